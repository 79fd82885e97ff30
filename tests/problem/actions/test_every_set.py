"""All sets of actions in one step: both engines, derivatives against differences, `check`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Xla
from snapo.engine.native import Native, unsupported
from snapo.problem.actions import Box, Choice, Integers, Product, Simplex, Stop
from snapo.problem.inputs import Input
from snapo.problem.policies.rules import Constant, Linear
from snapo.problem.policy import MLP, Residual
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Interface, Schedule, Simulator
from snapo.problem.smooth import Exact, Smooth

EVERY = Product(
    stop=Stop(rights=2),
    mode=Choice(3),
    lots=Integers(0, 5),
    mix=Simplex(2),
    power=Box(-1.0, 1.0),
)
SETS = [*EVERY.sets, EVERY, Choice(2), Integers([0, -3], [4, 3])]
HOT = Smooth(np.float32(0.02))


class Machine(Simulator):
    """Every kind of decision at once, each in the output and in the state."""

    horizon: int = 4
    action: Product = EVERY
    noise_size: int = 2
    drawn: bool = True

    def prepare(self, inputs):
        return Schedule({"speeds": inputs["speeds"]}, {"price": inputs["price"]})

    def initial(self, constants, noise):
        return {"x": jnp.ones(()), "right": self.action["stop"].initial(), "weight": jnp.ones(())}

    def observe(self, constants, now, state):
        return jnp.stack([state["x"], now["price"], state["right"].sum()])

    def step(self, constants, now, state, action, noise, smooth):
        decided = self.action.parts(action)
        right, used = self.action["stop"].use(state["right"], decided["stop"])
        mode, likelihood = decided["mode"], jnp.ones(())
        if self.drawn:
            mode, likelihood = self.action["mode"].draw(mode, noise[1])
        weight = state["weight"] * likelihood
        x = 0.9 * state["x"] + 0.1 * noise.sum() + 0.2 * mode @ constants["speeds"]
        x = x + 0.1 * decided["lots"][0] - 0.05 * decided["lots"][0] ** 2
        x = x + 0.3 * decided["mix"][0] * decided["power"][0]
        mixture = jnp.tanh(decided["mode"] @ constants["speeds"])
        cash = now["price"] * x * used + 0.1 * mixture - 0.1 * decided["power"][0] ** 2
        return {"x": x, "right": right, "weight": weight}, {"cash": weight * cash}

    def terminal(self, constants, state, smooth):
        left = self.action["stop"].left(state["right"])
        return {"cash": state["weight"] * left * state["x"]}


INPUTS = {"speeds": Input([0.0, 0.5, 1.5]), "price": Input([1.0, 2.0, 0.5, 1.2])}


@pytest.mark.parametrize("action", SETS, ids=lambda a: type(a).__name__)
def test_the_exact_form_lies_in_the_set_and_is_near_the_smooth_one(action):
    """Squash, near and settle end in the exact set; at temperature zero, the same numbers."""
    rng = np.random.default_rng(0)
    for _ in range(4):
        raw, base = (jnp.asarray(rng.normal(size=action.size), jnp.float32) for _ in range(2))
        soft = action.squash(raw, HOT)
        hard = action.squash(raw, Exact())
        for found in (hard, action.near(hard, base, Exact()), action.settle(soft, Exact())):
            assert action.fault(np.asarray(found)) is None
        np.testing.assert_array_equal(action.settle(soft, HOT), soft)
        cold = action.squash(raw, Smooth(np.float32(0.0)))
        np.testing.assert_allclose(cold, hard, atol=1e-6)
    assert sorted(i for group in action.together() for i in group) == list(range(action.size))


@pytest.mark.parametrize(
    "action, wrong, said",
    [
        (Choice(2), [0.5, 0.5], "weight of 1"),
        (Stop(), [0.4], "1 or 0"),
        (Integers(0, 5), [2.5], "not a whole number"),
        (Integers(0, 5), [6.0], "outside of 0 to 5"),
        (Product(run=Choice(2), much=Box(0.0, 1.0)), [0.0, 1.0, 2.0], "much: Action 0"),
    ],
)
def test_a_wrong_action_is_named(action, wrong, said):
    assert said in " ".join(action.fault(np.asarray(wrong)))


@pytest.mark.parametrize(
    "action",
    [Box(-np.inf, np.inf, 2), Box(0.0, 1.0, 2), Integers(0, 5, 2), Product(much=Box(0.0, 1.0, 2))],
    ids=repr,
)
def test_what_is_no_number_is_refused(action):
    assert action.fault(np.array([1.0, 1.0])) is None
    assert "Action 1 is not a number" in " ".join(action.fault(np.array([1.0, np.nan])))


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: Choice(1), "at least 2, the number of options"),
        (lambda: Choice(2.5), "size is 2.5"),
        (lambda: Choice(("run", "stop")), r"size is \('run', 'stop'\)"),
        (lambda: Simplex(2.5), "size is 2.5"),
        (lambda: Integers(0, 9, 0), "Integers: size is 0; .* after the bounds"),
        (lambda: Stop(rights=0), "rights is 0"),
        (lambda: Stop(hazard=1.0), "hazard is 1.0"),
        (lambda: Integers(0.5, 3), "low is 0.5"),
        (lambda: Product(), "no sets"),
        (lambda: Product(run=2), "run is 2"),
    ],
)
def test_a_set_that_makes_no_sense_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_parts_have_the_names_and_the_order_of_the_product():
    parts = EVERY.parts(np.arange(9.0))
    assert {name: part.tolist() for name, part in parts.items()} == {
        "stop": [0, 1], "mode": [2, 3, 4], "lots": [5], "mix": [6, 7], "power": [8],
    }  # fmt: skip
    assert EVERY["mode"] == Choice(3) and hash(EVERY) == hash(
        Product(**dict(zip(EVERY.names, EVERY.sets)))
    )


def test_classical_rules_are_exact_in_the_value():
    """A constant and a linear rule, whose numbers are smooth, decide in the exact set."""
    interface = Interface(EVERY, 3)
    for rule in (Constant(), Linear()):
        policy = rule.for_problem(interface, None)
        seen = jnp.ones(3)
        assert EVERY.fault(np.asarray(policy(seen, Exact()))) is None
        assert EVERY.fault(np.asarray(policy(seen, HOT))) is not None


@pytest.mark.prove
@pytest.mark.parametrize("residual", [False, True], ids=["network", "residual"])
def test_both_engines_take_every_set(residual):
    """Totals and gradients of the compiled kernel are those of XLA, to rounding in float64; the
    exact totals and the decisions too."""
    simulator, key = Machine(), jax.random.key(0)
    schedule, draws = prepare(simulator, INPUTS), Pseudo(0).draws(np.arange(16), simulator)
    network = MLP(EVERY, 3, key=key)
    policy = (
        Residual(Constant(0.3 * np.ones(9)), EVERY, 3, key=key, scale=20.0) if residual else network
    )
    smooth, weights = Smooth(np.float64(0.05)), {"cash": np.full(16, 1 / 16)}
    assert unsupported(simulator, schedule, policy, smooth) is None
    assert unsupported(simulator, schedule, policy, Exact()) is None
    given = simulator, policy, schedule, draws
    found = [engine("float64").adjoint(*given, smooth, weights) for engine in (Xla, Native)]
    np.testing.assert_allclose(found[0].totals["cash"], found[1].totals["cash"], rtol=1e-12)
    for a, b in zip(*(jax.tree.leaves((f.policy, f.schedule)) for f in found)):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-13)
    hard = [
        engine("float64").values(*given, Exact(), record=("action",)) for engine in (Xla, Native)
    ]
    np.testing.assert_allclose(hard[0].totals["cash"], hard[1].totals["cash"], rtol=1e-12)
    taken = [np.asarray(each.record["action"]) for each in hard]
    # A small one is the difference of numbers of order one: their round-off remains.
    np.testing.assert_allclose(taken[0], taken[1], rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(taken[0][..., :6], taken[1][..., :6])  # whole numbers
    for action in taken[0].reshape(-1, 9):
        assert EVERY.fault(action) is None


@pytest.mark.prove
def test_derivatives_are_those_of_the_smooth_form():
    """Central differences in float64 by every input, and by a shift of every component of the
    action before it is squashed: 1e-7. (A choice that is drawn: test_choice.py.)"""
    simulator, engine = Machine(drawn=False), Xla("float64")
    draws, smooth = Pseudo(0).draws(np.arange(8), simulator), Smooth(np.float64(0.05))
    weights = {"cash": np.full(8, 1 / 8)}
    network = MLP(EVERY, 3, key=jax.random.key(1))

    def shifted(by):
        biases = [*network.network.biases[:-1], np.linspace(-0.5, 0.5, 9) + by]
        return eqx.tree_at(lambda p: p.network.biases, network, biases)

    def value(by=0.0, **moved):
        inputs = {n: Input(x.value + moved.get(n, 0.0)) for n, x in INPUTS.items()}
        given = simulator, shifted(by), prepare(simulator, inputs), draws, smooth
        return float(engine.values(*given).totals["cash"].mean())

    def slope(step, **given):
        up, down = ({n: k * step for n, k in given.items()} for step in (step, -step))
        return (value(**up) - value(**down)) / (2 * step)

    found = engine.adjoint(
        simulator, shifted(0.0), prepare(simulator, INPUTS), draws, smooth, weights
    )
    by_bias = np.asarray(found.policy.network.biases[-1])
    np.testing.assert_allclose(by_bias, [slope(1e-5, by=e) for e in np.eye(9)], atol=1e-8)
    assert np.all(by_bias != 0)
    by_input = {
        "speeds": found.schedule.constants["speeds"],
        "price": found.schedule.steps["price"],
    }
    for name, each in by_input.items():
        expected = [slope(1e-5, **{name: e}) for e in np.eye(each.size)]
        np.testing.assert_allclose(each, expected, atol=1e-8)


@pytest.mark.prove
def test_check_takes_every_set():
    """No findings; a decision without effect is named with its components."""
    assert len(findings := snapo.check(Machine(drawn=False), INPUTS, paths=8)) == 0, str(findings)

    class Idle(Machine):
        def step(self, constants, now, state, action, noise, smooth):
            action = action.at[2:5].set(1 / 3)
            return super().step(constants, now, state, action, noise, smooth)

    assert "action[2:5]" in str(snapo.check(Idle(drawn=False), INPUTS, paths=8))
