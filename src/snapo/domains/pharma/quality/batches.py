"""Batches for every statistic of a study: one list of varied numbers, so one compiled function."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..flowsheet.case import PharmaCase
from ..given import Entry
from .draws import all_draws, all_entries

if TYPE_CHECKING:
    from ..flowsheet.process import Process

CHUNK = 128  # batches side by side; few rows are filled up to it, so that nothing compiles again


def varied(case: PharmaCase) -> tuple[Entry, ...]:
    """What varies from batch to batch, and after it the parameters that hold exactly."""
    available = all_entries(case)
    every = [(parameter.input, parameter.entry) for parameter in case.parameters]
    return available + tuple(entry for entry in every if entry not in available)


def inputs_with(
    process: "Process",
    changes: Mapping[Entry, float],
    about: Mapping[str, np.ndarray] | None = None,
) -> dict[str, np.ndarray]:
    """The process's inputs, or those `about`, with some entries replaced."""
    available = process.inputs if about is None else about
    inputs = {name: np.array(values, np.float64) for name, values in available.items()}
    for (name, entry), value in changes.items():
        inputs[name][entry] = value
    return inputs


def drawn(
    process: "Process", changes: Mapping[Entry, float], samples: int, seed: int
) -> np.ndarray:
    """[samples, V] draws of `varied` about the set point moved by `changes`; the same each time."""
    about = inputs_with(process, changes)
    batch = all_draws(process.case, samples, seed, about)
    fixed = [about[name][entry] for name, entry in varied(process.case)[batch.shape[1] :]]
    return np.hstack([batch, np.broadcast_to(fixed, (samples, len(fixed)))])


def nominally(process: "Process", changes: Mapping[Entry, float]) -> np.ndarray:
    """[1, V] the nominal model at the set point moved by `changes`."""
    about = inputs_with(process, changes)
    return np.array([[about[name][entry] for name, entry in varied(process.case)]])


def attributes(process: "Process", rows: np.ndarray) -> np.ndarray:
    """[n, Q] attributes of `rows` [n, V]; a batch without a finite result is NaN throughout."""
    count = len(rows)
    if count < CHUNK:
        rows = np.concatenate([rows, np.repeat(rows[:1], CHUNK - count, 0)])
    batch = process.batch(varied(process.case), rows, chunk=CHUNK)
    return np.where(batch.ok[:, None], batch.values, np.nan)[:count]
