"""The findings of `snapo.check`, while they are collected and when they are returned."""

import inspect
import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import jax

from snapo.problem.actions import Product


def explained(error: BaseException, simulator: Any, method: str) -> tuple[str, str, str]:
    """Location of an exception with file:line, the mistake, and how to fix it."""
    message, fix = _sentence(error)
    fix = _guess(str(error), simulator, method) or fix
    frame = _own_frame(error, simulator)
    if frame is None:
        return method, message, fix
    where = f"{method}, {short(frame.filename)}:{frame.lineno}"
    return where, f"{message} In: {frame.line}" if frame.line else message, fix


def _sentence(error: BaseException) -> tuple[str, str]:
    for kind, subject, fix in _READABLE:
        if isinstance(error, kind):
            return subject, fix
    message = (str(error).strip().splitlines() or [""])[0]
    return f"{type(error).__name__}: {message}", "Correct this line; nothing after it was examined."


def _guess(message: str, simulator: Any, method: str) -> str:
    """The likely cause of an index that JAX refuses; empty if there is none."""
    size = {"initial": "initial_noise_size", "step": "noise_size"}.get(method, "")
    if "out of bounds for axis 0 with size 0" in message and getattr(simulator, size, None) == 0:
        return f"If this is the noise, {size} is 0: set it to the number of normals that are read."
    if "string indexing" in message and isinstance(getattr(simulator, "action", None), Product):
        return "If this is an action: self.action.parts(action) has its parts by name."
    return ""


def _own_frame(error: BaseException, simulator: Any) -> traceback.FrameSummary | None:
    """The deepest frame in the simulator's file, or else outside of the libraries."""
    frames = traceback.extract_tb(error.__traceback__)
    try:
        home = inspect.getsourcefile(type(simulator))
    except TypeError:
        home = None
    local = [f for f in frames if f.filename == home]
    libraries = (
        f"{os.sep}site-packages{os.sep}",
        os.path.dirname(__file__),
        "<frozen",
        "contextlib",
    )
    other = [f for f in frames if not any(part in f.filename for part in libraries)]
    # The caller of `check` is first in the traceback; user code lies deeper.
    return local[-1] if local else (other[-1] if other else None)


def short(file: str | None) -> str:
    """A path relative to the working folder."""
    return os.path.relpath(file) if file and os.path.exists(file) else str(file)


_READABLE = [
    (
        jax.errors.TracerArrayConversionError,
        "NumPy was called on a number that JAX is tracing.",
        "Call jax.numpy (jnp) instead of numpy; NumPy is for fixed tables only.",
    ),
    (
        jax.errors.TracerBoolConversionError,
        "Python uses a number that differs between paths to decide something here (if, while, and, "
        "or, min, max).",
        "Write jnp.where, or smooth.indicator, smooth.minimum, smooth.choose for a limit.",
    ),
    (
        jax.errors.TracerIntegerConversionError,
        "Python needs a whole number here (an index, a range), but JAX is tracing this number, "
        "so its value is not known yet.",
        "Index a jax.numpy array with it (jnp.asarray(table)[i]), or make it static.",
    ),
    (
        jax.errors.NonConcreteBooleanIndexError,
        "A mask selects a number of entries that differs between paths.",
        "Do not change the shape: write jnp.where(mask, x, 0.0).",
    ),
    (
        jax.errors.ConcretizationTypeError,
        "Python needs the value of a number here (float(), int(), a shape), but JAX is tracing "
        "this number, so its value is not known yet.",
        "Keep it an array: drop the float() or int(); shapes must not depend on numbers.",
    ),
    (
        jax.errors.UnexpectedTracerError,
        "A number that JAX was tracing was stored outside of the call (in a list, a global, an "
        "attribute).",
        "Carry it in the state that step returns.",
    ),
]


Severity = Literal["error", "warning"]


class Finding(NamedTuple):
    """One mistake. `where`: its position (a method, a leaf or an input, with file:line if known);
    `subject`: the mistake itself; `fix`: how to correct it."""

    severity: Severity
    where: str
    subject: str
    fix: str

    def sentence(self) -> str:
        """The finding in one line, for notes."""
        return f"{self.where}: {self.subject} {self.fix}"

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}\n    {self.subject}\n    {self.fix}"


@dataclass(frozen=True)
class Findings:
    """All findings, errors first; `looked_at` describes the extent of the examination."""

    simulator: str
    items: tuple[Finding, ...]
    looked_at: str

    @property
    def errors(self) -> tuple[Finding, ...]:
        return tuple(item for item in self.items if item.severity == "error")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        return tuple(item for item in self.items if item.severity == "warning")

    @property
    def ok(self) -> bool:
        """Whether the simulator can be trained: there are no errors; warnings are allowed."""
        return not self.errors

    def __add__(self, other: "Findings") -> "Findings":
        items = sorted(dict.fromkeys(self.items + other.items), key=lambda item: item.severity)
        return Findings(self.simulator, tuple(items), self.looked_at)

    def __iter__(self) -> Iterator[Finding]:
        return iter(self.items)

    def __len__(self) -> int:
        return len(self.items)

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        if not self.items:
            return f"{self.simulator}: no findings. {self.looked_at}"
        counts = f"{_count(self.errors, 'error')}, {_count(self.warnings, 'warning')}"
        return "\n".join([f"{self.simulator}: {counts}. {self.looked_at}", *map(str, self.items)])


def _count(items, name: str) -> str:
    return f"{len(items)} {name}{'' if len(items) == 1 else 's'}"


class StopCheck(Exception):
    """An error that makes every later examination impossible."""


@dataclass
class Notes:
    """Collects the findings of one check."""

    simulator: Any
    items: list[Finding] = field(default_factory=list)

    def error(self, where: str, message: str, fix: str) -> None:
        self._add(Finding("error", where, message, fix))

    def warning(self, where: str, subject: str, fix: str) -> None:
        self._add(Finding("warning", where, subject, fix))

    def stop_on_errors(self) -> None:
        if any(item.severity == "error" for item in self.items):
            raise StopCheck

    @contextmanager
    def during(self, method: str):
        """Turns any exception of the simulator's code into a finding, and stops."""
        try:
            yield
        except StopCheck:
            raise
        except Exception as error:
            self.exception(error, method)
            raise StopCheck from error

    def exception(self, error: Exception, method: str) -> None:
        """Adds an exception as one finding, with file:line."""
        self.error(*self.explained(error, method))

    def explained(self, error: Exception, method: str) -> tuple[str, str, str]:
        """Location of an exception, the mistake, and how to fix it."""
        return explained(error, self.simulator, method)

    def method(self, name: str) -> str:
        """A method with file:line of its definition."""
        try:
            function = inspect.unwrap(getattr(type(self.simulator), name))
            file, line = inspect.getsourcefile(function), inspect.getsourcelines(function)[1]
        except (AttributeError, OSError, TypeError):
            return name
        return f"{name}, {short(file)}:{line}"

    def finished(self, looked_at: str) -> Findings:
        ordered = sorted(self.items, key=lambda item: item.severity)
        # A class instead of its object is a finding too.
        kind = self.simulator if isinstance(self.simulator, type) else type(self.simulator)
        return Findings(kind.__name__, tuple(ordered), looked_at)

    def _add(self, finding: Finding) -> None:
        if finding not in self.items:
            self.items.append(finding)
