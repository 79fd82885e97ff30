"""The cases of this folder, read, changed and made ready, each at most once per test run."""

from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from snapo.case.load import load
from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.contract.records import StorageCase, storage_inputs
from snapo.domains.gas_storage.contract.simulator import StorageSimulator
from snapo.domains.gas_storage.policy.network import StoragePolicy
from snapo.domains.gas_storage.setup import make_setup
from snapo.problem.problem import prepare
from snapo.problem.simulator import probe
from snapo.study.study import Setup

CASES = Path(__file__).parent / "cases"
# The slow store of G6 for two months and a few paths: a whole run in seconds.
SMALL = (
    "contract.end=2009-06-05", "contract.max_inventory=8.0", "training.steps=2",
    "training.paths=32", "evaluation.paths=256", "evaluation.sensitivity_paths=64",
    "evaluation.judge_paths=0",
)  # fmt: skip


def read_case(path: Path) -> StorageCase:
    """The case at a path, a TOML file or a folder with `case.toml`."""
    return DOMAIN.read(*load(path))


def read(name: str | Path, **tables: dict[str, Any]) -> StorageCase:
    """A case of this folder, or of another one, with keys of its tables changed (None: removed)."""
    return changed(CASES / name, **tables)


def changed(folder: Path, **tables: dict[str, Any]) -> StorageCase:
    return DOMAIN.read(*tables_of(folder, **tables))


def tables_of(folder: Path, **tables: dict[str, Any]) -> tuple[Path, dict[str, Any]]:
    """File and tables of a case, with keys changed (None: removed)."""
    file, data = load(folder)
    for table, keys in tables.items():
        given = data.setdefault(table, {})
        given.update(keys)
        for key in [key for key, value in given.items() if value is None]:
            del given[key]
    return file, data


def with_table(name: str, text: str, folder: Path) -> Path:
    """A folder with a case of this one, and the text of one more table."""
    folder.mkdir()
    (folder / "curve.csv").write_text((CASES / name / "curve.csv").read_text())
    (folder / "case.toml").write_text((CASES / name / "case.toml").read_text() + f"\n{text}\n")
    return folder


def bare(case: StorageCase):
    """Simulator without a value table, inputs and schedule: enough for any decisions."""
    simulator, inputs = StorageSimulator.of(case), storage_inputs(case)
    return simulator, inputs, prepare(simulator, inputs)


def untrained(simulator: StorageSimulator, schedule, seed: int = 0) -> StoragePolicy:
    return StoragePolicy(probe(simulator, schedule)[1].shape[0], key=jax.random.key(seed))


@cache
def setup(name: str) -> Setup:
    """A case made ready for the native engine."""
    return make_setup(read(name), "native")


def random_actions(days: int, paths: int, seed: int = 0) -> np.ndarray:
    """Fractions of injection and withdrawal [days, paths, 2]; half of them are extremes."""
    random = np.random.default_rng(seed)
    drawn = random.uniform(-0.5, 1.5, (days, paths, 2))
    return np.clip(drawn, 0.0, 1.0)
