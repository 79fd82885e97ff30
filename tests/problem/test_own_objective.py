"""Objectives of one's own, one formula in jax.numpy: weights, sampling errors, and speed."""

from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from time import perf_counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.problem.objective import CRRA, CVaR, Entropic, Mean, Objective

RNG = np.random.default_rng(0)
TOTALS = {"x": RNG.normal(1.5, 0.4, size=41), "y": RNG.normal(size=41)}


@dataclass(frozen=True)
class Formula(Objective):
    """Any formula of x, to compare with a closed form."""

    name: str

    outputs = ("x",)

    def formula(self, totals):
        return FORMULAS[self.name](totals["x"])


def tail_mean(x):
    """CVaR at 0.9 by a sort; the path on the edge counts in part."""
    tail = 0.1 * x.size
    return jnp.sum(jnp.sort(x) * jnp.clip(tail - jnp.arange(x.size), 0, 1)) / tail


FORMULAS = {
    "mean": jnp.mean,
    "mean-variance": lambda x: jnp.mean(x) - 1.5 * jnp.var(x),
    "entropic": lambda x: -(jax.nn.logsumexp(-2.0 * x) - jnp.log(x.size)) / 2.0,
    "crra": lambda x: jnp.mean(x**-4.0 / -4.0),
    "target": lambda x: -jnp.mean((x - 1.0) ** 2),
    "probability": lambda x: jnp.mean(jax.nn.sigmoid((x - 1.4) / 0.2)),
    "cvar": tail_mean,
}
CLOSED = {
    "mean": Mean("x"),
    "mean-variance": snapo.MeanVariance("x", 3.0),
    "entropic": Entropic("x", 2.0),
    "crra": snapo.ExpectedUtility("x", CRRA(5.0)),
    "target": snapo.Target("x", 1.0),
    "cvar": CVaR("x", 0.9),
}


@pytest.mark.parametrize("name", CLOSED)
def test_a_formula_gives_the_values_and_weights_of_its_closed_form(name):
    """Value and weights to 1e-12: the same numbers, by other roundings."""
    own, closed = Formula(name), CLOSED[name]
    assert own.value(TOTALS) == pytest.approx(closed.value(TOTALS), rel=1e-12)
    found = own.weights(TOTALS)["x"]
    assert found.dtype == np.float64 and isinstance(found, np.ndarray)
    np.testing.assert_allclose(found, closed.weights(TOTALS)["x"], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", [name for name in CLOSED if name != "cvar"])
def test_a_formula_of_sums_has_the_influence_of_its_closed_form(name):
    """The infinitesimal jackknife is the influence function itself: to 1e-12."""
    found = Formula(name).influence(TOTALS)
    np.testing.assert_allclose(found, CLOSED[name].influence(TOTALS), rtol=1e-11, atol=1e-13)


COUNTS = {
    "share": lambda x: jnp.mean(x) - 10.0 * (jnp.sum(x < -1.0) / x.size),
    "whole": lambda x: jnp.mean(x) - 10 * jnp.sum(jnp.where(x < -1.0, 1, 0)) / x.size,
    "times": lambda x: jnp.mean(x) - (10 * jnp.sum(x < -1.0).astype(int) + 0) / x.size,
    "product": lambda x: jnp.mean(x) - 10 / x.size * ((x < -1).astype(int) @ jnp.ones_like(x, int)),
    "nonzero": lambda x: jnp.mean(x) - 10 * jnp.count_nonzero(x < -1.0) / x.size,
    "two": lambda x: jnp.mean(x) - 10 * jnp.sum(jnp.stack([x, x + 9]) < -1, axis=1).max() / x.size,
}
FORMULAS |= COUNTS
FORMULAS["only"] = lambda x: jnp.sum(x < -1.0) / x.size
FORMULAS["mean of those"] = lambda x: jnp.sum(jnp.where(x < -1, x, 0)) / jnp.sum(x < -1)


@pytest.mark.parametrize("name", COUNTS)
def test_a_formula_that_counts_paths_has_the_influence_of_every_path(name):
    """The count is a sum of whole numbers, and its slope is zero almost everywhere: without it the
    deviation would be 1.0 and not 4.4."""
    x = np.random.default_rng(1).normal(size=4000)
    each = x - 10 * (x < -1)
    found = Formula(name).influence({"x": x})
    np.testing.assert_allclose(found, each, rtol=0, atol=1e-9)
    assert found.std() == pytest.approx(4.4, abs=0.1)


def test_a_count_without_anything_else_has_an_error():
    """A share p has the deviation sqrt(p (1 - p)) of one path; the mean m of the paths in a tail of
    the share p has the influence m + (x - m) / p within it, and m outside."""
    x = np.random.default_rng(1).normal(size=4000)
    within = x < -1
    share, mean = within.mean(), x[within].mean()
    found = Formula("only").influence({"x": x})
    assert found.std() == pytest.approx(np.sqrt(share * (1 - share)), rel=1e-9)
    found = Formula("mean of those").influence({"x": x})
    expected = mean + np.where(within, x - mean, 0.0) / share
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_a_formula_with_a_sort_has_nearly_the_influence_of_its_closed_form():
    """The integral of the slopes is off by half the gap at the edge of the tail times its slope of
    10: gaps are 1 / (2,000 * 0.175) on average, and ten of these 0.03, make 0.15 at most."""
    totals = {"x": RNG.normal(size=2000)}
    own, closed = Formula("cvar"), CLOSED["cvar"]
    np.testing.assert_allclose(own.influence(totals), closed.influence(totals), atol=0.15)


@dataclass(frozen=True)
class TailOfSum(Objective):
    """CVaR of x + y by a sort: two outputs, no sum over paths."""

    outputs = ("x", "y")

    def formula(self, totals):
        return tail_mean(totals["x"] + totals["y"])


def test_a_sort_of_two_outputs_has_about_the_spread_of_its_closed_form():
    """A sensitivity curve on 512 paths, 51 of them in the tail: its spread is off by about
    1 / sqrt(51), 14 %; within 25 %."""
    totals = {"x": RNG.normal(size=4000), "y": RNG.normal(size=4000)}
    closed = CVaR("z", 0.9)
    both = {"z": totals["x"] + totals["y"]}
    found = TailOfSum().influence(totals)
    assert found.mean() == pytest.approx(closed.value(both), rel=1e-12)
    assert found.std() == pytest.approx(closed.influence(both).std(), rel=0.25)


def test_the_rounded_step_has_the_weights_of_the_probability():
    weights = snapo.Probability("x", 1.4, 0.2).weights(TOTALS)["x"]
    np.testing.assert_allclose(Formula("probability").weights(TOTALS)["x"], weights, rtol=1e-12)


@dataclass(frozen=True)
class Ratio(Objective):
    """Mean of x over the standard deviation of y: two outputs, not a sum."""

    outputs = ("x", "y")

    def formula(self, totals):
        return jnp.mean(totals["x"]) / jnp.std(totals["y"], ddof=1)


def test_two_outputs_against_differences_and_the_delta_method():
    """Weights: step 1e-6, round-off 1e-10. Influence of mean/deviation by the delta method:
    IF = (x - m) / s - m ((y - n)^2 - s^2) / (2 s^3), up to ddof: 1 / N of it."""
    ratio = Ratio()
    found = ratio.weights(TOTALS)
    for name, weight in found.items():
        for i in (0, 17, 40):
            e = np.zeros(41)
            e[i] = 1e-6
            up, down = (ratio.value(TOTALS | {name: TOTALS[name] + s * e}) for s in (1, -1))
            assert weight[i] == pytest.approx((up - down) / 2e-6, abs=1e-8)
    x, y = RNG.normal(1.0, 0.5, 5000), RNG.normal(size=5000)
    m, n, s = x.mean(), y.mean(), y.std()
    expected = m / s + (x - m) / s - m * ((y - n) ** 2 - s**2) / (2 * s**3)
    np.testing.assert_allclose(ratio.influence({"x": x, "y": y}), expected, rtol=1e-3, atol=1e-3)


def test_own_objectives_join_with_others():
    mixed = 2 * Ratio() - 0.5 * CVaR("y", 0.8)
    assert mixed.outputs == ("x", "y") and not mixed.linear
    influence = mixed.influence(TOTALS)
    assert influence.mean() == pytest.approx(mixed.value(TOTALS), rel=1e-12)
    dear = CVaR("y", 0.8).weights({"y": -TOTALS["y"]})["y"]  # a negative CVaR is that of a cost
    expected = 2 * Ratio().weights(TOTALS)["y"] - 0.5 * dear
    np.testing.assert_allclose(mixed.weights(TOTALS)["y"], expected, rtol=1e-12)


def test_own_objectives_that_cannot_be_used_say_why():
    @dataclass(frozen=True)
    class Listed(Objective):
        levels: list
        outputs = ("x",)

        def formula(self, totals):
            return jnp.mean(totals["x"])

    @dataclass(frozen=True)
    class Vector(Objective):
        outputs = ("x",)

        def formula(self, totals):
            return totals["x"]

    class Empty(Objective):
        outputs = ("x",)

    with pytest.raises(TypeError, match="tuples of them"):
        Listed([0.1]).value(TOTALS)
    with pytest.raises(TypeError, match=r"shape \(41,\)"):
        Vector().value(TOTALS)
    with pytest.raises(NotImplementedError, match="write formula"):
        Empty().value(TOTALS)
    with pytest.raises(KeyError, match="no output 'x'"):
        Ratio().weights({"y": TOTALS["y"]})
    assert np.isfinite(Ratio().influence({"x": np.ones(1), "y": np.ones(1)})).all()


def test_weights_of_a_formula_cost_little_in_training():
    """512 paths, compiled: below a millisecond even on a busy machine (alone 0.1 to 0.2)."""
    totals = {"x": RNG.normal(size=512), "y": RNG.normal(size=512)}
    ratio, times = Ratio(), []
    for _ in range(50):
        start = perf_counter()
        ratio.weights(totals)
        times.append(perf_counter() - start)
    assert min(times) < 1e-3


@pytest.mark.prove
def test_the_example_of_an_own_objective_runs(monkeypatch):
    """Its ratio falls when risk rises, and its training improves on the start."""
    place = Path(__file__).parents[2] / "examples" / "own_objective.py"
    monkeypatch.syspath_prepend(place.parent)
    spec = spec_from_file_location("own_objective", place)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    text = place.read_text()
    written = text[text.index("@dataclass") : text.index("if __name__")].split("\n")
    assert len([line for line in written if line]) == 5
    ratio = module.Sharpe()
    wide = {"cash": np.array([1.0, 2.0, 3.0])}
    assert ratio.value(wide) == pytest.approx(2 / np.sqrt(2 / 3))
    training = snapo.Training(steps=20, paths=64, validation_paths=128, validation_every=10)
    evaluation = snapo.Evaluation(256, 64, 0, 0, search_paths=0)
    solution = snapo.solve(
        module.Reservoir(),
        module.inputs,
        objective=ratio,
        training=training,
        evaluation=evaluation,
        engine="xla",
    )
    assert solution.status == "trained" and 0 < solution.standard_error < solution.value
