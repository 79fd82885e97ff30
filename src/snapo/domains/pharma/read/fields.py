"""Fields of a table: each description is the text that an error message quotes as allowed."""

from typing import Annotated, Any, Literal

from pydantic import Field

from snapo.case.table import CaseTable

NUMBER = "a number, such as 1.32"


TextKey = Annotated[str, Field(min_length=1)]


Texts = Annotated[list[TextKey], Field(min_length=1)]


def quantity(subject: str, default: Any = ..., meaning: str | None = None) -> Any:
    """A field for a number with a unit, required without a default. `meaning`: its meaning."""
    text = f"a quantity in quotation marks, such as {subject}"
    return Field(default, description=text, title=meaning)


def number(subject: str = NUMBER, default: Any = ..., meaning: str | None = None) -> Any:
    """A field for a pure number."""
    return Field(default, description=subject, title=meaning)


def profile(default: Any = ..., meaning: str | None = None) -> Any:
    """A field for a temperature, or any control, over time."""
    message = 'a quantity such as "313.15 K", or { nodes = ["313 K", "278 K"] }'
    return Field(default, description=message, title=meaning)


def word(*text: str, default: Any = ...) -> Any:
    """A field for one of a few words."""
    return Field(default, description=" or ".join(f'"{item}"' for item in text))


class ProfileTable(CaseTable):
    """{ nodes = ["313.15 K", "278.15 K"], at = [0, 1], kind = "linear", ramp = "0.5 K/min" }"""

    nodes: Any = Field(description='a list of quantities, such as ["313 K", "278 K"]')
    at: Any = Field(None, description="shares of the unit's duration, rising from 0 to 1")
    kind: Literal["linear", "constant"] = word("linear", "constant", default="linear")
    ramp: Any = quantity('"0.5 K/min"', None)
