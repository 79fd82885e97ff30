"""Loads the user's module from the case's folder and executes it once, with messages for
mistakes."""

import hashlib
import importlib
import importlib.util
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from snapo.case.error import CaseError, Unquoted

OPTION = "--simulator"


class LoadedCode(NamedTuple):
    """A class of the user, and its file (None: an installed module)."""

    value: Any
    file: Path | None
    hash: str


def load_class(module: str, name: str, folder: Path) -> LoadedCode:
    """The class `name` of `module`: next to the case, in the working directory, or installed.

    **Raises:** `CaseError` if there is no such class, or the module cannot be executed.
    """
    position = Unquoted(f"{module}:{name}")
    if module in sys.stdlib_module_names:
        message = "Python has a module of this name; rename your module"
        raise CaseError(OPTION, "", position, message)
    loaded = _loaded(module, position, folder)
    result = getattr(loaded, name, None)
    if result is None:
        here = [key for key, var in vars(loaded).items() if _written_in(var, module)]
        hint = f"; its classes are {', '.join(here)}" if here else ""
        raise CaseError(OPTION, "", position, f"the module {module} has no {name}{hint}")
    from snapo.problem.simulator import Simulator

    if not (isinstance(result, type) and issubclass(result, Simulator)):
        message = f"{name} is not a subclass of snapo.Simulator"
        raise CaseError(OPTION, "", position, message)
    file = Path(loaded.__file__) if loaded.__file__ else None
    digest = hashlib.sha256(file.read_bytes()).hexdigest() if file else ""
    return LoadedCode(result, file, digest)


def _written_in(item: Any, module: str) -> bool:
    return isinstance(item, type) and item.__module__ == module


def _loaded(module: str, position: Unquoted, folder: Path) -> ModuleType:
    looked = list(dict.fromkeys([folder.resolve(), Path.cwd()]))
    for where in looked:
        file = where.joinpath(*module.split(".")).with_suffix(".py")
        if file.is_file():
            with importable(where), readable(file):
                return _run(module, file)
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name not in (module, module.partition(".")[0]):
            raise
        where = " or ".join(dict.fromkeys(map(str, looked)))
        message = f"there is no {module.replace('.', '/')}.py in {where}"
        raise CaseError(OPTION, "", position, message) from None


def _run(module: str, file: Path) -> ModuleType:
    """The module in `file`, executed again because another case may have a module of the same
    name."""
    spec = importlib.util.spec_from_file_location(module, file)
    assert spec is not None and spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    sys.modules[module] = made  # dataclasses look their module up
    try:
        spec.loader.exec_module(made)
    except BaseException:
        del sys.modules[module]
        raise
    return made


@contextmanager
def importable(folder: Path) -> Iterator[None]:
    """Modules next to the simulator can be imported within this context."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


@contextmanager
def readable(file: Path) -> Iterator[None]:
    """Converts any exception of the code in `file` into one message with its line."""
    try:
        yield
    except CaseError:
        raise
    except SyntaxError as error:
        where = f"line {error.lineno}" if error.lineno else ""
        raise CaseError(short(error.filename or file), where, None, f"{error.msg}") from error
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        local = [frame for frame in frames if frame.filename == str(file)]
        where = f"line {local[-1].lineno}" if local else ""
        line = f" In: {local[-1].line}" if local and local[-1].line else ""
        text = str(error).strip().rstrip(".")
        message = f"{type(error).__name__}: {text}.{line}".rstrip(".")
        raise CaseError(short(file), where, None, message) from error


def short(file: str | Path) -> str:
    """The path of a file, relative to the working directory if that is shorter."""
    try:
        near = os.path.relpath(file)
    except ValueError:
        return str(file)
    return near if len(near) < len(str(file)) else str(file)
