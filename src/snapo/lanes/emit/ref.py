"""Typed results of instructions."""

from dataclasses import dataclass

from ..numbers import TYPES


@dataclass(frozen=True)
class Ref:
    """A result: its text in the IR, element type (NumPy's name) and number of lanes."""

    text: str
    dtype: str
    lanes: int
    value: object = None  # where it is a known scalar

    @property
    def type(self) -> str:
        return f"<{self.lanes} x {TYPES[self.dtype]}>"

    @property
    def floating(self) -> bool:
        return self.dtype.startswith("float")

    @property
    def unsigned(self) -> bool:
        return self.dtype.startswith("uint") or self.dtype == "bool"
