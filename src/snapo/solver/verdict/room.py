"""How much a policy can still gain, where a bound from above or the exact value is known."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

NEAR = 0.005  # of the bound: nothing is left that a longer training should look for
USEFUL = 0.05  # of the bound: one that leaves more room tells nothing of a training
SIGNIFICANT = 2.0  # standard errors


class Room(NamedTuple):
    """The share of a value that can be gained at most, and the sentence on it."""

    share: float
    description: str

    @property
    def near(self) -> bool:
        """Whether that is next to nothing."""
        return self.share <= NEAR


def room(
    value: float | None,
    error: float | None,
    bounds: Mapping[str, Any] | None = None,
    exact: float | None = None,
) -> Room | None:
    """What is known of a value; None where nothing is, or no more than `USEFUL` could say.

    - `bounds`: as `Bound.row` has it; `exact`: the exact value, of which no policy has more.
    """
    results = [_below_exact(value, error, exact), _below_bound(bounds)]
    available = [item for item in results if item is not None and item.share <= USEFUL]
    return min(available, key=lambda entry: entry.share) if available else None


def _below_exact(value, error, exact) -> Room | None:
    if value is None or not exact or not np.isfinite([value, exact]).all():
        return None
    share = max(0.0, (exact - value + SIGNIFICANT * (error or 0.0)) / abs(exact))
    return Room(share, f"{_at_most(share)}: the exact value is {exact:,.6g}.")


def _below_bound(bounds) -> Room | None:
    if not bounds:
        return None
    gap, upper = bounds["gap"]["high"], bounds["upper"]
    if None in (gap, upper["value"]) or not upper["value"] or not np.isfinite(gap):
        return None
    share = max(0.0, gap / abs(upper["value"]))
    error = upper["standard_error"] or 0.0
    return Room(
        share,
        f"{_at_most(share)}: no policy is worth more than {upper['value']:,.6g} ± {error:,.2g}.",
    )


def _at_most(share: float) -> str:
    if share == 0:
        return "Nothing can be gained over this policy"
    return f"At most {100 * share:.2g} % can be gained over this policy"
