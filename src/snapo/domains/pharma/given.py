"""The numbers of a case where they are used, and the form of records without these numbers.

A formed record has no numbers of inputs, so traced code can read them only as arguments: two
records of equal form are the same program. Every other number (a grid, an order, a limit, and
inputs that a case holds fixed) is part of the form and is compiled into the program.
"""

from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Generic, Self, TypeVar

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record.arrays import Array, jnp
from snapo.problem.record.either import in_use, xp

Formed = TypeVar("Formed")


@dataclass(frozen=True, eq=False)
class InputUse:
    """How the numbers of a `CaseInput` are used; `values`: the numbers if they are not an input."""

    name: str
    index: np.ndarray
    values: np.ndarray | None


Entry = tuple[str, int]  # the name of a `CaseInput`, and a position in its values


def every_entry(inputs: Mapping[str, Any]) -> tuple[Entry, ...]:
    """All numbers, in order."""
    return tuple((name, i) for name, value in inputs.items() for i in range(np.size(value)))


def use(inputs: Mapping[str, Any], values: CaseInput | InputUse) -> Array:
    """The numbers for the computation: those of the input, or the fixed ones, at `given.index`."""
    if values.name in inputs:
        value = inputs[values.name]
    elif _held(values).size:
        value = fixed(_held(values))
    else:
        return xp.zeros(values.index.shape)
    # NumPy's integers of 64 bits are no index where JAX counts with 32.
    index = int(values.index) if values.index.ndim == 0 else values.index.astype(np.int32)
    return xp.asarray(value)[index]


def absent(inputs: Mapping[str, Any], values: CaseInput | InputUse) -> bool:
    """Whether a term can be omitted: its factor is zero and not an input."""
    return values.name not in inputs and not _held(values)[values.index].any()


def _held(values: CaseInput | InputUse) -> np.ndarray:
    """The numbers of an entry that is not an input."""
    if values.values is None:
        raise KeyError(f"{values.name} is an input, but its numbers are not in this record.")
    return values.values


def fixed(array: np.ndarray) -> Array:
    """A table as an array of JAX in the precision of the current trace, or as an array of NumPy.

    It is made from a copy, because JAX stores one constant for each NumPy array, in the precision
    of its first use.
    """
    if in_use():
        return np.array(array, float)  # pyright: ignore[reportReturnType]
    return jnp.asarray(np.array(array, jnp.result_type(float)))


@dataclass(frozen=True)
class Form(Generic[Formed]):
    """A formed `record`; two of them are equal if their entire contents are."""

    record: Formed = field(compare=False, repr=False)
    parts: Hashable = field(repr=False)

    @classmethod
    def of(cls, record: Formed, held: Collection[str] = ()) -> Self:
        """The form of a record of a case; `held`: names of numbers that are not inputs."""
        formed = _formed(record, held)
        return cls(formed, _parts(formed))


def _formed(record: Any, held: Collection[str]) -> Any:
    if isinstance(record, CaseInput):
        fixed = record.name in held or not record.values.size
        return InputUse(record.name, record.index, record.values if fixed else None)
    if isinstance(record, tuple):
        return tuple(_formed(item, held) for item in record)
    if is_dataclass(record):
        parts = {entry.name: _formed(getattr(record, entry.name), held) for entry in fields(record)}
        return replace(record, **parts)  # pyright: ignore[reportArgumentType]
    return record


def _parts(item: Any) -> Hashable:
    if isinstance(item, np.ndarray):
        return item.dtype.str, item.shape, item.tobytes()
    if isinstance(item, Mapping):
        return tuple((name, _parts(entry)) for name, entry in item.items())
    if isinstance(item, tuple):
        return tuple(map(_parts, item))
    if is_dataclass(item):
        return type(item), *(_parts(getattr(item, entry.name)) for entry in fields(item))
    # A whole number and a float that are equal are not the same program.
    return type(item), repr(item) if isinstance(item, float) else item
