"""Slices that ask for more than there is: as in NumPy they come out shorter, without a word.

`noise[1:4]` of two normals is one entry, which then spreads over a longer vector. JAX resolves a
slice while Python runs and leaves no trace of the question in a program, so that it is asked of
JAX's arrays as a method is traced.
"""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from snapo.problem.simulator import Schedule, Simulator

from ..findings import Notes
from ..program.methods import CodeLine, line_among, methods, preparation


class Short(NamedTuple):
    """A slice, the length of the axis that it is taken of, and its line."""

    requested: str
    length: int
    line: CodeLine


def short_slices(notes: Notes, simulator: Simulator, inputs: PyTree, schedule: Schedule) -> None:
    """Every slice of every method asks for entries that there are."""
    with jax.enable_x64(True):
        for method in (preparation(simulator, inputs), *methods(simulator, schedule)):
            with notes.during(method.name), _asked() as result:
                method.traced()
            for item in dict.fromkeys(result):
                notes.warning(
                    f"{method.name}, {item.line}",
                    f"The slice [{item.requested}] is taken of {item.length} entries: it is "
                    f"shorter than it says, without an error. In: {item.line.text}",
                    "Correct the slice, or the size that is declared.",
                )


@contextmanager
def _asked() -> Iterator[list[Short]]:
    """The slices past an end that this thread's code takes of traced arrays."""
    shorts: list[Short] = []
    mine, before = threading.get_ident(), Tracer.__getitem__

    def getitem(self, index):
        if threading.get_ident() == mine and (line := _users_line(sys._getframe(1))):
            shorts.extend(Short(*item, line) for item in _past(index, self.shape))
        return before(self, index)

    Tracer.__getitem__ = getitem
    try:
        yield shorts
    finally:
        Tracer.__getitem__ = before


def _users_line(frame: Any) -> CodeLine | None:
    """The line of a user's code that takes a slice itself; none in libraries and in snapo."""
    line = line_among([(frame.f_code.co_filename, frame.f_lineno)])
    return None if line is None or line.user_code else line


def _past(index: Any, shape: tuple[int, ...]) -> Iterator[tuple[str, int]]:
    """(slice, length) of the parts of an index that reach past the end of their axis."""
    parts = index if isinstance(index, tuple) else (index,)
    if any(np.dtype(getattr(part, "dtype", int)).kind == "b" for part in parts):
        return  # a mask takes as many axes as it has
    taken = sum(part is not None and part is not Ellipsis for part in parts)
    axis = 0
    for part in parts:
        if part is Ellipsis:
            axis += len(shape) - taken
        elif part is not None:
            if isinstance(part, slice) and axis < len(shape) and outside(part, shape[axis]):
                yield _written(part), shape[axis]
            axis += 1


def outside(part: slice, length: int) -> bool:
    """Whether an end that a slice names lies outside of an axis."""
    endpoints = [end for end in (part.start, part.stop) if isinstance(end, int | np.integer)]
    backwards = isinstance(part.step, int) and part.step < 0
    # Backwards, [n::-1] starts at an entry, and [:-n - 1:-1] says how far to go.
    low = -length - 1 if backwards else -length
    return any(not low <= end <= length for end in endpoints)


def _written(part: slice) -> str:
    start, stop = ("" if end is None else end for end in (part.start, part.stop))
    return f"{start}:{stop}" if part.step is None else f"{start}:{stop}:{part.step}"
