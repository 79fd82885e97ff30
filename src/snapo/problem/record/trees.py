"""Records as trees of JAX: importing this module registers all of them."""

import dataclasses
from typing import Any

import jax
from jax.tree_util import GetAttrKey

from . import STATIC, register_all


def _register(cls: Any) -> None:
    static, moving = [], []
    for item in dataclasses.fields(cls):
        (static if item.metadata.get(STATIC) else moving).append(item.name)
    keys = tuple(map(GetAttrKey, moving))

    def flatten(record: Any) -> tuple[tuple, tuple]:
        return (
            tuple([getattr(record, x) for x in moving]),
            tuple([getattr(record, x) for x in static]),
        )

    def with_keys(record: Any) -> tuple[tuple, tuple]:
        leaves, structure = flatten(record)
        return tuple(zip(keys, leaves)), structure

    def unflatten(structure: tuple, leaves: Any) -> Any:
        # Without `__init__`: the leaves of a tree may be anything, such as shapes.
        record = object.__new__(cls)
        vars(record).update(zip(moving, leaves))
        vars(record).update(zip(static, structure))
        return record

    jax.tree_util.register_pytree_with_keys(cls, with_keys, unflatten, flatten)


register_all(_register)
