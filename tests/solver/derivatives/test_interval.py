"""Intervals of reported derivatives: the two parts, directions, gaps, and single numbers."""

import numpy as np
import pytest
from scipy import stats

from snapo.solver.derivatives.interval import HELD, Curvature, Reported, plain
from snapo.solver.statistics import Estimate

BLOCKS = 32
T31 = stats.t.isf(0.025, BLOCKS - 1)


def derivative(shape=(3,), gap=0.0, coordinates=2, seed=0) -> Reported:
    rng = np.random.default_rng(seed)
    held = Estimate(rng.normal(2.0, 0.5, (BLOCKS, *shape)))
    by = np.full(shape, 0.01)
    root = rng.normal(size=(coordinates, coordinates))
    curvature = Curvature(root @ root.T, 0.01 * np.eye(coordinates), gap)
    return plain(held, by)._replace(
        slopes=rng.normal(size=(coordinates, *shape)), curvature=curvature
    )


def test_without_a_search_the_interval_is_students():
    found = derivative()._replace(slopes=np.zeros((0, 3)), curvature=Curvature.nothing())
    for k, interval in enumerate(found.numbers()):
        value, error = found.estimate.value[k], found.estimate.standard_error[k]
        assert interval.value == pytest.approx(value)
        assert interval.sampling == pytest.approx(T31 * error)
        assert interval.policy == 0
        assert (interval.low, interval.high) == pytest.approx(
            (value - T31 * error, value + T31 * error)
        )


def test_the_error_of_the_policy_goes_with_the_root_of_the_gap():
    """|bias| <= sqrt(2 gap kappa), kappa = M (-H)^-1 M'."""
    found = derivative()
    kappa = np.einsum("ik,ij,jk->k", found.slopes, found.curvature.inverse, found.slopes)
    nothing = [x.policy for x in found.numbers()]
    for gap in (0.01, 0.04):
        wider = [x.policy for x in derivative(gap=gap).numbers()]
        assert np.subtract(wider, nothing) == pytest.approx(np.sqrt(2 * gap * kappa))


def test_a_direction_adds_numbers_with_their_common_noise():
    found = derivative(gap=0.02)
    direction = np.array([1.0, -2.0, 0.5])
    along = found.along(direction)
    blocks = found.estimate.blocks @ direction
    assert along.value == pytest.approx(blocks.mean())
    assert along.sampling == pytest.approx(T31 * blocks.std(ddof=1) / np.sqrt(BLOCKS))
    slopes = found.slopes @ direction
    top = np.sqrt(slopes @ found.curvature.covariance @ slopes)
    margin = np.sqrt(2 * 0.02 * slopes @ found.curvature.inverse @ slopes)
    whole = T31 * np.hypot(along.sampling / T31, top) + margin
    assert along.sampling + along.policy == pytest.approx(whole)
    single = found.along(np.array([0.0, 1.0, 0.0]))
    assert single == pytest.approx(found.numbers()[1])


def test_random_directions_widen_where_they_show_more():
    found = derivative(gap=0.02)
    large = 100 * np.ones((6, 3))
    kappa = 100.0**2
    nothing = found._replace(others=large).capped(0.0).numbers()[0].policy
    widened = found._replace(others=large).numbers()[0].policy
    assert widened - nothing == pytest.approx(np.sqrt(2 * 0.02 * kappa))


def test_a_certified_gap_caps_the_part_of_the_policy():
    wide = derivative(gap=0.04)
    assert wide.capped(0.01).numbers() == derivative(gap=0.01).numbers()
    assert wide.capped(1.0).numbers() == wide.numbers()


def test_at_a_kink_the_interval_holds_both_sides():
    at_kink = derivative(gap=0.01)._replace(sides=(0.0, 0.1))
    both = at_kink.along(np.full(3, 0.01))
    assert both.low < 0.0 and both.high > 0.1 and 0.0 <= both.value <= 0.1


def test_one_block_has_no_sampling_error():
    """Without noise there is one block."""
    found = plain(Estimate(np.full((1,), 3.0)), np.asarray(0.01))
    assert found.source == HELD
    assert tuple(found.along(np.ones(()))) == (3.0, 3.0, 3.0, 0.0, 0.0)
