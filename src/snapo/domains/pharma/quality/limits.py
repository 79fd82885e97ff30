"""Quality limits as arrays: which hold, and how far a value is from them."""

from typing import NamedTuple

import numpy as np

from ..flowsheet.case import PharmaCase
from ..flowsheet.possible import smallest


class AttributeLimits(NamedTuple):
    """[Q] `low` and `high` in the attributes' units; infinite where there is none. `least`: the
    smallest possible value: a filtration time below 0 keeps no limit."""

    low: np.ndarray
    high: np.ndarray
    lower: np.ndarray

    @classmethod
    def of(cls, case: PharmaCase) -> "AttributeLimits":
        low = [-np.inf if attribute.low is None else attribute.low for attribute in case.attributes]
        high = [np.inf if item.high is None else item.high for item in case.attributes]
        possible = [entry.scale * smallest(entry.measure) for entry in case.attributes]
        return cls(np.array(low), np.array(high), np.array(possible))

    def hold(self, values: np.ndarray) -> np.ndarray:
        """[…, Q] whether each limit holds; a non-finite value breaks a limit."""
        selected = (values >= self.low) & (values <= self.high)
        selected = selected | ~self.any() & np.isfinite(values)
        return np.asarray(selected & (values >= self.lower))

    def any(self) -> np.ndarray:
        """[Q] whether an attribute has a limit."""
        return np.isfinite(self.low) | np.isfinite(self.high)

    def distance(self, values: np.ndarray) -> np.ndarray:
        """[…, Q] to the nearest limit, below 0 beyond it, infinite where there is none."""
        return np.minimum(values - self.low, self.high - values)
