"""State, decisions and outputs over time: bands of quantiles over paths of the exact simulator."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from snapo.case.error import counted
from snapo.engine import TRAJECTORY
from snapo.problem.smooth import Exact
from snapo.report.bands import quantile_fan
from snapo.report.drawing import date_numbers, draw, times_of
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Chart, Text
from snapo.report.quantity import number, quantity, with_unit

from ..chapter import Chapter, Floats, Number, floats
from ..study import Setup, StudyRun
from .distribution import QUANTILES

PATHS, MAX_NUMBERS = 4096, 4_000_000  # paths, and numbers of one record that are held at once
MAX_ENTRIES = 12  # of an array in the state: a larger one has no band
KINDS = ("state", "action", "outputs")
PICTURES = 12  # of one kind
HEADINGS = {"state": "state", "action": "decision", "outputs": "output of one step"}


@dataclass(frozen=True)
class BandSeries:
    """Bands of one number over time: [T + 1] for states, [T] for decisions and outputs.

    - `name`: "water", "stock.0"; `kind`: "state", "action" or "outputs"; `unit`: the unit of its
      numbers.
    - `mean`, `p01` …: the mean and quantiles over the paths; NaN at steps at which no path is
      finite.
    """

    name: str
    kind: str
    unit: str = ""
    mean: Floats = floats()
    p01: Floats = floats()
    p05: Floats = floats()
    p25: Floats = floats()
    p50: Floats = floats()
    p75: Floats = floats()
    p95: Floats = floats()
    p99: Floats = floats()

    @property
    def lines(self) -> dict[str, np.ndarray]:
        """{band: numbers} of the bands that have a finite number."""
        bands = {name: getattr(self, name) for name in ("mean", *QUANTILES)}
        return {name: band for name, band in bands.items() if np.isfinite(band).any()}

    @property
    def constant(self) -> float | None:
        """The number, if it is the same at every step of every path; None if it varies."""
        lines = self.lines
        if not {"mean", "p01", "p99"} <= lines.keys():
            return None
        level = float(lines["mean"][0])
        same = all(
            np.allclose(lines[name], level, rtol=1e-12, atol=0.0) for name in ("mean", "p01", "p99")
        )
        return level if same else None

    def times(self, factor: float) -> "BandSeries":
        """The series in another unit."""
        return replace(self, **{name: factor * band for name, band in self.lines.items()})


@dataclass(frozen=True)
class BandProfile:
    """All series; `paths`: the number of paths of their bands; `notes`: sentences on omissions."""

    series: tuple[BandSeries, ...] = ()
    paths: Number = 0
    notes: tuple[str, ...] = ()


def profile(
    *,
    without: Collection[str] = (),
    factor: Callable[[RunFiles, BandSeries], float] = lambda run, series: 1.0,
    together: int = 1,
) -> Chapter[BandProfile]:
    """The chapter "profile".

    - `without`: names of states that are omitted.
    - `together`: the number of steps in a period, for which the first state and the sums of outputs
      are shown.
    - `factor`: the factor by which the numbers of a series are multiplied in the report.
    """
    return Chapter(
        "profile",
        "Over time",
        BandProfile,
        lambda run: measure(run, without, together),
        lambda run, result: show(run, result, factor),
        "Over time",
        key="profile",
    )


def measure(run: StudyRun, without: Collection[str] = (), together: int = 1) -> BandProfile:
    """Measures the bands of the trained policy; units are taken from the study's `about`."""
    horizon, units = run.setup.problem.simulator.horizon, run.study.about.get("units", {})
    requested = min(PATHS, max(256, MAX_NUMBERS // horizon))
    series, notes, paths = [], [], 0
    for kind, name, values in recorded(run.setup, run.solution.policy, requested):
        values = values if together == 1 else _by_period(kind, values, together)
        _, paths, entries = values.shape
        if together > 1 and kind == "action":
            continue
        if (kind == "state" and name in without) or run.study.names.get(name) == "":
            continue
        if entries > MAX_ENTRIES:
            notes.append(f"{name} has {entries} numbers, too many for a chart.")
            continue
        for i in range(entries):
            full = name if entries == 1 else f"{name}.{i}"
            unit = units.get(full, units.get(name, ""))
            series.append(BandSeries(full, kind, unit, **bands(values[:, :, i])))
    return BandProfile(tuple(series), paths, tuple(notes))


def _by_period(kind: str, values: np.ndarray, together: int) -> np.ndarray:
    """The first state of each period, or the sum of all its outputs."""
    if kind == "state":
        return values[::together]
    return values.reshape(-1, together, *values.shape[1:]).sum(axis=1)


def recorded(setup: Setup, policy, paths: int) -> Iterator[tuple[str, str, np.ndarray]]:
    """(kind, name, numbers [T or T + 1, paths, entries]) of all series of a path."""
    problem = setup.problem
    bound, source = setup.engines.evaluate.bind(problem), problem.sources.evaluation
    records: dict[tuple[str, str], list[np.ndarray]] = {}
    for block in source.blocks(source.available(paths), 8):
        draws = source.draws(block, problem.simulator)
        rollout = bound.values(policy, draws, Exact(), record=TRAJECTORY)
        last = leaves(rollout.state)
        for kind in KINDS:
            for name, values in leaves(rollout.record[kind]).items():
                values = np.asarray(values, np.float64)
                if kind == "state":
                    values = np.concatenate([values, np.asarray(last[name], np.float64)[None]])
                flat = values.reshape(*values.shape[:2], -1)
                records.setdefault((kind, name or kind), []).append(flat)
    for (kind, name), blocks in records.items():
        yield kind, name, np.concatenate(blocks, axis=1)


def leaves(tree: Any) -> dict[str, Any]:
    """{dotted name: array} of a tree; if the tree is a single array, its name is empty."""
    paths = jax.tree_util.tree_flatten_with_path(tree)[0]
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in paths}


def bands(values: np.ndarray) -> dict[str, np.ndarray]:
    """Mean and quantiles of numbers [T, paths] over the finite paths; NaN if there are none."""
    if values.size and np.isfinite(values).all():  # at once, and not row by row
        return {"mean": values.mean(1), **dict(zip(QUANTILES, _quantiles(values)))}
    masked = np.where(np.isfinite(values), values, np.nan)
    any_finite = np.asarray(np.isfinite(masked).any(1))
    filled = np.where(any_finite.reshape(-1, 1), masked, 0.0)
    quantiles = np.nanquantile(filled, list(QUANTILES.values()), axis=1)
    rows = {"mean": np.nanmean(filled, axis=1), **dict(zip(QUANTILES, quantiles))}
    return {name: np.where(any_finite, row, np.nan) for name, row in rows.items()}


def _quantiles(values: np.ndarray) -> np.ndarray:
    """[quantiles, T] of finite numbers [T, paths]; the same results as `np.quantile`, in less
    time."""
    ordered = np.sort(values, axis=1)
    position = np.array(list(QUANTILES.values())) * (values.shape[1] - 1)
    left = np.floor(position).astype(int)
    low, high = ordered[:, left], ordered[:, np.ceil(position).astype(int)]
    return (low + (position - left) * (high - low)).T


def show(
    run: RunFiles,
    result: BandProfile,
    factor: Callable[[RunFiles, BandSeries], float] = lambda run, series: 1.0,
) -> Sequence[Block]:
    """Shows a fan for every number of the state, the decision and the outputs."""
    series = [x.times(factor(run, x)) for x in result.series if run.title_of(x.name)]
    step, paths = str(run.get("step", "step")), number(result.paths, 0)
    blocks: list[Block] = []
    for kind in HEADINGS:
        of_kind = [x for x in series if x.kind == kind]
        varying = [x for x in of_kind if x.constant is None]
        blocks += [
            _fan(run, f"fan-{kind}-{i}", x, step, paths) for i, x in enumerate(varying[:PICTURES])
        ]
        if len(varying) > PICTURES:
            blocks.append(
                Text(f"{len(varying) - PICTURES} more charts of this kind are not drawn.", True)
            )
        for x in of_kind:
            if (level := x.constant) is not None:
                size = quantity(level, x.unit)
                sentence = f"{run.title_of(x.name)} ({HEADINGS[kind]}) is {size} in every {step}."
                blocks.append(Text(sentence, caveat=True))
    return [*blocks, *(Text(note, caveat=True) for note in result.notes)]


def _fan(run: RunFiles, anchor: str, series: BandSeries, step: str, paths: str) -> Chart | Text:
    name, lines = run.title_of(series.name), series.lines
    if "mean" not in lines:
        return Text(f"{name} is non-finite on all paths.", caveat=True)
    when, times, dates = np.arange(float(len(lines["mean"]))), run.step_times, ""
    if times.local_times and (times.step == "day" or times.step == "hour"):
        steps_a_day, dates = 24 if times.step == "hour" else 1, times.step
        when = date_numbers(times_of(times.local_times, steps_a_day, len(when)))
    alt = (
        f"{name} over {counted(len(when), step)}: mean, median and bands of quantiles of {paths} "
        "paths."
    )
    label = with_unit(name, series.unit)
    svg = draw(
        anchor,
        alt,
        lambda axes: quantile_fan(axes, when, lines, label, None, step.capitalize(), dates),
        230,
    )
    return Chart(svg, f"{name} ({HEADINGS[series.kind]}) on {paths} paths, under the exact rules.")


PROFILE = profile()
