"""Batches for every statistic of a study; all use the same list of varied numbers, and so one
compiled function. Also quality limits as arrays: which are met, and the distance of a value from
them.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..flowsheet.case import PharmaCase
from ..flowsheet.possible import smallest
from ..given import Entry
from .draws import all_draws, all_entries

if TYPE_CHECKING:
    from ..flowsheet.process import PharmaProcess

CHUNK = 128  # batches side by side; few rows are filled up to it, so that nothing compiles again


def varied(case: PharmaCase) -> tuple[Entry, ...]:
    """The numbers that vary from batch to batch, followed by the parameters that do not."""
    available = all_entries(case)
    every = [(parameter.input, parameter.entry) for parameter in case.parameters]
    return available + tuple(entry for entry in every if entry not in available)


def inputs_with(
    process: "PharmaProcess",
    changes: Mapping[Entry, float],
    about: Mapping[str, np.ndarray] | None = None,
) -> dict[str, np.ndarray]:
    """The inputs of the process, or the inputs `about`, with some entries replaced."""
    available = process.inputs if about is None else about
    inputs = {name: np.array(values, np.float64) for name, values in available.items()}
    for (name, entry), value in changes.items():
        inputs[name][entry] = value
    return inputs


def drawn(
    process: "PharmaProcess", changes: Mapping[Entry, float], samples: int, seed: int
) -> np.ndarray:
    """[samples, V] draws of `varied` about the set point moved by `changes`; every call has the
    same draws."""
    about = inputs_with(process, changes)
    batch = all_draws(process.case, samples, seed, about)
    fixed = [about[name][entry] for name, entry in varied(process.case)[batch.shape[1] :]]
    return np.hstack([batch, np.broadcast_to(fixed, (samples, len(fixed)))])


def nominally(process: "PharmaProcess", changes: Mapping[Entry, float]) -> np.ndarray:
    """[1, V] the numbers of the nominal model at the set point moved by `changes`."""
    about = inputs_with(process, changes)
    return np.array([[about[name][entry] for name, entry in varied(process.case)]])


def attributes(process: "PharmaProcess", rows: np.ndarray) -> np.ndarray:
    """[n, Q] attributes of `rows` [n, V]; a batch without a finite result is NaN throughout."""
    count = len(rows)
    if count < CHUNK:
        rows = np.concatenate([rows, np.repeat(rows[:1], CHUNK - count, 0)])
    batch = process.batch(varied(process.case), rows, chunk=CHUNK)
    return np.where(batch.ok[:, None], batch.values, np.nan)[:count]


class AttributeLimits(NamedTuple):
    """[Q] `low` and `high` in the attributes' units; infinite if there is none. `least`: the
    smallest possible value; a value below it, such as a negative filtration time, meets no
    limit."""

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
        """[…, Q] whether each limit is met; a non-finite value violates a limit."""
        selected = (values >= self.low) & (values <= self.high)
        selected = selected | ~self.any() & np.isfinite(values)
        return np.asarray(selected & (values >= self.lower))

    def any(self) -> np.ndarray:
        """[Q] whether an attribute has a limit."""
        return np.isfinite(self.low) | np.isfinite(self.high)

    def distance(self, values: np.ndarray) -> np.ndarray:
        """[…, Q] to the nearest limit, below 0 beyond it, infinite if there is none."""
        return np.minimum(values - self.low, self.high - values)
