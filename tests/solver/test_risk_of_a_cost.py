"""A cost under measures of risk, on both engines: a share of it is hedged for .3 a share.

With a share h, cost ~ N(2 + .3 h, (1 - h)^2). Its dearest tenth is 2 + .3 h + 1.755 (1 - h) on
average, least at h = 1: 2.3. With aversion 1 the mean-variance and the entropic mean of the cost
are 2 + .3 h + (1 - h)^2 / 2, least at h = .7: 2.255.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import snapo

TAIL = stats.norm.pdf(stats.norm.ppf(0.9)) / 0.1  # 1.755
ENGINES = ["xla", "native"]


class Hedged(snapo.Simulator):
    """The cost of one day."""

    horizon: int = 1
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def prepare(self, inputs):
        return snapo.Schedule(inputs, jnp.zeros(1))

    def initial(self, constants, noise):
        return jnp.zeros(())

    def observe(self, constants, now, state):
        return jnp.ones(1)

    def step(self, constants, now, state, action, noise, smooth):
        share = action[0]
        open_ = (1 - share) * constants["deviation"] * noise[0]
        return state, {"cost": constants["level"] + 0.3 * share + open_}


INPUTS = {"level": snapo.Input(2.0), "deviation": snapo.Input(1.0)}
OPEN = snapo.Constant(np.zeros(1))  # nothing is hedged: cost ~ N(2, 1)
MEASURES = {
    "cvar": (-snapo.CVaR("cost", 0.9), -2 - TAIL, -TAIL),
    "entropic": (-snapo.Entropic("cost", 1.0), -2.5, -1.0),
    "mean-variance": (-snapo.MeanVariance("cost", 1.0), -2.5, -1.0),
    "mixture": (
        -snapo.Mean("cost") - 0.5 * snapo.CVaR("cost", 0.9), -3 - TAIL / 2, -TAIL / 2,
    ),
}  # fmt: skip


def problem_of(objective, **more):
    return snapo.Problem(Hedged(), INPUTS, objective, **more)


@pytest.mark.parametrize("name", MEASURES)
@pytest.mark.parametrize("engine", ENGINES)
def test_value_and_derivatives_are_those_of_the_dear_tail(engine, name):
    """Against the closed form, and against central differences on the same paths. In `step`, a
    share of 0 is exact."""
    objective, right, by_deviation = MEASURES[name]
    problem = problem_of(objective)
    used = snapo.Native("float64") if engine == "native" else snapo.Xla("float64")
    found = snapo.evaluate(problem, OPEN, paths=16384, engine=used)
    assert abs(found.value - right) < 4 * found.standard_error < 0.1
    _, gradient = snapo.value_and_gradient(problem, OPEN, paths=2048, engine=used)
    weight = 1.5 if name == "mixture" else 1.0
    assert gradient.inputs["level"] == pytest.approx(-weight, abs=1e-9)
    assert gradient.inputs["deviation"] == pytest.approx(by_deviation, abs=0.15)
    up, down = (
        snapo.evaluate(problem.at({"deviation": 1.0 + bump}), OPEN, paths=2048, engine=used).value
        for bump in (1e-5, -1e-5)
    )
    central = (up - down) / 2e-5
    assert gradient.inputs["deviation"] == pytest.approx(central, abs=1e-6)


@pytest.mark.parametrize("name", MEASURES)
def test_standard_errors_of_costs_are_those_of_the_spread_over_seeds(name):
    """Forty estimates of 4,096 paths: their spread is known to 11 %; three times that."""
    problem = problem_of(MEASURES[name][0], sources=snapo.Sources.of(None, 0))
    found = [
        snapo.evaluate(replace(problem, sources=snapo.Sources.of(None, seed)), OPEN, paths=4096)
        for seed in range(40)
    ]
    spread = np.std([each.value for each in found], ddof=1)
    assert np.mean([each.standard_error for each in found]) == pytest.approx(spread, rel=0.33)


@pytest.mark.prove
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    "objective, share, value",
    [
        (-snapo.CVaR("cost", 0.9), 1.0, -2.3),
        (-snapo.MeanVariance("cost", 1.0), 0.7, -2.255),
    ],
    ids=["cvar", "mean-variance"],
)
def test_training_hedges_the_dear_tail(engine, objective, share, value):
    found = snapo.solve(
        problem_of(objective), policy=snapo.Constant(np.full(1, 0.3)), engine=engine,
        training=snapo.Training(steps=200, paths=512, learning_rate=0.05),
        evaluation=snapo.Evaluation(paths=8192, sensitivity_paths=0),
    )  # fmt: skip
    assert found.value == pytest.approx(value, abs=0.02)
    assert float(found.policy(jnp.ones(1), snapo.Exact())[0]) == pytest.approx(share, abs=0.04)


def test_a_limit_on_the_tail_of_a_cost_is_broken_by_its_dear_tenth():
    """The cheapest tenth is .246, far below 1; the dearest one is 3.755."""
    limits = (snapo.AtMost(snapo.CVaR("cost", 0.9), 1.0),)
    found = snapo.solve(
        problem_of(-snapo.Mean("cost"), constraints=limits), policy=OPEN,
        training=snapo.Training(steps=0, paths=64),
        evaluation=snapo.Evaluation(paths=8192, sensitivity_paths=0),
    )  # fmt: skip
    (limit,) = found.constraints
    assert limit.met == "not met" and limit.name == "mean of the largest 10 % of cost at most 1"
    assert limit.value == pytest.approx(2 + TAIL, abs=4 * limit.standard_error)


@pytest.mark.prove
def test_the_price_of_a_limit_on_the_dear_tail():
    """At most 3 for the dearest tenth, mean cost as small as possible: 2 + 1.755 - 1.455 h = 3 at
    h = .519, and one more of the level saves .3 / 1.455 = .206."""
    limits = (snapo.AtMost(snapo.CVaR("cost", 0.9), 3.0),)
    found = snapo.solve(
        problem_of(-snapo.Mean("cost"), constraints=limits), policy=snapo.Constant(np.full(1, 0.3)),
        training=snapo.Training(steps=600, paths=1024, learning_rate=0.02),
        evaluation=snapo.Evaluation(paths=16384, sensitivity_paths=0),
    )  # fmt: skip
    (limit,) = found.constraints
    assert limit.value == pytest.approx(3.0, abs=0.02) and limit.met != "not met"
    assert limit.price == pytest.approx(0.3 / (TAIL - 0.3), abs=0.01)
