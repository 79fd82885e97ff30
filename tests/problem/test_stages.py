"""A policy for each stage of a chain: its own observation, its own bounds, both engines."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.problem.test_chain import HEAT, INPUTS, Grow, Heat, move

from snapo.engine import Xla
from snapo.engine.native import Native, unsupported
from snapo.problem.actions import Actions, Box, Choice, Integers, Product, Simplex, Stop
from snapo.problem.chain import Chain
from snapo.problem.inputs import Input
from snapo.problem.policies.composed import Stages
from snapo.problem.policies.rules import Constant, Linear
from snapo.problem.policy import MLP, parameters, trainable
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import pull_back

PATHS = 16
WEIGHTS = {name: np.full(PATHS, 1 / PATHS) for name in ("cost", "peak", "width", "end")}


class Narrow(Heat):
    action: Box = Box(0.2, 0.9)


class Own(Grow):
    action: Box = Box([-1.0, 0.0], [1.0, np.inf])


def made(chain, *policies):
    schedule = prepare(chain, INPUTS)
    return schedule, Stages(policies).for_problem(chain.interface(schedule), jax.random.key(3))


def rolled(chain, policy, schedule, engine=None, record=()):
    draws = Pseudo(3).draws(np.arange(PATHS), chain)
    engine = engine or Xla(precision="float64")
    return engine.values(chain, policy, schedule, draws, Exact(), record=record)


def test_stages_with_the_rows_of_one_policy_are_that_policy():
    """Linear feedback on [features…, stage]: each stage reads its own columns and rows of it.

    Same arithmetic in another order: 1e-12."""
    chain = Chain([Heat(), Grow()], [move])
    gain = np.random.default_rng(0).normal(size=(2, 5)) * 0.3
    schedule = prepare(chain, INPUTS)
    parts = (
        Linear(gain[:1, :1], gain[:1, 3]),
        Linear(gain[:, :3], gain[:, 4]),
    )
    apart = Stages(parts, chain.interface(schedule))
    one = rolled(chain, Linear(gain), schedule).totals
    each = rolled(chain, apart, schedule).totals
    for name in one:
        np.testing.assert_allclose(each[name], one[name], rtol=1e-12)


@pytest.mark.prove
def test_every_stage_has_its_own_features_and_bounds():
    chain = Chain([Narrow(), Own()], [move])
    assert chain.action == Box([-1.0, 0.0], [1.0, np.inf])
    schedule, policy = made(chain, MLP(hidden=(4,)), MLP(hidden=(5,)))
    widths = [each.network.weights[0].shape for each in policy.policies]
    assert widths == [(4, 1), (5, 3)]
    # Networks that ask for all they can get reach their own stage's bounds, and no further.
    wild = jax.tree.map(lambda x: x * 30 if eqx.is_inexact_array(x) else x, policy)
    action = np.asarray(rolled(chain, wild, schedule, record=("action",)).record["action"])
    heat, grow = action[:HEAT, :, 0], action[HEAT:]
    assert np.all((heat >= 0.2) & (heat <= 0.9)) and np.any(heat != heat[0, 0])
    assert np.all((grow >= [-1.0, 0.0]) & (grow[..., :1] <= 1.0))


def test_a_shared_policy_is_clipped_to_each_stages_bounds():
    chain = Chain([Narrow(), Grow()], [move])
    schedule = prepare(chain, INPUTS)
    own = rolled(chain, Constant([0.2, 0.3]), schedule, record=("state",))
    heated = rolled(chain, Constant([-1.0, 0.3]), schedule, record=("state",))
    for a, b in zip(
        own.record["state"]["stages"][0].values(), heated.record["state"]["stages"][0].values()
    ):
        # A policy's numbers are float32: 0.2 is off by 3e-9.
        np.testing.assert_allclose(a, b, rtol=1e-7)


@pytest.mark.prove
@pytest.mark.parametrize("smooth", [Exact(), Smooth(np.float64(0.1))], ids=["exact", "smooth"])
def test_both_engines_agree_on_stages(smooth):
    """1e-12 of the totals and 1e-10 of the gradients in float64, as for any problem."""
    chain = Chain([Narrow(), Own()], [move])
    schedule, policy = made(chain, MLP(hidden=(4,)), MLP(hidden=(5,)))
    assert unsupported(chain, schedule, policy, smooth) is None
    draws = Pseudo(3).draws(np.arange(PATHS), chain)
    given = (chain, policy, schedule, draws, smooth)
    xla, native = (engine("float64").adjoint(*given, WEIGHTS) for engine in (Xla, Native))
    for name in xla.totals:
        np.testing.assert_allclose(native.totals[name], xla.totals[name], rtol=1e-12)
    for a, b in zip(*(jax.tree.leaves((f.policy, f.schedule)) for f in (xla, native))):
        np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-13)


@pytest.mark.prove
def test_gradients_of_both_policies_against_central_differences():
    """Step 1e-5 in float64: truncation about 1e-10, round-off 1e-11; 1e-6 of the largest."""
    chain = Chain([Narrow(), Own()], [move])
    schedule, policy = made(chain, MLP(hidden=(3,)), Linear())
    policy = jax.tree.map(
        lambda x: np.asarray(x, np.float64) if eqx.is_inexact_array(x) else x, policy
    )
    draws, engine = Pseudo(3).draws(np.arange(PATHS), chain), Xla(precision="float64")
    found = engine.adjoint(chain, policy, schedule, draws, Exact(), WEIGHTS)
    gradient = parameters(found.policy)

    def value(policy):
        totals = engine.values(chain, policy, schedule, draws, Exact()).totals
        return sum(np.sum(totals[name] * w) for name, w in WEIGHTS.items())

    moving, fixed = trainable(policy)
    leaves, tree = jax.tree.flatten(moving)
    sizes = np.cumsum([0, *(leaf.size for leaf in leaves)])
    for i in range(0, sizes[-1], 2):
        k = int(np.searchsorted(sizes, i, side="right")) - 1
        shifted = []
        for sign in (1, -1):
            new = [np.array(leaf) for leaf in leaves]
            new[k].reshape(-1)[i - sizes[k]] += sign * 1e-5
            shifted.append(value(eqx.combine(jax.tree.unflatten(tree, new), fixed)))
        difference = (shifted[0] - shifted[1]) / 2e-5
        assert abs(difference - gradient[i]) < 1e-6 * np.abs(gradient).max(), (i, k)


class Mixed(Simulator):
    """Any set: every number of a decision pushes in its own way."""

    action: Actions = Simplex(3)
    inputs: str = eqx.field(static=True, default="all")
    horizon: int = 3
    noise_size: int = 1
    initial_noise_size: int = 1

    def prepare(self, inputs):
        return Schedule({"pull": inputs["pull"]}, {"push": inputs[self.inputs]})

    def initial(self, constants, noise):
        return jnp.stack([noise[0], 0.5])

    def observe(self, constants, now, state):
        return jnp.append(state, now["push"])

    def step(self, constants, now, state, action, noise, smooth):
        pushes = jnp.arange(1.0, 1 + action.shape[0]) / action.shape[0]
        pushed = jnp.stack([pushes @ action, jnp.sum(action**2)]) * now["push"]
        after = constants["pull"] * state + pushed + 0.3 * noise
        return after, {"cost": after[0] ** 2 + after[1] - jnp.sum(pushes * action)}


PUSH = np.array([0.1, 0.3, 0.2, 0.4, 0.1, 0.2])
MIXED = {"pull": Input(0.7), "first": Input(PUSH[:3]), "then": Input(PUSH[3:]), "all": Input(PUSH)}
SEVERAL = Product(run=Choice(2), lots=Integers(0, 3), size=Box(-1.0, 1.0))
WARM = Smooth(np.float64(0.1))
SETS = {
    "simplex": (Simplex(3), WARM),
    "stop": (Stop(2), WARM),
    "product": (SEVERAL, WARM),
    "product, exact": (SEVERAL, Exact()),
}


@pytest.mark.prove
@pytest.mark.parametrize("action, smooth", SETS.values(), ids=SETS)
def test_stages_of_one_set_of_any_kind_equal_one_simulator(action, smooth):
    """In both engines: totals to 1e-12, gradients by inputs and by the policy to 1e-9."""
    parts = [Mixed(action=action, inputs=name) for name in ("first", "then")]
    chain, whole = Chain(parts, [lambda c, state, n: state]), Mixed(action=action, horizon=6)
    assert chain.action == action
    rng = np.random.default_rng(1)
    schedules = [prepare(each, MIXED) for each in (chain, whole)]
    mlp = MLP(hidden=(4,)).for_problem(whole.interface(schedules[1]), jax.random.key(2))
    mlp = jax.tree.map(lambda x: np.float64(x) + rng.normal(size=x.shape), mlp)
    stages = Stages([mlp, mlp], chain.interface(schedules[0]))
    found = []
    for simulator, schedule, policy in ((chain, schedules[0], stages), (whole, schedules[1], mlp)):
        assert unsupported(simulator, schedule, policy, smooth) is None
        draws = Pseudo(3).draws(np.arange(PATHS), simulator)
        for engine in (Xla("float64"), Native("float64"))[: 2 if simulator is chain else 1]:
            weights = {"cost": np.full(PATHS, 1 / PATHS)}
            run = engine.adjoint(simulator, policy, schedule, draws, smooth, weights)
            slopes = pull_back(simulator, MIXED, [run.schedule])
            slope = parameters(run.policy).reshape(2 if simulator is chain else 1, -1).sum(0)
            found.append((run.totals["cost"], slope, slopes))
    pushes = [
        np.concatenate([slopes["first"][0], slopes["then"][0]])
        if np.any(slopes["first"][0])
        else slopes["all"][0]
        for _, _, slopes in found
    ]
    for (totals, slope, slopes), push in zip(found[1:], pushes[1:]):
        np.testing.assert_allclose(totals, found[0][0], rtol=1e-12)
        np.testing.assert_allclose(slope, found[0][1], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(slopes["pull"], found[0][2]["pull"], rtol=1e-9)
        np.testing.assert_allclose(push, pushes[0], rtol=1e-9)
    assert np.ptp(found[0][0]) > 0.1


def test_recipes_and_wrong_numbers_of_policies_are_refused():
    chain = Chain([Heat(), Grow()], [move])
    with pytest.raises(ValueError, match="1 policies for 2 stages"):
        made(chain, MLP())
    with pytest.raises(ValueError, match="this is a recipe"):
        Stages([MLP(), MLP()])(jnp.zeros(5), Exact())
