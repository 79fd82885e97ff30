"""`[demand]` of kind "normal"."""

from typing import Literal

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable, TableContext, doc

from .base import DEVIATION, MEAN, Demand, deviation_key, mean_key, register


class NormalTable(CaseTable):
    """`[demand]` of kind "normal"."""

    kind: Literal["normal"] = doc("normal demand; negative demand means returned goods")
    mean: CaseInput = mean_key()
    deviation: CaseInput = deviation_key()


@register
class NormalDemand(Demand):
    """Demand is mean + deviation z. Negative demand means returned goods; it is rare if the mean is
    at least 3 deviations."""

    kind = "normal"
    table = NormalTable
    mean: CaseInput
    spread: CaseInput

    @classmethod
    def read(cls, section: TableContext, table: NormalTable, maximum: float):
        mean, deviation = table.mean.values[0], table.deviation.values[0]
        if deviation > mean:
            message = (
                f"it must be at most the mean, {mean:g}; otherwise demand would often be negative"
            )
            raise section.error("deviation", float(deviation), message)
        return cls(table.mean, table.deviation)

    def prepare(self, parameters, factors):
        return {"mean": parameters[MEAN] * factors, "deviation": parameters[DEVIATION] * factors}

    def draw(self, now, normal, spread):
        return now["mean"] + now["deviation"] * normal

    def deviation(self, parameters, factors):
        return parameters[DEVIATION] * factors

    def describe(self) -> str:
        mean, spread = self.mean.values[0], self.spread.values[0]
        return f"normal, mean {mean:g}, standard deviation {spread:g}"
