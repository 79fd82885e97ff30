"""The chart of adjoints has its sentence: how much they grow, and how training went back."""

import numpy as np
import pytest

from snapo.report.evidence import history
from snapo.report.folder import RunFiles, RunResult


def run(growth, **result):
    """A run whose largest adjoint grows so much over ten steps back."""
    norms = [f"{norm:.6g}" for norm in np.geomspace(growth, 1.0, 10)]
    steps = [str(step) for step in range(10)]
    adjoints = {"step": steps, "usual": norms, "largest": norms, "angle": norms}
    return RunFiles(RunResult(**result), {}, {}, (), {}, {"step": steps, "best": steps}, adjoints)


@pytest.mark.parametrize(
    "growth, result, said",
    [
        (
            5000.0,
            {"clip": 12.5},
            ["5,000-fold", "'angle'", "each path's adjoint was bounded at 12"],
        ),
        (5000.0, {"window": 25}, ["through windows of 25 steps"]),
        (5000.0, {"clip": 3.0, "keep": 0.9}, ["only the share 0.9 of the adjoint"]),
        (5000.0, {}, ["5,000-fold"]),
        (50.0, {}, ["which is usual"]),
    ],
)
def test_the_sentence_under_the_chart(growth, result, said):
    chart, sentence = history(run(growth, **result)).blocks[-2:]
    assert "256 training paths" in chart.caption
    assert all(each in sentence.text for each in said), sentence.text
