"""Paths under the policy: distributions by year, weights, limits by month."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from snapo.engine import COURSE
from snapo.problem.inputs import plain
from snapo.problem.smooth import Exact
from snapo.study.study import StudyRun

from ..fund.dealing import dealt
from ..records.case import PensionCase
from ..regulation.stand import recovery, stand
from .setup import case_of

PATHS = 4096
SLACK = 1e-9  # below a limit, of the assets: round-off
QUANTILES = (1, 5, 25, 50, 75, 95, 99)
TAIL = 0.95  # level of the mean of the worst paths
RATIOS = np.array([0.0, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5, np.inf])  # columns of the policy map
FEW = 20  # paths in a cell of the map below which nothing is said


def work(run: StudyRun) -> dict[str, Any]:
    """ "by_year", "policy_map", "mix", "limits" and "first_decision"; writes profile.csv."""
    record = Record.of(run)
    found = {
        "by_year": by_year(record),
        "policy_map": policy_map(record),
        "mix": mix(record),
        "limits": limits_by_step(record, SLACK),
        "first_decision": first_decision(record),
        "recorded_paths": record.action.shape[1],
    }
    if record.case.regulation is not None:
        asked = stand(record.case, plain(run.setup.problem.inputs)).required_ratio
        found["recovery"] = recovery(record.case, record.funding, asked)
    years = found["by_year"]
    columns = {"year": years["years"], "underfunded": years["underfunded"]}
    columns |= {f"funding_{name}": values for name, values in years["funding"].items()}
    run.write_csv("profile.csv", tuple(columns), zip(*columns.values()))
    return found


@dataclass(frozen=True, eq=False)
class Record:
    """Recorded paths: `action` [T, N, A] with the weights that limits of trading allowed, `funding`
    [T + 1, N], outputs {name: [T, N]}."""

    case: PensionCase
    action: np.ndarray
    outputs: dict[str, np.ndarray]
    funding: np.ndarray

    @classmethod
    def of(cls, run: StudyRun) -> "Record":
        """The trained policy on the first paths of the evaluation."""
        setup, policy = run.setup, run.solution.policy
        problem, bound = setup.problem, setup.engines.evaluate.bind(setup.problem)
        source, actions, outputs, last = problem.sources.evaluation, [], [], []
        paths = source.available(min(PATHS, setup.evaluation.paths))
        limited = case_of(run).assets.dealing
        for block in source.blocks(paths, max(8, paths // 1024)):
            draws = source.draws(block, problem.simulator)
            # All of the course, whose program the certificate uses too.
            rolled = bound.values(policy, draws, Exact(), record=COURSE)
            action = np.asarray(rolled.record["action"])
            if limited:
                action = _traded(case_of(run), action, rolled.record["state"].weights)
            actions.append(action)
            outputs.append({k: np.asarray(v) for k, v in rolled.record["outputs"].items()})
            last.append(np.asarray(rolled.totals["funding_ratio"]))
        found = {k: np.concatenate([each[k] for each in outputs], 1) for k in outputs[0]}
        funding = np.concatenate([found["funding"], np.concatenate(last)[None]])
        return cls(case_of(run), np.concatenate(actions, 1), found, funding)

    @property
    def weights(self) -> np.ndarray:
        """[T, N, n] weights after trading; cash is the remainder."""
        count, cash = len(self.case.assets.classes), self.case.assets.cash
        weights = self.action[:, :, :count].astype(np.float64)
        weights[:, :, cash] += 1 - weights.sum(2)
        return weights

    @property
    def overlay(self) -> np.ndarray:
        """[T, N, b] where in its range each notional was set, from 0 to 1."""
        return self.action[:, :, len(self.case.assets.classes) :]


def _traded(case: PensionCase, action: np.ndarray, held: Any) -> np.ndarray:
    """The actions [T, N, A] with weights as traded, from those `held` [T, N, n] before."""
    count = len(case.assets.classes)
    wanted = action[:, :, :count].astype(np.float64)
    wanted[:, :, case.assets.cash] += 1 - wanted.sum(2)
    with jax.enable_x64(True):

        def one(wanted, held):
            return dealt(case.assets, case.step, wanted, held, Exact())

        weights = jax.jit(jax.vmap(jax.vmap(one)))(wanted, np.asarray(held, np.float64))
    return np.concatenate([np.asarray(weights), action[:, :, count:]], 2)


def by_year(record: Record) -> dict[str, Any]:
    """Fans at the ends of years: funding ratio, contributions, indexation; and probabilities."""
    case = record.case
    each = round(1 / case.step)
    ends = np.arange(0, case.steps + 1, each)
    years = (ends * case.step).tolist()
    funding = record.funding[ends]
    found: dict[str, Any] = {
        "years": years,
        "funding": _fan(funding),
        "underfunded": (funding < 1).mean(1),
        "shortfall": [_tail(np.minimum(row - 1, 0)) for row in funding],
    }
    for name, output in (("contribution", "contribution"), ("benefit", "benefit")):
        found[name] = _fan(_yearly(record.outputs[output], each))
    granted = _yearly(record.outputs["granted"] - record.outputs["cut"], each)
    if case.plan.indexation.rate is not None:
        # Fixed increases are part of the payments, and are not granted on top.
        granted = granted + float(case.plan.indexation.rate.used())
    found["indexation"] = _fan(granted)
    found["cumulated"] = _fan(np.cumprod(1 + granted, 0))
    return found


def _yearly(values: np.ndarray, each: int) -> np.ndarray:
    """[years, N] sums over the steps of a year; steps beyond the last whole year are left out."""
    whole = len(values) // each * each
    return values[:whole].reshape(-1, each, values.shape[1]).sum(1)


def _fan(values: np.ndarray) -> dict[str, np.ndarray]:
    """{quantile: [times]} of [times, N], and the mean."""
    quantiles = np.quantile(values, [q / 100 for q in QUANTILES], axis=1)
    named = {f"p{q:02d}": row for q, row in zip(QUANTILES, quantiles)}
    return {"mean": values.mean(1)} | named


def _tail(values: np.ndarray) -> float:
    """The mean of the worst paths, those that hold 1 - TAIL of them."""
    count = max(1, round((1 - TAIL) * len(values)))
    return float(np.sort(values)[:count].mean())


def policy_map(record: Record) -> dict[str, Any]:
    """Weights over funding ratio and time: means over the paths that are there.

    `growth`: of the classes with a shock of their own [years, columns]; `hedge`: of the mean
    place of the swap notionals in their ranges; null where fewer than FEW paths are.
    """
    case = record.case
    each = round(1 / case.step)
    starts = np.arange(0, case.steps, each)
    growth = record.weights[:, :, list(case.assets.shocks)].sum(2)
    parts = {"growth": growth}
    if case.buckets:
        parts["hedge"] = record.overlay.mean(2)
    found: dict[str, Any] = {"years": starts * case.step, "ratios": RATIOS}
    for name, values in parts.items():
        table = np.full((len(starts), len(RATIOS) - 1), np.nan)
        for row, start in enumerate(starts):
            here = slice(start, min(start + each, case.steps))
            column = np.digitize(record.funding[:-1][here].ravel(), RATIOS) - 1
            flat = values[here].ravel()
            for k in range(len(RATIOS) - 1):
                chosen = column == k
                if chosen.sum() >= FEW:
                    table[row, k] = flat[chosen].mean()
        found[name] = table
    return found


def mix(record: Record) -> dict[str, Any]:
    """Mean weights by class at the start of each year, and of the swaps' places in their ranges."""
    each = round(1 / record.case.step)
    weights, overlay = record.weights[::each].mean(1), record.overlay[::each].mean(1)
    return {
        "years": np.arange(0, record.case.steps, each) * record.case.step,
        "classes": [each.name for each in record.case.assets.classes],
        "weights": weights.T,
        "overlay": overlay.T,
    }


def limits_by_step(record: Record, round_off: float) -> dict[str, Any]:
    """Shares of the paths that break a limit: in each step [T], and ever.

    "weights": a weight or a group leaves its bounds; with swaps, "collateral": eligible assets do
    not cover the need under stress. Less than `round_off` is no breach: the learned policy often
    holds exactly as many swaps as its assets back, and the last bit may lie on either side.

    **Arguments:**

    - `round_off`: of a weight; of the assets now, per step, for collateral.
    """
    broken = {"weights": record.outputs["bound_excess"] > round_off}
    if record.case.buckets:
        broken["collateral"] = record.outputs["collateral_shortfall"] > round_off
    return {
        name: {"share": each.mean(1), "ever": float(each.any(0).mean())}
        for name, each in broken.items()
    }


def first_decision(record: Record) -> Mapping[str, np.ndarray]:
    """Today's weights [n] and places of the notionals in their ranges [b]: alike on all paths."""
    return {"weights": record.weights[0, 0], "overlay": record.overlay[0, 0]}
