"""What more steps would bring: the gain of the second half over the sum of the rates."""

from types import SimpleNamespace

import numpy as np
import pytest

from snapo.solver.learning.optimiser import rates, schedule
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.verdict.further import Further, compared_step, restless, times_of, too_short


def stands(step, redrawn=()):
    return SimpleNamespace(step=step, redrawn=redrawn)


@pytest.mark.parametrize(("steps", "warmup"), [(1, 0), (1, 5), (7, 0), (40, 10), (500, 500)])
def test_rates_in_numpy_are_those_of_the_training(steps, warmup):
    plan, count = TrainingPlan(steps=steps, warmup=warmup, learning_rate=0.003), 600
    expected = np.asarray(schedule(plan)(np.arange(count)))
    np.testing.assert_allclose(rates(plan, count), expected, rtol=1e-5, atol=1e-9)


def test_the_second_half_of_a_cosine_is_a_small_part_of_the_way():
    """A half is 1/2 + 1/pi of the whole way, so that the gain counts (1/2 + 1/pi) / (1 - 2/pi)."""
    training = TrainingPlan(steps=100_000, warmup=0)
    assert compared_step(stands(100_000), training) == 50_000
    closed = (0.5 + 0.318310) / (1 - 0.636620)
    assert times_of(stands(100_000), training) == pytest.approx(closed, rel=1e-3)
    # A run that stopped has come to a quarter and a half; one that began anew counts from there.
    assert compared_step(stands(70_000), training) == 25_000
    assert compared_step(stands(100_000, (60_000,)), training) == 60_000
    assert compared_step(stands(1), TrainingPlan(steps=1)) == 0


def test_more_is_told_where_it_is_sure_and_nothing_where_errors_are_wide():
    assert Further(1.0, 0.1, 2.0, 100.0).improving
    small = Further(0.4, 0.01, 2.0, 100.0)
    assert small.is_small and not small.improving
    for unsure in (Further(1.0, 0.6, 2.0, 100.0), Further(0.0, 1.0, 2.0, 100.0)):
        assert not unsure.is_small and not unsure.improving
    assert not Further(-1.0, 0.1, 2.0, 100.0).is_small  # it fell


def test_a_gradient_counts_above_its_noise_and_where_it_could_bring_something():
    assert restless(5.0, 1.0, 1.0, 100.0)
    assert not restless(1.5, 1.0, 1.0, 100.0)
    assert not restless(5.0, 1.0, 1e-3, 100.0)
    # Without noise nothing says how small a norm at a bend of the smooth value would be.
    assert not restless(5.0, 0.0, 1.0, 100.0)
    assert not restless(float("nan"), float("nan"), 1.0, 100.0)
    assert too_short(TrainingPlan(steps=60), 60)
    assert not too_short(TrainingPlan(steps=100), 100)
