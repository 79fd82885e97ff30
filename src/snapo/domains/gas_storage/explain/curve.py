"""The effect of a move of the forward curve, to first and second order, by delivery period.

With the decisions held fixed the cash of a day is linear in its forward price. With the decisions
at the old curve, the cash at the new curve minus the cash at the old curve is therefore delta times
move; this is X. With the decisions at the new curve, the same difference is the delta at the new
curve times the move; this is Y. Then

    first order X,   second order (Y - X) / 2,

and X + (Y - X) / 2 is the trapezoidal rule for the integral of delta along the move.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact
from snapo.solver import statistics
from snapo.solver.adjoint import float64
from snapo.solver.evaluate import of_groups, value_of_groups
from snapo.study.study import Setup

from ..setup import OUTPUT

CHUNK = 2048  # paths in one call of an engine: every output of every day is recorded


class DeliveryPeriod(NamedTuple):
    """A delivery period: the steps from `first` up to, but not including, `after`. A day of
    delivery may have several steps."""

    name: str
    first: int
    after: int


class PeriodEffect(NamedTuple):
    """The effects of first and second order of one period, each with its standard error."""

    first: float
    first_error: float
    second: float
    second_error: float


class CurveEffect(NamedTuple):
    """The effects by period, and their total.

    - `before`, `after` [G]: the shares of groups of paths in the values at both curves.
    - `error`: the error of the part of the difference between the two values that is beyond second
      order.
    """

    periods: tuple[PeriodEffect, ...]
    total: PeriodEffect
    before: np.ndarray
    after: np.ndarray
    error: float


def curve_effect(
    before: Setup,
    after: Setup,
    policy: Policy,
    periods: Sequence[DeliveryPeriod],
    curves: Sequence[str],
) -> CurveEffect:
    """The effect of the curves of `after` compared with those of `before`; the two must not differ
    otherwise.

    `curves`: the names of their inputs, one for each market. With the decisions held fixed the cash
    is a sum over markets, so the curves move one after the other. The periods of the first market
    come first, then those of the next one. The last period also contains the value of the gas left
    on the end date.
    """
    problems = before.problem, after.problem
    chain = [before.problem, *_between(before, after, curves), after.problem]
    engine = before.engines.evaluate
    engines = [setup.engines.evaluate.bind(setup.problem) for setup in (before, after)]
    between = [engine.bind(problem) for problem in chain[1:-1]]
    simulator, source = problems[0].simulator, problems[0].sources.evaluation
    paths = source.available(before.evaluation.paths)
    steps = np.zeros((len(periods), simulator.horizon))
    for row, period in zip(steps, periods, strict=True):
        row[period.first : period.after] = 1.0
    effect = np.zeros((2, len(curves), len(periods), paths))
    totals: list[dict[str, np.ndarray]] = [{}, {}]
    for block in source.blocks(paths, max(1, -(-paths // CHUNK))):
        draws = source.draws(block, simulator)
        for k in range(2):
            kind = ("action", "outputs")
            local = engines[k].values(policy, draws, Exact(), record=kind)
            held: dict[str, Any] = {"actions": local.record["action"], "record": ("outputs",)}
            others = [x.values(None, draws, Exact(), **held) for x in (*between, engines[1 - k])]
            ordered = [local, *others] if k == 0 else [others[-1], *others[:-1], local]
            cash = [_by_period(rollout, steps) for rollout in ordered]
            for m in range(len(curves)):
                effect[k][m][:, block] = cash[m + 1] - cash[m]
            for name, total in float64(local.totals).items():
                totals[k].setdefault(name, np.full(paths, np.nan))[block] = total
    values = [
        value_of_groups(p.objective, total, source, p.simulator.control_variates())
        for p, total in zip(problems, totals, strict=True)
    ]
    rows_of = effect.reshape(2, -1, paths)
    orders = np.array([
        [_controlled(p, total, source, x) for x in rows]
        for p, total, rows in zip(problems, totals, rows_of, strict=True)
    ])  # fmt: skip
    mean = orders.mean(axis=0)
    effects = tuple(_orders(x, y) for x, y in zip(*orders, strict=True))
    left = statistics.of_shares(values[1] - values[0] - mean.sum(axis=0))
    total = _orders(*orders.sum(axis=1))
    return CurveEffect(effects, total, values[0], values[1], left.standard_error)


def _between(before: Setup, after: Setup, curves: Sequence[str]) -> list[Problem]:
    """The problems in which 1, 2, … of the curves are those of `after`, but not all."""
    problem, result = before.problem, []
    for name in curves[:-1]:
        problem = problem.at({name: after.problem.inputs_by_name[name].value})
        result.append(problem)
    return result


def _orders(old: np.ndarray, new: np.ndarray) -> PeriodEffect:
    """The effects of first and second order, from the shares [G] of delta times move at both
    curves."""
    first, second = statistics.of_shares(old), statistics.of_shares((new - old) / 2)
    return PeriodEffect(first.value, first.standard_error, second.value, second.standard_error)


def _by_period(rollout, steps: np.ndarray) -> np.ndarray:
    """[P, N] the cash of each period."""
    cash = np.asarray(rollout.record["outputs"][OUTPUT], np.float64)
    result = steps @ cash
    result[-1] += np.asarray(rollout.totals[OUTPUT], np.float64) - cash.sum(axis=0)
    return result


def _controlled(problem, totals, source, values: np.ndarray) -> np.ndarray:
    """[G] the shares of groups in the mean of values, with the control variates of the problem."""
    objective = problem.objective
    controls = [
        of_groups(objective, totals, source, totals[name])
        for name in problem.simulator.control_variates()
    ]
    plain = of_groups(objective, totals, source, values)
    return statistics.controlled(plain, controls)[0]
