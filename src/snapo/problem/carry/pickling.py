"""Policies as Python pickles them: for another process of the user's own, never from a file.

`jax.nn.silu` and its like are wrapped functions, which pickle cannot find by their name; here they
go by the names of `registry`.
"""

from dataclasses import fields
from typing import Any, NamedTuple

import equinox as eqx

from .registry import functions, name_of


class _Named(NamedTuple):
    """A function of `registry.functions`."""

    name: str


def reduced(module: eqx.Module) -> tuple:
    """What `__reduce__` of a module with functions in its fields gives."""
    held = {field.name: getattr(module, field.name) for field in fields(module)}  # pyright: ignore
    return _made, (type(module), {name: _packed(value) for name, value in held.items()})


def _packed(value: Any) -> Any:
    name = name_of(value) if callable(value) else None
    return value if name is None else _Named(name)


def _made(kind: type, held: dict[str, Any]) -> Any:
    made = object.__new__(kind)
    for name, value in held.items():
        values = functions()[value.name] if isinstance(value, _Named) else value
        object.__setattr__(made, name, values)
    return made
