"""The derivative that is believed, against a move of a hundredth on a million common paths."""

import numpy as np
import pytest
from tests.solver.twelve import INPUTS, Hidden, LostSales, policy, problem

import snapo
from snapo.engine.native import Native
from snapo.problem.smooth import Exact
from snapo.solver.judge import UNKNOWN, hundredth

SURE = 3.0  # standard errors
TRAINING = snapo.Training(
    steps=120, paths=256, learning_rate=0.01, validation_paths=1024, validation_every=40, clip=30.0
)
CHUNK = 65_536


def moved(problem, policy, name: str, paths: int) -> tuple[float, float]:
    """Half the difference of the value after a move up and one down, and its standard error.

    Paths of a stream of their own, which neither training nor the table has seen.
    """
    by, value = hundredth(problem.named[name]), problem.named[name].value
    up, down = (Native("float64").bind(problem.at({name: value + s * by})) for s in (1, -1))
    source, differences = snapo.Pseudo(77), []
    for first in range(0, paths, CHUNK):
        draws = source.draws(np.arange(first, min(first + CHUNK, paths)), problem.simulator)
        high, low = (b.values(policy, draws, Exact()).totals["value"] for b in (up, down))
        differences.append((np.asarray(high) - np.asarray(low)) / 2)
    pairs = np.concatenate(differences).reshape(-1, 2).mean(1)  # antithetic
    return float(pairs.mean()), float(pairs.std(ddof=1) / np.sqrt(pairs.size))


def headlines(kind, paths: int) -> list[tuple]:
    """(input, the one that is believed, change by it, its error, change seen, its error)."""
    of = problem(kind)
    solution = snapo.solve(of, policy=policy(of), training=TRAINING, engine="native")
    rows = []
    for name, verdict in solution.sensitivities.verdicts.items():
        seen = moved(of, solution.policy, name, paths)
        found = {"held": verdict.held, "smooth": verdict.smooth}.get(verdict.supported)
        rows.append((name, verdict.supported, *(found or (np.nan, np.nan)), *seen))
    return rows


@pytest.mark.prove
@pytest.mark.parametrize("kind", [LostSales, Hidden], ids=lambda kind: kind.__name__)
def test_the_headline_holds_on_fewer_paths(kind):
    """Held derivatives that are not the derivative: where the state is hidden, and of demand."""
    assert not [row for row in headlines(kind, CHUNK) if not _holds(row)]


@pytest.mark.study
@pytest.mark.parametrize("kind", INPUTS, ids=lambda kind: kind.__name__)
def test_the_headline_derivative_is_within_three_errors_of_a_move_or_not_known(kind):
    rows = headlines(kind, 1_000_000)
    assert {row[0] for row in rows} == set(INPUTS[kind])
    assert not [row for row in rows if not _holds(row)]


def _holds(row: tuple) -> bool:
    """Whether the believed change is the one seen; where nothing is random, to round-off."""
    _, believed, change, error, seen, noise = row
    room = SURE * np.hypot(error, noise) + 1e-9 * abs(seen)
    return believed == UNKNOWN or abs(change - seen) <= room
