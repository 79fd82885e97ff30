"""Numbers as a desk writes them: thousands separators, a true minus sign, a unit on every one."""

import datetime
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

MINUS = "\N{MINUS SIGN}"
NONE = "\N{EN DASH}"  # stands where there is no number
SPACE = "\N{NO-BREAK SPACE}"
MONTHS = "January February March April May June July August September October November December"


def finite(value: Any) -> float | None:
    """The number as a float, or None where there is none or it is not finite."""
    if value is None or isinstance(value, str | bool):
        return None
    number = float(value)
    return number if math.isfinite(number) else None


def decimals(values: Iterable[Any], significant: int = 5) -> int:
    """Decimals that give the largest of `values` this many significant digits, 0 at least.

    One count for a whole column, so that its decimal points stand under one another.
    """
    sizes = [abs(number) for value in values if (number := finite(value)) is not None]
    largest = max(sizes, default=0.0)
    if largest == 0:
        return 0
    return max(0, significant - 1 - math.floor(math.log10(largest)))


def number(value: Any, places: int | None = None, sign: bool = False) -> str:
    """`-1234.5` as "−1,234.5"; `places` decimals, or what four significant digits need."""
    known = finite(value)
    if known is None:
        return NONE
    text = f"{abs(known):,.{min(decimals([known], 4), 9) if places is None else places}f}"
    if places is None and "." in text:
        text = text.rstrip("0").rstrip(".")
    if not any(digit in text for digit in "123456789"):
        return text
    if known < 0:
        return MINUS + text
    return "+" + text if sign else text


def quantity(value: Any, unit: str, places: int | None = None, sign: bool = False) -> str:
    """A number with its unit behind it; the space between them does not break."""
    text = number(value, places, sign)
    return text if text == NONE or not unit else f"{text}{SPACE}{unit}"


def money(value: Any, currency: str, places: int | None = None, sign: bool = False) -> str:
    """A number with its currency before it: "EUR 78,312"."""
    text = number(value, places, sign)
    return text if text == NONE or not currency else f"{currency}{SPACE}{text}"


def plus_minus(error: Any, places: int) -> str:
    """A standard error, "± 41"; nothing where there is none."""
    known = finite(error)
    return "" if known is None else f"±{SPACE}{number(known, places)}"


def percent(share: Any, places: int = 1) -> str:
    """`0.1234` as "12.3 %"."""
    known = finite(share)
    return NONE if known is None else f"{number(100 * known, places)}{SPACE}%"


def power(value: Any) -> str:
    """A size of error, small or large as a power of ten: "3.1 × 10⁻⁹"."""
    known = finite(value)
    if known is None or known == 0 or 1e-3 <= abs(known) < 1e4:
        return number(known)
    digits, exponent = f"{known:.1e}".split("e")
    raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{digits.replace('-', MINUS)}{SPACE}×{SPACE}10{raised}"


def long_date(day: Any) -> str:
    """`2021-04-25` as "25 April 2021"; anything else as it stands."""
    try:
        date = datetime.date.fromisoformat(str(day))
    except ValueError:
        return str(day) if day else NONE
    return f"{date.day}{SPACE}{MONTHS.split()[date.month - 1]}{SPACE}{date.year}"


def long_month(month: Any) -> str:
    """`2021-04`, or any day of that month, as "Apr 2021"; anything else as it stands."""
    try:
        date = datetime.date.fromisoformat(f"{str(month)[:7]}-01")
    except ValueError:
        return str(month) if month else NONE
    return f"{MONTHS.split()[date.month - 1][:3]}{SPACE}{date.year}"


def seconds(value: Any) -> str:
    """A duration: "0.4 s", "83 s", "12 min 5 s"."""
    known = finite(value)
    if known is None:
        return NONE
    if known < 120:
        return f"{number(known, 1 if known < 10 else 0)}{SPACE}s"
    return f"{int(known // 60)}{SPACE}min {int(known % 60)}{SPACE}s"


def array(values: Any) -> np.ndarray | None:
    """A list of numbers as float64, its nulls as NaN; None where there is nothing to show."""
    if values is None or len(values) == 0:
        return None
    numbers = np.array([math.nan if each is None else each for each in values], np.float64)
    return numbers if np.isfinite(numbers).any() else None
