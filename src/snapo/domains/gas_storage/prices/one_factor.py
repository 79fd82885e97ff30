"""`[model]` of kind "one-factor": one mean-reverting factor, its volatility by delivery day."""

from typing import Literal

from .given_factors import FactorTable, GivenFactors
from .process import register


class OneFactorTable(FactorTable):
    """`[model]` of kind "one-factor"."""

    kind: Literal["one-factor"]


@register
class OneFactor(GivenFactors):
    """S = F exp(s f - variance / 2), one Ornstein-Uhlenbeck factor."""

    kind = "one-factor"
    table = OneFactorTable

    def describe(self) -> str:
        return "One factor, mean-reverting, volatility by delivery day"
