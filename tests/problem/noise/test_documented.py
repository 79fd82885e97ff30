"""The example of docs/own_simulator.md, as it stands there."""

import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.solver.evaluate import path_totals

PAGE = Path(__file__).parents[3] / "docs" / "own_simulator.md"


@pytest.mark.prove
def test_the_shop_runs_and_the_own_noise_draws():
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    shop, spike = (next(b for b in blocks if name in b) for name in ("class Shop", "class Spike"))
    code, verb, rest = shop.partition("solution = snapo.solve(Shop(), inputs, ")
    few = (
        "training=snapo.Training(steps=3, paths=64, validation_paths=64),"
        "evaluation=snapo.Evaluation(512, 256, 0, 0), "
    )
    found = {}
    exec(code + verb + few + rest + spike, found)
    solution = found["solution"]
    assert solution.status == "trained" and solution.engine.startswith("native")
    by = solution.sensitivities.held
    assert np.all(np.isfinite(by["storm.transition"].value)) and by["demand.mean"].value != 0
    drawn = found["Spike"](0.3, 2.0).draw(np.array([-1.0, 0.0]))
    assert float(drawn) == pytest.approx(2 * np.log(2), rel=1e-5)


@pytest.mark.prove
def test_the_pendulum_has_no_findings_and_costs_what_one_by_hand_does():
    """Ten steps without a torque from beside the top, more than a turn away."""
    text = PAGE.read_text()
    block = next(b for b in re.findall(r"```python\n(.*?)```", text, re.S) if "class Pendulum" in b)
    found = {"snapo": snapo, "jnp": jnp}
    exec(block, found)
    simulator, inputs = found["Pendulum"](horizon=10), {"gravity": snapo.Input(10.0)}
    assert not snapo.check(simulator, inputs, paths=8)
    starts = snapo.Supplied(np.zeros((10, 1, 0)), np.array([[2.1, 0.0]]))
    problem = snapo.Problem(simulator, inputs, snapo.Mean("reward"), snapo.Sources(*[starts] * 3))
    angle, speed, reward = 0.1 * np.pi, 0.0, 0.0
    for _ in range(10):
        reward -= angle**2 + 0.1 * speed**2
        speed += 0.05 * 15 * np.sin(angle)
        angle += 0.05 * speed
    totals = path_totals(problem, snapo.Constant([0.0]), 1)
    assert totals["reward"][0] == pytest.approx(reward, rel=1e-4)
