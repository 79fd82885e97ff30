"""The transpose of `prepare` compiled beside other work: a later call compiles nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.engine.transpose import LARGE, compiled_meanwhile, pull_back
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


class Tabled(Grown):
    """With a table that no input makes, as that of a fitted value."""

    table = jnp.ones((2, LARGE))

    def prepare(self, inputs):
        made = super().prepare(inputs)
        return Schedule(made.constants | {"table": self.table}, {})


def test_a_large_cotangent_of_one_zero_takes_no_memory_and_changes_nothing():
    zero = np.broadcast_to(np.zeros(()), Tabled.table.shape)
    for table in (zero, np.zeros(zero.shape)):
        schedule = Schedule({"whole": np.ones(()), "table": table}, {})
        found = pull_back(Tabled(), INPUTS, [schedule])["rate"]  # pyright: ignore[reportArgumentType]
        np.testing.assert_allclose(found, np.full((1, 2), np.exp(0.4)), rtol=1e-14)
