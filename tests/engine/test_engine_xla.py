"""The XLA engine: gradients against differences, and everything that must not change them."""

import os
import subprocess
import sys
import textwrap

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.engine import Clip, Window, Xla
from snapo.engine.xla import _adjoint
from snapo.problem.actions import Box
from snapo.problem.inputs import Input
from snapo.problem.objective import CVaR, Mean
from snapo.problem.policy import MLP
from snapo.problem.problem import Problem, prepare
from snapo.problem.scenarios import Pseudo, Supplied
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import adjoint_of_finite_paths

DOUBLE = Xla(precision="float64")
T, PATHS = 6, 8
TRACES = []  # grows whenever `step` is traced


class Inputs(eqx.Module):
    drift: Input
    start: Input


class Toy(Simulator):
    """A smooth state of three numbers, a counter and a flag; totals of every kind."""

    horizon: int = T
    action: Box = Box(-1.0, 1.0, 2)
    noise_size: int = 3
    initial_noise_size: int = 1

    def prepare(self, inputs):
        steps = {"drift": inputs.drift, "cost": 1.0 + 0.1 * jnp.arange(self.horizon)}
        return Schedule({"start": inputs.start, "pull": jnp.asarray([0.3, 0.2])}, steps)

    def initial(self, constants, noise):
        return {
            "x": constants["start"] * (1 + 0.1 * noise[0]),
            "v": jnp.zeros(2) + 0.1 * noise[0],
            "count": jnp.int32(0),
            "above": jnp.asarray(False),
        }

    def observe(self, constants, now, state):
        return jnp.concatenate([state["v"], jnp.stack([state["x"], now["drift"]])])

    def step(self, constants, now, state, action, noise, smooth):
        TRACES.append(0)
        v = state["v"] * (1 - constants["pull"]) + 0.3 * action + 0.1 * noise[:2]
        x = state["x"] + now["drift"] + jnp.sin(v[0]) * v[1] + 0.1 * noise[2] * state["x"]
        above = state["above"] | (x > 1.5)
        after = {"x": x, "v": v, "count": state["count"] + above, "above": above}
        outputs = {
            "cash": x * now["cost"] - jnp.sum(action**2) + 0.1 * state["count"],
            "peak": x,
            "final": smooth.maximum(x, 1.0, scale=1.0),
        }
        return after, outputs

    def terminal(self, constants, state, smooth):
        return {"cash": state["x"] ** 2, "rest": state["v"][0] * constants["start"]}

    def totals(self):
        return {"peak": "max", "final": "last"}

    def state_scale(self, constants):
        return {
            "x": jnp.asarray(2.0),
            "v": jnp.ones(2),
            "count": jnp.int32(1),
            "above": jnp.asarray(True),
        }


TOY = Toy()
INPUTS = Inputs(Input(np.linspace(0.05, 0.2, T)), Input(1.2))
SMOOTH = Smooth(0.3)
NAMES = ("cash", "peak", "final", "rest")


def network(scale=30.0):
    """A small MLP whose last layer is not small, in float64 so that it can be bumped."""
    policy = MLP(TOY.action, 4, key=jax.random.key(0), hidden=(3,))
    policy = eqx.tree_at(
        lambda p: p.network.weights[-1], policy, policy.network.weights[-1] * scale
    )
    return jax.tree.map(lambda x: np.asarray(x, np.float64) if eqx.is_array(x) else x, policy)


POLICY = network()
SCHEDULE = prepare(TOY, INPUTS)
DRAWS = Pseudo(5).draws(np.arange(PATHS), TOY)
RNG = np.random.default_rng(0)
WEIGHTS = {name: RNG.normal(size=PATHS) / PATHS for name in NAMES}


def value(policy=POLICY, schedule=SCHEDULE, engine=DOUBLE, **options):
    totals = engine.values(TOY, policy, schedule, DRAWS, SMOOTH, **options).totals
    return sum(float(WEIGHTS[name] @ totals[name]) for name in WEIGHTS)


def close(a, b, **tolerance):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(x, y, **tolerance)


def bumps(tree):
    """Every floating number of a tree, bumped up and down by 1e-5: (leaf, index, up, down)."""
    leaves, structure = jax.tree.flatten(tree)
    for i, leaf in enumerate(leaves):
        if not eqx.is_inexact_array(leaf):
            continue
        for index in np.ndindex(leaf.shape):
            moved = []
            for sign in (1, -1):
                new = np.array(leaf)
                new[index] += sign * 1e-5
                moved.append(jax.tree.unflatten(structure, [*leaves[:i], new, *leaves[i + 1 :]]))
            yield i, index, *moved


@pytest.fixture(scope="module")
def adjoint():
    return DOUBLE.adjoint(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, WEIGHTS)


# Differences: step 1e-5 of numbers of order one. Truncation about 1e-10 times a third derivative of
# order ten, round-off 1e-16 * 10 / 1e-5 = 1e-10: 2e-8 absolute leaves room.


def test_gradient_to_the_policy(adjoint):
    leaves = jax.tree.leaves(adjoint.policy)
    moving = [x for x in jax.tree.leaves(POLICY) if eqx.is_inexact_array(x)]
    assert len(leaves) == len(moving)
    structure = jax.tree.structure(adjoint.policy)
    for i, index, up, down in bumps(eqx.filter(POLICY, eqx.is_inexact_array)):
        fixed = eqx.filter(POLICY, eqx.is_inexact_array, inverse=True)
        up, down = eqx.combine(up, fixed), eqx.combine(down, fixed)
        difference = (value(up) - value(down)) / 2e-5
        assert structure.flatten_up_to(adjoint.policy)[i][index] == pytest.approx(
            difference, abs=2e-8
        )


def test_gradient_to_every_entry_of_the_schedule(adjoint):
    leaves = jax.tree.leaves(adjoint.schedule)
    for i, index, up, down in bumps(SCHEDULE):
        difference = (value(schedule=up) - value(schedule=down)) / 2e-5
        assert leaves[i][index] == pytest.approx(difference, abs=2e-8)


@pytest.mark.prove
def test_gradient_to_the_starting_states_of_a_window():
    window = Window(2, T - 2)
    start = DOUBLE.values(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, window=Window(0, 2)).state
    options = {"window": window, "start": start}
    got = DOUBLE.adjoint(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, WEIGHTS, **options).start
    moving = eqx.filter(start, eqx.is_inexact_array)
    fixed = eqx.filter(start, eqx.is_inexact_array, inverse=True)
    for i, index, up, down in bumps(moving):
        up, down = (value(window=window, start=eqx.combine(s, fixed)) for s in (up, down))
        assert jax.tree.leaves(got)[i][index] == pytest.approx((up - down) / 2e-5, abs=2e-8)


def test_totals_are_those_of_a_loop_in_numpy():
    """Sum, maximum and last, integers and booleans, recomputed from the record."""
    record = ("state", "action", "outputs")
    out = DOUBLE.values(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, record=record)
    outputs = out.record["outputs"]
    close(out.totals["peak"], outputs["peak"].max(0), rtol=1e-15)
    close(out.totals["final"], outputs["final"][-1], rtol=1e-15)
    close(out.totals["cash"], outputs["cash"].sum(0) + out.state["x"] ** 2, rtol=1e-14)
    above = np.maximum.accumulate(outputs["peak"] > 1.5, axis=0)
    assert out.state["count"].dtype == np.int32 and out.state["above"].dtype == bool
    np.testing.assert_array_equal(out.state["above"], above[-1])
    np.testing.assert_array_equal(out.state["count"], above.sum(0))
    assert 0 < above[-1].sum() < PATHS or above.sum() not in (0, above.size)  # the flag is tried
    np.testing.assert_array_equal(out.record["state"]["x"][1:], outputs["peak"][:-1])


@pytest.mark.prove
def test_recorded_actions_replay_the_same_path(adjoint):
    first = DOUBLE.values(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, record=("action",))
    actions = first.record["action"]
    again = DOUBLE.values(TOY, None, SCHEDULE, DRAWS, SMOOTH, actions=actions)
    close(again.totals, first.totals, rtol=1e-14)
    held = DOUBLE.adjoint(TOY, None, SCHEDULE, DRAWS, SMOOTH, WEIGHTS, actions=actions)
    assert held.policy is None
    close(held.totals, adjoint.totals, rtol=1e-14)
    e = np.zeros(T)
    e[1] = 1e-5
    up, down = (
        value(
            None,
            eqx.tree_at(lambda s: s.steps["drift"], SCHEDULE, SCHEDULE.steps["drift"] + s * e),
            actions=actions,
        )
        for s in (1, -1)
    )
    assert held.schedule.steps["drift"][1] == pytest.approx((up - down) / 2e-5, abs=2e-8)
    assert held.schedule.steps["drift"][1] != pytest.approx(
        adjoint.schedule.steps["drift"][1], rel=1e-3
    )


def test_windows_compose_to_the_whole():
    whole = DOUBLE.values(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH)
    first = DOUBLE.values(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, window=Window(0, 2))
    second = DOUBLE.values(
        TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, window=Window(2, T - 2), start=first.state
    )
    close(second.state, whole.state, rtol=1e-14)
    close(first.totals["cash"] + second.totals["cash"], whole.totals["cash"], rtol=1e-13)
    close(np.maximum(first.totals["peak"], second.totals["peak"]), whole.totals["peak"], rtol=1e-14)
    assert "rest" in second.totals and "rest" not in first.totals  # `terminal` counts at the end


def test_many_cotangents_are_one_call_each(adjoint):
    several = {name: np.stack([w, 0 * w, 2 * w]) for name, w in WEIGHTS.items()}
    out = DOUBLE.adjoint(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, several)
    for k, factor in enumerate((1.0, 0.0, 2.0)):
        one = jax.tree.map(lambda leaf: leaf[k], (out.policy, out.schedule))  # noqa: B023
        expected = jax.tree.map(lambda leaf: factor * leaf, (adjoint.policy, adjoint.schedule))  # noqa: B023
        close(one, expected, rtol=1e-12, atol=1e-14)
    close(out.totals, adjoint.totals, rtol=1e-14)


@pytest.mark.prove
def test_segments_give_the_same_gradient(adjoint):
    """Segments that divide the horizon, that do not, and more than there are steps."""
    for segments in (2, 4):
        out = Xla(precision="float64", segments=segments).adjoint(
            TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, WEIGHTS
        )
        close(
            (out.policy, out.schedule), (adjoint.policy, adjoint.schedule), rtol=1e-12, atol=1e-14
        )


@pytest.mark.prove
def test_segments_need_less_memory():
    """256 steps of 4 numbers a path: 16 segments keep 16 + 16 states, an eighth of 256."""
    long = Toy(horizon=256)
    inputs = Inputs(Input(np.zeros(256)), Input(1.0))
    draws = Pseudo(1).draws(np.arange(1024), long)
    weights = {"cash": np.full(1024, 1 / 1024, np.float32)}

    def memory(segments):
        engine = Xla(segments=segments)
        call = engine.call(long, POLICY, prepare(long, inputs), draws, SMOOTH)
        compiled = _adjoint.lower(engine, call, weights, None, ("policy", "schedule")).compile()
        return compiled.compiled.memory_analysis().temp_size_in_bytes

    assert memory(16) < memory(None) / 3


@pytest.mark.prove
def test_clipping_bounds_each_path_alone(adjoint):
    """The adjoint of the first state, scaled, is at most norm times the path's weight, whatever
    the number of paths; a loose bound changes nothing; a path that obeys it is left alone."""
    window, options = Window(1, T - 1), {}
    options["start"] = DOUBLE.values(
        TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, window=Window(0, 1)
    ).state

    def norms(draws, weights, start, clip):
        out = DOUBLE.adjoint(
            TOY, POLICY, SCHEDULE, draws, SMOOTH, weights, clip=clip, window=window, start=start
        )
        square = (2.0 * out.start["x"]) ** 2 + np.sum(out.start["v"] ** 2, axis=1)
        return np.sqrt(square), out

    weight = {"cash": np.full(PATHS, 1 / PATHS)}
    free, plain = norms(DRAWS, weight, options["start"], None)
    _, same = norms(DRAWS, weight, options["start"], Clip(1e6))
    close((same.policy, same.schedule), (plain.policy, plain.schedule), rtol=1e-13)
    bound = float(np.median(free) * PATHS)
    tight, _ = norms(DRAWS, weight, options["start"], Clip(bound))
    assert np.all(tight <= bound / PATHS * (1 + 1e-12))
    assert np.any(free > bound / PATHS * 1.01)
    # Half of the paths, with the weights of a mean over half: twice the adjoint of each.
    half = Pseudo(5).draws(np.arange(PATHS // 2), TOY)
    start = jax.tree.map(lambda leaf: leaf[: PATHS // 2], options["start"])
    fewer, _ = norms(half, {"cash": np.full(PATHS // 2, 2 / PATHS)}, start, Clip(bound))
    np.testing.assert_allclose(fewer, 2 * tight[: PATHS // 2], rtol=1e-12)


def test_single_precision_agrees(adjoint):
    """Six steps of order one in float32: 1e-5 relative to the largest."""
    out = Xla().adjoint(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, WEIGHTS)
    for a, b in zip(jax.tree.leaves(out.schedule), jax.tree.leaves(adjoint.schedule)):
        assert a.dtype == jnp.float32 and b.dtype == np.float64
        np.testing.assert_allclose(a, b, atol=1e-5 * np.abs(b).max())
    assert not jax.config.jax_enable_x64  # nothing has set the global switch


def test_nothing_recompiles_when_temperature_seed_or_numbers_change():
    def everything(temperature, seed, factor):
        draws = Pseudo(seed).draws(np.arange(PATHS), TOY)
        schedule = jax.tree.map(lambda leaf: leaf * factor, SCHEDULE)
        weights = {name: factor * w for name, w in WEIGHTS.items()}
        smooth = Smooth(np.float32(temperature))
        DOUBLE.values(TOY, network(factor), schedule, draws, smooth)
        DOUBLE.adjoint(TOY, network(factor), schedule, draws, smooth, weights)

    everything(0.3, 1, 1.0)
    before = len(TRACES)
    everything(0.01, 2, 1.1)
    assert len(TRACES) == before


def test_what_is_asked_wrongly_is_refused():
    with pytest.raises(ValueError, match="neither a policy nor actions"):
        DOUBLE.values(TOY, None, SCHEDULE, DRAWS, SMOOTH)
    with pytest.raises(ValueError, match="actions have shape"):
        DOUBLE.values(TOY, None, SCHEDULE, DRAWS, SMOOTH, actions=np.zeros((T, PATHS, 1)))
    with pytest.raises(ValueError, match="extends beyond the horizon"):
        DOUBLE.values(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, window=Window(4, T))


@pytest.mark.study
def test_several_devices_give_the_same(adjoint):
    """Two CPU devices in a process of their own: sums over paths in another order, 1e-12."""
    here = os.getcwd()
    script = textwrap.dedent(f"""
        import jax, numpy as np, sys
        jax.config.update("jax_num_cpu_devices", 2)
        sys.path.insert(0, {here!r})
        from tests.engine.test_engine_xla import *
        assert len(jax.devices()) == 2
        engine = Xla(precision="float64", devices=tuple(jax.devices()))
        out = engine.adjoint(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, WEIGHTS)
        leaves = jax.tree.leaves((out.policy, out.schedule)) + [out.totals[n] for n in NAMES]
        several = engine.values(TOY, POLICY, SCHEDULE, DRAWS, SMOOTH, record=("state",))
        np.savez(sys.argv[1], *leaves, several.totals["cash"])
    """)
    path = os.path.join(os.environ.get("TMPDIR", "/tmp"), f"snapo-devices-{os.getpid()}.npz")
    try:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
        subprocess.run(
            [sys.executable, "-c", script, path], check=True, env=environment, timeout=300
        )
        with np.load(path) as found:
            got = [found[f"arr_{i}"] for i in range(len(found.files))]
    finally:
        if os.path.exists(path):
            os.remove(path)
    expected = jax.tree.leaves((adjoint.policy, adjoint.schedule)) + [
        adjoint.totals[n] for n in NAMES
    ]
    close(got, [*expected, adjoint.totals["cash"]], rtol=1e-12, atol=1e-14)


# --- paths that are not finite -----------------------------------------------------------------


class Fragile(Simulator):
    """Its only output is the logarithm of a random walk, which has none below zero."""

    horizon: int = 2
    action: Box = Box(-1.0, 1.0)
    noise_size: int = 1

    def prepare(self, inputs):
        return Schedule({}, {"one": jnp.ones(2)})

    def initial(self, constants, noise):
        return 1.0

    def observe(self, constants, now, state):
        return state[None]

    def step(self, constants, now, state, action, noise, smooth):
        return state + 0.1 * action[0] + noise[0] * now["one"], {}

    def terminal(self, constants, state, smooth):
        return {"log": jnp.log(state)}


@pytest.mark.parametrize("objective", [Mean("log"), CVaR("log", 0.5)], ids=["mean", "cvar"])
def test_a_path_that_is_not_finite_is_masked_and_counted(objective):
    """Value and gradient are those of the other paths alone."""
    simulator = Fragile()
    noise = np.full((2, 6, 1), 0.1)
    noise[0, [1, 4], 0] = -5.0
    noise[:, [0, 2, 3, 5], 0] += np.arange(4) * 0.2
    policy = MLP(simulator.action, 1, key=jax.random.key(0), hidden=(2,))
    bound = DOUBLE.bind(Problem(simulator, {}, objective))

    def run(paths):
        draws = Supplied(noise).draws(np.asarray(paths), simulator)
        return adjoint_of_finite_paths(bound, policy, draws, Exact(), objective)

    value, result, bad = run(range(6))
    expected, alone, none = run([0, 2, 3, 5])
    assert (bad, none) == (2, 0)
    assert value == pytest.approx(expected, rel=1e-14) and np.isfinite(value)
    close(result.policy, alone.policy, rtol=1e-12, atol=1e-16)
