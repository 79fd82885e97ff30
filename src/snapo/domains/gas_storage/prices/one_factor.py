"""`[model]` of kind "one-factor": one mean-reverting factor, its volatility by delivery day."""

from typing import Literal

from pydantic import Field

from snapo.case.table import Section, Table

from ..read.tables import AMOUNT, FileName, NotNegative
from .given_factors import GivenFactors, read_factors
from .process import Delivery, register


class OneFactorTable(Table):
    """`[model]` of kind "one-factor"."""

    kind: Literal["one-factor"]
    mean_reversion: NotNegative = Field(description="a number of at least 0")
    volatility: NotNegative | FileName = Field(description=AMOUNT)


@register
class OneFactor(GivenFactors):
    """S = F exp(s f - variance / 2), one Ornstein-Uhlenbeck factor."""

    kind = "one-factor"
    table = OneFactorTable

    @classmethod
    def read(cls, section: Section, table: OneFactorTable, delivery: Delivery):
        given = read_factors(section, [table], [], delivery, numbered=False)
        return cls(delivery, *given)  # pyright: ignore[reportCallIssue]

    def words(self) -> str:
        return "One factor, mean-reverting, volatility by delivery day"
