"""Quality limits as arrays: which hold, and how far a value is from them."""

from typing import NamedTuple

import numpy as np

from ..flowsheet.case import PharmaCase
from ..flowsheet.possible import least


class Limits(NamedTuple):
    """[Q] `low` and `high` in the attributes' units; infinite where there is none. `least`: the
    least value that is possible at all: a filtration time below 0 keeps no limit."""

    low: np.ndarray
    high: np.ndarray
    least: np.ndarray

    @classmethod
    def of(cls, case: PharmaCase) -> "Limits":
        low = [-np.inf if each.low is None else each.low for each in case.attributes]
        high = [np.inf if each.high is None else each.high for each in case.attributes]
        possible = [each.scale * least(each.measure) for each in case.attributes]
        return cls(np.array(low), np.array(high), np.array(possible))

    def hold(self, values: np.ndarray) -> np.ndarray:
        """[…, Q] whether each limit holds; a value that is not finite breaks a limit."""
        kept = (values >= self.low) & (values <= self.high)
        kept = kept | ~self.any() & np.isfinite(values)
        return np.asarray(kept & (values >= self.least))

    def any(self) -> np.ndarray:
        """[Q] whether an attribute has a limit."""
        return np.isfinite(self.low) | np.isfinite(self.high)

    def distance(self, values: np.ndarray) -> np.ndarray:
        """[…, Q] to the nearest limit, below 0 beyond it, infinite where there is none."""
        return np.minimum(values - self.low, self.high - values)
