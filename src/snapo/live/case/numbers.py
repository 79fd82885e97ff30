"""The numbers that were given in a case that was read, by the names of its inputs."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from snapo.case.given import Given
from snapo.problem.inputs import Input


def numbers_of(case: Any) -> dict[str, np.ndarray]:
    """{name: numbers} of everything given in the records of a case, whatever its domain."""
    return dict(_given(case, "", set()))


def _given(record: Any, name: str, seen: set[int]) -> Iterator[tuple[str, np.ndarray]]:
    if id(record) in seen:
        return
    if isinstance(record, Given):
        if record.values.size:
            yield record.name, record.values
    elif isinstance(record, Input):
        yield name, record.value
    elif isinstance(record, Mapping):
        seen.add(id(record))
        for key, each in record.items():
            yield from _given(each, str(key), seen)
    elif isinstance(record, tuple | list):
        seen.add(id(record))
        for each in record:
            yield from _given(each, name, seen)
    elif is_dataclass(record) and not isinstance(record, type):
        seen.add(id(record))
        for field in fields(record):
            yield from _given(getattr(record, field.name, None), field.name, seen)
