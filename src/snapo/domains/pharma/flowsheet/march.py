"""The time loops of many batches on the native engine: a lane is a batch, a step one of the mesh.

Everything between the units is algebra, which XLA computes for many batches in parallel. The
expensive part, the steps of a unit, is one kernel, which has the program of a step and the schedule
of all steps. Derivatives are propagated forward with the values; a unit computes only those with
respect to numbers that affect it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core as jex
from jaxtyping import Float

from snapo.engine import Native
from snapo.problem.actions import Box
from snapo.problem.code.version import ProgramText, text
from snapo.problem.policies.rules import Constant
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from ..given import Entry, Form
from ..time.dynamics import Dynamics, Numerics
from ..time.mesh import break_up, edges_of, local_points, steps_per_piece
from ..time.rosenbrock import push, rosenbrock
from ..time.runge_kutta import runge_kutta
from ..time.stiff import limit_of, size_of_error, steps_of
from ..units.operation import Timed, timed
from .case import Flowsheet, PharmaCase
from .flow import flow, problem_of

MarchSchedule = dict[str, np.ndarray]  # of each of T steps


def mesh_march(
    problem: Dynamics, numerics: Numerics, held: Float[np.ndarray, " n+1"] | None
) -> tuple[Callable, MarchSchedule]:
    """A step, (y, the schedule's row) -> y, and the schedule: the steps of `integrate` on a mesh,
    or the `held` steps of a stiff unit."""
    if held is not None:
        return _stiff(problem, numerics, held)
    return _explicit(problem, numerics)


def _explicit(problem: Dynamics, numerics: Numerics) -> tuple[Callable, MarchSchedule]:
    """`piece`: [T] number of the piece; `local`: [T, 3, 3] start, middle and end of the step within
    the piece, for each grading."""
    segments = break_up(edges_of(tuple(profile for profile, _ in problem.controls)), problem.event)
    endpoints = [segments.endpoints(*control) for control in problem.controls]
    seconds = problem.duration * jnp.diff(segments.breaks)

    def advance(y, now):
        k = now["piece"]
        local = segments.grading[k] @ now["local"]
        controls = (first[k] + (last[k] - first[k]) * local for first, last in endpoints)
        return runge_kutta(
            problem.rate, y, seconds[k] * (local[2] - local[0]), problem.drive(*controls)
        )

    count = len(segments.source)
    n = steps_per_piece(numerics.steps, count)
    points = local_points(n)
    start, end = points[:, :-1], points[:, 1:]
    local = np.moveaxis(np.stack([start, (start + end) / 2, end], -1), 1, 0)
    number = np.repeat(np.arange(count, dtype=np.int32), n)
    return advance, {"piece": number, "local": np.tile(local, (count, 1, 1))}


def _stiff(
    problem: Dynamics, numerics: Numerics, held: Float[np.ndarray, " n+1"]
) -> tuple[Callable, MarchSchedule]:
    """`piece`: [T]; `endpoints`: [T, 2] start and end of the step within the piece; `width`: [T] of
    the step, a share of the duration. y is NaN after a refused step."""
    edges = edges_of(tuple(profile for profile, _ in problem.controls))
    segments, steps = break_up(edges, None), steps_of(problem, held)
    endpoints = [segments.endpoints(*control) for control in problem.controls]
    limit = limit_of(numerics.stiff_tolerance)

    def advance(y, now):
        k = now["piece"]
        start, end = (
            [first[k] + (last[k] - first[k]) * now["ends"][i] for first, last in endpoints]
            for i in range(2)
        )
        drive = push(problem.drive, start, end)
        after, error, _ = rosenbrock(
            problem.rate, y, problem.duration * now["width"], drive, scanned=False
        )
        return jnp.where(size_of_error(error, y, after) <= limit, after, jnp.nan)

    first, last, number = (np.asarray(step) for step in steps)
    left, width = edges[number], np.diff(edges)[number]
    local = np.stack([(item - left) / width for item in (first, last)], 1)
    return advance, {"piece": number, "ends": local, "width": last - first}


ENGINE = Native("float64", threads=1)  # threads work on chunks of batches

# The same for all batches, or not, or with derivatives.
BatchKind = Literal["shared", "drawn", "moving"]


@dataclass(frozen=True)
class StepProgram:
    """A traced step whose numbers are arguments: steps with the same text compute the same
    function."""

    text: ProgramText
    function: Callable = field(compare=False, repr=False)

    def __call__(self, y, now, *numbers):
        return self.function(y, now, *numbers)


class March(Simulator):
    """A unit's steps for one batch, from a supplied state.

    State: `y` [m]; `drawn` and `moving`, numbers of these kinds that the steps read; `dy` [C, m]
    and `d_moving`, derivatives with respect to C numbers. `shared` are the constants.
    """

    horizon: int = eqx.field(static=True)
    advance: StepProgram = eqx.field(static=True)
    kinds: tuple[BatchKind, ...] = eqx.field(static=True)
    action = Box(-np.inf, np.inf)
    noise_size = 0

    def prepare(self, inputs) -> Schedule:
        raise NotImplementedError("A march already has its schedule.")

    def initial(self, constants, noise):
        raise NotImplementedError("A march needs a supplied initial state.")

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def step(self, constants, now, state, action, noise, smooth):
        def after(y, moving):
            held = {"shared": constants, "drawn": state["drawn"], "moving": moving}
            held = {kind: iter(numbers) for kind, numbers in held.items()}
            return self.advance(y, now, *(next(held[kind]) for kind in self.kinds))

        if not len(state["dy"]):
            return state | {"y": after(state["y"], state["moving"])}, {}
        y, push = jax.linearize(after, state["y"], state["moving"])
        return state | {"y": y, "dy": jax.vmap(push)(state["dy"], state["d_moving"])}, {}


class _Leg(NamedTuple):
    """One unit: its `march`, the march's `steps`, the sensitivities that reach it (`columns`), the
    size of its y, and `enter(draws, ends, d_ends, inputs)`, the shared constants and the state
    before the first step."""

    march: March
    steps: dict[str, np.ndarray]
    columns: np.ndarray
    size: int
    enter: Callable


class Batches(Protocol):
    """The interface that `Marches` needs of a process, which is a
    `flowsheet.process.PharmaProcess`."""

    @property
    def case(self) -> PharmaCase: ...

    @property
    def form(self) -> Form[Flowsheet]: ...

    def nominal_inputs(self) -> dict[str, Any]: ...

    def shifted(self, changes: Any, entries: Sequence[Entry], inputs: Any) -> dict: ...

    def of_measures(self, measures: dict[str, Any]) -> Any: ...


class Marches:
    """Attributes of many batches on the mesh, and their derivatives with respect to `by`, at draws
    of `entries`.

    Raises `engine.Unsupported`, when called, if the native engine cannot run a unit.
    """

    def __init__(self, process: Batches, entries: Sequence[Entry], by: Sequence[Entry]):
        self.process, self.entries, self.by = process, tuple(entries), tuple(by)
        self.legs: dict[str, _Leg] = {}
        with jax.enable_x64(True):
            for unit in timed(process.form.record.units):
                self.legs[unit.name] = self._leg(unit)
        self.leave = jax.jit(jax.vmap(self._leave, in_axes=(0, 0, 0, None)))

    def __call__(
        self, draws: Float[np.ndarray, "N E"], inputs: dict[str, np.ndarray]
    ) -> tuple[Float[np.ndarray, "N Q"], Float[np.ndarray, "N Q P"]]:
        """The attributes, and their derivatives with respect to `by`."""
        endpoints: dict[str, np.ndarray] = {}
        d_ends: dict[str, np.ndarray] = {}
        for name, leg in self.legs.items():
            with jax.enable_x64(True):
                shared, state = leg.enter(draws, endpoints, d_ends, inputs)
            schedule, policy = Schedule(shared, leg.steps), Constant(np.zeros(1))
            noise = Pseudo(0).draws(np.arange(len(draws)), leg.march)
            engine = ENGINE.values(leg.march, policy, schedule, noise, Exact(), start=state)
            endpoints[name] = engine.state["y"]
            d_ends[name] = np.zeros((len(draws), len(self.by), leg.size))
            d_ends[name][:, leg.columns] = engine.state["dy"]
        with jax.enable_x64(True):
            values, jacobian = self.leave(draws, endpoints, d_ends, inputs)
            return np.asarray(values), np.asarray(jacobian)

    def _given(self, numbers, draw, inputs):
        """The inputs of one batch, with `numbers` at the positions of `by`."""
        shifted = self.process.shifted
        return shifted(numbers, self.by, shifted(draw, self.entries, inputs))

    def _numbers(self, draw, inputs) -> list:
        """The values at the positions of `by` in one batch."""
        drawn = self.process.shifted(draw, self.entries, inputs)
        return [drawn[name][position] for name, position in self.by]

    def _leave(self, draw, endpoints, d_ends, inputs):
        def attributes(numbers, bounds):
            moved = self._given(numbers, draw, inputs)
            result = flow(self.process.form.record, moved, endpoints=bounds)
            return self.process.of_measures(result.measures)

        every = np.arange(len(self.by))
        values, rows = _pushed(attributes, every, self._numbers(draw, inputs), endpoints, d_ends)
        return values, rows.T

    def _leg(self, unit: Timed) -> _Leg:
        """The unit's leg, after the legs of the units before it were made."""
        made = {}

        def start(numbers, draw, endpoints, inputs):
            """y, and all numbers that a step reads."""
            problem = problem_of(
                self.process.form.record, unit, self._given(numbers, draw, inputs), endpoints
            )
            numerics = self.process.case.numerics
            advance, made["steps"] = mesh_march(problem, numerics, numerics.held.get(unit.name))
            now = {name: jnp.asarray(step[0]) for name, step in made["steps"].items()}
            advance, held = jax.closure_convert(advance, problem.start, now)
            if "advance" not in made:  # this runs again in every program of the leg
                version = text(advance, problem.start, now, *held)
                made["advance"] = StepProgram(version, advance)
            return [problem.start, *held]

        shapes, reached = self._reached(start)
        columns = np.flatnonzero([any(row) for row in np.transpose(reached)[:-1]])
        kinds: tuple[BatchKind, ...] = tuple(_kind(row) for row in reached[1:])
        steps = made["steps"]
        march = March(  # pyright: ignore[reportCallIssue]
            horizon=len(steps["piece"]), advance=made["advance"], kinds=kinds
        )
        return _Leg(march, steps, columns, shapes[0].shape[0], self._enter(start, kinds, columns))

    def _reached(self, start: Callable):
        """The outputs of `start`, and for each [P + 1] whether it depends on each of `by`, and
        whether on the draw."""
        count, inputs = len(self.by), self.process.nominal_inputs()
        numbers, draw = [np.float64(0)] * count, np.zeros(len(self.entries))
        endpoints = {name: np.zeros(leg.size) for name, leg in self.legs.items()}
        closed, shapes = jax.make_jaxpr(start, return_shape=True)(numbers, draw, endpoints, inputs)
        item = np.eye(count + 1, dtype=bool)
        marks = (
            list(item[:count]),
            item[count],
            {name: item[[*leg.columns, count]].any(0) for name, leg in self.legs.items()},
            {name: np.zeros_like(item[count]) for name in inputs},
        )
        return shapes, spread(closed.jaxpr, jax.tree.leaves(marks))

    def _enter(
        self, start: Callable, kinds: tuple[BatchKind, ...], columns: np.ndarray
    ) -> Callable:
        def of(kind: BatchKind, held: list) -> list:
            return [item for item, local in zip(held, kinds) if local == kind]

        def one(draw, endpoints, d_ends, inputs):
            def moving(numbers, bounds):
                y, *held = start(numbers, draw, bounds, inputs)
                return (y, of("moving", held)), held

            (y, moved), (dy, d_moved), held = _pushed(
                moving, columns, self._numbers(draw, inputs), endpoints, d_ends, has_aux=True
            )
            state = {"y": y, "dy": dy, "moving": moved, "d_moving": d_moved}
            return of("shared", held), state | {"drawn": of("drawn", held)}

        return jax.jit(jax.vmap(one, in_axes=(0, 0, 0, None), out_axes=(None, 0)))


def _kind(reached) -> BatchKind:
    *columns, drawn = reached
    return "moving" if any(columns) else "drawn" if drawn else "shared"


def _pushed(function, columns: np.ndarray, numbers: list, endpoints: dict, d_ends: dict, **aux):
    """A function of numbers and of the ends, and its derivatives [C, ...] by some `columns` of the
    numbers, through the ends as well."""
    value, push, *rest = jax.linearize(function, numbers, endpoints, **aux)
    if not len(columns):
        nothing = jax.tree.map(lambda item: jnp.zeros((0, *item.shape)), value)
        return value, nothing, *rest
    eye = np.eye(len(numbers))[columns]
    local = [eye[:, k] for k in range(len(numbers))]
    through = {name: d_end[columns] for name, d_end in d_ends.items()}
    return value, jax.vmap(push)(local, through), *rest


def spread(jaxpr: Any, marks: Sequence) -> list[np.ndarray]:
    """For each output, the marks of all arguments on which it depends."""
    available, none = dict(zip(jaxpr.invars, marks)), np.zeros_like(marks[0])

    def of(variables) -> np.ndarray:
        results = [
            available[v] for v in variables if not isinstance(v, jex.Literal) and v in available
        ]
        return np.any([none, *results], 0)

    for equation in jaxpr.eqns:
        available.update(dict.fromkeys(equation.outvars, of(equation.invars)))
    return [of([v]) for v in jaxpr.outvars]
