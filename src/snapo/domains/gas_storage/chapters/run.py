"""The files of a storage run, as the report of the run reads them, with the units of gas."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pydantic import TypeAdapter

from snapo.report.folder import RunFiles
from snapo.report.folder import Sensitivity as Sensitivity
from snapo.report.quantity import quantity

# Moves of the inputs' size that a slider goes to either side.
SPAN = 10


@dataclass(frozen=True)
class InputEntry:
    """An input in run.json: its metadata, in the unit of the input."""

    words: str = ""
    group: str = ""
    unit: str = ""
    move: float | None = None
    trade_unit: str = ""
    trade_factor: float = 1.0


ENTRIES = TypeAdapter(dict[str, InputEntry])


@dataclass(frozen=True)
class ReportedInput:
    """The metadata of an input; see `snapo.problem.inputs.Input`.

    `move` is in the unit of the input, and `trade_move` is the same move in the display unit,
    `trade_unit`.
    """

    name: str
    meaning: str
    group: str
    move: float
    trade_move: float
    trade_unit: str

    def title(self, label: str = "") -> str:
        """The name in a table, such as "Spot volatility", with the label of one number."""
        text = self.name.replace("_", " ").replace(".", " ").strip().capitalize()
        return f"{text}, {label}" if label else text


@dataclass(frozen=True)
class StorageRun(RunFiles):
    """A run folder, with the units of its contract."""

    @cached_property
    def inputs(self) -> dict[str, InputEntry]:
        """The metadata of the inputs by name."""
        return ENTRIES.validate_python(self.get("inputs", {}))

    def input_number(self, name: str, unit: str = "") -> ReportedInput:
        """The metadata of the input `name`; a move of one unit if it has none."""
        entry = self.inputs.get(name, InputEntry())
        move, factor = entry.move or 1.0, entry.trade_factor or 1.0
        plain = unit if unit not in ("", "1") else "unit"
        return ReportedInput(
            name, entry.words, entry.group, move, move * factor, entry.trade_unit or plain
        )

    def group(self, *groups: str) -> list[Sensitivity]:
        """The sensitivities to inputs of these families."""
        return [
            sensitivity
            for sensitivity in self.sensitivities
            if self.input_number(sensitivity.input).group in groups
        ]

    @property
    def days(self) -> list[str] | None:
        """The decision days [T], as ISO dates."""
        return self.get("days") or self.profile.get("date") or None

    @property
    def volume(self) -> str:
        """The unit of gas, "MWh"."""
        return str(self.get("volume_unit", "units"))

    @property
    def price(self) -> str:
        """The unit of a price, "EUR/MWh"."""
        return f"{self.currency}/{self.volume}" if self.currency else f"per {self.volume}"

    @property
    def daily(self) -> str:
        """The unit of a flow, "MWh/day"."""
        return f"{self.volume}/day"

    def gas(self, value: Any, digits: int | None = None) -> str:
        return quantity(value, self.volume, digits)
