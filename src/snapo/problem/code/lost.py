"""Inputs whose derivative is lost: outputs depend on them only through operations with slope zero.

Rounding and comparisons have a derivative of zero: the derivative of `floor(size * uniform)` with
respect to `size` is 0 on every path, but the derivative of its mean is not. If the input has
another way to the output, as in `x - floor(x)`, nothing is reported here.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.lanes import jax_private

from .. import inputs as inputs_
from ..simulator import Simulator
from ..smooth import Exact, Smooth
from .version import read_context

ROUNDING = ("floor", "ceil", "round", "sign", "nextafter")
COMPARING = ("lt", "gt", "le", "ge", "eq", "ne")


class Reach(NamedTuple):
    """The reach of a number: the inputs that move it and those with respect to which it has a
    slope, as sets of bits, and whether it differs between paths."""

    bumped: int = 0
    slope: int = 0
    by_path: bool = False

    def __or__(self, other: Any) -> "Reach":
        moved, slope = self.bumped | other.bumped, self.slope | other.slope
        return Reach(moved, slope, self.by_path or other.by_path)


DRAWN = Reach(by_path=True)


def lost(simulator: Simulator, inputs: PyTree) -> dict[str, list[Any]]:
    """The inputs that move an exact or smooth output but have no derivative, by name, each with
    the equations at which the derivative is lost.

    Decisions are held fixed: for an input that affects only decisions, a derivative of zero is
    correct. Operands of `jax.lax.stop_gradient` are left out, since the author of the code wants no
    derivative there.
    """
    names = [entry.name for entry in inputs_.named_inputs(inputs)]
    values = inputs_.values(inputs)
    if len(names) != len(values):
        return {}
    total, cuts = Reach(), []
    for smooth in (Exact(), Smooth(0.1)):
        with jax.enable_x64(True), read_context(object()):
            total |= _reach(simulator, inputs, values, smooth, cuts)
    cut = total.bumped & ~total.slope
    return {
        name: [eqn for eqn, inputs in cuts if inputs >> i & 1]
        for i, name in enumerate(names)
        if cut >> i & 1
    }


def _reach(
    simulator: Simulator, inputs: PyTree, values: list, smooth: Any, cuts: list[tuple[Any, int]]
) -> Reach:
    """The numbers on which all outputs of a path depend; `cuts` collects the equations at which
    derivatives end."""

    def first(values, noise):
        schedule = simulator.prepare(inputs_.replace(inputs, values))
        schedule = jax.tree.map(jnp.asarray, schedule)
        now = jax.tree.map(lambda leaf: leaf[0], schedule.steps)
        return schedule.constants, now, simulator.initial(schedule.constants, noise)

    def step(params, action, noise):
        constants, now, state = params
        after, outputs = simulator.step(constants, now, state, action, noise, smooth)
        after = jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), after, state)
        return after, outputs, simulator.terminal(constants, after, smooth)

    sizes = simulator.initial_noise_size, simulator.action.size, simulator.noise_size
    initial, *other = map(np.zeros, sizes)  # NumPy's: nothing is compiled for them
    started, shapes = jax.make_jaxpr(first, return_shape=True)(values, initial)
    stepped, endpoints = jax.make_jaxpr(step, return_shape=True)(shapes, *other)
    # One bit for each input; after them come the noise, and the action.
    marks = [Reach(1 << i, 1 << i) for i in range(len(values))]
    available = _results(started.jaxpr, [*marks, DRAWN], cuts)
    states, rest = len(jax.tree.leaves(endpoints[0])), [DRAWN] * len(other)
    while True:
        made = _results(stepped.jaxpr, [*available, *rest], cuts)
        after = [a | b for a, b in zip(available[len(available) - states :], made)]
        if after == available[len(available) - states :]:
            return _union(made[states:])
        available = [*available[: len(available) - states], *after]


def _results(
    jaxpr: Any, reaches: Sequence[Reach], cuts: list[tuple[Any, int]] | None = None
) -> list[Reach]:
    """What every result of a program depends on."""
    reach = dict(zip(jaxpr.invars, reaches))

    def of(atom: Any) -> Reach:
        return Reach() if isinstance(atom, jex.Literal) else reach.get(atom, Reach())

    for eqn in jaxpr.eqns:
        before = [of(x) for x in eqn.invars]
        after = _through(eqn, before)
        reach.update(zip(eqn.outvars, after))
        ended = _union(before).slope & _union(after).bumped & ~_union(after).slope
        if ended and cuts is not None:
            cuts.append((eqn, ended))
    return [of(x) for x in jaxpr.outvars]


def _through(eqn: Any, reaches: list[Reach]) -> list[Reach]:
    """What an equation's results depend on."""
    name, params = eqn.primitive.name, eqn.params
    by_hand = name.startswith("custom_")  # it has a hand-written derivative, for any content
    inner = None if by_hand else jax_private.called(eqn)
    if inner is not None:
        return _results(getattr(inner, "jaxpr", inner), reaches)
    if name == "cond":
        selected, *arguments = reaches
        ways = [_results(branch.jaxpr, arguments) for branch in params["branches"]]
        switched = selected._replace(slope=0)
        return [_union([*path, switched]) for path in zip(*ways)]
    if name == "scan":
        return _rounds(params, reaches)
    if name == "stop_gradient":
        return [Reach()] * len(eqn.outvars)
    both = _union(reaches)
    if name in COMPARING and not both.by_path:
        return [Reach()]  # a switch, which a small move of an input does not turn
    slope = _union([item for item, x in zip(reaches, eqn.invars) if _is_real(x)]).slope
    return [
        both._replace(slope=slope * (_is_real(x) and name not in ROUNDING)) for x in eqn.outvars
    ]


def _rounds(params: Any, reaches: list[Reach]) -> list[Reach]:
    """The rounds of a scan: its body, repeated until the carry depends on no further input."""
    fixed, carried = jax_private.arguments_of_scan(params)
    while True:
        made = _results(params["jaxpr"].jaxpr, reaches)
        after = [a | b for a, b in zip(reaches[fixed : fixed + carried], made)]
        if after == reaches[fixed : fixed + carried]:
            return made
        reaches = [*reaches[:fixed], *after, *reaches[fixed + carried :]]


def _is_real(variable: Any) -> bool:
    return bool(jnp.issubdtype(variable.aval.dtype, jnp.inexact))


def _union(several: Sequence[Reach]) -> Reach:
    total = Reach()
    for item in several:
        total |= item
    return total
