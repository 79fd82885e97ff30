"""`snapo.check`: tells an author what is wrong with a simulator before it is trained.

From the outside in: what is declared, the schedule, the shapes and types of one step, purity,
a rollout of a few paths under a simple random policy, whether every action and every normal
does something, and every input's adjoint against central bumps with the decisions held.
"""

import re
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.problem import inputs as inputs_
from snapo.problem.actions import Box, Simplex
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Scenarios
from snapo.problem.simulator import Schedule, Simulator, at
from snapo.problem.smooth import Exact, Smooth

from . import bumps as differences
from . import rollout as examine
from .findings import Findings, Notes, Stop


def check(
    simulator: Simulator,
    inputs: PyTree,
    *,
    scenarios: Scenarios | None = None,
    paths: int = 32,
    temperature: float = 0.05,
    seed: int = 0,
) -> Findings:
    """Examines a simulator and its inputs, and returns what to mend; it raises nothing.

    **Arguments:**

    - `scenarios`: standard normals when not given; `Supplied` where noise is something else.
    - `paths`, `temperature`: of the rollouts, whose limits are smooth.
    """
    notes = Notes(simulator)
    try:
        _declared(notes, simulator, inputs)
        schedule = _prepared(notes, simulator, inputs)
        observation = _one_step(notes, simulator, schedule)
        _repeatable(notes, simulator, inputs, schedule)
        run = examine.rolled(
            notes, simulator, schedule, observation, scenarios, paths, Smooth(temperature), seed
        )
        examine.observed(notes, simulator, run)
        moving = examine.used(notes, simulator, run, seed)
        examine.reachable(notes, simulator, run, moving)
        differences.bumped(notes, simulator, inputs, run, seed)
        looked = f"Examined {paths} paths of {simulator.horizon} steps and bumped every input."
    except Stop:
        looked = "Stopped at the first error that hides the rest."
    return notes.finished(looked)


def _declared(notes: Notes, simulator: Simulator, inputs: PyTree) -> None:
    for name, least in (("horizon", 1), ("noise_size", 0), ("initial_noise_size", 0)):
        value = getattr(simulator, name, None)
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
            notes.error(name, f"It is {value!r}.", f"Make it a whole number, at least {least}.")
    if not isinstance(simulator.action, Box | Simplex):
        notes.error(
            "action", f"It is {simulator.action!r}.", "Make it a Box(size) or a Simplex(size)."
        )
    if not inputs_.named(inputs):
        notes.warning(
            "inputs",
            "There is no Input, so there is nothing to differentiate by.",
            "Wrap the numbers whose sensitivity matters: Input(value, unit).",
        )
    notes.stop_on_errors()


def _prepared(notes: Notes, simulator: Simulator, inputs: PyTree) -> Schedule:
    """The schedule: its type, its leading axis, finite and in float64."""
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
        raise Stop
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
                f"Give it a leading axis of {simulator.horizon}, one entry a step; "
                "what holds for the whole horizon belongs in constants.",
            )
    notes.stop_on_errors()
    return schedule


def _one_step(notes: Notes, simulator: Simulator, schedule: Schedule):
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
                ends = jax.eval_shape(simulator.terminal, constants, state, smooth)
            _scalars(notes, "terminal", ends)
            notes.stop_on_errors()
            names.append((set(outputs), set(ends)))
    if names[0] != names[1]:
        differ = sorted((names[0][0] ^ names[1][0]) | (names[0][1] ^ names[1][1]))
        notes.error(
            notes.method("step"),
            f"The outputs {differ} exist only for Exact() or only for Smooth().",
            "Return the same names every time.",
        )
    _declared_outputs(notes, simulator, names[0][0] | names[0][1])
    notes.stop_on_errors()
    return observation


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
                "Keep its shape and type; start a floating number as 0.0, not as 0.",
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
                "Outputs are single real numbers; sum it, or return one output a component.",
            )


def _declared_outputs(notes: Notes, simulator: Simulator, names: set[str]) -> None:
    for name, kind in simulator.totals().items():
        if kind not in ("sum", "max", "last"):
            notes.error(
                "totals", f"{name!r} is totalled by {kind!r}.", 'Say "sum", "max" or "last".'
            )
    for method, declared in (
        ("totals", simulator.totals()),
        ("control_variates", simulator.control_variates()),
    ):
        for name in sorted(set(declared) - names):
            notes.error(
                method, f"There is no output {name!r}.", f"The outputs are {sorted(names)}."
            )


def _repeatable(notes: Notes, simulator: Simulator, inputs: PyTree, schedule: Schedule) -> None:
    """Two traces of every method must be the same program."""
    constants, now = schedule.constants, at(schedule.steps, 0)
    noise: Any = np.full(simulator.noise_size, 0.1)
    action: Any = np.full(simulator.action.size, 0.5)
    initial_noise: Any = np.full(simulator.initial_noise_size, 0.1)

    with jax.enable_x64(True):
        start = jax.jit(lambda: simulator.initial(constants, initial_noise))()
        calls = {
            "prepare": lambda: (
                lambda v: simulator.prepare(inputs_.replace(inputs, v)),
                inputs_.values(inputs),
            ),
            "initial": lambda: (lambda z: simulator.initial(constants, z), initial_noise),
            "observe": lambda: (lambda s: simulator.observe(constants, now, s), start),
            "step": lambda: (
                lambda x: simulator.step(constants, now, x[0], x[1], x[2], Exact()),
                (start, action, noise),
            ),
            "terminal": lambda: (lambda s: simulator.terminal(constants, s, Exact()), start),
        }
        for name, fresh in calls.items():
            with notes.during(name):
                if _program(*fresh()) == _program(*fresh()):
                    continue
                # Programs may differ in print alone; numbers decide.
                (f, x), (g, y) = fresh(), fresh()
                first, second = jax.tree.leaves(jax.jit(f)(x)), jax.tree.leaves(jax.jit(g)(y))
            if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second)):
                notes.error(
                    notes.method(name),
                    "Two calls with the same arguments differ: randomness, a clock or a counter "
                    "in Python.",
                    "Use the noise that step is given, and carry what changes in the state.",
                )
    notes.stop_on_errors()


def _program(function, argument) -> str:
    closed = jax.make_jaxpr(function)(argument)
    constants = [np.asarray(c).tobytes() for c in closed.consts]
    return re.sub(r"0x[0-9a-f]+", "", str(closed.jaxpr)) + repr(constants)


def _described(x) -> str:
    """A shape and type in words."""
    if hasattr(x, "shape") and hasattr(x, "dtype"):
        return f"{x.dtype}{list(x.shape)}"
    if isinstance(x, dict | list | tuple):
        return str(jax.tree.map(_described, x))
    return type(x).__name__
