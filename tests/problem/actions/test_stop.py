"""Stopping: rights and hazards, derivatives against stops that are drawn, and known values."""

import importlib.util
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.stopping import cases, measured

import snapo
from snapo.engine import Native
from snapo.problem.actions import Stop
from snapo.problem.policies.rules import Linear
from snapo.problem.simulator import Schedule
from snapo.problem.smooth import Exact, Smooth

EXAMPLES = Path(__file__).parents[3] / "examples"


def put():
    spec = importlib.util.spec_from_file_location("put", EXAMPLES / "american_put.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_rights_are_used_one_at_a_time():
    """Three rights and exact decisions: use, wait, use, use; then there is none to use."""
    stop = Stop(rights=3)
    right, seen = stop.initial(), []
    for hazard in (1.0, 0.0, 1.0, 1.0, 1.0):
        right, used = stop.use(right, jnp.full(3, hazard))
        seen.append((float(used), float(stop.left(right))))
    assert seen == [(1, 2), (0, 2), (1, 1), (1, 0), (0, 0)]


def test_the_chance_that_a_right_is_left():
    right = Stop(rights=2).use(jnp.array([0.2, 0.7]), jnp.array([0.5, 0.4]))[0]
    assert float(Stop(rights=2).alive(right)) == pytest.approx(0.8, rel=1e-6)
    assert float(Stop(rights=2).left(right)) == pytest.approx(0.38 + 2 * 0.42, rel=1e-6)


@pytest.mark.prove
def test_training_can_come_back_from_a_hazard_that_has_nearly_vanished():
    """Ten widths further down the slope is a thousandth, where a logistic curve's is e^-10 of it."""
    hot = Smooth(np.float64(0.02))
    slope = jax.vmap(jax.grad(lambda raw: Stop().squash(raw[None], hot)[0]))
    near, far = (float(slope(jnp.array([at]))[0]) for at in (0.0, -40.0))
    assert far > near / 400
    assert all(np.isfinite(np.asarray(slope(jnp.array([-1e6, 1e6])))))


def test_hazards_give_the_law_of_the_number_of_rights():
    """Two rights, hazards that differ by the rights left, against the tree of all outcomes."""
    stop, hazards = Stop(rights=2), np.array([[0.3, 0.6], [0.5, 0.2], [0.9, 0.4]])
    right, total = stop.initial(), 0.0
    for hazard in hazards:
        right, used = stop.use(right, jnp.asarray(hazard))
        total += float(used)
    chances = {2: 1.0, 1: 0.0, 0: 0.0}
    for one, two in hazards:
        chances = {
            2: chances[2] * (1 - two),
            1: chances[2] * two + chances[1] * (1 - one),
            0: chances[0] + chances[1] * one,
        }
    np.testing.assert_allclose(right, [chances[1], chances[2]], rtol=1e-6)
    assert total == pytest.approx(chances[1] + 2 * chances[0], rel=1e-6)


def test_an_untrained_network_hardly_ever_stops_and_a_rule_stops_at_its_threshold():
    stop, zero = Stop(hazard=0.01), jnp.zeros(1)
    assert float(stop.squash(zero, Smooth(np.float32(0.02)))[0]) == pytest.approx(0.01, rel=1e-5)
    assert float(stop.squash(zero, Exact())[0]) == 0
    assert float(stop.squash(zero + 5, Exact())[0]) == 1


def drawn(module, gain, given, seed):
    """[paths] payoffs of a put on 10 dates where every stop is drawn from its hazard, in NumPy."""
    rng = np.random.default_rng(seed)
    spot = np.full(1_000_000, given["spot"])
    alive, paid = np.ones(len(spot), bool), np.zeros(len(spot))
    drift = (given["rate"] - given["volatility"] ** 2 / 2) / 10
    for date in range(10):
        year = date / 10
        score = gain[0] * 5 * np.log(spot / given["strike"]) + gain[1] * (1 - year) + gain[2]
        now = alive & (rng.random(len(spot)) < (1 + score / np.sqrt(1 + score**2)) / 2)
        paid += now * np.exp(-given["rate"] * year) * np.maximum(given["strike"] - spot, 0)
        alive &= ~now
        spot = spot * np.exp(drift + given["volatility"] * rng.normal(size=len(spot)) / 10**0.5)
    return paid + alive * np.exp(-given["rate"]) * np.maximum(given["strike"] - spot, 0)


@pytest.mark.prove
def test_the_hazard_form_is_the_unbiased_derivative_of_stops_that_are_drawn():
    """One adjoint pass against central differences of a simulation in NumPy whose paths do stop,
    on a million common paths: the value, and derivatives by spot and volatility, within two
    standard errors of the difference. The rule is far from the best, so that a path jumps."""
    module = put()

    class Ten(module.Put):
        horizon = 10
        action = Stop(scale=50.0)

        def prepare(self, inputs):
            year = jnp.arange(10.0) / 10
            drift = (inputs["rate"] - inputs["volatility"] ** 2 / 2) / 10
            moves = {"drift": drift, "deviation": inputs["volatility"] / 10**0.5}
            steps = {"left": 1 - year, "discount": jnp.exp(-inputs["rate"] * year)}
            return Schedule({**inputs, **moves}, steps)

    simulator, gain, offset = Ten(), (-3.0, -0.5), -2.0
    hazard = (1 + offset / np.sqrt(1 + offset**2)) / 2
    policy = Linear(np.array([gain]), np.array([hazard]), Stop())
    problem = snapo.Problem(simulator, module.inputs, snapo.Mean("cash"))
    found = snapo.sensitivities(
        problem, policy, paths=65536, smooth=Smooth(np.float64(0.02)), smooth_paths=65536,
        engine=Native("float64"),
    ).smooth  # fmt: skip
    values = {name: float(given.value) for name, given in module.inputs.items()}
    for name, step in (("spot", 0.5), ("volatility", 0.01)):
        high, low = (
            drawn(module, (*gain, offset), values | {name: values[name] + by}, 1)
            for by in (step, -step)
        )
        slopes = (high - low) / (2 * step)
        error = np.hypot(slopes.std() / 1000, float(found[name].standard_error))
        assert abs(slopes.mean() - float(found[name].value)) < 2 * error, (
            name,
            slopes.mean(),
            found,
        )
        assert error < 0.03 * abs(slopes.mean())


class Controlled:
    """The share, discounted and stopped, is a martingale: it takes most of the noise away."""

    def control_variates(self):
        return ("share",)

    def step(self, terms, now, state, action, noise, smooth):
        after, outputs = super().step(terms, now, state, action, noise, smooth)
        used = self.action.use(state["right"], action)[1]
        share = used * (now["discount"] * state["spot"] - terms["spot"])
        return after, outputs | {"share": share}

    def terminal(self, terms, state, smooth):
        share = jnp.exp(-terms["rate"]) * state["spot"] - terms["spot"]
        outputs = super().terminal(terms, state, smooth)
        return outputs | {"share": self.action.left(state["right"]) * share}


@pytest.mark.prove
def test_the_american_put_as_one_writes_it_by_default_settings():
    """S 36, K 40, r 6 %, sigma 20 %, 50 dates a year: 4.478 by finite differences (Longstaff and
    Schwartz, 2001, table 1). At least 4.46; 4.4718 ± .0033 was seen. Stopping at once is 4."""
    module = put()

    class Put(Controlled, module.Put):
        pass

    solution = snapo.solve(
        Put(), module.inputs, objective=snapo.Mean("cash"),
        evaluation=snapo.Evaluation(131072, sensitivity_paths=0, judge_paths=0, search_paths=0),
    )  # fmt: skip
    assert solution.status == "trained" and solution.engine == "native"
    assert 4.46 < solution.value < 4.478 + 3 * solution.standard_error
    assert abs(solution.smoothing_gap) < 0.01


@pytest.mark.study
@pytest.mark.parametrize("name", list(cases()))
def test_problems_of_known_value_end_near_it_with_a_certificate(name):
    """The longer training of `python -m benchmarks.stopping`, three seeds of each; the policy's
    value is that of the bound's paths, whose penalty takes most of the noise away."""
    case = cases()[name]
    for seed in range(3):
        found = measured(case, seed)
        short = 1 - found.lower.value / case.value
        assert short < 0.004 + 3 * found.lower.standard_error / case.value, (seed, found)
        assert found.lower.low < case.value < found.upper.high, (seed, found)
        assert found.gap.value < 0.01 * case.value, (seed, found)
