"""Examples of docs/simulator/, as they stand there, with few steps of training."""

import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.solver.evaluate import path_totals

PAGES = sorted((Path(__file__).parents[2] / "docs" / "simulator").glob("*.md"))
FEW = """
    training=snapo.Training(steps=3, paths=64, validation_paths=64),
    evaluation=snapo.Evaluation(512, 256, 0, 0, search_paths=0),
"""


def written(what: str) -> dict:
    """The names that the block with these words makes; where it solves, with few steps."""
    found = {"snapo": snapo, "jnp": jnp}
    text = "\n".join(page.read_text() for page in PAGES)
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    found = {"snapo": snapo, "jnp": jnp}
    code, verb, rest = next(b for b in blocks if what in b).partition("solution = snapo.solve(")
    if verb:
        rest = rest.rstrip().removesuffix(")").rstrip().removesuffix(",") + f",{FEW})"
    exec(code + verb + rest, found)
    return found


@pytest.mark.prove
def test_the_pendulum_has_no_findings_and_costs_what_one_by_hand_does():
    """Ten steps without a torque from beside the top, more than a turn away."""
    simulator = written("class Pendulum")["Pendulum"](horizon=10)
    inputs = {"gravity": snapo.Input(10.0)}
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


@pytest.mark.prove
@pytest.mark.parametrize("what", ["class Tank", "class Reactor"])
def test_the_tank_and_the_two_stages_are_solved(what):
    """By the native engine; in the chain the first stage's rate earns in the second one."""
    found = written(what)
    solution = found["solution"]
    assert solution.status == "trained" and solution.engine.startswith("native")
    # The error of the tank's reading changes nothing but decisions.
    findings = snapo.check(solution.problem.simulator, solution.problem.inputs, paths=8)
    assert not findings, str(findings)
    by = solution.sensitivities.held
    assert all(np.all(np.isfinite(each.value)) for each in by.values())
    if what == "class Reactor":
        assert by["reactor.rate"].value > 0 and by["store.price"].value > 0
