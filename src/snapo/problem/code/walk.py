"""All objects that a user's code reads, from the classes and functions in a tree to the objects to
which
they refer.

Functions are read by their code, constants by value, mutable objects by their present content.
Functions of libraries are taken unchanged.
"""

import functools
import importlib.util
import marshal
import sys
from collections import deque
from collections.abc import Hashable, Iterable, Iterator
from enum import Enum
from functools import cache
from hashlib import blake2b
from pathlib import Path
from types import CellType, FunctionType, MethodType, ModuleType
from typing import Any

import jax
import numpy as np
from jax.tree_util import default_registry

from .names import CONTAINERS, Names, names

INSTALLED = {"site-packages", "dist-packages"}
SNAPO = __name__.partition(".")[0]
UNDER = {SNAPO, "equinox", "jax", "jaxlib", "numpy", "optax", "scipy"}  # snapo and its dependencies


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
    """Whether a package is snapo, part of Python, or installed with them."""
    return is_known(name) or _installed(name)


def is_known(name: str) -> bool:
    """Whether a package is snapo, a dependency, or part of Python: none of these contains a user's
    simulator."""
    return name in UNDER or is_python(name)


def is_python(name: str) -> bool:
    """Whether a package comes with Python."""
    return name in sys.stdlib_module_names


@cache
def _installed(name: str) -> bool:
    file = getattr(sys.modules.get(name), "__file__", None)
    return file is not None and not INSTALLED.isdisjoint(Path(file).parts)


PLAIN = (type(None), bool, int, float, complex, str, bytes, type(...), range, np.generic, np.dtype)
ARRAYS = (np.ndarray, np.generic, jax.Array)
MAXIMUM = 20_000  # objects that are inspected; the rest is unknown
# Entries of a class that no method reads.
SET_BY_PYTHON = {"_abc_impl", "__annotate__", "__annotate_func__"}


class Walk:
    """The objects that are read. - `fixed`: code and constants, on which the program depends.
    - `moving`: the content of mutable objects, such as lists and NumPy arrays, and variables that
      the code itself sets, such as a counter: the program may depend on them.
    - `unseen`: whether there is anything else that cannot be inspected.
    - `user_code`: whether any code is the user's.
    """

    def __init__(self, trees: Iterable[Any]):
        self.fixed: list[Hashable] = []
        self.moving: list[Hashable] = []
        self.unseen, self.user_code, self._made = False, False, False
        self._opened: set[str] = set()
        self._numbers: dict[int, int] = {}
        self._waiting: deque[Any] = deque()
        self._alive: list[Any] = []  # so that no other thing gets the identity of one
        self._modules: dict[int, ModuleType] = {}
        self._members: set[str] = set()
        self._asked: set[tuple[int, str]] = set()
        for tree in trees:
            self._tree(tree)
        while self._waiting:
            self._look(self._waiting.popleft())
            if not self._waiting:
                self._ask_modules()
            if len(self._numbers) > MAXIMUM:
                self.unseen = True
                break

    def _tree(self, x: Any) -> None:
        """A tree of JAX: its arrays are arguments, all else is compiled in."""
        if isinstance(x, ARRAYS):
            return
        parts = default_registry.flatten_one_level(x)
        if parts is None:
            self._value(x, self.fixed)
            return
        children, rest = parts
        if not is_known(name := package(type(x))):
            self._opened.add(name)  # a simulator's package is read, even if it is installed
        self._value(type(x), self.fixed)
        self._value(rest, self.fixed)
        for child in children:
            self._tree(child)

    def _closed(self, x: Any) -> bool:
        name = package(x)
        return name not in self._opened and is_library(name)

    def _value(self, x: Any, out: list[Hashable]) -> None:
        """Writes down a value, or the number of something that is looked at later."""
        if isinstance(x, Enum):
            out.append((package(type(x)), type(x).__qualname__, x.name))
        elif isinstance(x, PLAIN):
            # By their print, for which 0.0 and -0.0 differ, and a number that is none is itself.
            out.append((type(x), x.tobytes() if isinstance(x, np.generic) else repr(x)))
        elif isinstance(x, tuple | frozenset):
            self._several(x, out)
        elif isinstance(x, jax.Array):
            self._array(x, out)
        elif isinstance(x, FunctionType | type) and self._closed(x):
            out.append(x)
        elif isinstance(x, ModuleType):
            self._modules.setdefault(id(x), x)
            out.append(x)
        elif isinstance(x, CellType):
            self._value(_content(x), out)
        elif isinstance(x, MethodType):
            self._several((x.__func__, x.__self__), out)
        elif isinstance(x, functools.partial):
            self._several((x.func, x.args, tuple(x.keywords.items())), out)
        elif isinstance(x, property):
            self._value(x.fget, out)
        elif package(type(x)) == SNAPO and _is_hashable(x):
            out.append(x)  # compared by `==` of its class, as in a tree of JAX
            if _is_frozen(x):  # it may hold a function of a user's
                self._several((v for v in vars(x).values() if not isinstance(v, PLAIN)), out)
        else:
            self._later(x, out)

    def _several(self, x: Iterable[Any], out: list[Hashable]) -> None:
        items = tuple(x)
        if len(items) > 64 and (written := _marshalled(items)) is not None:
            out.append((type(x), written))
            return
        out.append((type(x), len(items)))
        for item in items:
            self._value(item, out)

    def _array(self, x: Any, out: list[Hashable]) -> None:
        if getattr(x.dtype, "hasobject", False):
            self._several(x.ravel().tolist(), out)
            return
        try:
            numbers = np.asarray(x)
        except Exception:  # a key of random numbers, or one that is being traced
            out.append(_Same(x))
            return
        content = blake2b(numbers.tobytes()).digest()
        out.append((type(x), numbers.shape, str(numbers.dtype), content))

    def _later(self, x: Any, out: list[Hashable]) -> None:
        if id(x) not in self._numbers:
            self._numbers[id(x)] = len(self._numbers)
            self._alive.append(x)
            self._waiting.append(x)
        out.append(("number", self._numbers[id(x)]))

    def _look(self, x: Any) -> None:
        """Something that refers to others, or that may change in place."""
        if isinstance(x, FunctionType):
            self._function(x)
        elif isinstance(x, type):
            self._class(x)
        elif isinstance(x, np.ndarray):
            self._array(x, self.fixed)
        elif isinstance(x, dict):
            self._several(x.items(), self.moving)
        elif isinstance(x, list | set | deque):
            self._several(x, self.moving)
        elif isinstance(x, bytearray):
            self.moving.append(bytes(x))
        else:
            self._object(x)

    def _function(self, x: FunctionType) -> None:
        self.user_code = True
        by_name = names(x.__code__)
        self.unseen |= by_name.unseen
        self._made |= by_name.made
        self._members |= by_name.members
        self.fixed.append(x.__code__)
        self._several((x.__defaults__, tuple((x.__kwdefaults__ or {}).items())), self.fixed)
        for name, cell in zip(x.__code__.co_freevars, x.__closure__ or ()):
            self._named(by_name, name, _content(cell))
        for name in sorted(by_name.read | by_name.added):
            if name in x.__globals__:
                self._named(by_name, name, x.__globals__[name])
        for level, name in sorted(by_name.modules):
            self._imported(x, level, name)
        if (inner := getattr(x, "__wrapped__", None)) is not None:
            self._value(inner, self.fixed)
        if attributes := _attributes(x):
            self._several(attributes.items(), self.moving)

    def _named(self, by_name: Names, name: str, x: Any) -> None:
        if name in by_name.added and isinstance(x, CONTAINERS):
            return
        out = self.moving if name in by_name.written else self.fixed
        out.append(name)
        self._value(x, out)

    def _imported(self, x: FunctionType, level: int, name: str) -> None:
        try:
            full = importlib.util.resolve_name("." * level + name, x.__globals__["__package__"])
        except (ImportError, KeyError, TypeError):
            self.unseen = True
            return
        parts = full.split(".")
        for end in range(1, len(parts) + 1):
            if (module := sys.modules.get(".".join(parts[:end]))) is not None:
                self._value(module, self.fixed)

    def _class(self, x: type) -> None:
        self.user_code = True
        self.fixed.append((x.__module__, x.__qualname__))
        for item in x.__mro__[1:]:
            self._value(item, self.fixed)
        for name, value in vars(x).items():
            by_python = name.startswith("__") and not isinstance(value, FunctionType)
            if not by_python and name not in SET_BY_PYTHON:
                self.fixed.append(name)
                self._value(value, self.fixed)

    def _object(self, x: Any) -> None:
        """Any other thing: the function or the object in it, and its attributes."""
        inside = [getattr(x, name, None) for name in ("__wrapped__", "__func__", "__self__")]
        attributes = _attributes(x)
        library = self._closed(type(x))
        if not library or attributes:
            self._value(type(x), self.fixed)
        for item in inside:
            if not isinstance(item, ModuleType):
                self._value(item, self.fixed)
        if attributes:
            stays = library or _is_frozen(x)
            self._several(attributes.items(), self.fixed if stays else self.moving)
        elif library:
            self.fixed.append(x if _is_hashable(x) else _Same(x))
            alone = all(entry is None for entry in inside)
            self.unseen |= alone and (isinstance(x, Iterator) or not _is_known(x))

    def _ask_modules(self) -> None:
        """The members of modules that any function names. In a user's module a member cannot be
        known if its name is made at run time; of all other objects every attribute is read."""
        for module in list(self._modules.values()):
            library = self._closed(module)
            self.unseen |= self._made and not library
            for name in sorted(self._members & vars(module).keys()):
                if (id(module), name) not in self._asked:
                    self._asked.add((id(module), name))
                    self._member(module, name, library)

    def _member(self, module: ModuleType, name: str, library: bool) -> None:
        x = vars(module)[name]
        self.fixed.append(name)
        simple = isinstance(x, (*PLAIN, FunctionType, type, ModuleType))
        if simple or not library or is_python(package(module)):
            self._value(x, self.fixed)
        else:
            self.fixed.append(_Same(x))


class _Same:
    """A thing that is equal only to itself."""

    def __init__(self, x: Any):
        self.x = x

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.x is other.x

    def __hash__(self) -> int:
        return id(self.x)

    def __repr__(self) -> str:
        return f"_Same({id(self.x)})"


def _content(cell: CellType) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # not set yet
        return None


def _attributes(x: Any) -> dict[str, Any]:
    """The attributes of an object, without those of Python itself, and none of a function compiled
    by JAX, whose attributes belong to the call."""
    if package(type(x)) == "jaxlib":
        return {}
    result = dict(getattr(x, "__dict__", {}))
    for kind in type(x).__mro__:
        slots = vars(kind).get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if hasattr(x, name):
                result[name] = getattr(x, name)
    return {name: value for name, value in result.items() if not name.startswith("__")}


def _is_frozen(x: Any) -> bool:
    parameters = getattr(type(x), "__dataclass_params__", None)
    return parameters is not None and parameters.frozen


def _is_known(x: Any) -> bool:
    """Whether an object that is not written in Python contains nothing that may change."""
    return is_known(package(type(x))) and (not callable(x) or is_library(package(x)))


def _is_hashable(x: Any) -> bool:
    try:
        hash(x)
    except TypeError:
        return False
    return True


def _marshalled(items: tuple) -> bytes | None:
    """A digest of plain numbers and texts; None if there is anything else."""
    try:
        return blake2b(marshal.dumps(items, 2)).digest()
    except ValueError:
        return None
