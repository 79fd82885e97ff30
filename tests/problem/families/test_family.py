"""One policy for a range of inputs, against the closed form of every member."""

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Native, Xla
from snapo.problem.scenarios import Pseudo
from snapo.solver.evaluate import evaluate

T, NOISE = 4, 0.3
RANGES = {"effort": (0.3, 3.0), "drift": (0.6, 1.1)}


class Regulator(snapo.Simulator):
    """x' = drift x + u + noise; cost x^2 + effort u^2 a step, and x^2 at the end."""

    horizon: int = T
    action: snapo.Box = snapo.Box(-np.inf, np.inf)
    noise_size: int = 1
    initial_noise_size = 1

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"left": jnp.linspace(-1.0, 1.0, T)})

    def initial(self, constants, noise):
        return constants["start"] * noise[0]

    def observe(self, constants, now, state):
        return jnp.stack([state, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        after = constants["drift"] * state + action[0] + NOISE * noise[0]
        return after, {"cost": state**2 + constants["effort"] * action[0] ** 2}

    def terminal(self, constants, state, smooth):
        return {"cost": state**2}


INPUTS = {"start": snapo.Input(1.0), "effort": snapo.Input(1.0), "drift": snapo.Input(0.9)}
PROBLEM = snapo.Problem(Regulator(), INPUTS, -snapo.Mean("cost"))
FAMILY = snapo.Family(PROBLEM, RANGES, members=32)


def best(start: float, effort: float, drift: float) -> float:
    """Riccati's recursion: the least expected cost, as a value."""
    weight, constant = 1.0, 0.0
    for _ in range(T):
        constant += weight * NOISE**2
        weight = 1 + drift**2 * effort * weight / (effort + weight)
    return -(weight * start**2 + constant)


@pytest.fixture(scope="module")
def policy() -> snapo.Policy:
    given = {"training": snapo.Training(steps=500, paths=256, validation_paths=1024)}
    few = snapo.Evaluation(2048, 0, 0, 0, search_paths=0)
    return snapo.solve(FAMILY.training, policy=snapo.MLP(), evaluation=few, **given).policy


@pytest.mark.prove
def test_the_policy_is_near_the_optimum_of_every_member(policy):
    """Within 1.5 % of the least cost in corners and inside, on the same exact expectation."""
    for effort, drift in ((0.35, 0.65), (0.35, 1.05), (2.8, 0.65), (2.8, 1.05), (1.0, 0.9)):
        member = FAMILY.at({"effort": effort, "drift": drift})
        found = evaluate(member, policy, paths=8192, engine=Native("float64"))
        least = best(1.0, effort, drift)
        assert found.value < least + 3 * found.standard_error
        assert found.value > 1.015 * least - 3 * found.standard_error, (effort, drift)


@pytest.mark.prove
def test_sensitivities_of_a_member_in_both_engines(policy):
    """By the envelope theorem held derivatives are those of the least cost, but for what the policy
    lacks: within 4 % and three standard errors."""
    at = {"effort": 1.5, "drift": 0.95}
    member = FAMILY.at(at)
    tables = [
        snapo.sensitivities(member, policy, paths=8192, smooth_paths=0, engine=engine).held
        for engine in (Native("float64"), Xla("float64"))
    ]
    values = {"start": 1.0, **at}
    for name, found in tables[0].items():
        assert found.value == pytest.approx(tables[1][name].value, rel=1e-9), name
        up, down = ({**values, name: values[name] + by} for by in (1e-5, -1e-5))
        slope = (best(**up) - best(**down)) / 2e-5
        assert abs(found.value - slope) < 0.04 * abs(slope) + 3 * found.standard_error, name


@pytest.mark.prove
def test_a_path_of_the_training_is_one_of_its_member():
    """Totals of paths that were dealt to members are those of the members' own problems."""
    rule = snapo.Constant(np.array([-0.25]))
    draws = Pseudo(1).draws(np.arange(64), FAMILY.training.simulator)
    bound = Xla("float64").bind(FAMILY.training)
    rolled = bound.values(rule, draws, snapo.Exact(), record=("state",))
    dealt = np.asarray(rolled.record["state"]["member"])[0]
    assert len(set(dealt)) > 10
    native = Native("float64").bind(FAMILY.training).values(rule, draws, snapo.Exact())
    assert native.totals["cost"] == pytest.approx(np.asarray(rolled.totals["cost"]), rel=1e-12)
    states = np.asarray(rolled.record["state"]["own"])
    points = FAMILY.training.simulator.points[dealt]
    # effort and drift stand in the order of the ranges.
    costs = (states**2).sum(0) + T * points[:, 0] * 0.25**2
    final = np.asarray(rolled.state["own"]) ** 2
    assert rolled.totals["cost"] == pytest.approx(costs + final, rel=1e-12)


def test_refused():
    with pytest.raises(ValueError, match="no input"):
        snapo.Family(PROBLEM, {"speed": (0, 1)})
    with pytest.raises(ValueError, match=r"range of effort is 0.3; it must be \(low, high\)"):
        snapo.Family(PROBLEM, {"effort": 0.3})  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="low must be less"):
        snapo.Family(PROBLEM, {"effort": (2.0, 1.0)})
    with pytest.raises(ValueError, match="outside its range"):
        FAMILY.at({"effort": 5.0})


def test_inputs_of_the_ranges_have_no_derivative_in_the_training():
    """They are each member's own: zeros would be told as if they were known."""
    assert set(FAMILY.training.inputs_by_name) == set(PROBLEM.inputs_by_name) - set(FAMILY.ranges)
    assert FAMILY.at({}).inputs_by_name.keys() == PROBLEM.inputs_by_name.keys()


def test_sensitivities_of_a_member_as_the_docs_write_it():
    found = snapo.sensitivities(FAMILY.at({"effort": 1.5}), snapo.Constant(np.array([-0.25])))
    assert found.held["effort"].value == pytest.approx(-T * 0.25**2)
