"""The form of a record: all of it that code is compiled for.

A formed record has no numbers of inputs, so traced code cannot read one but as an argument: two
records of equal forms are the same program. Every other number is part of the form (a grid, an
order, a limit, and inputs that a case holds fixed): it is compiled in.
"""

from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Generic, Self, TypeVar

import numpy as np

from snapo.case.given import CaseInput

from ..given import InputUse

Record = TypeVar("Record")


@dataclass(frozen=True)
class Form(Generic[Record]):
    """A formed `record`, compared by all that is in it."""

    record: Record = field(compare=False, repr=False)
    parts: Hashable = field(repr=False)

    @classmethod
    def of(cls, record: Record, held: Collection[str] = ()) -> Self:
        """The form of a record of a case; `held`: names of numbers that are no inputs."""
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
