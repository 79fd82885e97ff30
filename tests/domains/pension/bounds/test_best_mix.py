"""The best mix within limits is that of a linear program."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from snapo.domains.pension.bounds.best_mix import MixBounds, best_mix

pytestmark = pytest.mark.prove
SHARES = st.lists(st.floats(0, 1), min_size=5, max_size=5)


def program(limits: MixBounds, worth: np.ndarray) -> float:
    member = (limits.group[:, None] == np.arange(len(limits.group_low))).T.astype(float)
    found = linprog(
        -worth,
        np.concatenate([member, -member]),
        np.concatenate([limits.group_high, -limits.group_low]),
        np.ones((1, len(worth))),
        [1.0],
        list(zip(limits.low, limits.high)),
    )
    return -found.fun if found.success else np.nan


@settings(max_examples=60, deadline=None)
@given(SHARES, SHARES, SHARES, st.floats(0, 0.4), st.floats(0.6, 1))
def test_as_a_linear_program(low, high, worth, group_low, group_high):
    low = 0.2 * np.array(low)
    limits = MixBounds(
        low,
        np.maximum(low, high),
        np.array([0, 0, 1, 1, 2]),
        np.array([group_low, 0.1, 0.0]),
        np.array([group_high, 0.9, 1.0]),
        np.array([0.0, -0.1]),
        np.array([0.25, 0.3]),
    )
    exact = program(limits, np.array(worth))
    if np.isfinite(exact):
        with jax.enable_x64(True):
            found = best_mix(limits, np.array(worth), np.array([0.02, -0.01]))
        np.testing.assert_allclose(found, exact + 0.25 * 0.02 + 0.1 * 0.01, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(SHARES, SHARES, SHARES, st.floats(-0.6, 0.4), st.floats(0.6, 1.6))
def test_as_a_linear_program_where_classes_may_be_short(low, width, worth, group_low, group_high):
    low = np.array(low) - 0.6
    limits = MixBounds(
        low,
        low + 2 * np.array(width),
        np.array([0, 0, 1, 1, 2]),
        np.array([group_low, -0.5, low[4]]),
        np.array([group_high, 1.4, low[4] + 2 * width[4]]),
        np.zeros(0),
        np.zeros(0),
    )
    exact = program(limits, np.array(worth))
    if np.isfinite(exact):
        with jax.enable_x64(True):
            found = best_mix(limits, np.array(worth), np.zeros(0))
        np.testing.assert_allclose(found, exact, atol=1e-9)
