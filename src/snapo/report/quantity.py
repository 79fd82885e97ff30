"""Numbers as text for readers: with thousands separators, a proper minus sign and units."""

import datetime
import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from snapo.solver.statistics import half_width

MINUS = "\N{MINUS SIGN}"
NONE = "\N{EN DASH}"  # where there is no number
PLUS_MINUS = "± is half of a 95 % interval, simulation error only"  # where the first one stands
SPACE = "\N{NO-BREAK SPACE}"
ROUNDING = 1e-12  # relative, of sums in double precision
TINY, MAXIMUM = 1e-5, 7  # below which, and beyond how many decimals, a power of ten reads better
# A power of a unit; a digit after other letters may belong to a name, as in CO2.
POWER = re.compile(
    r"((?<![A-Za-z])(?:[cdhkmnuµ]?m|s|h|min|rad|K|ft|day|week|month|year)|\))\^?(-?\d)(?![\w.])"
)
MONTHS = "January February March April May June July August September October November December"


def finite(value: Any) -> float | None:
    """The number as a float; None if there is none or it is not finite."""
    if value is None or isinstance(value, str | bool):
        return None
    number = float(value)
    return number if math.isfinite(number) else None


def decimals(values: Iterable[Any], significant: int = 5) -> int:
    """The number of decimals, at least 0, with which the largest of `values` has `digits`
    significant digits. All numbers of a column have the same number of decimals, so that their
    decimal points are aligned.
    """
    sizes = [abs(number) for value in values if (number := finite(value)) is not None]
    largest = max(sizes, default=0.0)
    if largest == 0:
        return 0
    return max(0, significant - 1 - math.floor(math.log10(largest)))


def number(value: Any, digits: int | None = None, sign: bool = False) -> str:
    """`-1234.5` as "−1,234.5"; it has `digits` decimals, by default as many as four significant
    digits need.

    A number that would be mostly zeros is a power of ten: "1.578 × 10⁻⁶".
    """
    available = finite(value)
    if available is None:
        return NONE
    if available == 0 and digits is not None and digits > MAXIMUM:
        return "0"
    if 0 < abs(available) < TINY and (digits is None or digits > MAXIMUM):
        return ("+" if sign and available > 0 else "") + power(available, 3)
    text = f"{abs(available):,.{min(decimals([available], 4), 9) if digits is None else digits}f}"
    if digits is None and "." in text:
        text = text.rstrip("0").rstrip(".")
    if not any(digit in text for digit in "123456789"):
        return text
    if available < 0:
        return MINUS + text
    return "+" + text if sign else text


def quantity(value: Any, unit: str, digits: int | None = None, sign: bool = False) -> str:
    """A number with its unit after it; a line does not break between them."""
    text = number(value, digits, sign)
    return (
        text if text == NONE or not unit else f"{text}{SPACE}{unit_words(unit)}".replace(" ", SPACE)
    )


def money(value: Any, currency: str, digits: int | None = None, sign: bool = False) -> str:
    """A number with its currency before it: "EUR 78,312"."""
    text = number(value, digits, sign)
    return text if text == NONE or not currency else f"{currency}{SPACE}{text}"


def plus_minus(error: Any, digits: int) -> str:
    """Half of the 95 % interval, "± 41", from a standard error; "" if there is none.

    A number that `digits` decimals would round to zero keeps a digit: "± 0.00004".
    """
    available = finite(error)
    return plus_minus_half(None if available is None else half_width(available), digits)


def plus_minus_half(half: Any, digits: int) -> str:
    """The same text from the half-width of an interval."""
    available = finite(half)
    if available is None:
        return ""
    text = (
        power(available, 0) if _tiny(available) else number(available, _reached(available, digits))
    )
    return f"±{SPACE}{text}"


def measured(value: Any, error: Any, digits: int, sign: bool = False) -> tuple[str, str]:
    """A value and half of its 95 % interval, ("+0.00018", "± 0.00008"), from its standard error.

    Both have `digits` decimals, or more if the first digit of a smaller error needs more; both are
    powers of ten if they are very small. An error below the rounding of the value is omitted.
    """
    available, values = finite(error), finite(value)
    half = None if available is None else half_width(available)
    if half is not None and values is not None and abs(half) < ROUNDING * abs(values):
        half = 0.0
    if half is not None and _tiny(half) and values is not None and _tiny(values):
        return ("+" if sign and values > 0 else "") + rough(values), plus_minus_half(half, digits)
    if half is not None and not _tiny(half):
        digits = _reached(half, digits)
    return number(value, digits, sign), plus_minus_half(half, digits)


def rough(value: Any) -> str:
    """A number with few digits, for which only the size matters: "9.1", "−616", "1.9 × 10⁻⁸"."""
    available = finite(value)
    if available is None or available == 0:
        return number(available, 0)
    return power(available, 1) if _tiny(available) else number(available, decimals([available], 2))


def _tiny(value: float) -> bool:
    return 0 < abs(value) < TINY


def _reached(error: float, digits: int) -> int:
    """This number of decimals, or more if an error would otherwise be shown as 0."""
    return max(digits, decimals([error], 1)) if abs(error) < 0.5 * 10.0**-digits else digits


def percent(share: Any, digits: int = 1) -> str:
    """`0.1234` as "12.3 %"."""
    available = finite(share)
    return NONE if available is None else f"{number(100 * available, digits)}{SPACE}%"


def part_of(share: Any, digits: int = 2) -> str:
    """A share in percent; a share that would round to zero is "less than 0.01 %"."""
    available = finite(share)
    minimum = 10.0 ** -(digits + 2)
    if available is None or available == 0 or abs(available) >= minimum / 2:
        return percent(share, digits)
    return f"less than {percent(minimum, digits)}"


def unit_words(unit: str) -> str:
    """A unit in handwritten form: "kg/m3" as "kg/m³", "um" as "µm", "Pa*s" as "Pa·s"."""
    text = POWER.sub(lambda result: result[1] + raised(result[2]), unit)
    text = re.sub(r"\bsqrt\((\w+)\)|\b([A-Za-z]+)\^0\.5\b", r"√\1\2", text)
    return re.sub(r"\bum\b", "µm", text).replace("*", "·").replace("^k", "ᵏ")


def derivative_unit(value: str, unit: str) -> str:
    """The unit of a derivative: the unit of the value per unit of an input, with common units
    cancelled.

    >>> [derivative_unit("EUR", unit) for unit in ("EUR/MWh", "1", "MWh", "1/year", "EUR")]
    ['MWh', 'EUR', 'EUR/MWh', 'EUR·year', '1']
    >>> derivative_unit("", "MWh"), derivative_unit("points", "EUR/MWh")
    ('per MWh', 'points per EUR/MWh')
    """
    if unit in ("", "1"):
        return value or "1"
    top, _, bottom = unit.partition("/")
    if "/" in bottom or " " in unit:  # no simple quotient
        return f"{value or 'value'} per {unit}"
    if value and top == value:
        return bottom or "1"
    if top == "1":
        return f"{value}·{bottom}" if value else bottom
    if not bottom:
        return f"{value}/{unit}" if value else f"per {unit}"
    return f"{value or 'value'} per {unit}"


def readable(name: str) -> str:
    """A name from the code as text: "cash_flow" as "Cash flow", "plant.mass" as "Plant mass"."""
    text = re.sub(r"\bmwh\b", "MWh", name.replace("_", " ").replace(".", " "))
    return text[:1].upper() + text[1:]


def with_unit(name: str, unit: str) -> str:
    """A name with its unit after it: "Size, µm"; the name alone if there is no unit."""
    return name if unit in ("", "1") else f"{name}, {unit_words(unit)}"


def raised(text: str) -> str:
    """Digits and minus signs as superscripts."""
    return text.translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def power(value: Any, decimal_places: int = 1) -> str:
    """The size of an error; if it is very small or large, as a power of ten: "3.1 × 10⁻⁹"."""
    available = finite(value)
    if available is None or available == 0 or 1e-3 <= abs(available) < 1e4:
        return number(available)
    digits, exponent = f"{available:.{decimal_places}e}".split("e")
    digits = digits.rstrip("0").rstrip(".") if decimal_places > 1 else digits
    return f"{digits.replace('-', MINUS)}{SPACE}×{SPACE}10{raised(str(int(exponent)))}"


def long_date(day: Any) -> str:
    """`2021-04-25` as "25 April 2021"; anything else unchanged."""
    try:
        date = datetime.date.fromisoformat(str(day))
    except ValueError:
        return str(day) if day else NONE
    return f"{date.day}{SPACE}{MONTHS.split()[date.month - 1]}{SPACE}{date.year}"


def until(end: Any) -> str:
    """The last day of a period whose end, `end`, is excluded: `2022-04-01` as "31 March 2022"."""
    try:
        date = datetime.date.fromisoformat(str(end)[:10])
    except ValueError:
        return long_date(end)
    return long_date(date - datetime.timedelta(days=1))


def long_month(month: Any) -> str:
    """`2021-04`, or any day of that month, as "Apr 2021"; anything else unchanged."""
    try:
        date = datetime.date.fromisoformat(f"{str(month)[:7]}-01")
    except ValueError:
        return str(month) if month else NONE
    return f"{MONTHS.split()[date.month - 1][:3]}{SPACE}{date.year}"


def seconds(value: Any) -> str:
    """A duration: "0.02 s", "0.4 s", "83 s", "12 min 5 s"."""
    available = finite(value)
    if available is None:
        return NONE
    if available < 0.1:
        return f"{number(available, 2)}{SPACE}s" if available >= 0.005 else f"0{SPACE}s"
    if available < 120:
        return f"{number(available, 1 if available < 10 else 0)}{SPACE}s"
    return f"{int(available // 60)}{SPACE}min {int(available % 60)}{SPACE}s"


def array(values: Any) -> np.ndarray | None:
    """A list of numbers as float64, in which nulls become NaN; None if there is no number to
    show."""
    if values is None or len(values) == 0:
        return None
    numbers = np.array([math.nan if value is None else value for value in values], np.float64)
    return numbers if np.isfinite(numbers).any() else None
