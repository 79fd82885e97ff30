"""Standard errors against closed forms and against the scatter of repeated samples."""

import time

import jax
import numpy as np
import pytest
from scipy import stats

import snapo
from snapo.problem.objective import CVaR, Mean
from snapo.solver import statistics
from snapo.solver.derivatives.changes import plan
from snapo.solver.evaluate import estimate, value_of, value_of_groups
from snapo.solver.provenance import Clock
from snapo.solver.statistics import Estimate

RNG = np.random.default_rng(0)


def test_pairs_are_one_draw_each():
    pairs = RNG.normal(size=(500, 1)) + 0.1 * RNG.normal(size=(500, 2))
    found = statistics.mean(pairs.ravel(), np.arange(1000) // 2)
    means = pairs.mean(1)
    assert found.value == pytest.approx(means.mean(), rel=1e-12)
    assert found.standard_error == pytest.approx(means.std(ddof=1) / np.sqrt(500), rel=1e-12)
    assert found.degrees == 499
    # Taken for independent, the error would be smaller by nearly the square root of two.
    alone = statistics.mean(pairs.ravel())
    assert found.standard_error > 1.38 * alone.standard_error


def test_a_mean_over_groups_of_different_sizes_is_that_of_all_paths():
    """A mean of the groups' means would give the last, smaller group's paths more weight."""
    values = RNG.normal(size=101)
    groups = np.arange(101) // 10
    found = statistics.mean(values, groups)
    assert found.value == pytest.approx(values.mean(), rel=1e-12)
    left = [values[groups != g].mean() for g in range(11)]
    spread = np.sqrt(10 / 11 * np.sum((left - np.mean(left)) ** 2))
    assert found.standard_error == pytest.approx(spread, rel=0.05)


def test_the_error_of_a_ratio_is_the_scatter_of_ratios():
    tries = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        bottom = rng.uniform(1, 3, 200)
        tries.append(statistics.ratio(2 * bottom + rng.normal(size=200), bottom))
    values = [each.value for each in tries]
    errors = [each.standard_error for each in tries]
    assert np.mean(errors) == pytest.approx(np.std(values), rel=0.15)
    top, bottom = np.arange(5.0), np.ones(5)
    assert statistics.ratio(top, bottom).value == 2.0


@pytest.mark.parametrize("level", [0.05, 0.5])
def test_the_error_of_a_quantile(level):
    """sqrt(p (1 - p) / n) over the density, within a sixth: it is a difference of two quantiles."""
    x = RNG.normal(size=40_000)
    edge = stats.norm.ppf(level)
    found = statistics.quantile(x, level)
    expected = np.sqrt(level * (1 - level) / x.size) / stats.norm.pdf(edge)
    assert found.standard_error == pytest.approx(expected, rel=1 / 6)
    assert found.contains(edge, 0.999)


def test_a_tail_has_the_error_of_its_objective():
    x = RNG.normal(size=4000)
    groups = np.arange(4000) // 2
    found = statistics.tail(x, 0.9, groups)
    same = estimate(CVaR("x", 0.9), {"x": x}, snapo.Pseudo())
    assert found[:2] == pytest.approx((same.value, same.standard_error), rel=1e-12)


def test_none_of_a_hundred_is_not_surely_none():
    share, error = statistics.proportion(np.array([0, 50, 100]), 100)
    np.testing.assert_array_equal(share, [0.0, 0.5, 1.0])
    assert error[0] == pytest.approx(error[2]) and 1.96 * error[0] == pytest.approx(0.03, rel=0.15)
    assert error[1] == pytest.approx(0.05, rel=0.03)


def test_students_limits():
    """Tables of t: 2.0395 for 31 degrees, 1.95996 for none too few; Bonferroni for ten."""
    assert statistics.critical(31) == pytest.approx(2.0395, abs=1e-4)
    assert statistics.critical() == pytest.approx(1.95996, abs=1e-5)
    assert statistics.critical(comparisons=10) == pytest.approx(stats.norm.isf(0.0025))
    low, high = statistics.Sampled(1.0, 0.1, 31).interval()
    assert (low, high) == pytest.approx((1 - 0.20395, 1 + 0.20395), abs=1e-5)
    assert np.isnan(statistics.of_shares(np.ones(1)).standard_error)


def test_the_norm_of_noise_is_zero_on_average():
    """The norm of a mean of 32 blocks of noise in 100 dimensions: the noise in it is all of it."""
    found = [Estimate(np.random.default_rng(i).normal(size=(32, 100))) for i in range(50)]
    norm, noise = np.array([each.norm() for each in found]).T
    assert np.all(noise > 1.5) and np.median(norm) < 0.5
    real = Estimate(RNG.normal(size=(32, 100)) + 3.0)
    assert real.norm()[0] == pytest.approx(30.0, rel=0.03)


def test_blocks_of_different_sizes_are_left_out_too():
    """The mean: every block's pull counts as its paths do, and the errors are of one path each."""
    x, sizes = RNG.normal(size=140), [20, 40, 30, 50]
    parts = np.split(x, np.cumsum(sizes)[:-1])
    found = plan(Mean("x"), {"x": x}, sizes)
    sums = np.array([part.sum() / 140 for part in parts])
    blocks = Estimate(found.estimate(sums, np.zeros(0)))
    assert blocks.value == pytest.approx(x.mean(), rel=1e-12)
    scatter = []
    for seed in range(2000):
        parts = np.split(np.random.default_rng(seed).normal(size=140), np.cumsum(sizes)[:-1])
        sums = np.array([part.sum() / 140 for part in parts])
        scatter.append(Estimate(found.estimate(sums, np.zeros(0))).standard_error ** 2)
    assert np.mean(scatter) == pytest.approx(1 / 140, rel=0.1)


def test_a_control_whose_mean_is_not_zero_is_refused():
    """The objective itself as a control would take away the whole value, and leave 0.0."""
    noise = RNG.normal(size=2000)
    totals = {"x": 3 + noise, "martingale": noise + 0.1 * RNG.normal(size=2000)}
    source = snapo.Pseudo(antithetic=False)
    plain = estimate(Mean("x"), totals, source)
    wrong = estimate(Mean("x"), totals, source, ("x",))
    assert wrong.refused == ("x",) and wrong[:2] == plain[:2]
    both = estimate(Mean("x"), totals, source, ("x", "martingale"))
    assert both.refused == ("x",) and both.control > 0.98
    assert both.standard_error < 0.12 * plain.standard_error
    assert abs(both.value - 3) < 4 * both.standard_error
    groups = value_of_groups(Mean("x"), totals, source, ("x", "martingale"))
    assert groups.mean() == pytest.approx(both.value, rel=1e-12)


def test_rare_numbers_that_are_not_finite_are_left_out_and_counted():
    """One in a thousand at most; the paired scenarios of groups stay in their places."""
    x = RNG.normal(size=4000)
    bad = x.copy()
    bad[[10, 20, 21]] = np.nan, np.inf, np.nan
    found = estimate(Mean("x"), {"x": bad}, snapo.Pseudo())
    assert found.dropped == 3
    assert found.value == pytest.approx(np.delete(x, [10, 20, 21]).mean(), rel=1e-12)
    assert value_of(Mean("x"), {"x": bad}) == pytest.approx(found.value, rel=1e-12)
    assert value_of_groups(Mean("x"), {"x": bad}, snapo.Pseudo()).size == 2000
    bad[30:32] = np.nan
    many = estimate(Mean("x"), {"x": bad}, snapo.Pseudo())
    assert many.dropped == 5 and np.isnan(many.value) and np.isnan(many.standard_error)


def test_compiling_within_compiling_counts_once():
    with Clock() as clock:
        time.sleep(0.05)
        jax.monitoring.record_event_duration_secs("/jax/core/compile/inner", 0.01)
        jax.monitoring.record_event_duration_secs("/snapo/compile", 0.04)
        clock.stage("train")
    found = clock.total()
    # Differences of a clock that counts seconds since the machine started: to the nanosecond.
    assert 0.04 - 1e-9 <= found["compile"] < 0.05 and found["train"] >= 0.01 - 1e-9
    assert found["total"] == pytest.approx(found["compile"] + found["train"])
    jax.monitoring.record_event_duration_secs("/snapo/compile", 1.0)
    clock.stage("evaluate")
    assert clock.total()["compile"] == found["compile"]


@pytest.mark.prove
@pytest.mark.parametrize("count", [256, 1024])
def test_the_interval_of_a_mean_with_a_long_tail_holds_it(count):
    """Lognormal numbers, whose mean is known: Student's interval holds it in 81 to 83 %.

    Their skewness is 414: no interval of so few numbers holds the mean in all of 95 %.
    """
    random, deviation, trials = np.random.default_rng(5), 2.0, 200
    exact, held, plain = np.exp(deviation**2 / 2), 0, 0
    for _ in range(trials):
        values = np.exp(deviation * random.standard_normal(count))
        found = statistics.skewed_mean(values)
        held += found.low <= exact <= found.high
        plain += statistics.mean(values).contains(exact)
        assert found.few and found.low < found.value < found.high
    assert held / trials >= 0.87 and held > plain + 0.04 * trials


def test_the_interval_of_a_mean_without_a_tail_is_that_of_blocks():
    random, trials = np.random.default_rng(6), 400
    held = 0
    for _ in range(trials):
        found = statistics.skewed_mean(random.standard_normal(640) + 2.0)
        held += found.low <= 2.0 <= found.high
        assert not found.few
    assert statistics.proportion(held, trials)[0] == pytest.approx(0.95, abs=0.03)


def test_a_mean_of_equal_numbers_has_no_interval():
    found = statistics.skewed_mean(np.full(100, 3.0))
    assert found == (3.0, 0.0, 3.0, 3.0, False)


def test_deviation_and_shortfall_of_a_normal_sample():
    """sd / sqrt(2 n); z sd and phi(z) / 0.05 sd below the mean (Jorion, Value at Risk, 2006)."""
    values = 5 + 3 * np.random.default_rng(3).normal(size=40_000)
    result = statistics.deviation(values)
    assert abs(result.value - 3) < 3 * result.standard_error
    assert result.standard_error == pytest.approx(3 / np.sqrt(80_000), rel=0.05)
    z = float(stats.norm.ppf(0.95))
    risk, mean_below = statistics.shortfall(values, 0.95)
    assert abs(risk.value - 3 * z) < 3 * risk.standard_error
    assert abs(mean_below.value - 3 * stats.norm.pdf(z) / 0.05) < 3 * mean_below.standard_error


def test_errors_of_deviation_and_shortfall_are_their_scatter():
    """Also of antithetic pairs, whose squares are one draw each."""
    tries = []
    for seed in range(300):
        half = np.random.default_rng(seed).normal(size=1000)
        values = np.exp(0.3 * np.concatenate([half, -half]))
        groups = np.tile(np.arange(1000), 2)
        tries.append(
            (statistics.deviation(values, groups), *statistics.shortfall(values, 0.9, groups))
        )
    for results in zip(*tries, strict=True):
        scatter = np.std([result.value for result in results])
        assert np.mean([x.standard_error for x in results]) == pytest.approx(scatter, rel=0.15)


@pytest.mark.parametrize(
    ("error", "text"),
    [(0.0123, "± 0.024"), (2.1, "± 4.1"), (157.0, "± 310"), (35_557.0, "± 70,000")],
)
def test_half_of_an_interval_is_written_without_a_power_of_ten(error, text):
    """It was "± 3.1e+02"."""
    assert statistics.plus_minus(error) == text
