"""Paths under the policy: distributions by year, weights, limits by month."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import jax
import numpy as np

from snapo.engine import TRAJECTORY
from snapo.problem.inputs import plain
from snapo.problem.smooth import Exact
from snapo.report.bands import Layer, heat, stack
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart
from snapo.report.quantity import number
from snapo.study.chapter import Chapter, Floats, Number, floats
from snapo.study.study import StudyRun

from ..fund.terms import trading_limits
from ..fund.trading import dealt
from ..records.case import PensionCase
from ..regulation.position import RecoveryCourse, recovery, stand
from ..results.setup import case_of
from ..run import PensionRun, with_measure

MAXIMUM = 4096  # paths that are recorded
SLACK = 1e-9  # below a limit, of the assets: round-off
QUANTILES = (1, 5, 25, 50, 75, 95, 99)
TAIL = 0.95  # level of the mean of the worst paths
RATIOS = np.array([0.0, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5, np.inf])  # columns of the policy map
FEW = 20  # paths in a cell of the map below which it stays empty
EMPTY = np.zeros(0)
LAYERS = ("main", "inject", "withdraw", "limit", "good", "other")  # colours of the mean mix
Fan = dict[str, Floats]  # {"p05": [times], "mean": [times]}


@dataclass(frozen=True)
class YearlyFans:
    """Quantiles by year. At `years` from now: the `funding` ratio F, the share of paths with F
    below 1 (`underfunded`), and the mean of min(F - 1, 0) over the 5 % of paths with the lowest F
    (`shortfall`). Within each year: contributions, benefits, and increases minus cuts, which are
    also `cumulated`.
    """

    years: Floats
    funding: Fan
    underfunded: Floats
    shortfall: Floats
    contribution: Fan
    benefit: Fan
    indexation: Fan
    cumulated: Fan


@dataclass(frozen=True)
class PolicyMap:
    """Weights over funding ratio and time: means over the paths in each cell.

    - `years` [Y]: starts of years; `ratios` [R + 1]: edges of the columns.
    - `growth` [Y, R]: the weight of the classes with a separate shock; `hedge` [Y, R]: the mean
      position of the swap notionals in their ranges, empty without swaps. Cells with fewer than
      FEW paths are NaN.
    """

    years: Floats
    ratios: Floats
    growth: Floats
    hedge: Floats = floats()


@dataclass(frozen=True)
class MeanMix:
    """Mean weights [classes, Y] at the start of each year, and mean positions of the swap notionals
    in their ranges [b, Y]."""

    years: Floats
    classes: tuple[str, ...]
    weights: Floats
    overlay: Floats


@dataclass(frozen=True)
class LimitBreaches:
    """The share of the paths that violate a limit: in each step [T], and in any step (`ever`)."""

    share: Floats
    ever: Number


@dataclass(frozen=True)
class FirstAllocation:
    """Today's weights [n] and positions of the notionals in their ranges [b], on all paths."""

    weights: Floats
    overlay: Floats


@dataclass(frozen=True)
class PathTables:
    """The results of the recorded paths; `recovery`: the recovery to the ratio that the regulator
    requires, None without a regulator."""

    by_year: YearlyFans
    policy_map: PolicyMap
    mix: MeanMix
    limits: dict[str, LimitBreaches]
    first_decision: FirstAllocation
    recorded_paths: int
    recovery: RecoveryCourse | None = None


def measure(run: StudyRun) -> PathTables:
    """The results of the trained policy on recorded paths. Writes profile.csv."""
    record, recovered = RecordedPaths.of(run), None
    if record.case.regulation is not None:
        required = stand(record.case, plain(run.setup.problem.inputs)).required_ratio
        recovered = recovery(record.case, record.funding, required)
    years = by_year(record)
    columns = {"year": years.years, "underfunded": years.underfunded}
    columns |= {f"funding_{name}": values for name, values in years.funding.items()}
    run.write_csv("profile.csv", tuple(columns), zip(*columns.values()))
    return PathTables(
        years,
        policy_map(record),
        mean_mix(record),
        limits_by_step(record, SLACK),
        FirstAllocation(record.weights[0, 0], record.overlay[0, 0]),
        record.action.shape[1],
        recovered,
    )


@dataclass(frozen=True, eq=False)
class RecordedPaths:
    """Recorded paths: `action` [T, N, A], with the weights after the limits of trading; `funding`
    [T + 1, N]; `outputs` {name: [T, N]}."""

    case: PensionCase
    action: np.ndarray
    outputs: dict[str, np.ndarray]
    funding: np.ndarray

    @classmethod
    def of(cls, run: StudyRun) -> "RecordedPaths":
        """The trained policy on the first paths of the evaluation."""
        setup, policy = run.setup, run.solution.policy
        problem, bound = setup.problem, setup.engines.evaluate.bind(setup.problem)
        source, actions, outputs, last = problem.sources.evaluation, [], [], []
        paths = source.available(min(MAXIMUM, setup.evaluation.paths))
        limited = trading_limits(case_of(run).assets, case_of(run).step).dealing
        for block in source.blocks(paths, max(8, paths // 1024)):
            draws = source.draws(block, problem.simulator)
            # The whole trajectory, whose program the certificate uses too.
            rollout = bound.values(policy, draws, Exact(), record=TRAJECTORY)
            action = np.asarray(rollout.record["action"])
            if limited:
                action = _traded(case_of(run), action, rollout.record["state"].weights)
            actions.append(action)
            outputs.append({k: np.asarray(v) for k, v in rollout.record["outputs"].items()})
            last.append(np.asarray(rollout.totals["funding_ratio"]))
        table = {k: np.concatenate([output[k] for output in outputs], 1) for k in outputs[0]}
        funding = np.concatenate([table["funding"], np.concatenate(last)[None]])
        return cls(case_of(run), np.concatenate(actions, 1), table, funding)

    @property
    def weights(self) -> np.ndarray:
        """[T, N, n] weights after trading; cash is the remainder."""
        count, cash = len(self.case.assets.classes), self.case.assets.cash
        weights = self.action[:, :, :count].astype(np.float64)
        weights[:, :, cash] += 1 - weights.sum(2)
        return weights

    @property
    def overlay(self) -> np.ndarray:
        """[T, N, b] the position of each notional in its range, from 0 to 1."""
        return self.action[:, :, len(self.case.assets.classes) :]


def _traded(case: PensionCase, action: np.ndarray, held: Any) -> np.ndarray:
    """The actions [T, N, A] with weights as traded, from those `held` [T, N, n] before."""
    count = len(case.assets.classes)
    requested = action[:, :, :count].astype(np.float64)
    requested[:, :, case.assets.cash] += 1 - requested.sum(2)
    with jax.enable_x64(True):
        limits = trading_limits(case.assets, case.step)

        def one(target, held):
            return dealt(case.assets.cash, limits, target, held, Exact())

        weights = jax.jit(jax.vmap(jax.vmap(one)))(requested, np.asarray(held, np.float64))
    return np.concatenate([np.asarray(weights), action[:, :, count:]], 2)


def first_traded(
    case: PensionCase, action: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Today's weights [n] and positions of the notionals [b], from the first action [A]."""
    if trading_limits(case.assets, case.step).dealing:
        action = _traded(case, action[None, None], held[None, None])[0, 0]
    record = RecordedPaths(case, action[None, None], {}, np.zeros(0))
    return record.weights[0, 0], record.overlay[0, 0]


def by_year(record: RecordedPaths) -> YearlyFans:
    """Distributions by year: funding ratio, contributions, benefits and indexation; and the
    probability and size of a shortfall."""
    case, outputs = record.case, record.outputs
    steps = round(1 / case.step)
    endpoints = np.arange(0, case.steps + 1, steps)
    funding = record.funding[endpoints]
    granted = _yearly(outputs["granted"] - outputs["cut"], steps)
    if case.plan.indexation.rate is not None:
        # Fixed increases are part of the payments, and are not granted on top.
        granted = granted + float(case.plan.indexation.rate.used())
    return YearlyFans(
        years=endpoints * case.step,
        funding=_fan(funding),
        underfunded=(funding < 1).mean(1),
        shortfall=np.array([_tail(np.minimum(row - 1, 0)) for row in funding]),
        contribution=_fan(_yearly(outputs["contribution"], steps)),
        benefit=_fan(_yearly(outputs["benefit"], steps)),
        indexation=_fan(granted),
        cumulated=_fan(np.cumprod(1 + granted, 0)),
    )


def _yearly(values: np.ndarray, item: int) -> np.ndarray:
    """[years, N] sums over the steps of a year; steps beyond the last whole year are left out."""
    complete = len(values) // item * item
    return values[:complete].reshape(-1, item, values.shape[1]).sum(1)


def _fan(values: np.ndarray) -> Fan:
    """{quantile: [times]} of [times, N], and the mean."""
    quantiles = np.quantile(values, [q / 100 for q in QUANTILES], axis=1)
    by_name = {f"p{q:02d}": row for q, row in zip(QUANTILES, quantiles)}
    return {"mean": values.mean(1)} | by_name


def _tail(values: np.ndarray) -> float:
    """The mean over the worst paths, a share 1 - TAIL of all paths."""
    count = max(1, round((1 - TAIL) * len(values)))
    return float(np.sort(values)[:count].mean())


def policy_map(record: RecordedPaths) -> PolicyMap:
    """Means of weights and positions over the paths in each cell of years and funding ratios."""
    case = record.case
    steps = round(1 / case.step)
    starts = np.arange(0, case.steps, steps)
    growth = record.weights[:, :, list(case.assets.shocks)].sum(2)

    def mapped(values: np.ndarray) -> np.ndarray:
        cells = np.full((len(starts), len(RATIOS) - 1), np.nan)
        for row, start in enumerate(starts):
            year = slice(start, min(start + steps, case.steps))
            column = np.digitize(record.funding[:-1][year].ravel(), RATIOS) - 1
            flat = values[year].ravel()
            for k in range(len(RATIOS) - 1):
                selected = column == k
                if selected.sum() >= FEW:
                    cells[row, k] = flat[selected].mean()
        return cells

    hedge = mapped(record.overlay.mean(2)) if case.buckets else EMPTY
    return PolicyMap(starts * case.step, RATIOS, mapped(growth), hedge)


def mean_mix(record: RecordedPaths) -> MeanMix:
    """Mean weights and positions over the paths at the starts of years."""
    case = record.case
    steps = round(1 / case.step)
    weights, overlay = record.weights[::steps].mean(1), record.overlay[::steps].mean(1)
    years = np.arange(0, case.steps, steps) * case.step
    names = tuple(class_.name for class_ in case.assets.classes)
    return MeanMix(years, names, weights.T, overlay.T)


def limits_by_step(record: RecordedPaths, round_off: float) -> dict[str, LimitBreaches]:
    """Shares of the paths that violate a limit.

    "weights": a weight or a group leaves its bounds; with swaps, "collateral": eligible assets do
    not cover the need under stress. A violation below `round_off` does not count: the learned
    policy often holds exactly as many swaps as its assets can back, so that the last bit would
    decide.

    **Arguments:** - `round_off`: as a weight; for collateral, as a share of the assets now, times
    the length of a step in years.
    """
    broken = {"weights": record.outputs["bound_excess"] > round_off}
    if record.case.buckets:
        broken["collateral"] = record.outputs["collateral_shortfall"] > round_off
    return {
        name: LimitBreaches(paths.mean(1), float(paths.any(0).mean()))
        for name, paths in broken.items()
    }


def show(run: PensionRun, result: PathTables) -> Sequence[Block]:
    """The policy as a map of weights over funding ratio and time, and its mean mix."""
    table = result.policy_map
    blocks: list[Block] = [
        _map("growth", "share of equity, property and other risky classes", table, table.growth)
    ]
    if table.hedge.size:
        text = "mean position of the swap notionals between their limits"
        blocks.append(_map("hedge", text, table, table.hedge))
    return [*blocks, _mix(result.mix)]


def _map(name: str, text: str, table: PolicyMap, values: np.ndarray) -> Chart:
    rows = range(0, len(table.years), max(1, -(-len(table.years) // 12)))
    down = [f"year {number(table.years[i] + 1, 0)}" for i in rows]
    across, grid = _columns(table.ratios), values[list(rows)]
    alt = f"Map of the {text}, with the funding ratio across and the year upwards."
    svg = draw(
        f"map-{name}", alt, lambda axes: heat(axes, grid, across, down, "%"), 60.0 + 19 * len(rows)
    )
    caption = (
        f"{text[:1].upper()}{text[1:]}, in per cent: means over the paths with that funding "
        "ratio in that year; a cell is empty if there are almost none."
    )
    return Chart(svg, caption)


def _columns(edges: np.ndarray) -> list[str]:
    """["below 80 %", "80–90 %", …, "from 150 %"]."""
    texts = []
    for low, high in pairwise(100 * edges):
        if not low:
            texts.append(f"below {number(high, 0)} %")
        elif not np.isfinite(high):
            texts.append(f"from {number(low, 0)} %")
        else:
            texts.append(f"{number(low, 0)}–{number(high, 0)} %")
    return texts


def _mix(mix: MeanMix) -> Chart:
    mean = mix.weights
    order = np.argsort(-np.abs(mean.mean(1)), kind="stable")
    largest, rest = order[:5], order[5:]
    layers = [
        Layer(mix.classes[i], 100 * mean[i], colour, 0.8)
        for i, colour in zip(largest, LAYERS, strict=False)
    ]
    if rest.size:
        layers.append(Layer("All others", 100 * mean[rest].sum(0), LAYERS[5], 0.5))
    alt = "Mean weights by class at the start of each year. " + "; ".join(
        f"{layer.label} {number(layer.values[0], 0)} % now" for layer in layers
    )
    svg = draw("mix", alt, lambda axes: stack(axes, mix.years, layers, "%"), 240)
    text = "Mean weights at the start of each year, over all paths."
    if mean.min() < 0:
        text += " A weight below zero is a short position, or borrowed cash."
    return Chart(svg, text)


PATHS = Chapter(
    "paths", with_measure("The policy"), PathTables, measure, show, "Policy", anchor="policy"
)
