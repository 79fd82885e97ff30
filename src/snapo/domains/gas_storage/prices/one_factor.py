"""`[model]` of kind "one-factor": one mean-reverting factor, its volatility by delivery day."""

from typing import Literal

from snapo.case.table import Section

from .given_factors import FactorTable, GivenFactors, read_factors
from .process import Delivery, register


class OneFactorTable(FactorTable):
    """`[model]` of kind "one-factor"."""

    kind: Literal["one-factor"]


@register
class OneFactor(GivenFactors):
    """S = F exp(s f - variance / 2), one Ornstein-Uhlenbeck factor."""

    kind = "one-factor"
    table = OneFactorTable

    @classmethod
    def read(cls, section: Section, table: OneFactorTable, delivery: Delivery):
        given = read_factors(section, [table], [], delivery, numbered=False)
        return cls.of(delivery, *given)

    def describe(self) -> str:
        return "One factor, mean-reverting, volatility by delivery day"
