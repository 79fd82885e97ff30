"""Whose code a function or a class is: a user's is read, that of libraries is taken as it is."""

import sys
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

INSTALLED = {"site-packages", "dist-packages"}
SNAPO = __name__.partition(".")[0]
UNDER = {SNAPO, "equinox", "jax", "jaxlib", "numpy", "optax", "scipy"}  # what snapo is made of


def package(x: Any) -> str:
    """The outermost package of a function, a class or a module."""
    if isinstance(x, ModuleType):
        name = x.__name__
    elif isinstance(x, FunctionType):
        name = x.__globals__.get("__name__") or ""
    else:
        name = getattr(x, "__module__", None) or ""
    return str(name).partition(".")[0]


def is_library(name: str) -> bool:
    """Whether a package is snapo, Python's own, or installed beside them."""
    return is_known(name) or _installed(name)


def is_known(name: str) -> bool:
    """Whether a package is snapo, one that it is made of, or Python's own: none has a simulator of
    a user's."""
    return name in UNDER or is_python(name)


def is_python(name: str) -> bool:
    """Whether a package comes with Python."""
    return name in sys.stdlib_module_names


@cache
def _installed(name: str) -> bool:
    file = getattr(sys.modules.get(name), "__file__", None)
    return file is not None and not INSTALLED.isdisjoint(Path(file).parts)
