"""A method's program evaluated equation by equation, with records of comparisons and indices.

Calls are traced inside; loops, `lax.cond` and functions with a custom derivative run as a unit.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np
from jax.lax import GatherScatterMode
from jaxtyping import Array, PyTree

from snapo.lanes import jax_private
from snapo.problem.simulator import Simulator
from snapo.problem.smooth import Smooth

from .methods import CodeLine, Method, line_of, methods, preparation, said_by_user
from .rollout import CheckedRollout

COMPARISONS = ("lt", "gt", "le", "ge")
_CALLS = ("jit", "pjit", "closed_call", "core_call", "checkpoint", "remat", "remat2")
NONE = -1  # no site is changed
# Of a number in a program: known in tracing, computed from its arguments, or from tainted ones.
KNOWN, GIVEN, TAINTED = range(3)


class CodeSite(NamedTuple):
    """An equation that is watched: its primitive, its line, and the length and the slice size of
    every axis that it indexes."""

    kind: str
    line: CodeLine | None
    ranges: tuple[tuple[int, int], ...] = ()

    @property
    def writes(self) -> bool:
        return self.kind.startswith("scatter") or self.kind == "dynamic_update_slice"


class Observed(NamedTuple):
    """What was recorded in one call: its results, the truth of every comparison, and for every
    read the first index that is out of range (0 if none is), its axis, and whether there is such
    an index."""

    results: list[Any]
    truths: list[Any]
    outside: list[tuple[Any, Any, Any]]


class Change(NamedTuple):
    """A change at one site: the results of a comparison are replaced by `truths`, or a read out of
    range is moved by `shift` times its size plus one. `comparison` and `read` are the numbers of
    the sites, or `NONE`."""

    comparison: Any
    truths: Any
    read: Any
    shift: Any


class Watched:
    """A program whose floating-point comparisons and indexed reads are recorded and can be changed.

    `tainted`: for each argument, whether it depends on decisions or inputs: only comparisons of
    such numbers are sites.
    """

    def __init__(self, closed, tainted: Sequence[bool]):
        self.closed, self.tainted = closed, tainted
        self.comparisons: list[CodeSite] = []
        self.reads: list[CodeSite] = []
        self.shapes = jax.eval_shape(self._unchanged, *closed.in_avals)

    def _unchanged(self, *arguments) -> Observed:
        return self(arguments, None)

    def nothing(self, many: int) -> Change:
        """A change of no site, for this number of points."""
        truths = [np.zeros((many, *x.shape), bool) for x in self.shapes.truths]
        return Change(np.int32(NONE), truths, np.int32(NONE), np.float64(0))

    def __call__(self, arguments: Sequence[Any], change: Change | None) -> Observed:
        walk = _Walk(change)
        marks = [TAINTED if item else GIVEN for item in self.tainted]
        results, _ = walk.run(self.closed.jaxpr, self.closed.consts, arguments, marks, None)
        self.comparisons, self.reads = walk.comparisons, walk.reads
        return Observed(results, walk.truths, walk.outside)


class _Walk:
    """One evaluation of a program."""

    def __init__(self, change: Change | None):
        self.change = change
        self.comparisons: list[CodeSite] = []
        self.reads: list[CodeSite] = []
        self.truths: list[Array] = []
        self.outside: list[tuple[Array, Array, Array]] = []

    def run(self, jaxpr, consts, arguments, given_marks, caller: CodeLine | None):
        """The results of a program, and whether each result is tainted."""
        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *arguments]))
        marks = dict(zip(jaxpr.invars, given_marks))

        def read(atom):
            return atom.val if isinstance(atom, jex.Literal) else values[atom]

        def marked(atom):
            return KNOWN if isinstance(atom, jex.Literal) else marks.get(atom, KNOWN)

        for eqn in jaxpr.eqns:
            inputs, dirty = [read(x) for x in eqn.invars], [marked(x) for x in eqn.invars]
            line = line_of(eqn) or caller
            if eqn.primitive.name in _CALLS and (inner := _program(eqn)) is not None:
                result, dirty = self.run(inner.jaxpr, inner.consts, inputs, dirty, line)
            else:
                result = jax_private.apply(eqn, inputs, eqn.source_info.traceback)
                result = self._watched(eqn, inputs, result, line, dirty)
                dirty = [max(dirty, default=KNOWN)] * len(result)
            values.update(zip(eqn.outvars, result))
            marks.update(zip(eqn.outvars, dirty))
        return [read(x) for x in jaxpr.outvars], [marked(x) for x in jaxpr.outvars]

    def _watched(self, eqn, values, results, line, dirty: list[int]):
        """An equation's results, with the change of its site."""
        kind = eqn.primitive.name
        if (
            kind in COMPARISONS
            and TAINTED in dirty
            and jnp.issubdtype(values[0].dtype, jnp.floating)
        ):
            number = len(self.comparisons)
            self.comparisons.append(CodeSite(kind, line))
            if self.change is not None:
                here = self.change.comparison == number
                results = [jnp.where(here, self.change.truths[number], results[0])]
            self.truths.append(results[0])
        elif (indices := _indices(eqn, values, dirty)) is not None and not said_by_user(eqn):
            index, ranges = indices
            number = len(self.reads)
            self.reads.append(CodeSite(kind, line, tuple(ranges)))
            self.outside.append(_first_outside(index, ranges))
            if self.change is not None and not self.reads[-1].writes:
                here = (self.change.read == number) & self.outside[-1][2]
                results = [jnp.where(here, _shifted(results[0], self.change.shift), results[0])]
        return results


def _program(eqn) -> Any:
    inner = jax_private.called(eqn)
    if inner is None or isinstance(inner, jex.ClosedJaxpr):
        return inner
    return None if inner.constvars else jex.ClosedJaxpr(inner, ())


def _shifted(x: Array, shift: Any) -> Array:
    if jnp.issubdtype(x.dtype, jnp.bool_):
        return ~x
    return x + (shift * (1 + abs(x))).astype(x.dtype)


def _indices(eqn, values, dirty: list[int]) -> tuple[Array, list[tuple[int, int]]] | None:
    """The indices [..., axes] of a read or write, and (length, size of a part) of each axis.

    None if they are known when the method is traced, or if the program itself defines reads
    outside: `mode="clip"` or "fill".
    """
    kind, params = eqn.primitive.name, eqn.params
    first = 2 if kind == "dynamic_update_slice" else 1
    if kind in ("dynamic_slice", "dynamic_update_slice"):
        if not any(dirty[first:]):
            return None
        sizes = params["slice_sizes"] if first == 1 else values[1].shape
        starts = jnp.stack([jnp.asarray(x, int) for x in values[first:]], -1)
        return starts, list(zip(values[0].shape, sizes))
    if kind.startswith(("gather", "scatter")) and dirty[1] != KNOWN:
        shape, numbers = values[0].shape, params["dimension_numbers"]
        if kind != "gather" and params["mode"] != GatherScatterMode.CLIP:
            return values[1], [(shape[a], 1) for a in numbers.scatter_dims_to_operand_dims]
        if params["mode"] == GatherScatterMode.PROMISE_IN_BOUNDS:
            sizes = params["slice_sizes"]
            return values[1], [(shape[a], sizes[a]) for a in numbers.start_index_map]
    return None


def _first_outside(index: Array, ranges: list[tuple[int, int]]) -> tuple[Array, Array, Array]:
    """The first index outside of its range, its axis, and whether there is one."""
    if not ranges or not index.size:
        return jnp.int32(0), jnp.int32(0), jnp.bool_(False)
    last = np.array([length - size for length, size in ranges])
    flat = jnp.reshape(index, (-1, len(ranges)))
    outside = jnp.ravel((flat < 0) | (flat > last))
    first = jnp.argmax(outside)
    return jnp.ravel(flat)[first], first % len(ranges), outside[first]


def tainted_by(function: Callable[..., Any], *arguments) -> list[bool]:
    """Whether each result of a function depends on its arguments."""
    closed = jax.make_jaxpr(function)(*arguments)
    return tainted_results(closed.jaxpr, [True] * len(closed.jaxpr.invars))


def tainted_results(jaxpr, tainted: Sequence[bool]) -> list[bool]:
    """Whether each result of a program depends on its tainted arguments."""
    marks = dict(zip(jaxpr.invars, tainted))

    def marked(atom):
        return not isinstance(atom, jex.Literal) and marks.get(atom, False)

    for eqn in jaxpr.eqns:
        dirty = [marked(x) for x in eqn.invars]
        inner = _program(eqn) if eqn.primitive.name in _CALLS else None
        if inner is None:
            count = [any(dirty)] * len(eqn.outvars)
        else:
            count = tainted_results(inner.jaxpr, dirty)
        marks.update(zip(eqn.outvars, count))
    return [marked(x) for x in jaxpr.outvars]


POINTS, PATHS, STEPS = 2048, 8, 256  # at most; paths of each run


class SamplePoints:
    """A method's program, and its arguments at [steps * paths] points in the order of the steps.

    - `moving`: for each argument, whether it differs between points.
    - `steps`: the number of steps from which the points come.
    """

    def __init__(
        self,
        method: Method,
        recorded: dict[str, Any],
        steps: int,
        tainted: dict[str, list[bool]] | None = None,
    ):
        self.method, self.steps = method, steps
        self.arguments: list[Any] = []
        self.moving: list[bool] = []
        dirty: list[bool] = []
        for name, tree in method.arguments.items():
            leaves = jax.tree.leaves(recorded.get(name, tree))
            self.arguments += leaves
            self.moving += [name in recorded] * len(leaves)
            dirty += (tainted or {}).get(name, [name in ("state", "action")] * len(leaves))
        self.recorder = Watched(method.traced(), dirty)
        axes = tuple(0 if moves else None for moves in self.moving)
        changed = Change(None, 0, None, None)  # pyright: ignore[reportArgumentType]
        self.compiled = jax.jit(jax.vmap(self.recorder, (axes, changed)))

    @cached_property
    def met(self) -> Observed:
        """The observed numbers at all points."""
        return self.observe(self.arguments)

    def observe(self, arguments: Sequence[Any], change: Change | None = None) -> Observed:
        """The observed numbers at these arguments; the truths of a change have an entry per
        point."""
        if change is None:
            many = next(len(x) for x, moves in zip(arguments, self.moving) if moves)
            change = self.recorder.nothing(many)
        return jax.tree.map(np.asarray, self.compiled(tuple(arguments), change))

    def some(self, which: np.ndarray) -> list[Any]:
        """The arguments of some of the points."""
        return [x[which] if moves else x for x, moves in zip(self.arguments, self.moving)]


def moments(
    simulator: Simulator, inputs: PyTree, runs: Sequence[CheckedRollout]
) -> Iterator[SamplePoints]:
    """Every method at the inputs and at moments of the runs.

    The points are NumPy arrays: with JAX arrays, each selection would be compiled for each
    simulator.
    """
    run, times = runs[0], _times(simulator.horizon)
    paths = min(PATHS, run.draws.size, max(2, POINTS // (len(runs) * len(times))))
    made = preparation(simulator, inputs)
    alone = jax.tree.map(lambda x: np.asarray(x)[None], made.arguments)
    yield SamplePoints(made, alone, 1)

    smooth = Smooth(jnp.asarray(run.smooth.temperature, float))
    initial, observe, step, terminal = methods(simulator, run.schedule, smooth)
    yield SamplePoints(initial, {"noise": np.asarray(run.draws.initial_noise)[:paths]}, 1)

    by_inputs = _tainted(made, run.schedule)
    recorded = {
        "state": _joined([item.states for item in runs], times, paths),
        "action": _joined([entry.actions for entry in runs], times, paths),
        "noise": _joined([value.draws.step_noise for value in runs], times, paths),
        "now": jax.tree.map(
            lambda x: np.repeat(np.asarray(x)[times], len(runs) * paths, 0), run.schedule.steps
        ),
    }
    yield SamplePoints(observe, {name: recorded[name] for name in ("now", "state")}, len(times))
    stepped = SamplePoints(step, recorded, len(times), by_inputs)
    yield stepped
    # The state after the last step is not recorded: it is made again.
    last = np.arange((len(times) - 1) * len(runs) * paths, len(times) * len(runs) * paths)
    leaves, tree = jax.tree.flatten(step.arguments["state"])
    after = stepped.observe(stepped.some(last)).results
    final_states = jax.tree.unflatten(tree, [after[k] for k in range(len(leaves))])
    yield SamplePoints(terminal, {"state": final_states}, 1, by_inputs)


def _tainted(made: Method, schedule: Any) -> dict[str, list[bool]]:
    """For the leaves of `constants` and `now`, whether inputs move them."""
    result = iter(tainted_by(made.function, *made.arguments.values()))
    parts = (("constants", schedule.constants), ("now", schedule.steps))
    return {name: [next(result) for _ in jax.tree.leaves(tree)] for name, tree in parts}


def _times(horizon: int) -> np.ndarray:
    """All steps, or some of many, the first and the last among them."""
    return np.unique(np.linspace(0, horizon - 1, min(horizon, STEPS)).astype(int))


def _joined(trees: Sequence[Any], times: np.ndarray, paths: int) -> Any:
    """Recorded arrays [T, paths, ...] of the runs as one [times * runs * paths, ...]."""

    def joined(*leaves):
        taken = np.concatenate([np.asarray(x)[times][:, :paths] for x in leaves], 1)
        steps, many, *rest = taken.shape  # without noise the last is 0
        return taken.reshape(steps * many, *rest)

    return jax.tree.map(joined, *trees)
