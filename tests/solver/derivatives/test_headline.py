"""The reported derivative, against a bump of one percent on a million common paths."""

import numpy as np
import pytest
from tests.solver.twelve import INPUTS, Hidden, LostSales, policy, problem

import snapo
from snapo.engine.native import Native
from snapo.problem.smooth import Exact
from snapo.solver.derivatives.interval import one_percent
from snapo.solver.statistics import critical

SURE = 3.0  # standard errors
TRAINING = snapo.Training(
    steps=120, paths=256, learning_rate=0.01, validation_paths=1024, validation_every=40, clip=30.0
)
CHUNK = 65_536


def moved(problem, policy, name: str, paths: int) -> tuple[float, float]:
    """Half the difference of the value after a move up and one down, and its standard error.

    Paths of a stream of their own, which neither training nor the table has seen.
    """
    by, value = one_percent(problem.inputs_by_name[name]), problem.inputs_by_name[name].value
    up, down = (Native("float64").bind(problem.at({name: value + s * by})) for s in (1, -1))
    source, differences = snapo.Pseudo(77), []
    for first in range(0, paths, CHUNK):
        draws = source.draws(np.arange(first, min(first + CHUNK, paths)), problem.simulator)
        high, low = (b.values(policy, draws, Exact()).totals["value"] for b in (up, down))
        differences.append((np.asarray(high) - np.asarray(low)) / 2)
    pairs = np.concatenate(differences).reshape(-1, 2).mean(1)  # antithetic
    return float(pairs.mean()), float(pairs.std(ddof=1) / np.sqrt(pairs.size))


def headlines(kind, paths: int) -> list[tuple]:
    """(input, interval of the change along one percent, its sampling error, change seen, error)."""
    of = problem(kind)
    solution = snapo.solve(of, policy=policy(of), training=TRAINING, engine="native")
    rows = []
    for name in solution.sensitivities.verdicts:
        seen = moved(of, solution.policy, name, paths)
        interval = solution.sensitivities.along(name, one_percent(of.inputs_by_name[name]))
        rows.append((name, interval, interval.sampling / critical(31), *seen))
    return rows


@pytest.mark.prove
@pytest.mark.parametrize("kind", [LostSales, Hidden], ids=lambda kind: kind.__name__)
def test_the_headline_holds_on_fewer_paths(kind):
    """Held derivatives that are not the derivative: where the state is hidden, and of demand."""
    assert not [row for row in headlines(kind, CHUNK) if not _holds(row)]


@pytest.mark.study
@pytest.mark.parametrize("kind", INPUTS, ids=lambda kind: kind.__name__)
def test_the_headline_derivative_is_within_three_errors_of_a_bump_or_not_known(kind):
    rows = headlines(kind, 1_000_000)
    assert {row[0] for row in rows} == set(INPUTS[kind])
    assert not [row for row in rows if not _holds(row)]


def _holds(row: tuple) -> bool:
    """Whether the reported change is the one seen, within the interval and the error of both.

    The bump has third-order terms that the derivative has not: a thousandth of it is allowed.
    """
    _, interval, error, seen, noise = row
    if not np.isfinite(interval.value):
        return True
    room = SURE * np.hypot(error, noise) + 1e-3 * abs(seen)
    return interval.low - room <= seen <= interval.high + room
