"""State, action and outputs over time: bands of quantiles over paths of the exact simulator."""

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import jax
import numpy as np

from snapo.engine import COURSE
from snapo.problem.smooth import Exact

from ..study import Part, Setup, StudyRun
from .distribution import QUANTILES

PATHS, MOST_NUMBERS = 4096, 4_000_000  # paths, and numbers of one record that are held at once
MOST_ENTRIES = 12  # of an array in the state: a larger one has no band of its own
KINDS = ("state", "action", "outputs")


def profile_part(units: Mapping[str, str], without: Collection[str] = ()) -> Part:
    """A part that gives "profile": {"series": [...], "paths", "notes"}.

    A series has a name ("water", "stock.0"), a kind ("state", "action" or "outputs"), a unit, and
    under "mean", "p01" … its bands over time: states [T + 1], actions and outputs [T]. States
    `without` are left out: those that say nothing in the value.
    """
    return Part("profile", _work(units, without), needs=("training",))


def _work(
    units: Mapping[str, str], without: Collection[str]
) -> Callable[[StudyRun], dict[str, Any]]:
    def work(run: StudyRun) -> dict[str, Any]:
        horizon = run.setup.problem.simulator.horizon
        wanted = min(PATHS, max(256, MOST_NUMBERS // horizon))
        series, notes, paths = [], [], 0
        for kind, name, values in recorded(run.setup, run.solution.policy, wanted):
            paths = values.shape[1]
            if kind == "state" and name in without:
                continue
            if values.shape[2] > MOST_ENTRIES:
                notes.append(f"{name} has {values.shape[2]} numbers and no band of its own.")
                continue
            for i in range(values.shape[2]):
                full = name if values.shape[2] == 1 else f"{name}.{i}"
                unit = units.get(full, units.get(name, ""))
                about = {"name": full, "kind": kind, "unit": unit}
                series.append(about | bands(values[:, :, i]))
        return {"profile": {"series": series, "paths": paths, "notes": notes}}

    return work


def recorded(setup: Setup, policy, wanted: int) -> Iterator[tuple[str, str, np.ndarray]]:
    """(kind, name, numbers [T or T + 1, paths, entries]) of all that a path does."""
    problem = setup.problem
    bound, source = setup.engines.evaluate.bind(problem), problem.sources.evaluation
    found: dict[tuple[str, str], list[np.ndarray]] = {}
    for block in source.blocks(source.available(wanted), 8):
        draws = source.draws(block, problem.simulator)
        rolled = bound.values(policy, draws, Exact(), record=COURSE)
        last = leaves(rolled.state)
        for kind in KINDS:
            for name, values in leaves(rolled.record[kind]).items():
                values = np.asarray(values, np.float64)
                if kind == "state":
                    values = np.concatenate([values, np.asarray(last[name], np.float64)[None]])
                flat = values.reshape(*values.shape[:2], -1)
                found.setdefault((kind, name or kind), []).append(flat)
    for (kind, name), parts in found.items():
        yield kind, name, np.concatenate(parts, axis=1)


def leaves(tree: Any) -> dict[str, Any]:
    """{dotted name: array} of a tree; the name of a tree that is one array is empty."""
    found = jax.tree_util.tree_flatten_with_path(tree)[0]
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in found}


def bands(values: np.ndarray) -> dict[str, list[float]]:
    """Mean and quantiles over paths of numbers [T, paths]; without those not finite."""
    if values.size and np.isfinite(values).all():  # at once, and not row by row
        rows = {"mean": values.mean(1), **dict(zip(QUANTILES, _quantiles(values)))}
        return {name: row.tolist() for name, row in rows.items()}
    kept = np.where(np.isfinite(values), values, np.nan)
    known = np.asarray(np.isfinite(kept).any(1))
    filled = np.where(known.reshape(-1, 1), kept, 0.0)
    quantiles = np.nanquantile(filled, list(QUANTILES.values()), axis=1)
    rows = {"mean": np.nanmean(filled, axis=1), **dict(zip(QUANTILES, quantiles))}
    return {name: np.where(known, row, np.nan).tolist() for name, row in rows.items()}


def _quantiles(values: np.ndarray) -> np.ndarray:
    """[quantiles, T] of finite numbers [T, paths], as `np.quantile` finds them, in less time."""
    ordered = np.sort(values, axis=1)
    place = np.array(list(QUANTILES.values())) * (values.shape[1] - 1)
    left = np.floor(place).astype(int)
    low, high = ordered[:, left], ordered[:, np.ceil(place).astype(int)]
    return (low + (place - left) * (high - low)).T
