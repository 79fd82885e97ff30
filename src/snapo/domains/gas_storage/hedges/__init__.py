"""Profit and loss of a contract and its hedge, and the list of hedges."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

from ..ladder.products import BALANCE, DAY_AHEAD

DELTAS, MIN_VARIANCE = "deltas", "least variance"


class DailyHedge(NamedTuple):
    """A hedge that is adjusted on each day, in the `families` of [products].

    - `rule`: with DELTAS each product hedges its own exposure; with MIN_VARIANCE the first product
      of each family is traded, such that the variance of the next day is smallest.
    """

    rule: str
    families: tuple[str, ...]

    @property
    def title(self) -> str:
        return "Daily, least variance" if self.rule == MIN_VARIANCE else "Daily, deltas"

    @property
    def products(self) -> str:
        """The products as text. Least variance uses only the first product of a family: for
        "months", the next month."""
        if self.rule != MIN_VARIANCE:
            return as_text(self.families)
        return as_text([f"next {x[:-1]}" if x.endswith("s") else x for x in self.families])


def as_text(families: Sequence[str]) -> str:
    """Keys of [products] as text for a reader."""
    return ", ".join(family.replace("_", " ") for family in families)


def usual_hedges(families: Collection[str]) -> tuple[DailyHedge, ...]:
    """Hedges of deltas in longer products, then with shorter products added; and hedges of least
    variance in one family, and in all families.

    `families`: the families that are traded, the shortest first.
    """
    short = [family for family in families if family in (DAY_AHEAD, BALANCE)]
    longer = tuple(family for family in families if family not in short)
    sets = [longer] if longer else []
    for family in reversed(short):
        sets.append((family, *(sets[-1] if sets else ())))
    single = [family for family in families if family != BALANCE]
    minimum = [(family,) for family in single] + ([tuple(single)] if len(single) > 1 else [])
    return (*(DailyHedge(DELTAS, x) for x in sets), *(DailyHedge(MIN_VARIANCE, x) for x in minimum))
