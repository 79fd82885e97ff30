"""A bank between the periods of a level: units short in one period can be made up in the next
periods, and units in excess lower the next minimum.

A period ends where the counted level restarts. The balances Z_1 to Z_N of the bank are ordered by
age: Z_k comes from k periods ago. Z_1 is positive for volumes to be made up, and negative for
volumes carried forward, which are lost after one period. The other balances are not negative, and
Z_N is lost after this period. The oldest units are made up first. m is the minimum of a period,
x+ = max(x, 0), O_k is the sum of Z_j+ over j > k, and O_0 the sum over all j:

    own minimum        m - (-Z_1)+
    made up            u(Q) = (Q - m)+ - (Q - m - O_0)+,   Q the volume of the period so far
    of age k           u_k(Q) = (Q - m - O_k)+ - (Q - m - O_k - Z_k+)+
    balances after it  share x (m - (-Z_1)+ - Q)+ - min((Q - m - O_0)+, limit), and Z_k+ - u_k(Q)

The first O_0 units above the minimum are those made up, and each of them also earns `refund`. All
functions are linear between multiples of a common measure of m, the balances, `limit` and the
volumes.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from snapo.problem.record.arrays import Array, Float


class Bank(NamedTuple):
    """The numbers of every step; balances are ordered by age, the newest first.

    - `minimum`: m; `share`: the share of the missing units that may be made up, 1 or 0.
    - `limit`: the maximum of the units carried forward; `refund`: the amount earned for each unit
      made up.
    """

    minimum: Float[Array, " T"]
    share: Float[Array, " T"]
    limit: Float[Array, " T"]
    refund: Float[Array, " T"]

    def at(self, t: int) -> "Bank":
        """The row of a step."""
        return Bank(*(x[t] for x in self))

    def owed(self, balances: Sequence[Any], positive: Callable) -> Any:
        """The minimum of a period, minus the units carried forward to it."""
        return self.minimum - positive(-balances[0])

    def made_up(self, counted: Any, balances: Sequence[Any], positive: Callable) -> Any:
        """Units made up so far."""
        above = counted - self.minimum
        return positive(above) - positive(above - _units(balances, positive))

    def settled(self, counted: Any, balances: Sequence[Any], positive: Callable) -> list[Any]:
        """The balances after a period. They fall with the volume of the period, and rise with the
        balances before it."""
        above = counted - self.minimum
        short = positive(self.owed(balances, positive) - counted)
        excess = positive(above - _units(balances, positive))
        result = [self.share * short - (excess - positive(excess - self.limit))]
        for k, balance in enumerate(balances[:-1]):
            left, units = above - _units(balances[k + 1 :], positive), positive(balance)
            result.append(units - (positive(left) - positive(left - units)))
        return result


def _units(balances: Sequence[Any], positive: Callable) -> Any:
    """The units to be made up, summed over all balances."""
    parts = [positive(balance) for balance in balances]
    return sum(parts[1:], parts[0])
