"""The files of a storage run as its report reads them, with the units of gas."""

from dataclasses import dataclass
from typing import Any

from snapo.report.folder import Folder
from snapo.report.folder import Sensitivity as Sensitivity
from snapo.report.quantity import quantity


@dataclass(frozen=True)
class Run(Folder):
    """A run folder with the units of the contract."""

    @property
    def days(self) -> list[str] | None:
        """Decision days [T], ISO."""
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

    def gas(self, value: Any, places: int | None = None) -> str:
        return quantity(value, self.volume, places)
