"""Whether two cases are one program, so that code compiled for one serves the other."""

from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from snapo.case.given import Given

from ..flowsheet.case import PharmaCase

PARTS = (
    "network", "feeds", "units", "connections", "parameters", "attributes", "uncertainty", "held",
    "numerics",
)  # fmt: skip


def alike(one: PharmaCase, other: PharmaCase) -> bool:
    """Whether the cases differ in numbers of their inputs alone.

    Which of them are zero must be the same: a term whose factor is nothing may be left out.
    """
    held = one.held | other.held
    return all(_same(getattr(one, name), getattr(other, name), held) for name in PARTS)


def _same(one: Any, other: Any, held: Iterable[str]) -> bool:
    if type(one) is not type(other):
        return False
    if isinstance(one, Given):
        if (one.name, one.labels, one.unit) != (other.name, other.labels, other.unit):
            return False
        if not np.array_equal(one.index, other.index):
            return False
        if one.name in held:
            return np.array_equal(one.values, other.values)
        return np.array_equal(one.values != 0, other.values != 0)
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(lambda a, b: _same(a, b, held), one, other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(_same(one[k], other[k], held) for k in one)
    if is_dataclass(one):
        return all(
            _same(getattr(one, each.name), getattr(other, each.name), held) for each in fields(one)
        )
    return bool(one == other)
