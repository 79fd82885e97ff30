"""Every problem of the core's tests, the examples and gas storage: both engines, one answer."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests import test_examples as examples
from tests.domains.gas_storage.storage_cases import setup as storage
from tests.engine.native.problems import TOLERANCE, Store, Tanh, difference
from tests.solver import test_constant_mix as mix
from tests.solver import test_funding as funding
from tests.solver import test_lqr as lqr
from tests.solver import test_merton as merton

from snapo.engine import Xla
from snapo.engine.native import Native, unsupported
from snapo.engine.native.call import NativeCall
from snapo.problem.inputs import Input
from snapo.problem.policy import MLP
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, probe
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import pull_back

PATHS = 48
SEEDS = (4, 5, 6)
STEPS = 12  # of the problems whose horizon is a number: XLA compiles no faster, but runs so
STORAGE = ("quick", "G1", "G3", "G6")


@cache
def problem(name: str):
    """(simulator, inputs, schedule, policy) of a problem."""
    if name in STORAGE:
        made, policy, *_ = storage(name)
        return made.simulator, made.inputs, made.schedule, policy
    if name in examples.NAMES:
        simulator, inputs, _ = examples.problem(name)
    else:
        simulator, inputs = {
            "regulator": lambda: (lqr.Regulator(), lqr.INPUTS),
            "merton": lambda: (
                merton.Merton(),
                merton.Inputs(**{k: Input(v) for k, v in merton.MARKET.items()}),
            ),
            "constant mix": lambda: (mix.Mix(), mix.inputs()),
            "funding": lambda: (funding.Funding(), funding.inputs()),
        }[name]()
        simulator = replace(simulator, horizon=min(simulator.horizon, STEPS))
    schedule = prepare(simulator, inputs)
    features = probe(simulator, schedule)[1].shape[0]
    return simulator, inputs, schedule, MLP(simulator.action, features, key=jax.random.key(1))


CORE = ("regulator", "merton", "constant mix", "funding")
FAST = (*CORE, "own_simulator", "battery")
SLOW = [pytest.param(n, marks=pytest.mark.study) for n in ("quick", "portfolio", "G1", "G3", "G6")]


@pytest.mark.prove
@pytest.mark.parametrize("constraints", [Exact(), Smooth(np.float64(0.1))], ids=["exact", "smooth"])
@pytest.mark.parametrize("name", [*FAST, *SLOW])
def test_engines_agree(name, constraints):
    """The gradient by every parameter and input, relative to the largest of each: 2e-11 in float64.

    The largest of all three draws: in one draw a sum over the paths may cancel (G3's derivative by
    the injection fuel is 214 in one and 6,800 in another, off by 1.5e-8 in the former; G3 was seen
    off by 1.01e-11, hence twice 1e-11). In float32 1e-5, beyond what float32 itself does to XLA's
    own answer, five times over (other roundings):
    where a store stands at a limit, they decide which side of the kink a path is on. They are
    chance, hence three draws.
    Inputs, not the schedule: where two limits coincide by construction, only the sum of their
    derivatives has a meaning.
    """
    simulator, inputs, schedule, policy = problem(name)
    assert unsupported(simulator, schedule, policy, constraints) is None

    def gradient(engine, seed: int):
        draws = Pseudo(seed).draws(np.arange(PATHS), simulator)
        given = (simulator, policy, schedule, draws, constraints)
        names = Native("float64").values(*given).totals
        weights = {name: np.linspace(0.5, 1.5, PATHS) / PATHS for name in names}
        found = engine.adjoint(*given, weights)
        return found.totals, found.policy, pull_back(simulator, inputs, [found.schedule])

    def gradients(engine):
        return jax.tree.map(lambda *draws: np.stack(draws), *(gradient(engine, s) for s in SEEDS))

    exact = gradients(Xla("float64"))

    def gap(engine) -> float:
        # What does not matter at all (the one row of constant rates) is left as rounding.
        return difference(exact, gradients(engine), least=1e-3)

    assert gap(Native("float64")) < 2e-11
    single = gap(Native("float32"))
    # XLA's own is compiled where it is needed.
    assert single < 1e-5 or single < 1e-5 + 5 * gap(Xla("float32"))


class Tabled(Store):
    """A table of a step that is read without and with a derivative, as a fitted value's is."""

    def prepare(self, inputs):
        made = super().prepare(inputs)
        table = jnp.cos(jnp.arange(100.0 * self.horizon)).reshape(self.horizon, 100)
        return Schedule(made.constants, made.steps | {"table": table})

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = super().step(constants, now, state, action, noise, smooth)
        still = jax.lax.stop_gradient(now["table"]).reshape(50, 2)
        place = jnp.clip(jnp.floor(50 * state["level"]), 0, 49).astype(int)
        cash = outputs["cash"] + still[place, 0] * state["x"] + now["table"][1] ** 2
        return after, outputs | {"cash": cash}


def test_a_table_without_its_derivative_is_read_where_it_is():
    simulator, policy = Tabled(), Tanh((4, 14, 2))
    draws, schedule = Pseudo(0).draws(np.arange(33), simulator), simulator.prepare(None)
    values = simulator, policy, schedule, draws, Smooth(0.2)
    weights = {"cash": jnp.linspace(0, 1, 33)}
    expected, found = (x.adjoint(*values, weights) for x in (Xla("float64"), Native("float64")))
    assert difference(expected, found) < TOLERANCE["float64"]
    engine = Native("float64")
    with engine.numbers():
        call = NativeCall(engine, *values, None, None, None)
        code = call.runner(False, (), False, ()).kernel.code
    assert code.strides["steps"] - code.filled["steps"] < 400  # a copy of the table has 800 bytes
