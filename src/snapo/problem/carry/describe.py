"""A policy in words: all of it that is no number, so that weights are not taken for another's.

Two policies with weights of the same shapes are still two where one has the activation `silu` and
the other `tanh`, or another set of actions.
"""

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import numpy as np


def described(tree: Any) -> dict[str, str]:
    """{place: words} of the kinds, plain settings and functions in a policy or a tree of policies.

    Places are like "policy.activation". Nothing depends on the process: functions and classes have
    their names alone. Arrays are left out.
    """
    return dict(_lines(tree, ""))


def difference(stored: Mapping[str, str], now: Mapping[str, str]) -> str:
    """The first difference as a clause, "its activation is tanh, and here it is silu"; or "".

    A place that only one of the two has makes no difference: another version may have added it.
    """
    for position, text in now.items():
        if stored.get(position, text) != text:
            return f"its {position} is {stored[position]}, and here it is {text}"
    return ""


def _lines(value: Any, position: str):
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield f"{position} kind".strip(), type(value).__name__
        for field in dataclasses.fields(value):
            yield from _lines(
                getattr(value, field.name, None), f"{position}.{field.name}".strip(".")
            )
    elif isinstance(value, Mapping):
        for key, field in value.items():
            yield from _lines(field, f"{position}.{key}".strip("."))
    elif isinstance(value, list | tuple):
        for index, field in enumerate(value):
            yield from _lines(field, f"{position}[{index}]")
    elif isinstance(value, jax.Array | np.ndarray):
        return  # shapes are compared where the numbers are read
    elif value is None or isinstance(value, bool | int | float | str):
        yield position, repr(value)
    elif callable(value):
        yield position, _name(value)
    else:
        yield f"{position} kind".strip(), type(value).__name__


def _name(function: Any) -> str:
    """A function's name, with the settings of a partial one."""
    if isinstance(function, partial):
        values = [*map(repr, function.args), *(f"{k}={v!r}" for k, v in function.keywords.items())]
        plain = [item for item in values if " at 0x" not in item]
        return f"{_name(function.func)}({', '.join(plain)})"
    return str(getattr(function, "__name__", type(function).__name__))
