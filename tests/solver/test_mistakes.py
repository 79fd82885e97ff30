"""Mistakes that `solve` refuses in one message before anything compiles, and those it lives with."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.checker.check import problem_mistakes
from snapo.engine.native import Native, unsupported
from snapo.problem.actions import Box
from snapo.problem.inputs import Input
from snapo.problem.objective import AtMost, Mean
from snapo.problem.policy import MLP, Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact
from snapo.solver.solve import Evaluation, solve
from snapo.solver.train import Training

WEIGHTS = np.array([0.3, 0.7])


class Inputs(eqx.Module):
    decay: Input
    plain: float = 2.0


class Drift(Simulator):
    """Follows an action; `kind` is the way in which the step is written."""

    horizon: int = eqx.field(static=True, default=3)
    action: Box = eqx.field(default=Box(0.0, 1.0))
    noise_size: int = eqx.field(static=True, default=2)
    kind: str = eqx.field(static=True, default="right")

    def prepare(self, inputs):
        return Schedule({"decay": inputs.decay, "plain": inputs.plain * jnp.ones(())}, {})

    def initial(self, constants, noise):
        return jnp.array(1.0)

    def observe(self, constants, now, state):
        return jnp.stack([state])

    def step(self, constants, now, state, action, noise, smooth):
        moved = noise[0]
        if self.kind == "table":
            moved = jnp.sum(WEIGHTS * noise)
        elif self.kind == "product":
            moved = jnp.dot(jnp.asarray(WEIGHTS), noise)
        elif self.kind == "noise":
            moved = noise[2]
        elif self.kind == "action":
            moved = action[1]
        elif self.kind == "print":
            jax.debug.print("moved {}", moved)
        state = state * constants["decay"] + 0.1 * moved
        return state, {"cost": constants["plain"] * (state - action[0]) ** 2}

    def totals(self):
        return {"cost": "median"} if self.kind == "total" else {}  # pyright: ignore


class Five(Policy):
    def __call__(self, observation, smooth):
        return jnp.array([5.0])


INPUTS = Inputs(Input(np.array(0.9)))


def problem(kind: str = "right") -> Problem:
    return Problem(Drift(kind=kind), INPUTS, -Mean("cost"))


REFUSED = {
    "table": "A table of shape (2,)",
    "product": "A table of shape (2,)",
    "noise": "noise[2]",
    "action": "action[1]",
    "total": "'median'",
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_mistake_is_named_before_anything_compiles(kind, monkeypatch):
    monkeypatch.setattr("snapo.solver.solve.choose", None)
    with pytest.raises(ValueError, match="nothing was compiled") as refused:
        solve(problem(kind), policy=MLP(hidden=(4,)))
    assert REFUSED[kind] in str(refused.value)


@pytest.mark.parametrize(
    "objective, limits, said",
    [
        (-Mean("costs"), (), "error: objective\n    There is no output 'costs'."),
        (Mean("cost") + Mean("gain"), (), "no output 'gain'"),
        (-Mean("cost"), (AtMost("costly", 1.0),), "error: constraints[0]\n    There is no output 'costly'"),
        ("gain", (), "error: objective\n    There is no output 'gain'."),
        (1.0, (), "It is not an objective, such as Mean(output): 1.0."),
        (-Mean("cost"), ("cost",), "constraints[0]\n    It is not a constraint, such as Mean(output) <= level: 'cost'"),
    ],
)  # fmt: skip
def test_outputs_that_are_not_there_are_named_with_those_that_are(objective, limits, said):
    with pytest.raises(ValueError, match="nothing was compiled") as refused:
        solve(
            Drift(), INPUTS, MLP(hidden=(4,)), objective=objective, constraints=limits, engine="xla"
        )
    assert said in str(refused.value)
    assert "The outputs are ['cost']." in str(refused.value)


def test_a_class_in_place_of_a_simulator_and_other_things_are_told():
    given = Inputs(Input(0.9))
    with pytest.raises(ValueError, match=r"Drift is a class; pass an object of it, Drift\(\)"):
        solve(Drift, given)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="a str is neither a simulator nor a Problem"):
        solve("drift", given)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"training is {'steps': 2}; it must be snapo.Training"):
        solve(Drift(), given, training={"steps": 2})  # pyright: ignore[reportArgumentType]


def test_one_limit_needs_no_tuple():
    """It comes as far as the outputs, of which it is none."""
    with pytest.raises(ValueError, match=r"constraints\[0\]\s+There is no output 'dose'"):
        solve(Drift(), Inputs(Input(0.9)), objective=Mean("cost"), constraints=AtMost("dose", 0.1))


def test_an_action_outside_of_its_set_is_named():
    found = problem_mistakes(problem(), Five())
    assert len(found.errors) == 1 and "Action 0 is 5, outside of 0 to 1" in str(found)


def test_a_problem_without_mistakes_passes():
    assert problem_mistakes(problem(), MLP(hidden=(4,))).ok


@pytest.mark.parametrize("kind", ["table", "product"])
def test_native_reads_a_table_in_both_precisions(kind):
    """JAX gives a NumPy table that it met in one precision to the programs of the other."""
    totals = []
    for precision in ("float32", "float64", "float32"):
        native, made = Native(precision), problem(kind)
        draws = Pseudo(0).draws(np.arange(8), made.simulator)
        actions = np.zeros((3, 8, 1))
        found = native.values(made.simulator, None, made.schedule, draws, Exact(), actions=actions)
        totals.append(np.asarray(found.totals["cost"], np.float64))
    np.testing.assert_allclose(totals[0], totals[1], rtol=1e-5)
    np.testing.assert_array_equal(totals[0], totals[2])


def test_a_print_is_not_dropped():
    made = problem("print")
    policy = MLP(hidden=(4,)).for_problem(made.interface, jax.random.key(0))
    reason = unsupported(made.simulator, made.schedule, policy, Exact())
    assert reason is not None and "jax.debug.print" in reason


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Training(steps=-3), "steps is -3; it must be a whole number of at least 0"),
        (lambda: Training(paths=0), "paths is 0"),
        (lambda: Training(validation_every=0.5), "validation_every is 0.5"),  # pyright: ignore
        (lambda: Training(patience=0), "patience is 0"),
        (lambda: Training(learning_rate=-1), "learning_rate is -1; it must be a number above 0"),
        (lambda: Training(learning_rate=float("nan")), "learning_rate is nan"),
        (lambda: Training(learning_rate="fast"), "learning_rate is 'fast'"),  # pyright: ignore
        (lambda: Training(average=2.0), "average is 2.0; it must be a number above 0, at most 1"),
        (lambda: Training(temperature_end=-1), "temperature_end is -1; it must be a number above"),
        (lambda: Training(temperature_start=np.inf), "temperature_start is inf"),
        (lambda: Training(decay=-0.1), "decay is -0.1; it must be a number, 0 or more"),
        (lambda: Training(clip=0.0), "clip is 0.0; it must be a number above 0, 'auto' or None"),
        (lambda: Training(clip="often"), "clip is 'often'"),
        (lambda: Training(seed=-1), "seed is -1; it must be a whole number of at least 0"),
        (lambda: Training(seed="a"), "seed is 'a'"),  # pyright: ignore
        (lambda: Evaluation(judge_paths=-3), "judge_paths is -3; it must be a whole number of at"),
        (lambda: Evaluation(sensitivity_paths=-1), "sensitivity_paths is -1"),
        (lambda: Evaluation(scenarios="halton"), "'halton'"),
    ],
)
def test_numbers_without_sense_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_without_sensitivities_and_with_a_plain_number_beside_inputs():
    few = Training(steps=1, paths=8, validation_paths=8)
    none = Evaluation(paths=64, sensitivity_paths=0, smooth_paths=0)
    solution = solve(problem(), policy=MLP(hidden=(4,)), training=few, evaluation=none)
    assert solution.sensitivities is None and np.isfinite(solution.value)
