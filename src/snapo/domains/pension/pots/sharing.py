"""The shares of pots in the return of a fund, and the solidarity reserve at the end of a year.

    protection of a cohort     = V (x R + (1 - x) Rc)
    protection of the reserve  = S Rc
    excess return              = the whole return - all protection
    a cohort's share of excess = exposure x pot / (the sum of exposure x pot + S)

V is the pot of a cohort, x its share of protection, and S the reserve. R, the return of a cohort's
annuity, is that of its payments on the curve of the path, so that a fully protected pot buys the
same pension at any rates. Rc is the return of cash over the step. If all assets of the fund earn
Rc, every pot and the reserve also earn Rc, for any protections and exposures: there is no ex-ante
redistribution.

Source: De Nederlandsche Bank, Open Boek Toezicht, Q&A "Hoe kan een pensioenuitvoerder de
toedelingsregels zo vormgeven dat er op voorhand geen herverdelingseffecten tussen leeftijdsgroepen
plaatsvinden in de solidaire premieregeling?" (29 June 2023, updated 7 November 2023), step 1: V RH
is credited to a pot, on the whole of V; R is the return of the protection portfolio or of
zero-coupon bonds, Rc that of cash, x the share of interest rates that is hedged. Its formula of RH
is an image that could not be read: RH = x R + (1 - x) Rc follows from this text, and from
Pensioenwet, art. 10a (5), which forbids redistribution beforehand between pots, and between them
and the reserve (DNB, factsheet "Toedelingsregels in de solidaire premieregeling", 29 June 2023).

The reserve has an exposure of one; a loss that it cannot bear falls on the pots, in proportion to
exposure times pot. All functions conserve money: afterwards pots and reserve add up to their sum
before plus the return.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.smooth import Constraints

ROUND = 0.001  # of the assets, over which corners are rounded while training


class SharedResult(NamedTuple):
    """Money of each cohort's pot [C] and of the reserve, and the collective `excess` return."""

    pots: Float[Array, " C"]
    reserve: Array
    excess: Array


class Reserve(NamedTuple):
    """The rules of the reserve: shares, see `records.pots.Pots`."""

    fill_return: Array
    release: Array
    largest: Array


class ClosedPots(NamedTuple):
    """After the end of a year: `pots` [C], `reserve`, the money `filled` into it (negative if it
    was too large and money was returned) and `released` from it."""

    pots: Float[Array, " C"]
    reserve: Array
    filled: Array
    released: Array


def shared(
    pots: Float[Array, " C"],
    reserve: Array,
    earned: Array,
    returned: Float[Array, " C"],
    cash: Array,
    protection: Float[Array, " C"],
    exposure: Float[Array, " C"],
    smooth: Constraints,
) -> SharedResult:
    """The parts of the return `earned` in a step, in money.

    **Arguments:**

    - `pots`, `reserve`: the pots and the reserve that earned the return. `returned`, `cash`: the
      returns of each cohort's annuity and of cash over the step, as shares.
    """
    protected = pots * (protection * returned + (1 - protection) * cash)
    selected = reserve * cash
    excess = earned - jnp.sum(protected) - selected
    weights = exposure * pots
    complete = jnp.sum(weights) + reserve
    none = complete <= 0
    local = excess * reserve / jnp.where(none, 1.0, complete)
    local = smooth.maximum(local, -reserve - selected, ROUND * (jnp.sum(pots) + reserve))
    return SharedResult(
        protected + (excess - local) * _parts(weights, pots), selected + local, excess
    )


def closed(
    pots: Float[Array, " C"],
    reserve: Array,
    gained: Array,
    missing: Callable[[Array], Array],
    exposure: Float[Array, " C"],
    rules: Reserve,
    smooth: Constraints,
) -> ClosedPots:
    """The end of a year: the reserve takes its share of the excess return `gained` in the year,
    returns the money above its maximum size, and restores pensions.

    **Arguments:**

    - `missing`: a function of pots [C] that gives the money [C] that their pensions in payment
      lack.
    """
    total = jnp.sum(pots) + reserve
    scale = ROUND * total
    maximum = rules.largest * total
    requested = rules.fill_return * smooth.positive_part(gained, scale)
    # Positive: there is room. Negative: the reserve is too large, and gives back.
    filled = smooth.minimum(requested, maximum - reserve, scale)
    pots = pots - filled * _parts(exposure * pots, pots)
    reserve = reserve + filled
    lack = missing(pots)
    needed = jnp.sum(lack)
    released = smooth.minimum(needed, rules.release * reserve, scale)
    pots = pots + released * lack / jnp.where(needed > 0, needed, 1.0)
    released = jnp.where(needed > 0, released, 0.0)
    return ClosedPots(pots, reserve - released, filled, released)


def _parts(weights: Array, pots: Array) -> Float[Array, " C"]:
    """Shares in proportion to the weights, or to the pots if all weights are zero."""
    complete = jnp.sum(weights)
    weights = jnp.where(complete > 0, weights, pots)
    complete = jnp.sum(weights)
    return weights / jnp.where(complete > 0, complete, 1.0)
