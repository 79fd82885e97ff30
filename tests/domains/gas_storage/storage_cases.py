"""The cases of this folder, read, changed and made ready, each at most once per test run."""

from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from snapo.case.table import load
from snapo.domains.gas_storage.case import resolve
from snapo.domains.gas_storage.contract.inputs import storage_inputs
from snapo.domains.gas_storage.contract.records import StorageCase
from snapo.domains.gas_storage.contract.simulator import StorageSimulator
from snapo.domains.gas_storage.policy.network import StoragePolicy
from snapo.domains.gas_storage.problem import Problem, make_problem
from snapo.problem.prepare import prepare
from snapo.problem.simulator import probe
from snapo.solver import certificate

CASES = Path(__file__).parent / "cases"


def read(name: str, **tables: dict[str, Any]) -> StorageCase:
    """A case of this folder, with keys of its tables changed (None: removed)."""
    return changed(CASES / name, **tables)


def changed(folder: Path, **tables: dict[str, Any]) -> StorageCase:
    file, data = load(folder)
    for table, keys in tables.items():
        given = data.setdefault(table, {})
        given.update(keys)
        for key in [key for key, value in given.items() if value is None]:
            del given[key]
    return resolve(file, data)


def bare(case: StorageCase):
    """Simulator without a guide, inputs and schedule: enough for any decisions."""
    simulator, inputs = StorageSimulator(case), storage_inputs(case)
    return simulator, inputs, prepare(simulator, inputs)


def untrained(simulator: StorageSimulator, schedule, seed: int = 0) -> StoragePolicy:
    return StoragePolicy(probe(simulator, schedule)[1].shape[0], key=jax.random.key(seed))


@cache
def problem(name: str) -> Problem:
    """A case made ready for the native engine."""
    return make_problem(read(name), 0, "native")


def off_ties(inputs, **zeros: float):
    """Inputs a hair away, where round numbers no longer tie."""
    return certificate.nudged(inputs, zeros)


def random_actions(days: int, paths: int, seed: int = 0) -> np.ndarray:
    """Fractions of injection and withdrawal [days, paths, 2]; half of them are extremes."""
    random = np.random.default_rng(seed)
    drawn = random.uniform(-0.5, 1.5, (days, paths, 2))
    return np.clip(drawn, 0.0, 1.0)
