"""Arrays put together from parts, and slices of them that read the parts themselves.

An observation is one array of many numbers, and a policy may read few of them. Where its slices
read the parts, nothing computes the others, and no derivative goes through them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

ADDS_AXES = {"broadcast_in_dim", "expand_dims", "reshape"}
REMOVES_AXES = {"squeeze", "reshape"}


@dataclass(frozen=True)
class Parts:
    """An array as its parts along an axis; `stacked`: they are rows without that axis.

    The array itself is here too: its identity is a key, which no later array may have.
    """

    array: Any
    parts: Sequence[Any]
    axis: int = 0
    stacked: bool = False

    def lengths(self) -> list[int]:
        """Of the parts along the axis."""
        return [1 if self.stacked else jnp.shape(part)[self.axis] for part in self.parts]


class Assembled:
    """The arrays that one trace has put together or given further axes."""

    def __init__(self):
        self._parts: dict[int, Parts] = {}
        self._sources: dict[int, tuple[Any, Any]] = {}

    def result(self, eqn, inputs: list[Any]) -> Any:
        """The result of an equation that reads an assembled array; None where it is applied."""
        name, params = eqn.primitive.name, eqn.params
        if name == "slice" and (parts := self._parts.get(id(inputs[0]))) is not None:
            return self._sliced(parts, params)
        if name in REMOVES_AXES and id(inputs[0]) in self._sources:
            source = self._sources[id(inputs[0])][1]
            return source if jnp.shape(source) == eqn.outvars[0].aval.shape else None
        return None

    def add(self, eqn, inputs: list[Any], outputs: list[Any]) -> None:
        """Notes an equation that was applied, if it assembles an array."""
        name, params = eqn.primitive.name, eqn.params
        if name == "concatenate":
            self._assembled(Parts(outputs[0], inputs, params["dimension"]))
        elif name == "stack" and params["axis"] == 0:
            self._assembled(Parts(outputs[0], inputs, stacked=True))
        elif name in ADDS_AXES and jnp.size(inputs[0]) == jnp.size(outputs[0]):
            self._sources[id(outputs[0])] = outputs[0], inputs[0]

    def _assembled(self, parts: Parts) -> Any:
        self._parts[id(parts.array)] = parts
        return parts.array

    def _sliced(self, whole: Parts, params) -> Any:
        """A slice along the axis of the parts; None of other ones, of all and of nothing."""
        starts, limits, axis = params["start_indices"], params["limit_indices"], whole.axis
        shape = jnp.shape(whole.array)
        across = [i for i in range(len(shape)) if i != axis]
        partial = any((starts[i], limits[i]) != (0, shape[i]) for i in across)
        stepped = any(stride != 1 for stride in params["strides"] or ())
        if stepped or partial or limits[axis] - starts[axis] in (0, shape[axis]):
            return None
        return self._between(whole, starts[axis], limits[axis])

    def _between(self, whole: Parts, start: int, limit: int) -> Any:
        """The positions from `start` to before `limit`."""
        selected, offset = [], 0
        for part, length in zip(whole.parts, whole.lengths()):
            first, last = max(start - offset, 0), min(limit - offset, length)
            if first < last:
                selected.append(self._part(whole, part, first, last, length))
            offset += length
        if len(selected) == 1:
            return selected[0]
        joined = jax.lax.concatenate(selected, whole.axis)
        return self._assembled(Parts(joined, selected, whole.axis))

    def _part(self, whole: Parts, part: Any, first: int, last: int, length: int) -> Any:
        """Positions of one part, with the axis."""
        if whole.stacked:
            row = jax.lax.expand_dims(part, (0,))
            self._sources[id(row)] = row, part
            return row
        if last - first == length:
            return part
        if (inner := self._parts.get(id(part))) is not None and inner.axis == whole.axis:
            return self._between(inner, first, last)
        return jax.lax.slice_in_dim(part, first, last, axis=whole.axis)
