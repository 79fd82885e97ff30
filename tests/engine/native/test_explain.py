"""An explanation is of the code that runs."""

import numpy as np
import pytest
from tests.engine.native.problems import Store, Tanh

from snapo.engine.native import Native, call, explain
from snapo.lanes.machine import pipeline
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Smooth


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_the_text_is_that_of_the_kernel_in_use(precision):
    store, policy, smooth = Store(), Tanh((4, 14, 2)), Smooth(0.2)
    schedule, weights = store.prepare(None), {"cash": np.ones(8)}
    draws = Pseudo(0).draws(np.arange(8), store)
    call._runners.clear()
    Native(precision).adjoint(store, policy, schedule, draws, smooth, weights)
    (runner,) = call._runners.values()
    explanation = explain(store, schedule, policy, smooth, precision)
    assert explanation.llvm == runner.kernel.text
    assert f"blocks of {runner.kernel.lanes} paths" in explanation.target


def test_the_instructions_come_from_the_pipeline_of_the_kernel(monkeypatch):
    """The same passes and target; `tests/lanes/machine/test_pipeline.py` compares the bytes."""
    seen = []
    original = pipeline.Pipeline.optimised

    def optimised(self, text, target):
        seen.append((self, text, target.triple))
        return original(self, text, target)

    monkeypatch.setattr(pipeline.Pipeline, "optimised", optimised)
    explanation = explain(Store(), policy=Tanh((4, 14, 2)))
    shown = explanation.assembly()
    pipeline.object_code(explanation.llvm)
    assert seen[0] == seen[1]
    assert "step_reverse:" in shown and "step_forward:" in shown
