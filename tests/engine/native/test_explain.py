"""An explanation is of the code that runs."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.engine.native.problems import Store, Tanh

from snapo.engine.native import Native, call, explain
from snapo.lanes.machine import pipeline
from snapo.problem.policy import Policy
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import EXACT, Smooth


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


class Observed(Store):
    """Its observation and its step compute the same limits; a policy may read one number of it."""

    def limits(self, now, state):
        return jnp.sqrt(1 + state["level"] * jnp.exp(now["forward"]))

    def observe(self, constants, now, state):
        others = jnp.tanh(jnp.stack([state["level"], now["forward"]]))
        return jnp.concatenate([self.limits(now, state)[None], state["x"][None], others])

    def step(self, constants, now, state, action, noise, smooth):
        action = action * self.limits(now, state)
        return super().step(constants, now, state, action, noise, smooth)


class First(Policy):
    """Reads one number."""

    def __call__(self, observation, smooth=EXACT):
        return jnp.stack([observation[0], 1 - observation[0]])


def test_what_two_functions_compute_is_computed_once():
    """The limits of the step are those of the observation, of which nothing else is needed."""
    programs = dict(explain(Observed(), policy=First()).programs)
    assert programs["step: computed once per step"].count(" exp ") == 1
    path = programs["step: one path and its transpose"]
    assert path.count(" sqrt ") == 1 and path.count(" tanh ") == 0
