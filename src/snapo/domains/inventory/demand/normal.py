"""`[demand]` of kind "normal"."""

from typing import Literal

from pydantic import Field

from snapo.case.table import CaseTable, Positive, TableContext

from .base import DEVIATION, MEAN, Demand, deviation_given, mean_given, register


class NormalTable(CaseTable):
    """`[demand]` of kind "normal"."""

    kind: Literal["normal"]
    mean: Positive = Field(description="a number above 0")
    deviation: Positive = Field(description="a number above 0")


@register
class NormalDemand(Demand):
    """mean + deviation z. Below zero it is goods that come back; rare from 3 deviations on."""

    kind = "normal"
    table = NormalTable
    mean: float
    spread: float
    unit: str

    @classmethod
    def read(cls, section: TableContext, table: NormalTable, unit: str, maximum: float):
        if table.deviation > table.mean:
            message = f"allowed is at most the mean, {table.mean:g}: demand would often be below 0"
            raise section.error("deviation", table.deviation, message)
        return cls(table.mean, table.deviation, unit)

    def inputs(self):
        return mean_given(self.mean, self.unit), deviation_given(self.spread, self.unit)

    def prepare(self, parameters, factors):
        return {"mean": parameters[MEAN] * factors, "deviation": parameters[DEVIATION] * factors}

    def draw(self, now, normal, spread):
        return now["mean"] + now["deviation"] * normal

    def deviation(self, parameters, factors):
        return parameters[DEVIATION] * factors

    def describe(self) -> str:
        return f"normal, mean {self.mean:g}, standard deviation {self.spread:g}"
