"""The cheap part of `check`, for `solve`: what tracing alone finds, before anything compiles."""

from collections import OrderedDict
from collections.abc import Callable, Hashable

import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.problem.code.version import of_preparation, read_context
from snapo.problem.form import form_of
from snapo.problem.inputs import unnamed
from snapo.problem.policies.memory import remembered
from snapo.problem.policies.rules import Constant
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem, all_versions
from snapo.problem.simulator import Simulator
from snapo.problem.smooth import Exact

from .arrays.indices import within
from .arrays.slices import short_slices
from .arrays.tables import tables
from .findings import Findings, Notes, StopCheck
from .loops import loops
from .lost import lost_derivatives
from .repeatable import repeatable
from .shapes import declared, one_step, prepared
from .wanted import require

KEPT = 64
_faultless: OrderedDict[Hashable, None] = OrderedDict()  # forms of snapo's own simulators


def first_mistakes(problem: Problem, policy: Policy) -> Findings:
    """Mistakes in declarations, shapes, totals, outputs that objective and limits name, slices,
    indices, tables, loops, numbers drawn in Python, and actions; it never raises.

    It takes tenths of a second; `snapo.check` looks at much more.
    """
    of_simulator = simulator_mistakes(problem.simulator, problem.inputs)
    return of_simulator if of_simulator.errors else of_simulator + problem_mistakes(problem, policy)


def simulator_mistakes(simulator: Simulator, inputs: PyTree) -> Findings:
    """Those of a simulator and its inputs."""

    def look(notes: Notes) -> None:
        declared(notes, simulator, inputs)
        schedule = prepared(notes, simulator, inputs)
        library = of_preparation(simulator, inputs) is None
        form = form_of((simulator, unnamed(inputs), schedule)) if library else None
        if library and form in _faultless:
            return
        one_step(notes, simulator, schedule)
        if not library:  # tests cover these for snapo's own code
            short_slices(notes, simulator, inputs, schedule)
            repeatable(notes, simulator, inputs, schedule)
            loops(notes, simulator, inputs, schedule)
            lost_derivatives(notes, simulator, inputs)
            tables(notes, simulator, schedule)
        within(notes, simulator, inputs, schedule)
        if library and not notes.items:
            _faultless[form] = None
            while len(_faultless) > KEPT:
                _faultless.popitem(last=False)

    return _looked(simulator, inputs, look)


def problem_mistakes(problem: Problem, policy: Policy) -> Findings:
    """Those of an objective, limits and a policy for a simulator that has none."""

    def look(notes: Notes) -> None:
        shapes = one_step(notes, problem.simulator, problem.schedule)
        require(notes, problem.objective, problem.constraints, shapes.outputs)
        _decides(notes, problem, policy, shapes.observation.shape[0])

    return _looked(problem.simulator, problem.inputs, look)


def _looked(simulator: Simulator, inputs: PyTree, look: Callable[[Notes], None]) -> Findings:
    notes = Notes(simulator)
    try:
        with read_context(all_versions(simulator, inputs)):
            look(notes)
    except StopCheck:
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
            result = np.asarray(policy(jnp.concatenate([observation, nothing]), Exact()))
            result = result[: len(result) - nothing.size]
        if result.shape != (size,):
            notes.error(where, f"Its actions have shape {result.shape}.", f"Return ({size},).")
        elif fault := action.fault(result):
            notes.error(where, *fault)
        notes.stop_on_errors()
