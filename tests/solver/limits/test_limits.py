"""Limits on the average: prices known in closed form, and a limit that cannot be met."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import snapo
from snapo.engine import Xla
from snapo.problem.objective import Probability, priced
from snapo.problem.problem import Problem
from snapo.problem.smooth import Smooth
from snapo.solver.evaluate import path_totals
from snapo.solver.limits import Dual, LimitFound, limits_found, notes_of, updated_prices
from snapo.solver.verdict.convergence import _gain


class Spend(snapo.Simulator):
    """Earns b x - x^2 / 2 by spending x on each of four days; b differs by day and path.

    Without limits x = b. With a budget of B for the mean of the whole spending, x = b - price with
    4 (mean of b) - 4 price = B.
    """

    horizon: int = 4
    noise_size: int = 1
    initial_noise_size = 1
    action: snapo.Box = snapo.Box(-10.0, 10.0)

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


class Noisy(Spend):
    """Earns noise beside, far larger than all that decisions change."""

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = super().step(constants, now, state, action, noise, smooth)
        return after, outputs | {"earned": outputs["earned"] + 1e6 * noise[0]}


INPUTS = {"worth": snapo.Input(1.0)}
FEW = snapo.Evaluation(paths=16384, sensitivity_paths=4096, smooth_paths=0, judge_paths=0)


def solved(limits, **settings):
    return snapo.solve(
        Spend(), INPUTS, snapo.Linear(), objective=snapo.Mean("earned"), constraints=limits,
        training=snapo.Training(**{"steps": 300, "learning_rate": 0.03, **settings}),
        evaluation=FEW,
    )  # fmt: skip


@pytest.fixture(scope="module")
def budget():
    return solved((snapo.AtMost("spent", 6.0),))


@pytest.mark.prove
def test_the_price_of_a_budget_is_that_of_its_closed_form(budget):
    """Mean of b 2, budget 6: x = b - .5, price .5, value 4 (E b^2 - .25) / 2 = 8."""
    (found,) = budget.constraints
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
    assert snapo.Solution.load(tmp_path).constraints == budget.constraints
    assert "mean of spent at most 6" in str(budget)


@pytest.mark.prove
def test_a_limit_that_cannot_be_met_and_one_that_does_not_bind_are_told():
    found = solved((snapo.AtMost("spent", -50.0), snapo.AtLeast("earned", -1e4)), steps=60)
    assert [each.met for each in found.constraints] == ["not met", "met"]
    assert found.constraints[1].price == 0
    assert any("Limit not met on fresh paths: mean of spent" in note for note in found.notes)


class Newsvendor(snapo.Simulator):
    """One order q against a normal demand of 100 ± 20 a day; what is left is lost."""

    horizon: int = 1
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.0, 300.0)

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
        objective=snapo.Mean("profit"), constraints=(limit,),
        training=snapo.Training(steps=800, paths=1024, learning_rate=0.5),
        evaluation=snapo.Evaluation(paths=65536, sensitivity_paths=0, smooth_paths=0),
    )  # fmt: skip
    (each,) = found.constraints
    # The logistic step of width 2 measures F' over a tenth of a deviation: its slope is 3 % larger.
    assert abs(abs(each.price) - known / 1.03) < 2 * each.price_error < 0.15 * known
    assert abs(each.multiplier) == pytest.approx(known / 1.03, rel=0.03)
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
    one = updated_prices(Dual(), snapo.Mean("x"), limits, totals, 1.0)
    assert one.multipliers[0] > 0 and one.prices[0] > one.multipliers[0]
    two = updated_prices(one, snapo.Mean("x"), limits, {"x": np.full(2, -99.0)}, 1.0)
    assert two.prices == (0.0,) and two.multipliers[0] < 0.9 * one.multipliers[0]
    assert Dual.read([list(each) for each in one]) == one


@pytest.mark.prove
def test_the_unit_of_a_price_is_that_of_derivatives_and_knows_no_noise():
    """At x = 1 the objective's derivative by x is b - x, 1 on average, and the measure's is 1."""
    limits, policy = (snapo.AtMost("spent", 1.0),), snapo.Constant(np.array([1.0]))
    units = []
    for simulator in (Spend(), Noisy()):
        problem = Problem(simulator, INPUTS, snapo.Mean("earned"), constraints=limits)
        given = policy.for_problem(problem.interface, jax.random.key(0))
        draws = problem.sources.training.batch(0, 512, simulator)
        bound = Xla(precision="float64").bind(problem)
        dual = Dual().measured(bound, given, draws, Smooth(0.02), problem.objective, limits)
        units += dual.units
    assert units[0] == pytest.approx(1.0, abs=0.1) and units[1] == pytest.approx(units[0], rel=1e-6)


@pytest.mark.prove
def test_a_limit_far_from_its_level_has_no_price_and_a_note():
    """Whatever multiplier training ended with: two are spent each day, eight in all."""
    told = {}
    for level in (8.01, 100.0):
        limits = (snapo.AtMost("spent", level),)
        problem = Problem(Spend(), INPUTS, snapo.Mean("earned"), constraints=limits)
        policy = snapo.Linear().for_problem(problem.interface, jax.random.key(0))
        totals = path_totals(problem, policy, 1024)
        room = {"spent": 8.0 + np.tile([-0.3, 0.3], 512)}
        engine = Xla(precision="float64")
        found = limits_found(problem, policy, totals | room, Dual((0.5,)), Smooth(0.01), engine)
        told[level] = found[0], notes_of(found)
    near, notes = told[8.01]
    assert near.met == "met" and near.binds and near.price_error > 0 and not notes
    far, notes = told[100.0]
    assert far.met == "met" and not far.binds and far.price == 0 and "it has no price" in str(far)
    assert len(notes) == 1 and "Training ended at a price of 0.5" in notes[0]


class Reservoir(snapo.Simulator):
    """Water is sold, by default half of what the turbines take; a network decides."""

    horizon: int = 12
    noise_size: int = 2
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def prepare(self, inputs):
        return snapo.Schedule(inputs, {"week": jnp.arange(12.0)})

    def initial(self, constants, noise):
        return {"water": jnp.asarray(60.0), "price": constants["price"]}

    def observe(self, constants, now, state):
        return jnp.stack([now["week"] / 6 - 1, state["water"] / 50 - 1, state["price"] / 50 - 1])

    def step(self, constants, now, state, action, noise, smooth):
        release = smooth.minimum(10 * action[0], state["water"], scale=10.0)
        rain = 4 * jnp.exp(0.5 * noise[0] - 0.125)
        water = smooth.minimum(state["water"] - release + rain, 100.0, scale=10.0)
        price = state["price"] ** 0.8 * constants["price"] ** 0.2 * jnp.exp(0.2 * noise[1])
        return {"water": water, "price": price}, {
            "cash": state["price"] * release,
            "released": release,
        }


@pytest.mark.prove
def test_a_network_keeps_limits_far_below_the_rule_that_it_begins_with():
    """It begins at 60. Between two levels the value rises by no less than the price at the upper
    one, and by no more than that at the lower."""
    values, prices = [], []
    levels = (3.0, 20.0, 50.0)
    for level in levels:
        solution = snapo.solve(
            Reservoir(), {"price": snapo.Input(50.0)}, snapo.MLP(), objective=snapo.Mean("cash"),
            constraints=(snapo.AtMost("released", level),),
            training=snapo.Training(steps=600),
            evaluation=snapo.Evaluation(paths=16384, sensitivity_paths=0),
        )  # fmt: skip
        (found,) = solution.constraints
        assert found.value == pytest.approx(level, rel=0.02)
        assert found.price == pytest.approx(found.multiplier, rel=0.03)
        values.append(solution.value), prices.append(found.price)
    for k in (0, 1):
        slope = (values[k + 1] - values[k]) / (levels[k + 1] - levels[k])
        assert 0.98 * prices[k + 1] < slope < 1.02 * prices[k]


class Budget(snapo.Simulator):
    """Four days without noise, each worth more than the one before; a dose costs nothing but the
    budget, so that the best constant decision spends all and breaks it."""

    horizon: int = 4
    noise_size: int = 0
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"day": jnp.arange(4.0)})

    def initial(self, constants, noise):
        return jnp.zeros(())

    def observe(self, constants, now, state):
        return now["day"][None] / 2 - 0.75

    def step(self, constants, now, state, action, noise, smooth):
        saved = constants["worth"] * (1 + now["day"]) * action[0]
        return state, {"saved": saved, "doses": action[0]}


def test_a_rule_that_breaks_a_limit_is_no_rival():
    """Ten are saved with four doses, seven with the two that there are."""
    problem = Problem(
        Budget(), INPUTS, snapo.Mean("saved"), constraints=(snapo.AtMost("doses", 2.0),)
    )
    mine = {"saved": np.full(8, 7.0), "doses": np.full(8, 2.0)}
    for doses, sure in ((4.0, True), (2.0, False)):
        other = {"saved": np.full(8, 10.0), "doses": np.full(8, doses)}
        assert _gain(problem, mine, [other], np.arange(8)).is_significant == sure
    # None at all would look good at the price of the last dose, were it worth eight.
    none = {"saved": np.zeros(8), "doses": np.zeros(8)}
    assert _gain(problem, mine, [none], np.arange(8)).value == 7.0


@pytest.mark.prove
def test_without_noise_a_limit_is_met_up_to_round_off():
    """Two doses go to the last two days: 3 + 4. All paths are one, so no interval allows for the
    last digits of a policy in float32."""
    found = snapo.solve(
        Budget(), INPUTS, objective=snapo.Mean("saved"), constraints=(snapo.AtMost("doses", 2.0),),
        training=snapo.Training(steps=400, paths=16, learning_rate=0.01), evaluation=FEW,
        engine="xla",
    )  # fmt: skip
    assert found.value == pytest.approx(7.0, abs=1e-4)
    assert found.constraints[0].met in ("met", "met nearly") and found.convergence == "converged"
    assert not found.notes


def test_a_limit_at_its_level_without_a_price_is_said_to_be_met_exactly():
    """All decisions at bounds of their set: nothing moves, and derivatives tell no price."""
    at = LimitFound("doses", 2.0, 1.9999999, 0.0, 1.9999999, 1.9999999, 0.0, 0.0, 1.5, "met")
    assert "met exactly" in notes_of((at,))[0] and "a price of 1.5" in notes_of((at,))[0]
    assert "with slack" in notes_of((at._replace(value=1.8, high=1.8),))[0]
