"""The transpose of `prepare` compiled beside other work: a later call compiles nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.engine.transpose import compiled_meanwhile, pull_back
from snapo.problem.inputs import Input
from snapo.problem.problem import prepare
from snapo.problem.simulator import Schedule
from snapo.solver.provenance import Clock

INPUTS = {"rate": Input([0.1, 0.3], "1/year")}


class Grown:
    """All that `prepare` and `pull_back` ask of a simulator."""

    def __eq__(self, other):
        return isinstance(other, Grown)

    def __hash__(self):
        return 1

    def prepare(self, inputs):
        return Schedule({"whole": jnp.prod(jnp.exp(inputs["rate"]))}, {})

    def prepared_apart(self):
        return self, lambda schedule: schedule


def test_what_is_compiled_meanwhile_is_not_compiled_again():
    schedule = prepare(Grown(), INPUTS)  # pyright: ignore[reportArgumentType]
    one = jax.tree.map(np.ones_like, schedule)
    with Clock() as clock:
        with compiled_meanwhile(Grown(), INPUTS, schedule):  # pyright: ignore[reportArgumentType]
            pass
        clock.stage("train")
        found = pull_back(Grown(), INPUTS, [one])["rate"]  # pyright: ignore[reportArgumentType]
        clock.stage("evaluate")
    assert clock.seconds["compile"] == 0.0
    np.testing.assert_allclose(found, np.full((1, 2), np.exp(0.4)), rtol=1e-14)


def test_a_failure_is_told_by_the_call_that_needs_it():
    class Broken(Grown):
        def prepare(self, inputs):
            raise RuntimeError("no schedule")

    nothing = Schedule({}, {})
    with compiled_meanwhile(Broken(), INPUTS, nothing):  # pyright: ignore[reportArgumentType]
        pass
    with pytest.raises(RuntimeError, match="no schedule"):
        pull_back(Broken(), INPUTS, [nothing])  # pyright: ignore[reportArgumentType]
