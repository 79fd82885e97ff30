"""All that a trace reads of a tree, as text that another process can compare.

Arrays are arguments of a trace: their shapes and types are written. All else is compiled in, and is
written by value: plain values, tuples, objects of snapo with all their attributes, and classes and
functions of snapo and its dependencies by their names. Anything else, such as a user's class or a
closure, has no text.
"""

import sys
from collections.abc import Iterator
from enum import Enum
from functools import cache, partial
from hashlib import blake2b
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import equinox as eqx
import jax
import jaxlib
import numpy as np
from jax.tree_util import default_registry

import snapo

from .walk import ARRAYS, PLAIN, is_known, package

# Settings of JAX that a trace may depend on.
SETTINGS = (
    "jax_numpy_dtype_promotion", "jax_numpy_rank_promotion",
    "jax_default_matmul_precision", "jax_default_prng_impl", "jax_threefry_partitionable",
    "jax_debug_nans", "jax_debug_infs", "jax_enable_checks", "jax_disable_jit",
)  # fmt: skip

WRITTEN_IN_PYTHON = {"equinox", "snapo"}  # packages whose objects are all in their attributes


class _NoTextError(Exception):
    """Something that only this process can compare."""


def described(*trees: Any) -> str | None:
    """The text of some trees of JAX; None if a part of them has none."""
    try:
        return "\n".join(part for tree in trees for part in _tree(tree))
    except _NoTextError:
        return None


def settings() -> str:
    """JAX's settings and version, and the sources of snapo: every trace depends on them."""
    values = [f"{name}={getattr(jax.config, name, None)}" for name in SETTINGS]
    values.append(str(jax.dtypes.canonicalize_dtype(np.float64)))
    versions = [library.__version__ for library in (jax, jaxlib, eqx, np)]
    return "\n".join([*values, *versions, sys.version, _sources()])


@cache
def _sources() -> str:
    """A digest of all modules of snapo."""
    digest, root = blake2b(), Path(snapo.__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def _tree(x: Any) -> Iterator[str]:
    if isinstance(x, (*ARRAYS, jax.ShapeDtypeStruct)):
        yield f"array {x.shape} {x.dtype}"
        return
    parts = default_registry.flatten_one_level(x)
    if parts is None:
        yield _value(x)
        return
    children, rest = parts
    children = tuple(children)
    yield f"{_value(type(x))} {_value(rest)} {len(children)}"
    for child in children:
        yield from _tree(child)


def _value(x: Any) -> str:
    if isinstance(x, type):
        return _name(x)
    if isinstance(x, Enum):
        return f"{_name(type(x))}.{x.name}"
    if isinstance(x, PLAIN):
        return f"{type(x).__name__} {x!r}"
    if isinstance(x, tuple | list | frozenset):
        items = [_value(item) for item in x]
        ordered = sorted(items) if isinstance(x, frozenset) else items
        return f"{_name(type(x))} [{', '.join(ordered)}]"
    if isinstance(x, partial):
        return f"partial {_value((x.func, x.args, tuple(sorted(x.keywords.items()))))}"
    if isinstance(x, MethodType):
        return f"method {_name(x.__func__)} of {_value(x.__self__)}"
    if isinstance(x, FunctionType) or package(type(x)) not in WRITTEN_IN_PYTHON:
        return _name(x)
    if any(vars(kind).get("__slots__") for kind in type(x).__mro__):
        raise _NoTextError
    members = (f"{name}={_value(value)}" for name, value in sorted(vars(x).items()))
    return f"{_name(type(x))}({', '.join(members)})"


def _name(x: Any) -> str:
    """The name of a class or a function of snapo or of a dependency, if it has that name there."""
    if x is type(None):
        return "None"
    module, name = getattr(x, "__module__", None), getattr(x, "__qualname__", None)
    if module is None or name is None or not is_known(package(x)):
        raise _NoTextError
    target = sys.modules.get(module)
    for part in name.split("."):
        target = getattr(target, part, None)
    if target is not x:
        raise _NoTextError
    return f"{module}.{name}"
