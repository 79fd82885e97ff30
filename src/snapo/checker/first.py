"""The cheap part of `check`, for `solve`: what tracing alone finds, before anything compiles."""

import jax.numpy as jnp
import numpy as np

from snapo.problem.policies.memory import remembered
from snapo.problem.policy import Constant, Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact

from .arrays.indices import within
from .arrays.tables import tables
from .findings import Findings, Notes, Stop
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
        within(notes, simulator, problem.inputs, schedule)
        tables(notes, simulator, schedule)
        _decides(notes, problem, policy, shapes.observation.shape[0])
    except Stop:
        pass
    except Exception as error:
        notes.exception(error, "check")
    return notes.finished("Nothing was compiled.")


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
