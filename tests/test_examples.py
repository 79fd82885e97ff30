"""The examples: no findings, and a short solve that improves on doing nothing clever."""

import importlib.util
from pathlib import Path

import jax
import numpy as np
import pytest

import snapo
from snapo.engine import Xla
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact

EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def problem(name):
    """(simulator, inputs, objective) of an example."""
    module = load(name)
    if name == "own_simulator":
        return module.Reservoir(), module.inputs, snapo.Mean("cash")
    if name == "american_put":
        return module.Put(), module.inputs, snapo.Mean("cash")
    if name == "max_call":
        return module.MaxCall(), module.inputs, snapo.Mean("cash")
    objective = module.objective() if name == "portfolio" else snapo.Mean("value")
    return module.simulator(), module.inputs(), objective


NAMES = ("own_simulator", "american_put", "max_call", "battery", "portfolio")


def test_the_readme_example_is_short():
    lines = (EXAMPLES / "own_simulator.py").read_text().splitlines()
    assert len(lines) <= 30 and max(map(len, lines)) <= 100


SLOWER = [*NAMES[:3], *(pytest.param(name, marks=pytest.mark.study) for name in NAMES[3:])]


@pytest.mark.prove
@pytest.mark.parametrize("name", SLOWER)
def test_an_example_has_no_findings(name):
    findings = snapo.check(*problem(name)[:2], paths=8)
    assert len(findings) == 0, str(findings)


def test_portfolio_weights_obey_their_limits():
    """Drawn wealth is positive, and shares obey asset and group limits to 1e-12 whatever is asked."""
    module = load("portfolio")
    groups = ((module.EQUITIES, 0.2, 0.6), (module.BONDS, 0.2, 0.6), (module.OTHERS, 0.0, 1.0))
    rng = np.random.default_rng(0)
    with jax.enable_x64(True):
        for scale in (1.0, 30.0):
            logits = jax.numpy.asarray(rng.normal(size=30) * scale)
            weights = np.asarray(jax.jit(lambda x: Exact().simplex(x, 0.0, 0.10, groups))(logits))
            assert weights.sum() == pytest.approx(1.0, abs=1e-12)
            assert weights.min() >= 0 and weights.max() <= 0.10 + 1e-12
            for members, low, high in groups:
                assert low - 1e-12 <= weights[list(members)].sum() <= high + 1e-12


def test_battery_stays_feasible_and_keeps_its_energy():
    """Energy within 0 and capacity in the exact simulator under random decisions, to rounding."""
    simulator, inputs, _ = problem("battery")
    actions = np.random.default_rng(1).uniform(-1, 1, (simulator.horizon, 16, 1))
    draws = Pseudo(0).draws(np.arange(16), simulator)
    schedule = prepare(simulator, inputs)
    out = Xla(precision="float64").values(
        simulator, None, schedule, draws, Exact(), actions=actions, record=("state",)
    )
    state = out.record["state"]
    assert state["energy"].min() >= -1e-12
    assert np.all(state["energy"] <= state["capacity"] + 1e-12)
    assert np.all(np.diff(state["capacity"], axis=0) < 0)


@pytest.mark.prove
@pytest.mark.parametrize("name", SLOWER)
def test_a_short_training_gains(name):
    """60 steps of 64 paths against the untrained network on the same fresh paths: the difference
    is many standard errors, so its sign needs no tolerance."""
    simulator, inputs, objective = problem(name)
    # Only the value is read.
    parts = dict.fromkeys(("judge_paths", "search_paths", "selection_paths", "smooth_paths"), 0)
    evaluation = snapo.Evaluation(paths=1024, sensitivity_paths=64, **parts)
    solution, first = (
        snapo.solve(
            simulator,
            inputs,
            objective=objective,
            training=snapo.Training(steps, 64, validation_every=30, validation_paths=256),
            evaluation=evaluation,
            engine="xla",
        )
        for steps in (30 if name == "portfolio" else 60, 0)
    )
    assert solution.status == "trained"
    assert solution.value > first.value
