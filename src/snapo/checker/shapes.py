"""Declarations, the schedule, and shapes and types of every method, by abstract evaluation."""

from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.problem import inputs as inputs_
from snapo.problem.actions import Actions
from snapo.problem.objective import Limit, Objective, as_constraints
from snapo.problem.problem import prepare
from snapo.problem.simulator import Schedule, Simulator, at
from snapo.problem.smooth import Exact, Smooth

from .findings import Notes, StopCheck

KEEP = (
    "step must return the same shape and type; in initial, write a floating-point number as "
    "0.0, not as 0."
)
COMPONENTS = (
    "Outputs are single real numbers; sum the array, or return one output for each component."
)
ONE = "A vector of one number is not a number; write action[0] or noise[0] for the number in it."


def declared(notes: Notes, simulator: Simulator, inputs: PyTree) -> None:
    """Checks the declared sizes, action set and inputs."""
    if isinstance(simulator, type):
        name = simulator.__name__
        notes.error("simulator", f"{name} is a class.", f"Pass an object: {name}().")
        raise StopCheck
    for name, minimum in (("horizon", 1), ("noise_size", 0), ("initial_noise_size", 0)):
        value = getattr(simulator, name, None)
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < minimum:
            allowed = f"{name} is {value!r}; it must be a whole number of at least {minimum}."
            notes.error(name, allowed, "Change it in the class.")
    if not isinstance(action := getattr(simulator, "action", None), Actions):
        notes.error("action", f"It is {action!r}.", "Make it a set, such as Box(0.0, 1.0).")
    if not inputs_.named_inputs(inputs):
        notes.warning(
            "inputs",
            "There is no Input, so there is nothing to differentiate with respect to.",
            "Wrap the numbers whose sensitivity matters: Input(value, unit).",
        )
    notes.stop_on_errors()


def prepared(notes: Notes, simulator: Simulator, inputs: PyTree) -> Schedule:
    """Checks the schedule: its type, its leading axis, and that it is finite and in float64."""
    method = notes.method("prepare")
    with jax.enable_x64(True), notes.during("prepare"):
        made = jax.eval_shape(
            lambda v: simulator.prepare(inputs_.replace(inputs, v)), inputs_.values(inputs)
        )
    if not isinstance(made, Schedule):
        notes.error(
            method,
            f"It returns a {type(made).__name__}.",
            "Return snapo.Schedule(constants, steps).",
        )
        raise StopCheck
    with notes.during("prepare"):
        schedule = prepare(simulator, inputs)
    for path, leaf in jax.tree_util.tree_flatten_with_path(schedule)[0]:
        where = f"{method}: schedule{jax.tree_util.keystr(path)}"
        if leaf.dtype == np.float32:
            notes.error(where, "It is float32; schedules are float64.", "Drop the explicit dtype.")
        if leaf.dtype.kind == "f" and not np.all(np.isfinite(leaf)):
            index = tuple(int(i) for i in np.argwhere(~np.isfinite(leaf))[0])
            notes.error(
                where,
                f"Entry {index} is {leaf[index]}.",
                "Make every number of the schedule finite.",
            )
    for path, leaf in jax.tree_util.tree_flatten_with_path(schedule.steps)[0]:
        if leaf.ndim == 0 or leaf.shape[0] != simulator.horizon:
            notes.error(
                f"{method}: schedule.steps{jax.tree_util.keystr(path)}",
                f"Its shape is {leaf.shape}; the horizon is {simulator.horizon}.",
                f"Give it a first axis of {simulator.horizon}, one entry for each step; numbers "
                "for the whole horizon belong in constants.",
            )
    notes.stop_on_errors()
    return schedule


class Shapes(NamedTuple):
    """The shape and type of the observation, and the names of all outputs."""

    observation: Any
    outputs: frozenset[str]


def one_step(notes: Notes, simulator: Simulator, schedule: Schedule) -> Shapes:
    """Shapes and types of `initial`, `observe`, `step` and `terminal`, by abstract evaluation."""
    constants, now = schedule.constants, at(schedule.steps, 0)
    noise, action = np.zeros(simulator.noise_size), np.zeros(simulator.action.size)
    with jax.enable_x64(True):
        with notes.during("initial"):
            state = jax.eval_shape(
                simulator.initial, constants, np.zeros(simulator.initial_noise_size)
            )
        with notes.during("observe"):
            observation = jax.eval_shape(simulator.observe, constants, now, state)
        if getattr(observation, "ndim", None) != 1 or observation.dtype.kind != "f":
            notes.error(
                notes.method("observe"),
                f"It returns {_described(observation)}.",
                "Return one vector of floating numbers: jnp.stack([…]).",
            )
        names = []
        for smooth in (Exact(), Smooth(0.1)):
            with notes.during("step"):
                result = jax.eval_shape(
                    simulator.step, constants, now, state, action, noise, smooth
                )
                if not (isinstance(result, tuple) and len(result) == 2):
                    raise TypeError(f"step returns {_described(result)}; return (state, outputs).")
            after, outputs = result
            _same_state(notes, state, after)
            _scalars(notes, "step", outputs)
            with notes.during("terminal"):
                final_outputs = jax.eval_shape(simulator.terminal, constants, state, smooth)
            _scalars(notes, "terminal", final_outputs)
            notes.stop_on_errors()
            names.append((set(outputs), set(final_outputs)))
    if not names[0][0] | names[0][1]:
        notes.error(
            notes.method("step"),
            "There are no outputs, so there is nothing to value.",
            'Return them with the state: return state, {"cash": cash}.',
        )
        raise StopCheck
    if names[0] != names[1]:
        differ = sorted((names[0][0] ^ names[1][0]) | (names[0][1] ^ names[1][1]))
        notes.error(
            notes.method("step"),
            f"The outputs {differ} exist only with Exact() or only with Smooth().",
            "Return the same names every time.",
        )
    outputs = frozenset(names[0][0] | names[0][1])
    _declared_outputs(notes, simulator, outputs)
    notes.stop_on_errors()
    return Shapes(observation, outputs)


def _same_state(notes: Notes, before: PyTree, after: PyTree) -> None:
    if jax.tree.structure(before) != jax.tree.structure(after):
        notes.error(
            notes.method("step"),
            f"The state changes structure: initial gives {_described(before)}, "
            f"step gives {_described(after)}.",
            "Return from step the same tree of arrays as from initial.",
        )
        return
    for (path, x), y in zip(
        jax.tree_util.tree_flatten_with_path(before)[0], jax.tree.leaves(after)
    ):
        both_floating = x.dtype.kind == "f" and y.dtype.kind == "f"
        if x.shape != y.shape or not (both_floating or x.dtype == y.dtype):
            notes.error(
                f"{notes.method('step')}: state{jax.tree_util.keystr(path)}",
                f"It changes from {_described(x)} in initial to {_described(y)} in step.",
                ONE if (x.shape, y.shape) == ((), (1,)) else KEEP,
            )


def _scalars(notes: Notes, method: str, outputs) -> None:
    if not isinstance(outputs, dict):
        notes.error(
            notes.method(method),
            f"Its outputs are {_described(outputs)}.",
            "Return {name: number}.",
        )
        return
    for name, value in outputs.items():
        if value.shape != () or value.dtype.kind not in "fiub":
            notes.error(
                f"{notes.method(method)}: output {name!r}",
                f"It is {_described(value)}.",
                ONE if value.shape == (1,) else COMPONENTS,
            )


def _declared_outputs(notes: Notes, simulator: Simulator, names: frozenset[str]) -> None:
    for name, kind in simulator.totals().items():
        if kind not in ("sum", "max", "last"):
            notes.error(
                "totals", f"{name!r} is totalled by {kind!r}.", 'Write "sum", "max" or "last".'
            )
    for method, declared in (
        ("totals", simulator.totals()),
        ("control_variates", simulator.control_variates()),
    ):
        for name in sorted(set(declared) - names):
            notes.error(
                method, f"There is no output {name!r}.", f"The outputs are {sorted(names)}."
            )


def _described(x) -> str:
    """A shape and type as text."""
    if hasattr(x, "shape") and hasattr(x, "dtype"):
        return f"{x.dtype}{list(x.shape)}"
    if isinstance(x, dict | list | tuple):
        return str(jax.tree.map(_described, x))
    return type(x).__name__


class Unknown(NamedTuple):
    """The mistake in `of`, the objective or a limit: the name or object that it has instead of an
    output."""

    of: str
    got: str
    subject: str


def unknown_outputs(
    objective: Any, constraints: Sequence[Any] | Limit, outputs: Collection[str]
) -> Iterator[Unknown]:
    """Every named output that does not exist, and every object that is not an objective or limit.

    The objective None means that it is not known yet, and is accepted.
    """
    if objective is None:
        pass
    elif not isinstance(objective, Objective):
        yield Unknown("objective", repr(objective), "It is not an objective, such as Mean(output).")
    else:
        yield from _missing("objective", objective, outputs)
    for k, limit in enumerate(as_constraints(constraints)):
        if not isinstance(limit, Limit):
            message = "It is not a constraint, such as Mean(output) <= level."
            yield Unknown(f"constraints[{k}]", repr(limit), message)
        else:
            yield from _missing(f"constraints[{k}]", limit.measure, outputs)


def _missing(of: str, measure: Objective, outputs: Collection[str]) -> Iterator[Unknown]:
    for name in dict.fromkeys(measure.outputs):
        if name not in outputs:
            yield Unknown(of, repr(name), f"There is no output {name!r}.")


def require(
    notes: Notes, objective: Any, constraints: Sequence[Any] | Limit, outputs: Collection[str]
) -> None:
    """Reports unknown outputs and other mistakes of this kind, and stops if there are any."""
    for unknown in unknown_outputs(objective, constraints, outputs):
        message = (
            unknown.subject
            if unknown.got in unknown.subject
            else f"{unknown.subject[:-1]}: {unknown.got}."
        )
        notes.error(unknown.of, message, f"The outputs are {sorted(outputs)}.")
    notes.stop_on_errors()
