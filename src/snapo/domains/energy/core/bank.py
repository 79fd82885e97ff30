"""A bank between the periods of a level: units short in one are made up in the next, and units in
excess lower the next minimum.

A period ends where the counted level restarts. The balance Z of the bank is positive for volumes to
be made up, and negative for those carried forward; both come from the last period and are lost
after one more. With the minimum m of a period, and x+ = max(x, 0):

    own minimum        m - (-Z)+
    made up            u(Q, Z) = (Q - m)+ - (Q - m - Z+)+,   Q the volume of the period so far
    balance after it   share x (m - (-Z)+ - Q)+ - min((Q - m - Z+)+, limit)

The first Z+ units above the minimum are those made up: each earns `refund` as well. All
functions are linear between multiples of a common measure of m, Z, `limit` and the volumes.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxtyping import Array, Float


class Bank(NamedTuple):
    """The numbers of every step.

    - `minimum`: m; `share`: of the units short that may be made up, 1 or 0.
    - `limit`: of the units carried forward; `refund`: money for each unit made up.
    """

    minimum: Float[Array, " T"]
    share: Float[Array, " T"]
    limit: Float[Array, " T"]
    refund: Float[Array, " T"]

    def at(self, t: int) -> "Bank":
        """The row of a step."""
        return Bank(*(x[t] for x in self))

    def owed(self, balance: Any, positive: Callable) -> Any:
        """The own minimum of a period."""
        return self.minimum - positive(-balance)

    def made_up(self, counted: Any, balance: Any, positive: Callable) -> Any:
        """Units made up so far."""
        above = counted - self.minimum
        return positive(above) - positive(above - positive(balance))

    def settled(self, counted: Any, balance: Any, positive: Callable) -> Any:
        """The balance after a period; it falls with the volume, and rises with the balance."""
        short = positive(self.owed(balance, positive) - counted)
        excess = positive(counted - self.minimum - positive(balance))
        return self.share * short - (excess - positive(excess - self.limit))
