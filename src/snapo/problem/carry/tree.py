"""A policy as plain data and arrays, and back: known kinds alone, none of their code is run."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from . import registry

DEEPEST = 20  # levels of policies in policies


class NotKnown(ValueError):
    """A part of a policy that no file can describe: its place and kind."""


def encoded(value: Any, arrays: list[np.ndarray], position: str = "policy") -> Any:
    """What JSON can say of a policy; its arrays are appended to `arrays`.

    **Raises:** `NotKnown` at a class or function that is not in the registry.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": repr(value)}
    if isinstance(value, np.generic):
        return encoded(value.item(), arrays, position)
    if isinstance(value, jax.Array | np.ndarray):
        arrays.append(np.asarray(value))
        return {"array": len(arrays) - 1, "numpy": not isinstance(value, jax.Array)}
    if type(value) in (tuple, list):
        items = [encoded(item, arrays, f"{position}[{i}]") for i, item in enumerate(value)]
        return {type(value).__name__: items}
    if isinstance(value, eqx.Module) and not isinstance(value, type):
        name = type(value).__name__
        if name not in registry.KINDS or type(value) is not registry.kind(name):
            _unknown(value, position)
        metadata = {
            field.name: encoded(getattr(value, field.name), arrays, f"{position}.{field.name}")
            for field in dataclasses.fields(value)
        }
        return {"kind": name, "fields": metadata}
    if callable(value) and (name := registry.name_of(value)):
        return {"function": name}
    return _unknown(value, position)


def _unknown(value: Any, position: str) -> Any:
    name = getattr(value, "__name__", type(value).__name__)
    raise NotKnown(
        f"its {position} is {name}" if position != "policy" else f"it is of class {name}"
    )


def decoded(metadata: Any, arrays: Sequence[np.ndarray], depth: int = 0) -> Any:
    """The inverse of `encoded`.

    **Raises:** `ValueError`, `KeyError` or `TypeError` for anything that `encoded` does not write.
    """
    if depth > 3 * DEEPEST:
        raise ValueError("it is nested too deeply")
    if metadata is None or isinstance(metadata, bool | int | str | float):
        return metadata
    match metadata:
        case {"array": int(index), "numpy": bool(plain)} if 0 <= index < len(arrays):
            return arrays[index] if plain else jnp.asarray(arrays[index])
        case {"float": "inf" | "-inf" | "nan" as text}:
            return float(text)
        case {"tuple": list(items)}:
            return tuple(decoded(item, arrays, depth + 1) for item in items)
        case {"list": list(items)}:
            return [decoded(entry, arrays, depth + 1) for entry in items]
        case {"function": str(name)} if name in registry.functions():
            return registry.functions()[name]
        case {"kind": str(name), "fields": dict(fields)} if name in registry.KINDS:
            return _made(registry.kind(name), fields, arrays, depth)
    raise ValueError(f"it names {str(metadata)[:60]!r}, which this version does not know")


def _made(kind: type, fields: dict[str, Any], arrays: Sequence[np.ndarray], depth: int) -> Any:
    """An object with these fields; its constructor is not called."""
    available = {item.name: item for item in dataclasses.fields(kind)}
    if other := set(fields) - set(available):
        raise ValueError(f"a {kind.__name__} has no {sorted(other)[0]!r} in this version")
    made = object.__new__(kind)
    for name, field in available.items():
        if name in fields:
            value = decoded(fields[name], arrays, depth + 1)
        elif field.default is not dataclasses.MISSING:
            value = field.default  # a field that an older version did not have
        else:
            raise ValueError(f"a {kind.__name__} has {name!r} in this version, and not in the file")
        object.__setattr__(made, name, value)
    return made
