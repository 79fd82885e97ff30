"""The example of docs/simulator/noise.md, as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest

import snapo
from snapo.solver.certificate import certify_derivatives

PAGE = Path(__file__).parents[3] / "docs" / "simulator" / "noise.md"


@pytest.mark.prove
def test_the_shop_runs_and_the_own_noise_draws():
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    shop, spike = (next(b for b in blocks if name in b) for name in ("class Shop", "class Spike"))
    code, verb, rest = shop.partition("solution = snapo.solve(Shop(), inputs, ")
    few = (
        "training=snapo.Training(steps=3, paths=64, validation_paths=64),"
        "evaluation=snapo.Evaluation(512, 256, 0, 0, search_paths=0), "
    )
    found = {}
    exec(code + verb + few + rest + spike, found)
    solution = found["solution"]
    assert solution.status == "trained" and solution.engine.startswith("native")
    by = solution.sensitivities.held
    assert np.all(np.isfinite(by["storm.transition"].value)) and by["demand.mean"].value != 0
    # A path does not move with its parameters of whole numbers and regimes: neither the check nor the
    # certificate compares them path by path.
    given = solution.problem
    assert "no findings" in str(snapo.check(given.simulator, given.inputs))
    assert given.in_mean == ("demand.mean", "storm.transition")
    assert {bump.input for bump in certify_derivatives(given, solution.policy, paths=16)} == {
        "price.df"
    }
    drawn = found["Spike"](0.3, 2.0).draw(np.array([-1.0, 0.0]))
    assert float(drawn) == pytest.approx(2 * np.log(2), rel=1e-5)
