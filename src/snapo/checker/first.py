"""The cheap part of `check`, for `solve`: what tracing alone finds, before anything compiles."""

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.policies.memory import remembered
from snapo.problem.policy import Constant, Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact

from .findings import Findings, Notes, Stop
from .indices import within
from .precision import TABLE, tables
from .shapes import declared, one_step
from .wanted import wanted


def first_mistakes(problem: Problem, policy: Policy) -> Findings:
    """Mistakes in declarations, shapes, totals, outputs that objective and limits name, indices,
    tables and actions; it never raises.

    It takes tenths of a second; `snapo.check` looks at much more.
    """
    notes, simulator = Notes(problem.simulator), problem.simulator
    try:
        declared(notes, simulator, problem.inputs)
        schedule = problem.schedule
        shapes = one_step(notes, simulator, schedule)
        wanted(notes, problem.objective, problem.limits, shapes.outputs)
        within(notes, simulator, schedule)
        notes.stop_on_errors()
        _precisions(notes, problem)
        _decides(notes, problem, policy, shapes.observation.shape[0])
    except Stop:
        pass
    except Exception as error:
        notes.exception(error, "check")
    return notes.finished("Nothing was compiled.")


def _precisions(notes: Notes, problem: Problem) -> None:
    """The step traced as training does, and then as evaluation does."""
    simulator, schedule = problem.simulator, problem.schedule

    def given(dtype):
        def cast(x):
            floating = jnp.issubdtype(np.asarray(x).dtype, np.floating)
            return jnp.asarray(x, dtype) if floating else jnp.asarray(x)

        start = np.zeros(simulator.initial_noise_size)
        constants, now, start = jax.tree.map(
            cast, (schedule.constants, at(schedule.steps, 0), start)
        )
        state = jax.eval_shape(simulator.initial, constants, start)
        action, noise = (
            jax.ShapeDtypeStruct((n,), dtype) for n in (simulator.action.size, simulator.noise_size)
        )
        return constants, now, state, action, noise

    def looped(constants, now, state, action, noise):
        """Two steps in a loop, where JAX keeps its programs from one precision to the other."""

        def step(carried, _):
            after, outputs = simulator.step(constants, now, carried, action, noise, Exact())
            after = jax.tree.map(lambda x, y: x.astype(y.dtype), after, carried)
            return after, sum(outputs.values(), jnp.zeros((), action.dtype))

        return jax.lax.scan(step, state, length=2)[1].sum()

    for precision in ("float32", "float64", "float32"):
        dtype = np.dtype(precision)
        try:
            with jax.enable_x64(precision == "float64"):
                others = sorted(set(tables(simulator, given(dtype), dtype)))
                jax.eval_shape(looped, *given(dtype))
        except Exception as error:
            where, what, _ = notes.explained(error, "step")
            notes.error(where, f"It fails in {precision}. {what}", TABLE)
            raise Stop from error
        for shape, found in others:
            notes.error(
                notes.method("step"),
                f"A table of shape {shape} is {found} where all else is {precision}.",
                TABLE,
            )
        notes.stop_on_errors()


def _decides(notes: Notes, problem: Problem, policy: Policy, features: int) -> None:
    """The actions of a policy of the user's own, at a few observations, lie in the set."""
    if type(policy).__module__.startswith("snapo.") and not isinstance(policy, Constant):
        return
    size, action = problem.action.size, problem.action
    where = f"policy {type(policy).__name__}"
    for observation in (jnp.zeros(features), jnp.ones(features), -jnp.ones(features)):
        with notes.during(where):
            nothing = jnp.zeros(remembered(policy))
            found = np.asarray(policy(jnp.concatenate([observation, nothing]), Exact()))
            found = found[: len(found) - nothing.size]
        if found.shape != (size,):
            notes.error(where, f"Its actions have shape {found.shape}.", f"Return ({size},).")
        elif fault := action.fault(found):
            notes.error(where, *fault)
        notes.stop_on_errors()
