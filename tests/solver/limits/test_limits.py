"""Limits on the average: prices known in closed form, and a limit that cannot be met."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import snapo
from snapo.problem.limits import priced
from snapo.problem.objective import Probability
from snapo.solver.limits.dual import Dual, moved


class Spend(snapo.Simulator):
    """Earns b x - x^2 / 2 by spending x on each of four days; b differs by day and path.

    Without limits x = b. With a budget of B for the mean of the whole spending, x = b - price with
    4 (mean of b) - 4 price = B.
    """

    horizon: int = 4
    noise_size: int = 1
    initial_noise_size = 1
    action: snapo.Box = snapo.Box(1, -10.0, 10.0)

    def prepare(self, inputs):
        return snapo.Schedule(inputs, jnp.zeros(4))

    def initial(self, constants, noise):
        return {"b": 2.0 + 0.5 * noise[0]}

    def observe(self, constants, now, state):
        return jnp.stack([state["b"] - 2.0])

    def step(self, constants, now, state, action, noise, smooth):
        x = action[0]
        outputs = {"earned": constants["worth"] * state["b"] * x - x**2 / 2, "spent": x}
        return {"b": 2.0 + 0.5 * noise[0]}, outputs


INPUTS = {"worth": snapo.Input(1.0)}
FEW = snapo.Evaluation(paths=16384, sensitivity_paths=4096, smooth_paths=0, judge_paths=0)


def solved(limits, **settings):
    return snapo.solve(
        Spend(), INPUTS, snapo.Linear(), objective=snapo.Mean("earned"), limits=limits,
        training=snapo.Training(**{"steps": 300, "learning_rate": 0.03, **settings}),
        evaluation=FEW,
    )  # fmt: skip


@pytest.fixture(scope="module")
def budget():
    return solved((snapo.AtMost("spent", 6.0),))


@pytest.mark.prove
def test_the_price_of_a_budget_is_that_of_its_closed_form(budget):
    """Mean of b 2, budget 6: x = b - .5, price .5, value 4 (E b^2 - .25) / 2 = 8."""
    (found,) = budget.limits
    assert found.met in ("met", "met nearly")
    assert found.value == pytest.approx(6.0, abs=0.03)
    assert abs(found.price - 0.5) < 3 * found.price_error + 0.005 and found.price_error < 0.02
    assert found.multiplier == pytest.approx(0.5, abs=0.05)
    assert budget.value == pytest.approx(8.0, abs=0.05 + 3 * budget.standard_error)


@pytest.mark.prove
def test_derivatives_are_those_of_the_best_value_within_the_limit(budget):
    """By w, x = w b - .5 + 2 (w - 1): d value / d w = 4 E[b x] at w = 1: 4 (4.25 - 1) = 13."""
    held = budget.sensitivities.held["worth"]
    assert float(held.value) == pytest.approx(13.0, abs=0.15)


@pytest.mark.prove
def test_the_file_and_the_lines_tell_limits(budget, tmp_path):
    budget.save(tmp_path)
    assert snapo.Solution.load(tmp_path).limits == budget.limits
    assert "mean of spent at most 6" in str(budget)


@pytest.mark.prove
def test_a_limit_that_cannot_be_met_and_one_that_does_not_bind_are_told():
    found = solved((snapo.AtMost("spent", -50.0), snapo.AtLeast("earned", -1e4)), steps=60)
    assert [each.met for each in found.limits] == ["not met", "met"]
    assert found.limits[1].price == 0
    assert any("Limit not met on fresh paths: mean of spent" in note for note in found.notes)


class Newsvendor(snapo.Simulator):
    """One order q against a normal demand of 100 ± 20 a day; what is left is lost."""

    horizon: int = 1
    noise_size: int = 1
    action: snapo.Box = snapo.Box(1, 0.0, 300.0)

    def prepare(self, inputs):
        return snapo.Schedule(inputs, jnp.zeros(1))

    def initial(self, constants, noise):
        return jnp.zeros(())

    def observe(self, constants, now, state):
        return jnp.ones(1)

    def step(self, constants, now, state, action, noise, smooth):
        demand = 100 + 20 * noise[0]
        sold = smooth.minimum(action[0], demand, scale=20.0)
        outputs = {"profit": constants["price"] * sold - action[0], "short": demand - sold}
        return state, outputs | {"room": action[0] - demand}


@pytest.mark.prove
def test_a_newsvendor_with_a_service_level():
    """Price 2, cost 1: 100 without limits. At least 95 % of days in full, F: profit' =
    2 (1 - F) - 1 is paid by F' = f / 20."""
    limit, z = snapo.AtLeast(Probability("room", 0.0, width=2.0), 0.95), norm.ppf(0.95)
    slope = norm.pdf(z) / 20
    known = (1 - 2 * (1 - norm.cdf(z))) / slope
    found = snapo.solve(
        Newsvendor(), {"price": snapo.Input(2.0)}, snapo.Constant(np.array([100.0])),
        objective=snapo.Mean("profit"), limits=(limit,),
        training=snapo.Training(steps=800, paths=1024, learning_rate=0.5),
        evaluation=snapo.Evaluation(paths=65536, sensitivity_paths=0, smooth_paths=0),
    )  # fmt: skip
    (each,) = found.limits
    # The logistic step of width 2 measures F' over a tenth of a deviation: its slope is within 2 %.
    assert abs(each.price) == pytest.approx(known, rel=0.08)
    assert each.value == pytest.approx(limit.level, rel=0.005)


def test_names_signs_and_the_priced_objective():
    totals = {"x": np.array([1.0, 2.0, 3.0]), "y": np.array([0.0, 0.0, 3.0])}
    low, high = snapo.AtLeast("x", 2.5), snapo.AtMost(Probability("y", 1.0), 0.5)
    assert (low.excess(totals), round(high.excess(totals), 6)) == (0.5, -0.166667)
    assert high.name == "probability of y above 1 at most 0.5"
    whole = priced(snapo.Mean("x"), (low, high), (2.0, 3.0))
    assert whole.value(totals) == pytest.approx(2.0 + 2.0 * 2.0 - 3.0 / 3)
    with pytest.raises(ValueError, match="level is nan"):
        snapo.AtMost("x", float("nan"))


def test_multipliers_move_with_the_excess_and_never_below_zero():
    limits, totals = (snapo.AtMost("x", 1.0),), {"x": np.array([1.0, 3.0])}
    one = moved(Dual(), snapo.Mean("x"), limits, totals, 1.0)
    assert one.multipliers[0] > 0 and one.prices[0] > one.multipliers[0]
    two = moved(one, snapo.Mean("x"), limits, {"x": np.full(2, -99.0)}, 1.0)
    assert two.multipliers == two.prices == (0.0,)
    assert Dual.read([list(each) for each in one]) == one
