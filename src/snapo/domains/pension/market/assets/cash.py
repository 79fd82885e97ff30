"""Cash: it earns the integral of the short rate, without further risk."""

from dataclasses import dataclass
from typing import ClassVar

from snapo.problem.record.either import xp

from ...records.assets import AttributionPart
from .asset_class import AssetClass, register


@register
@dataclass(frozen=True)
class Cash(AssetClass):
    """Cash in the fund's currency."""

    kind: ClassVar[str] = "cash"
    description: ClassVar[str] = "earns the short rate"
    columns: ClassVar[tuple[str, ...]] = ()
    without: ClassVar[str] = "its return is the short rate, which follows from the curve"
    part: ClassVar[AttributionPart] = "cash"
    risk: ClassVar[str] = "none"
    collateral: ClassVar[float] = 1.0
    is_cash: ClassVar[bool] = True

    @classmethod
    def read(cls, row, names):
        if row.cells.get("currency"):
            raise row.error("currency", "cash is held in the fund's currency")
        return {}

    @classmethod
    def prepare(cls, scene, positions):
        return None, None

    @classmethod
    def log_return(cls, case, positions, terms, steps, now):
        return xp.broadcast_to(now.cash, (len(positions),))

    @classmethod
    def payments(cls, case, positions):
        return None
