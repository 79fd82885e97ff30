"""Fields of a table: each description is the text that an error message quotes as allowed."""

import math
from typing import Annotated, Any

from pydantic import Field

from snapo.case.quantity import Range

PROBABILITY = Range(0.0, 1.0, "()", noun="a probability")
TextKey = Annotated[str, Field(min_length=1)]


Texts = Annotated[list[TextKey], Field(min_length=1)]


def quantity(subject: str, default: Any = ..., meaning: str | None = None) -> Any:
    """A field for a number with a unit, required without a default. `meaning`: its meaning."""
    text = f"a quantity in quotation marks, such as {subject}"
    return Field(default, description=text, title=meaning)


def whole(low: int, high: float = math.inf, default: Any = ..., note: str = "") -> Any:
    """A field for a whole number of a range."""
    return within(Range(low, high, note=note, noun="a whole number"), default)


def within(bounds: Range, default: Any = ...) -> Any:
    """A field for a number of a range, which its type does not repeat."""
    low, high = bounds.endpoints
    limits = {
        "gt" if low == "(" else "ge": bounds.low,
        "lt" if high == ")" else "le": bounds.high,
    }
    limits: Any = {name: end for name, end in limits.items() if math.isfinite(end)}
    return Field(default, description=str(bounds), **limits)


def tables(name: str) -> Any:
    """A field for one table of an array, or more."""
    return Field(description=f"one table {name} or more", min_length=1)


def pair(subject: str) -> Any:
    """A field for a list of two."""
    return Field(description=f"two {subject}", min_length=2, max_length=2)


def word(*text: str, default: Any = ...) -> Any:
    """A field for one of a few names."""
    return Field(default, description=" or ".join(f'"{item}"' for item in text))
