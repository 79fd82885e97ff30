"""Smooth constraints: their limits, their stated error bounds, and two finite derivatives."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.lanes.compiled import run

from snapo.lanes.machine.pipeline import host
from snapo.problem.smooth import Exact, Smooth

EXACT = Exact()
number = st.floats(-50.0, 50.0, allow_nan=False)
width = st.sampled_from([1e-6, 1e-3, 0.1, 1.0, 7.0])
quick = settings(max_examples=40, deadline=None)


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


@partial(jax.jit, static_argnums=0)
def at(name, smooth, *arguments):
    """One operation of `smooth`, compiled once for all numbers."""
    return getattr(smooth, name)(*arguments)


def rounding(*numbers):
    """A few units in the last place of the largest number involved."""
    return 8 * np.finfo(float).eps * max(1.0, *np.abs(numbers))


@quick
@given(number, width, width)
def test_positive_part_and_absolute_stay_within_their_bounds(x, temperature, scale):
    with jax.enable_x64(True):
        w, smooth = temperature * scale, Smooth(temperature)
        above = float(at("positive_part", smooth, x, scale)) - max(x, 0.0)
        assert -rounding(x, w) <= above <= 3 * w / 16 + rounding(x, w)
        if abs(x) >= w:  # compact support: beyond the width it IS the exact function
            assert above == 0.0
        above = float(at("absolute", smooth, x, scale)) - abs(x)
        assert -rounding(x, w) <= above <= 3 * w / 8 + rounding(x, w)


@quick
@given(number, number, width)
def test_minimum_maximum_and_clip_stay_feasible(a, b, w):
    with jax.enable_x64(True):
        smooth, slack = Smooth(w), rounding(a, b, w)
        low, high = min(a, b), max(a, b)
        assert low - 3 * w / 16 - slack <= float(at("minimum", smooth, a, b)) <= low + slack
        assert high - slack <= float(at("maximum", smooth, a, b)) <= high + 3 * w / 16 + slack
        for x in (low - 1.0, low, (a + b) / 2, high, high + 0.01):
            clipped, exact = float(at("clip", smooth, x, low, high)), float(np.clip(x, low, high))
            assert low - slack <= clipped <= high + slack
            assert abs(clipped - exact) <= 3 * w / 16 + slack


@quick
@given(number, st.floats(0.0, 2.0), st.floats(-100.0, 100.0), width)
def test_a_clip_to_less_than_its_width_stays_feasible(low, room, x, w):
    """Wherever x lies, and however narrow the limits are; where they are wide, the corners are
    those of minimum and maximum."""
    with jax.enable_x64(True):
        smooth, high, slack = Smooth(1.0), low + room, rounding(low, x, w)
        clipped = float(at("clip", smooth, x, low, high, w))
        assert low - slack <= clipped <= high + slack
        assert abs(clipped - float(np.clip(x, low, high))) <= 3 * min(w, room) / 16 + slack
        if room > 1.001 * w:
            floor = at("maximum", smooth, x, low, w)
            assert clipped == float(at("minimum", smooth, floor, high, w))
    assert float(at("clip", Smooth(1.0), -5.0, 0.0, 0.1)) >= 0


@quick
@given(number, width, width)
def test_indicator_is_within_its_bound(x, temperature, scale):
    with jax.enable_x64(True):
        smooth = float(at("indicator", Smooth(temperature), x, scale))
        bound = np.exp(-abs(x) / (temperature * scale))
        assert abs(smooth - float(x > 0)) <= bound + 1e-15


@quick
@given(number, number, width)
def test_share_is_the_mean_indicator_along_the_segment(a, b, w):
    """Against 2,001-point averages; the trapezoid's error is below (step / w)^2 / 100, and where
    the segment is long against w only the bound is checked."""
    with jax.enable_x64(True):
        share, exact = (float(at("share", smooth, a, b)) for smooth in (Smooth(w), EXACT))
        assert -1e-12 <= share <= 1 + 1e-12
        if a != b:
            assert abs(share - exact) <= 2 * w * np.log(2) / abs(a - b) + 1e-9
        if abs(a - b) < 20 * w:
            points = np.linspace(a, b, 2001)
            mean = np.trapezoid(np.asarray(at("indicator", Smooth(w), points)), dx=1 / 2000)
            assert share == pytest.approx(mean, abs=2e-6)


def test_share_joins_its_two_formulas():
    """The quotient and Gauss's three points meet where |a - b| = 0.4 w, to 1e-9."""
    for mid in (-3.0, 0.0, 0.7):
        left, right = (
            float(at("share", Smooth(1.0), mid + h, mid - h)) for h in (0.2 - 1e-12, 0.2 + 1e-12)
        )
        assert left == pytest.approx(right, abs=1e-9)


@quick
@given(st.lists(number, min_size=2, max_size=6), width)
def test_weights_and_choose(scores, w):
    with jax.enable_x64(True):
        scores = np.asarray(scores)
        weights = np.asarray(at("weights", Smooth(w), scores))
        assert weights.sum() == pytest.approx(1.0, abs=1e-12) and weights.min() >= 0
        options = np.arange(scores.size, dtype=float)
        assert float(at("choose", EXACT, scores, options)) == int(np.argmax(scores))
        assert 0 <= float(at("choose", Smooth(w), scores, options)) <= scores.size - 1 + 1e-9


@pytest.mark.parametrize("x", [-2.0, -0.5, 0.0, 0.5, 2.0])
def test_temperature_zero_is_exact(x):
    cold, y = Smooth(0.0), 0.25
    for name, arguments in {
        "positive_part": (x,),
        "absolute": (x,),
        "indicator": (x,),
        "minimum": (x, y),
        "maximum": (x, y),
        "clip": (x, -1.0, 1.0),
        "share": (x, y),
        "weights": (jnp.asarray([x, y, 0.1]),),
    }.items():
        np.testing.assert_array_equal(at(name, cold, *arguments), at(name, EXACT, *arguments), name)


@partial(jax.jit, static_argnums=0)
def derivatives(function, smooth, x):
    """Value, first and second derivative by `x`, the second by forward over reverse."""

    def both(x):
        slope = jax.grad(function, argnums=1)
        second = jax.jvp(partial(slope, smooth), (x,), (jnp.ones_like(x),))
        return jnp.stack([function(smooth, x), *second])

    return jax.vmap(both)(x) if jnp.ndim(x) else both(x)


SCALARS = {
    "positive_part": lambda s, x: s.positive_part(x),
    "absolute": lambda s, x: s.absolute(x),
    "indicator": lambda s, x: s.indicator(x),
    "minimum": lambda s, x: s.minimum(x, 1.0),
    "maximum": lambda s, x: s.maximum(x, 1.0),
    "clip": lambda s, x: s.clip(x, -1.0, 1.0),
    "empty clip": lambda s, x: s.clip(x, 1.0, 1.0),
    "share": lambda s, x: s.share(x, 1.0),
    "share of a point": lambda s, x: s.share(x, x),
    "choose": lambda s, x: s.choose(jnp.stack([x, 0.0, 1.0]), jnp.asarray([3.0, 4.0, 5.0])),
}


@pytest.mark.prove
@pytest.mark.parametrize("name", SCALARS)
@pytest.mark.parametrize(
    "smooth",
    [EXACT, Smooth(0.0), Smooth(0.1), Smooth(1e-30)],
    ids=["exact", "zero", "warm", "cold"],
)
def test_value_and_two_derivatives_are_finite(name, smooth):
    """At the kink, at equal arguments, beside them, far away, and at numbers near overflow."""
    x = jnp.asarray([0.0, -0.0, 1.0, -1.0, 1.0 + 1e-12, 0.1, 5.0, -5.0, 1e-300, 1e150, -1e150])
    found = derivatives(SCALARS[name], smooth, x)
    assert np.all(np.isfinite(found)), found


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("temperature", [0.1, 0.003])
def test_weights_of_large_scores_are_finite(temperature, dtype):
    """Above 1e9 widths (in float64 1e18) they were NaN: compilers round the quotient and the
    difference once."""
    with jax.enable_x64(dtype is np.float64):
        weights = Smooth(temperature).weights
        whole, of_product = jax.jit(weights), jax.jit(lambda a, b: weights(a * b))
        further = (1.2345e20, 1e30) if dtype is np.float64 else ()
        for size in (1e3, 1.234567e6, 1.2345678e7, 1.234567e9, 1.2345e12, *further):
            scores = np.array([size, 0.0, 1.0], dtype)
            root = np.sqrt(np.array([size, 0.01, 0.01], dtype))
            (native,) = run(weights, np.tile(scores, (host().lanes(np.dtype(dtype).name), 1)))
            for found in (whole(scores), of_product(root, root), native[0]):
                np.testing.assert_allclose(found, [1.0, 0.0, 0.0], atol=1e-6)


UNBOUND = (
    lambda s, x: s.minimum(x, jnp.inf),
    lambda s, x: s.minimum(jnp.inf, x),
    lambda s, x: s.maximum(x, -jnp.inf),
    lambda s, x: s.maximum(-jnp.inf, x),
    lambda s, x: s.clip(x, -jnp.inf, jnp.inf),
)


@pytest.mark.parametrize("smooth", [EXACT, Smooth(0.0), Smooth(0.1)], ids=["exact", "zero", "warm"])
def test_infinite_limits_do_not_bind_and_leave_derivatives_finite(smooth):
    inf, x = jnp.inf, jnp.asarray(0.3)
    for function in UNBOUND:
        found = derivatives(function, smooth, x)
        np.testing.assert_array_equal(found, [0.3, 1.0, 0.0])
    for name, argument, value in (
        ("positive_part", inf, inf),
        ("positive_part", -inf, 0.0),
        ("indicator", inf, 1.0),
        ("indicator", -inf, 0.0),
    ):
        assert float(at(name, smooth, argument)) == value, (name, argument)
    assert float(at("minimum", smooth, inf, inf)) == inf
    assert float(at("maximum", smooth, -inf, -inf)) == -inf
    for name in ("positive_part", "indicator", "absolute"):
        for x in (inf, -inf):
            assert np.isfinite(derivatives(SCALARS[name], smooth, x)[1]), (name, x)


@quick
@given(number, width)
def test_positive_part_has_the_derivatives_of_its_formula(x, w):
    """First derivative between 0 and 1; second non-negative and at most 3 / (4 w)."""
    with jax.enable_x64(True):
        _, first, second = derivatives(SCALARS["positive_part"], Smooth(w), x)
        assert -1e-12 <= first <= 1 + 1e-12
        assert -1e-9 / w <= second <= 0.75 / w * (1 + 1e-9)


def test_float32_stays_float32():
    with jax.enable_x64(False):
        smooth, x = Smooth(np.float32(0.1)), jnp.float32(0.3)
        for name, function in SCALARS.items():
            assert function(smooth, x).dtype == jnp.float32, name


# --- simplex ------------------------------------------------------------------------------------

LOW = np.asarray([0.0, 0.1, 0.0, 0.05, 0.0, 0.0])
HIGH = np.asarray([0.5, 0.4, 0.3, 0.5, 0.6, 1.0])
GROUPS = (((0, 1), 0.15, 0.45), ((2, 4), 0.02, 0.5))
logits = st.lists(st.floats(-30.0, 30.0), min_size=6, max_size=6)


def shares_of(x, grouped):
    """Shares from logits [6], moves of both bounds [12] and of the total [1]."""
    groups = GROUPS if grouped else ()
    return EXACT.simplex(x[:6], LOW + x[6:12], HIGH + x[12:18], groups, 1.0 + x[18])


shares_of = jax.jit(shares_of, static_argnums=1)
jacobian_of = jax.jit(jax.jacrev(shares_of), static_argnums=1)


@quick
@given(logits, st.booleans())
def test_simplex_obeys_bounds_and_groups_and_adds_up(raw, grouped):
    """To 1e-12: 11 halvings of a bracket under 60 wide leave an error below 0.015, four Newton
    steps less than a digit."""
    with jax.enable_x64(True):
        shares = np.asarray(shares_of(jnp.asarray(raw + [0.0] * 13), grouped))
        assert shares.sum() == pytest.approx(1.0, abs=1e-12)
        assert np.all(shares >= LOW - 1e-12) and np.all(shares <= HIGH + 1e-12)
        for members, low, high in GROUPS if grouped else ():
            assert low - 1e-12 <= shares[list(members)].sum() <= high + 1e-12


@pytest.mark.parametrize("grouped", [False, True])
def test_simplex_derivatives_against_differences(grouped):
    """Logits, bounds and total. Step 1e-5: truncation (1e-5)^2 / 6, round-off 1e-12 / 1e-5."""
    rng = np.random.default_rng(1)
    for _ in range(10):
        x = np.concatenate([rng.uniform(-4, 4, 6), np.zeros(13)])
        slope = jacobian_of(x, grouped)
        for i in range(19):
            e = np.zeros(19)
            e[i] = 1e-5
            difference = (shares_of(x + e, grouped) - shares_of(x - e, grouped)) / 2e-5
            np.testing.assert_allclose(slope[:, i], difference, atol=2e-6)


def test_simplex_without_bounds_is_the_softmax_when_the_bounds_are_wide():
    """w = b sigma(x + level) with b large: shares tend to softmax(x), off by about 1 / b."""
    x = jnp.asarray([0.3, -1.0, 2.0])
    shares = EXACT.simplex(x, 0.0, 1e6)
    np.testing.assert_allclose(shares, jax.nn.softmax(x), atol=2e-6)


def test_simplex_at_extremes():
    """Extreme logits, no room at all, and a second derivative."""
    first = jax.jit(jax.value_and_grad(lambda x: EXACT.simplex(x, 0.0, 0.7)[0]))
    for raw in ([1e4, -1e4, 0.0], [0.0, 0.0, 0.0], [-1e4, -1e4, -1e4]):
        assert all(np.all(np.isfinite(v)) for v in first(jnp.asarray(raw))), raw
        shares = jax.jit(lambda x: EXACT.simplex(x, 0.0, 0.7))(jnp.asarray(raw))
        assert float(shares.sum()) == pytest.approx(1.0, abs=1e-9)
    bounds = jnp.asarray([0.2, 0.3, 0.5])
    np.testing.assert_allclose(jax.jit(EXACT.simplex)(jnp.zeros(3), bounds, bounds), bounds)
    second = jax.jit(jax.hessian(lambda x: EXACT.simplex(x, 0.0, 0.7)[0]))(
        jnp.asarray([0.3, -1.0, 2.0])
    )
    assert np.all(np.isfinite(second)) and np.any(second != 0)


def test_simplex_refuses_overlapping_groups():
    with pytest.raises(ValueError, match="two groups"):
        EXACT.simplex(jnp.zeros(3), groups=(((0, 1), 0.0, 1.0), ((1, 2), 0.0, 1.0)))
