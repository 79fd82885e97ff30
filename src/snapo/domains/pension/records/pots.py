"""Personal pots under the Dutch Future of Pensions Act, and the outputs of their paths; conventions
as in `records.case`.
"""

from dataclasses import dataclass

from snapo.case.given import CaseInput
from snapo.problem.record import TreeRecord

from .people import FundMembers


@dataclass(frozen=True, eq=False)
class PotRules:
    """The state of the law; see the comments in `regulation/dutch_wtp.toml`.

    - `largest`: the largest solidarity reserve, as a share of all assets; `from_contributions`,
      `from_excess_return`: the largest shares of a year's contributions and excess return that may
      be paid into the reserve.
    """

    since: str
    source: str
    largest: float
    from_contributions: float
    from_excess_return: float


class Pots(TreeRecord):
    """Personal pots instead of rights; C cohorts, shares as fractions.

    - `reserve`: the share of the solidarity reserve in the assets now; `largest`: the largest share
      that it may have.
    - `fill_contribution`, `fill_return`: the shares of contributions and of a year's positive
      excess return, see `pots.sharing`, that are paid into it; `release`: the largest share of it
      that may be used in a year to restore pensions in payment. All index [].
    - `protection`: the share of a cohort's pot that earns the return of its annuity, while the
      rest earns the return of cash; `exposure`: the weight of the pot in the excess return; both
      by age, index [T, C].
    """

    rules: PotRules
    reserve: CaseInput
    fill_contribution: CaseInput
    fill_return: CaseInput
    release: CaseInput
    largest: CaseInput
    protection: CaseInput
    exposure: CaseInput


# At the horizon: the mean pension over that of today, weighted by the pots of today, and the
# reserve's share of the assets. Sums over steps: money into the reserve at the ends of years, and
# out of it.
POT_OUTPUTS = ("pension", "reserve", "filled", "released")


def pensions(members: FundMembers | None) -> tuple[str, ...]:
    """The names of the outputs of cohorts: a cohort's pension at the horizon divided by that of
    today."""
    return () if members is None else tuple(f"pension {name}" for name in members.names)
