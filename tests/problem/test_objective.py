"""Objectives: weights are derivatives, and standard errors cover."""

import operator

import numpy as np
import pytest
from scipy import stats

from snapo.problem.objective import (
    CRRA,
    AtLeast,
    AtMost,
    CVaR,
    Entropic,
    ExpectedUtility,
    Mean,
    MeanVariance,
    Probability,
    Target,
    priced,
)

RNG = np.random.default_rng(0)
X = RNG.normal(1.5, 0.4, size=41)
Y = RNG.normal(size=41)

SMOOTH = {
    "mean": Mean("x"),
    "cvar": CVaR("x", 0.9),
    "cvar of whole paths": CVaR("x", 1 - 4 / 41),
    "mean-variance": MeanVariance("x", 3.0),
    "entropic": Entropic("x", 2.0),
    "crra": ExpectedUtility("x", CRRA(5.0)),
    "log": ExpectedUtility("x", CRRA(1.0)),
    "target": Target("x", 1.0),
    "mixture": Mean("x") * 2 + 0.5 * CVaR("y", 0.8) - Target("x", 1.0),
    "negative": -Mean("y"),
    "cvar of a cost": -CVaR("x", 0.9),
    "mean-variance of a cost": -0.5 * MeanVariance("x", 3.0),
    "entropic of a cost": -Entropic("x", 2.0) / 3,
    "mixture of costs": -(2 * Mean("x") + 0.5 * CVaR("y", 0.8)) - Entropic("x", 2.0),
    "most of a cost": AtMost(Mean("y") + CVaR("x", 0.9), 1.0).measure,
}


@pytest.mark.parametrize("name", SMOOTH)
def test_weights_are_derivatives(name):
    """Step 1e-6: truncation 1e-12 times a third derivative below 1e3, round-off 1e-16 / 1e-6."""
    objective, totals = SMOOTH[name], {"x": X, "y": Y}
    weights = objective.weights(totals)
    assert set(weights) == set(objective.outputs)
    for output, weight in weights.items():
        for i in range(41):
            e = np.zeros(41)
            e[i] = 1e-6
            up, down = (objective.value(totals | {output: totals[output] + s * e}) for s in (1, -1))
            assert weight[i] == pytest.approx((up - down) / 2e-6, abs=5e-9)


@pytest.mark.parametrize("name", SMOOTH)
def test_influence_has_the_value_as_its_mean(name):
    totals = {"x": X, "y": Y}
    influence = SMOOTH[name].influence(totals)
    assert influence.shape == (41,)
    assert influence.mean() == pytest.approx(SMOOTH[name].value(totals), rel=1e-12)


def test_linear_objectives_know_their_weights_beforehand():
    assert (2 * Mean("x") - Mean("y")).linear and not (Mean("x") + CVaR("y", 0.9)).linear


def test_cvar_is_the_mean_of_the_tail():
    x = np.arange(10.0)
    assert CVaR("x", 0.8).value({"x": x}) == pytest.approx(0.5)  # the mean of 0 and 1
    assert CVaR("x", 0.75).value({"x": x}) == pytest.approx(
        (0 + 1 + 0.5 * 2) / 2.5
    )  # half of the third
    weights = CVaR("x", 0.75).weights({"x": x})["x"]
    np.testing.assert_allclose(weights[:4], [0.4, 0.4, 0.2, 0.0], atol=1e-15)
    # Ties and a tail below one path keep the weights' sum at one.
    for level, x in ((0.9, np.zeros(7)), (0.99, np.arange(7.0))):
        assert CVaR("x", level).weights({"x": x})["x"].sum() == pytest.approx(1.0)


def test_cvar_and_entropic_of_normals():
    """N(0, 1): CVaR is -phi(z) / (1 - level), the entropic value -a / 2; on a fine quantile grid
    the mean of a tail is off by less than 1e-3 and the exponential moment by less than 1e-4."""
    x = stats.norm.ppf((np.arange(200_000) + 0.5) / 200_000)
    z = stats.norm.ppf(0.95)
    assert CVaR("x", 0.95).value({"x": x}) == pytest.approx(-stats.norm.pdf(z) / 0.05, abs=1e-3)
    assert Entropic("x", 1.0).value({"x": x}) == pytest.approx(-0.5, abs=1e-4)


COST = {"cost": 2.0 + stats.norm.ppf((np.arange(200_000) + 0.5) / 200_000)}
DEAREST = 2.0 + stats.norm.pdf(stats.norm.ppf(0.9)) / 0.1  # 3.755: the mean of the dearest tenth


@pytest.mark.parametrize(
    "objective, right",
    [
        (-CVaR("cost", 0.9), -DEAREST),
        (-Entropic("cost", 1.0), -2.5),
        (-MeanVariance("cost", 1.0), -2.5),
        (-2.0 * CVaR("cost", 0.9) / 4, -DEAREST / 2),
        (-Mean("cost") - 0.5 * CVaR("cost", 0.9), -2.0 - DEAREST / 2),
        (Mean("cost") - (Mean("cost") + Entropic("cost", 1.0)), -2.5),
        (-(Mean("cost") + 0.5 * CVaR("cost", 0.9)), -2.0 - DEAREST / 2),
        # A sign twice is none: the cheap tenth again, the bad one of a gain.
        (-1 * (-CVaR("cost", 0.9)), 4.0 - DEAREST),
        (-Probability("cost", 2.0), -0.5),
    ],
    ids=repr,
)  # fmt: skip
def test_a_negative_measure_of_risk_looks_at_the_dear_tail(objective, right):
    """Cost ~ N(2, 1) on a fine grid of quantiles: tail and exponential moment are off by 1e-3."""
    assert objective.value(COST) == pytest.approx(right, abs=1e-3)
    assert objective.influence(COST).mean() == pytest.approx(right, abs=1e-3)


def test_limits_look_at_the_tail_that_breaks_them():
    """At most: the dear tail of a cost. At least: the cheap tail of a gain."""
    cheapest = 4.0 - DEAREST
    for limit, measured, excess in (
        (AtMost(CVaR("cost", 0.9), 1.0), DEAREST, DEAREST - 1.0),
        (AtMost(Entropic("cost", 1.0), 1.0), 2.5, 1.5),
        (AtMost(Mean("cost") + CVaR("cost", 0.9), 1.0), 2.0 + DEAREST, 1.0 + DEAREST),
        (AtMost(-CVaR("cost", 0.9), 1.0), -cheapest, -cheapest - 1.0),
        (AtLeast(CVaR("cost", 0.9), 1.0), cheapest, 1.0 - cheapest),
        (AtLeast(-CVaR("cost", 0.9), -1.0), -DEAREST, DEAREST - 1.0),
    ):
        assert limit.measure.value(COST) == pytest.approx(measured, abs=1e-3)
        assert limit.excess(COST) == pytest.approx(excess, abs=1e-3)
        paid = priced(Mean("cost"), (limit,), (2.0,))
        by_limit = paid.value(COST) - 2.0
        assert by_limit == pytest.approx(-2.0 * limit.sign * measured, abs=2e-3)
    assert AtMost(CVaR("cost", 0.9), 1.0).name == "mean of the largest 10 % of cost at most 1"
    assert AtLeast(CVaR("cost", 0.9), 1.0).name == "mean of the smallest 10 % of cost at least 1"


def test_a_utility_of_a_cost_is_refused():
    """A utility is of what shall be large; minus the utility of a cost would seek risk."""
    utility = ExpectedUtility("cost", CRRA(2.0))
    for wrong in (
        lambda: -utility,
        lambda: Mean("x") - 0.5 * utility,
        lambda: AtMost(utility, 1.0),
    ):
        with pytest.raises(ValueError, match=r"ExpectedUtility of cost.*-cost"):
            wrong()


def test_objectives_add_and_scale_as_numbers_do():
    totals = {"a": np.array([1.0, 2.0, 6.0]), "b": np.array([2.0, 4.0, 0.0])}
    a, b = Mean("a"), Mean("b")
    for objective, right in (
        (a / 2, 1.5),
        (sum([a, b]), 5.0),
        (sum([a]), 3.0),
        (-a / 3, -1.0),
        (a - b, 1.0),
        (a - a, 0.0),
        (np.float64(2.0) * a, 6.0),
        (-(a - 2 * b) / 2, 0.5),
    ):
        assert objective.value(totals) == pytest.approx(right)
    for wrong in (lambda: a + 1, lambda: 1 - a, lambda: a * None, lambda: a * b, lambda: 2 / a):
        with pytest.raises(TypeError, match="unsupported operand"):
            wrong()
    for wrong in (lambda: a * np.nan, lambda: a / 0):
        with pytest.raises(ValueError, match=r"Mean: the factor is (nan|1 / 0); it must be"):
            wrong()


def test_objectives_are_said_in_words():
    for objective, words in (
        (Mean("a"), "mean of a"),
        (-Mean("a"), "minus the mean of a"),
        (-CVaR("a", 0.9), "minus the mean of the largest 10 % of a"),
        (0.5 * CVaR("a") - Mean("b") / 4, "0.5 × mean of the smallest 5 % of a - 0.25 × mean of b"),
        (MeanVariance("a", 2.0), "mean-variance of a (aversion 2)"),
        (-MeanVariance("a", 2.0), "minus the mean-variance of the cost a (aversion 2)"),
        (-0.5 * Entropic("a"), "minus 0.5 × entropic mean of the cost a (aversion 1)"),
        (Probability("a", 1.5), "probability of a above 1.5"),
        (ExpectedUtility("a", CRRA(2.0)), "mean utility of a, CRRA(risk_aversion=2.0, wealth=0.0)"),
    ):
        assert str(objective) == words


def test_entropic_does_not_overflow():
    x = np.array([-1e6, 0.0, 1e6])
    objective = Entropic("x", 1.0)
    assert objective.value({"x": x}) == pytest.approx(-1e6 + np.log(3))
    np.testing.assert_allclose(objective.weights({"x": x})["x"], [1.0, 0.0, 0.0])


def test_utility_and_its_certainty_equivalent():
    for aversion in (0.5, 1.0, 5.0):
        utility = CRRA(aversion)
        assert utility.certainty_equivalent(float(utility(np.array([1.7]))[0])) == pytest.approx(
            1.7
        )
        assert utility(np.array([0.0]))[0] == -np.inf


def test_probability_counts_and_its_weights_are_a_density():
    x = RNG.normal(size=100_000)
    objective = Probability("x", threshold=0.3, width=0.05)
    assert objective.value({"x": x}) == np.mean(x > 0.3)
    # Moving all paths by dx moves the probability by the density: smoothing 0.05 wide changes it by
    # about width^2 pi^2 / 6 * density'' / density, 0.4 %; sampling 100,000 paths by 1 %.
    total = objective.weights({"x": x})["x"].sum()
    assert total == pytest.approx(stats.norm.pdf(0.3), rel=0.04)


@pytest.mark.parametrize(
    "objective, truth",
    [
        (Mean("x"), 0.0),
        (CVaR("x", 0.9), -stats.norm.pdf(stats.norm.ppf(0.9)) / 0.1),
        (MeanVariance("x", 2.0), -1.0),
        (Entropic("x", 1.0), -0.5),
        (Target("x", 1.0), -2.0),
        (Mean("x") + CVaR("x", 0.9), -stats.norm.pdf(stats.norm.ppf(0.9)) / 0.1),
        (Probability("x", 0.5), stats.norm.sf(0.5)),
        (-CVaR("x", 0.9), -stats.norm.pdf(stats.norm.ppf(0.9)) / 0.1),
        (-Mean("x") - Entropic("x", 1.0), -0.5),
    ],
    ids=[
        "mean",
        "cvar",
        "mean-variance",
        "entropic",
        "target",
        "mixture",
        "probability",
        "cvar of a cost",
        "mixture of costs",
    ],
)
def test_standard_errors_cover(objective, truth):
    """400 samples of 2,000 normals, 95 % intervals: coverage 0.95 with a standard error of 0.011;
    within three of them and half a point for bias."""
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(400):
        totals = {"x": rng.normal(size=2000)}
        error = objective.influence(totals).std(ddof=1) / np.sqrt(2000)
        hits += abs(objective.value(totals) - truth) < 1.96 * error
    assert 0.91 <= hits / 400 <= 0.985


def test_an_unknown_output_is_named():
    with pytest.raises(KeyError, match="no output 'z'"):
        Mean("z").value({"x": X})
    with pytest.raises(ValueError, match="between 0 and 1"):
        CVaR("x", 95.0)


def test_training_leads_away_from_ruin():
    """A path without wealth has the largest weight that there is; its value is minus infinity."""
    x = {"x": np.array([2.0, 0.5, -1.0, 4.0])}
    log = ExpectedUtility("x", CRRA(1.0))
    assert log.value(x) == -np.inf and np.isnan(log.weights(x)["x"][2])
    np.testing.assert_allclose(log.climb(x)["x"], np.array([0.5, 2.0, 2.0, 0.25]) / 4)
    both = (2 * log + Mean("x")).climb(x)["x"]
    np.testing.assert_allclose(both, 2 * log.climb(x)["x"] + 0.25)


@pytest.mark.parametrize("of", SMOOTH.values(), ids=SMOOTH)
@pytest.mark.parametrize("level", [0.05, -2, np.float64(0.05), np.float32(0.5), np.int64(3)])
def test_a_comparison_with_a_number_is_a_constraint(of, level):
    if isinstance(of, ExpectedUtility):  # it has no upper limit
        assert (of >= level) == (level <= of) == AtLeast(of, level)
        return
    assert (of <= level) == (level >= of) == AtMost(of, level)
    assert (of >= level) == (level <= of) == AtLeast(of, level)
    assert (of <= level) != (of >= level)


def test_a_comparison_with_anything_else_is_refused():
    """Objectives stay equal where all their numbers are, and may be keys."""
    for other in ("x", None, True, np.True_, 1j, [0.1], np.ones(2), np.array(0.1), Mean("y")):
        for compared in (operator.le, operator.ge):
            for pair in ((Mean("x"), other), (other, Mean("x"))):
                with pytest.raises(TypeError, match=r"Mean: compared with .*; it must be a number"):
                    compared(*pair)
    with pytest.raises(ValueError, match="level is nan; it must be a finite number"):
        operator.le(Mean("x"), np.nan)
    with pytest.raises(TypeError, match="'<' not supported"):
        operator.lt(Mean("x"), 0.1)
    assert Mean("x") == Mean("x") != Mean("y") and CVaR("x", 0.9) != Mean("x")
    assert {Mean("x"): 1, CVaR("x"): 2}[CVaR("x", 0.95)] == 2


def test_a_chain_of_comparisons_is_not_taken_for_its_last_one():
    with pytest.raises(TypeError, match="two constraints"):
        assert 0.1 <= Mean("x") <= 0.2
