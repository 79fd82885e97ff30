"""A chain of two stages is the same problem as one simulator written by hand."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.engine import Xla
from snapo.problem.actions import Box, Simplex
from snapo.problem.chain import Chain
from snapo.problem.inputs import Input
from snapo.problem.policies.rules import Linear
from snapo.problem.problem import in_mean, prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import pull_back

ENGINE = Xla(precision="float64")
HEAT, GROW = 3, 4


class HeatInputs(eqx.Module):
    ambient: Input
    rate: Input


class GrowInputs(eqx.Module):
    growth: Input


class Heat(Simulator):
    """A vessel is heated; effort costs."""

    horizon: int = HEAT
    action: Box = Box(-1.0, 1.0)
    noise_size: int = 1
    initial_noise_size: int = 1

    def prepare(self, inputs):
        return Schedule({"rate": inputs.rate}, {"ambient": inputs.ambient})

    def initial(self, constants, noise):
        return {"temperature": 1.0 + 0.1 * noise[0], "count": jnp.int32(0)}

    def observe(self, constants, now, state):
        return jnp.stack([state["temperature"]])

    def step(self, constants, now, state, action, noise, smooth):
        x = state["temperature"]
        x = x + constants["rate"] * (now["ambient"] - x) + 0.3 * action[0] + 0.1 * noise[0]
        after = {"temperature": x, "count": state["count"] + 1}
        return after, {"cost": action[0] ** 2 * x, "peak": x, "end": x**2}

    def terminal(self, constants, state, smooth):
        return {"cost": (state["temperature"] - 2.0) ** 2}

    def totals(self):
        return {"peak": "max", "end": "last"}


class Grow(Simulator):
    """Crystals grow with a width and a height; two actions, two normals."""

    horizon: int = GROW
    action: Box = Box(-1.0, 1.0, 2)
    noise_size: int = 2

    def prepare(self, inputs):
        return Schedule({}, {"growth": inputs.growth})

    def initial(self, constants, noise):
        return jnp.ones(2)

    def observe(self, constants, now, state):
        return jnp.concatenate([state, now["growth"][None]])

    def step(self, constants, now, state, action, noise, smooth):
        after = state * (1 + 0.1 * now["growth"] + 0.05 * action) + 0.02 * noise
        return after, {"cost": jnp.sum(after**2) * 0.1, "width": after[0]}

    def terminal(self, constants, state, smooth):
        return {"cost": jnp.prod(state)}

    def totals(self):
        return {"width": "max"}


def move(constants, state, following):
    x = state["temperature"]
    return jnp.stack([x, x * constants["rate"] * 5])


class ByHand(Simulator):
    """The two stages in one simulator, chosen by `where`."""

    horizon: int = HEAT + GROW
    action: Box = Box(-1.0, 1.0, 2)
    noise_size: int = 2
    initial_noise_size: int = 1

    def prepare(self, inputs):
        heat, grow = inputs
        steps = {
            "first": jnp.arange(HEAT + GROW) < HEAT,
            "turn": jnp.arange(HEAT + GROW) == HEAT - 1,
            "ambient": jnp.concatenate([heat.ambient, jnp.zeros(GROW)]),
            "growth": jnp.concatenate([jnp.zeros(HEAT), grow.growth]),
        }
        return Schedule({"rate": heat.rate}, steps)

    def initial(self, constants, noise):
        return {"x": 1.0 + 0.1 * noise[0], "size": jnp.ones(2), "end": jnp.zeros(())}

    def observe(self, constants, now, state):
        one = jnp.stack([state["x"], 0.0, 0.0, 1.0, 0.0])
        two = jnp.concatenate([state["size"], jnp.stack([now["growth"], 0.0, 1.0])])
        return jnp.where(now["first"], one, two)

    def step(self, constants, now, state, action, noise, smooth):
        first, x, size = now["first"], state["x"], state["size"]
        hot = x + constants["rate"] * (now["ambient"] - x) + 0.3 * action[0] + 0.1 * noise[0]
        grown = size * (1 + 0.1 * now["growth"] + 0.05 * action) + 0.02 * noise
        seeds = jnp.stack([hot, hot * constants["rate"] * 5])
        after = {
            "x": jnp.where(first, hot, x),
            "size": jnp.where(now["turn"], seeds, jnp.where(first, size, grown)),
            "end": jnp.where(first, hot**2, state["end"]),
        }
        heating = action[0] ** 2 * hot + jnp.where(now["turn"], (hot - 2.0) ** 2, 0.0)
        outputs = {
            "cost": jnp.where(first, heating, jnp.sum(grown**2) * 0.1),
            "peak": jnp.where(first, hot, -jnp.inf),
            "width": jnp.where(first, -jnp.inf, grown[0]),
            "end": after["end"],
        }
        return after, outputs

    def terminal(self, constants, state, smooth):
        return {"cost": jnp.prod(state["size"])}

    def totals(self):
        return {"peak": "max", "width": "max", "end": "last"}


INPUTS = (
    HeatInputs(Input([1.5, 1.6, 1.8]), Input(0.2)),
    GrowInputs(Input([0.3, 0.4, 0.2, 0.1])),
)
CHAIN = Chain([Heat(), Grow()], [move])
POLICY = Linear(np.random.default_rng(0).normal(size=(2, 5)) * 0.3)


def run(simulator, inputs, names=("cost", "peak", "width", "end"), paths=16):
    """Totals and d mean(all outputs) / d inputs."""
    schedule = prepare(simulator, inputs)
    draws = Pseudo(3).draws(np.arange(paths), simulator)
    weights = {name: np.full(paths, 1 / paths) for name in names}
    result = ENGINE.adjoint(simulator, POLICY, schedule, draws, Exact(), weights)
    return result, pull_back(simulator, inputs, [result.schedule])


@pytest.fixture(scope="module")
def whole():
    """Totals and derivatives of the chain whose outputs of one name are added."""
    return run(CHAIN, INPUTS)


@pytest.mark.prove
def test_two_stages_equal_one_simulator_by_hand(whole):
    """Same arithmetic in another order: equal to 1e-12."""
    chained, moved = whole
    # Stage one reads one normal of two: the draws are those of noise_size 2 in both.
    written, expected = run(ByHand(), INPUTS)
    for name in ("cost", "peak", "width", "end"):
        np.testing.assert_allclose(chained.totals[name], written.totals[name], rtol=1e-12)
    for name in expected:
        np.testing.assert_allclose(moved[name], expected[name], rtol=1e-11, atol=1e-13)
    for a, b in zip(jax.tree.leaves(chained.policy), jax.tree.leaves(written.policy)):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-13)


def test_inputs_of_both_stages_against_central_differences(whole):
    """Step 1e-5: truncation about 1e-10, round-off 1e-16 / 1e-5, so 1e-8 relative is ample."""
    _, moved = whole

    def value(inputs):
        schedule = prepare(CHAIN, inputs)
        draws = Pseudo(3).draws(np.arange(16), CHAIN)
        totals = ENGINE.values(CHAIN, POLICY, schedule, draws, Exact()).totals
        return sum(total.mean() for total in totals.values())

    for get, name in [
        (lambda i: i[0].ambient.value, "0.ambient"),
        (lambda i: i[0].rate.value, "0.rate"),
        (lambda i: i[1].growth.value, "1.growth"),
    ]:
        base = get(INPUTS)
        for index in np.ndindex(base.shape):
            bump = np.zeros_like(base)
            bump[index] = 1e-5
            up, down = (value(eqx.tree_at(get, INPUTS, base + s * bump)) for s in (1, -1))
            np.testing.assert_allclose(
                moved[name][0][index], (up - down) / 2e-5, rtol=1e-8, atol=1e-10
            )


def test_names_keep_outputs_apart_and_mappings_name_the_inputs(whole):
    chain = Chain([Heat(), Grow()], [move], names=("heat", "grow"))
    inputs = {"heat": INPUTS[0], "grow": INPUTS[1]}
    together, _ = whole
    names = ("heat.cost", "grow.cost", "heat.peak", "grow.width", "heat.end")
    apart, moved = run(chain, inputs, names)
    assert set(apart.totals) == set(names)
    both = apart.totals["heat.cost"] + apart.totals["grow.cost"]
    np.testing.assert_allclose(both, together.totals["cost"], rtol=1e-12)
    assert "heat.rate" in moved and "grow.growth" in moved


def test_inputs_in_the_mean_are_those_of_the_stages():
    class Counts(Grow):
        def in_mean(self):
            return ("growth",)

    stages = [Heat(), Counts()]
    apart = Chain(stages, [move], names=("heat", "grow"))
    of = ((apart, {"heat": INPUTS[0], "grow": INPUTS[1]}), (Chain(stages, [move]), INPUTS))
    assert [in_mean(*each) for each in of] == [("grow.growth",), ("1.growth",)]


def test_what_cannot_be_chained_is_refused():
    class Shares(Grow):
        action: Simplex = Simplex(2)

    class Sums(Grow):
        def totals(self):
            return {"peak": "last"}

    with pytest.raises(ValueError, match="all must be Boxes"):
        Chain([Heat(), Shares()], [move])
    with pytest.raises(ValueError, match="maps"):
        Chain([Heat(), Grow()], [])
    with pytest.raises(ValueError, match="names"):
        Chain([Heat(), Grow()], [move], names=("a", "a"))
    with pytest.raises(ValueError, match="totalled"):
        Chain([Heat(), Sums()], [move])
