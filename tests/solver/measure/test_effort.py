"""The work of derivatives beside a training: in paths, and never from a clock."""

import numpy as np
import pytest

from snapo.solver.derivatives.bump import PRECISE, Reaction, settled
from snapo.solver.derivatives.rebuilt import LONG, fewer
from snapo.solver.measure.selection import BACK, FEWEST, PURPOSES, SMALL, Effort, Evaluation


@pytest.mark.parametrize("horizon", [1, 365])
def test_the_work_is_a_part_of_the_training_and_a_little_more(horizon):
    effort = Effort.for_training(100_000, horizon, 16384)
    assert effort.work == pytest.approx(100_000 / PURPOSES + SMALL / horizon)
    assert effort.valued(40) == min(16384, int(effort.work / 40))
    assert effort.gone_back(20) == min(16384, int(effort.work / 20 / BACK))


def test_a_search_has_a_least_number_of_paths_unless_fewer_are_asked_for():
    assert Effort.for_training(100, 1000, 16384).valued(1000) == FEWEST
    assert Effort.for_training(100, 1000, 64).valued(1000) == 64


@pytest.mark.parametrize(("horizon", "paths"), [(LONG, 512), (2 * LONG, 256), (100_000, 128)])
def test_a_search_on_long_paths_has_fewer(horizon, paths):
    assert Effort.for_training(100, horizon, 16384).valued(1000) == paths


def reaction(value, error, held=10.0, blocks=16):
    """A reaction of this mean and standard error."""
    noise = np.tile([1.0, -1.0], blocks // 2)
    noise *= error * np.sqrt(blocks) / noise.std(ddof=1)
    return Reaction(np.full(32, held), value + noise, 0.0, 0.0, 0.0, 0.0, True)


@pytest.mark.parametrize(
    "value, error, slight, enough",
    [
        (0.0, 0.01, 0.0, True),  # nothing, and known to 0.1 % of the derivative
        (0.0, 0.05, 0.0, False),  # known to 0.5 %
        (0.0, 0.05, 0.2, True),  # but so small that nobody sees it
        (0.1, 0.01, 0.0, False),  # a reaction
        (0.1, 0.01, 0.2, True),  # that nobody sees
    ],
)
def test_more_paths_are_taken_where_a_reaction_is_not_known(value, error, slight, enough):
    assert settled(reaction(value, error), PRECISE, slight) == enough


@pytest.mark.parametrize(
    ("asked", "horizon", "left"),
    [(4096, LONG, 4096), (4096, 4 * LONG, 1024), (1000, 4 * LONG, 512), (100, 4 * LONG, 100)],
)
def test_long_paths_have_as_many_steps_together_as_those_of_three_months(asked, horizon, left):
    assert fewer(asked, horizon) == left
    evaluation = Evaluation(asked, asked, asked, asked, asked, asked).within(horizon)
    assert evaluation.paths == asked  # those of the value stay
    assert evaluation.sensitivity_paths == evaluation.judge_paths == left
