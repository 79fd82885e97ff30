"""The problem of a call: a `Problem`, or a simulator with its inputs and other arguments.

Every public function of a problem takes either form, with the arguments in the same order::

    snapo.evaluate(problem, policy, paths=4096)
    snapo.evaluate(Reservoir(), inputs, policy, paths=4096, objective="cash")
"""

import re
from collections.abc import Callable
from functools import partial, wraps
from inspect import signature
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, overload

import jax
import jax.numpy as jnp

from .actions.sets import count
from .code.version import reading_once
from .objective import Limit, Mean, Objective
from .policies.composed import NEEDED
from .problem import Problem
from .scenarios import Scenarios, Sources
from .simulator import Simulator, at
from .smooth import Exact

P = ParamSpec("P")
R = TypeVar("R", covariant=True)
BESIDE = ("objective", "scenarios", "constraints")  # of a simulator, by name
SMALL = {"cost", "costs", "loss", "losses", "shortfall", "shortfalls", "penalty", "penalties"}


class Verb(Protocol[P, R]):
    """A function of a problem, or of a simulator and its inputs."""

    @overload
    def __call__(self, problem: Problem, /, *args: P.args, **others: P.kwargs) -> R: ...
    @overload
    def __call__(
        self, simulator: Simulator, inputs: Any = ..., /, *args: Any, **more: Any
    ) -> R: ...


@overload
def takes_problem(verb: Callable[Concatenate[Problem, P], R]) -> Verb[P, R]: ...
@overload
def takes_problem(
    *, objective: bool
) -> Callable[[Callable[Concatenate[Problem, P], R]], Verb[P, R]]: ...
def takes_problem(verb: Any = None, *, objective: bool = True) -> Any:
    """Extends a function of a `Problem` and a policy to simulators.

    `objective`: whether the function needs an objective.
    """
    return partial(_either, objective=objective) if verb is None else _either(verb, objective)


def _either(verb: Callable[..., Any], objective: bool) -> Callable[..., Any]:
    name, parameters = verb.__name__, list(signature(verb).parameters)
    policy = parameters[1]

    @wraps(verb)
    def called(*args: Any, **others: Any) -> Any:
        first, rest = (args[0], args[1:]) if args else (others.pop(parameters[0], None), ())
        adjacent = {key: others.pop(key) for key in BESIDE if key in others}
        # A simulator may have no inputs, and its policy at once.
        alone = bool(rest) and callable(rest[0]) and policy not in others
        if isinstance(first, Simulator) and rest and "inputs" not in others and not alone:
            others["inputs"], rest = rest[0], rest[1:]
        made = problem_of(name, first, others.pop("inputs", None), needs=objective, **adjacent)
        if objective and not isinstance(made.objective, Objective):
            message = "it must be an objective, or the name of an output for its mean"
            raise ValueError(f"{name}: objective is {made.objective!r}; {message}.")
        decides = rest[0] if rest else others.get(policy)
        if not callable(decides) and not (decides is None and "actions" in others):
            raise ValueError(f"{name}: {policy} is {decides!r}; it must be {NEEDED}.")
        with reading_once():
            return verb(made, *rest, **others)

    called.__doc__ = f"{verb.__doc__ or ''}{SAID.format(objective=SAID_OBJECTIVE * objective)}"
    return called


SAID_OBJECTIVE = "`objective`, "
SAID = """
    `problem` is a `Problem`, or a simulator followed by its `inputs`, with {objective}`scenarios`
    and `constraints` as keywords.
    """


def problem_of(
    verb: str,
    problem: Any,
    inputs: Any = None,
    objective: Any = None,
    scenarios: Scenarios | Sources | None = None,
    constraints: Any = (),
    *,
    sources: Sources | None = None,
    seed: int = 0,
    needs: bool = True,
) -> Problem:
    """The problem that a caller means: the problem that was passed, or that of a simulator with its
    inputs.

    **Arguments:** `sources`: used if there are no `scenarios`; `needs`: whether an objective is
    needed.

    **Raises:** `ValueError` if a `Problem` is passed together with inputs, an objective, scenarios
    or constraints, if the first argument is neither a problem nor a simulator, and for invalid
    sizes, scenarios or constraints.
    """
    if isinstance(problem, type):
        name = problem.__name__
        raise ValueError(f"{verb}: {name} is a class; pass an object of it, {name}().")
    if isinstance(problem, Problem):
        local = (item is not None for item in (inputs, objective, scenarios))
        if constraints not in ((), [], None) or any(local):
            message = "inputs, objective, scenarios and constraints"
            raise ValueError(f"{verb}: a Problem has its own {message}; do not pass them as well.")
        _sizes(verb, problem.simulator)
        return problem
    if not isinstance(problem, Simulator):
        kind = type(problem).__name__
        raise ValueError(f"{verb}: a {kind} is neither a simulator nor a Problem.")
    _sizes(verb, problem)
    if not isinstance(scenarios, Scenarios | Sources | None):
        message = "it must be scenarios, such as snapo.Sobol(0), or Sources"
        raise ValueError(f"{verb}: scenarios is {scenarios!r}; {message}.")
    if not isinstance(constraints, Limit | list | tuple):
        message = 'it must be a list of constraints, such as [snapo.Mean("unserved") <= 0.05]'
        raise ValueError(f"{verb}: constraints is {constraints!r}; {message}.")
    selected = sources if scenarios is None and sources is not None else Sources.of(scenarios, seed)
    aim = Mean("") if objective is None else objective
    made = Problem(problem, inputs, aim, selected, constraints)
    if objective is not None:
        return made
    names = outputs_of(made)
    only = _only_output(verb, names) if needs else names[0]
    return Problem(problem, inputs, Mean(only), selected, constraints).prepared(made.schedule)


def outputs_of(problem: Problem) -> list[str]:
    """The names of a simulator's outputs, by tracing one step; nothing is compiled."""
    simulator = problem.simulator

    def all_steps(schedule):
        first = simulator.initial(schedule.constants, jnp.zeros(simulator.initial_noise_size))
        action, noise = jnp.zeros(simulator.action.size), jnp.zeros(simulator.noise_size)
        now = at(schedule.steps, 0)
        after, outputs = simulator.step(schedule.constants, now, first, action, noise, Exact())
        return outputs, simulator.terminal(schedule.constants, after, Exact())

    outputs, last = jax.eval_shape(all_steps, problem.schedule)
    return list(dict.fromkeys([*outputs, *last]))


def _only_output(verb: str, names: list[str]) -> str:
    """The only output, if there is just one, and its name does not suggest a cost."""
    if len(names) != 1:
        raise ValueError(
            f"{verb}: the simulator has the outputs {sorted(names)}; name the one to "
            'maximise, such as objective="profit" or -Mean("cost").'
        )
    text = re.findall("[a-z]+", re.sub("([A-Z])", r" \1", names[0]).lower())
    if SMALL & set(text):
        name = f'"{names[0]}"'
        raise ValueError(
            f"{verb}: the only output is {names[0]!r}, and objectives are maximised; write "
            f"objective=-snapo.Mean({name}) to minimise it, or objective={name} to maximise it."
        )
    return names[0]


def _sizes(verb: str, simulator: Simulator) -> None:
    """Refuses an invalid horizon and invalid numbers of normals."""
    for name, minimum in (("horizon", 1), ("noise_size", 0), ("initial_noise_size", 0)):
        count(
            f"{verb}: {type(simulator).__name__}: {name}", getattr(simulator, name, None), minimum
        )
