"""What `snapo.check` finds, and errors of a simulator's own code put in one sentence."""

import inspect
import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import jax

Severity = Literal["error", "warning"]


class Finding(NamedTuple):
    """One thing to mend. `where` names a method, a leaf or an input, with file:line if known."""

    severity: Severity
    where: str
    what: str
    mend: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}\n    {self.what}\n    {self.mend}"


@dataclass(frozen=True)
class Findings:
    """All findings, errors first; `looked_at` says in words what was examined."""

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
        """Whether the simulator can be trained: warnings do not forbid it."""
        return not self.errors

    def __iter__(self) -> Iterator[Finding]:
        return iter(self.items)

    def __len__(self) -> int:
        return len(self.items)

    def __str__(self) -> str:
        if not self.items:
            return f"{self.simulator}: nothing to mend. {self.looked_at}"
        counts = f"{len(self.errors)} errors, {len(self.warnings)} warnings"
        return "\n".join([f"{self.simulator}: {counts}. {self.looked_at}", *map(str, self.items)])


class Stop(Exception):
    """Nothing more can be examined."""


@dataclass
class Notes:
    """Findings while they are made."""

    simulator: Any
    items: list[Finding] = field(default_factory=list)

    def error(self, where: str, what: str, mend: str) -> None:
        self._add(Finding("error", where, what, mend))

    def warning(self, where: str, what: str, mend: str) -> None:
        self._add(Finding("warning", where, what, mend))

    def stop_on_errors(self) -> None:
        if any(item.severity == "error" for item in self.items):
            raise Stop

    @contextmanager
    def during(self, method: str):
        """Turns whatever the simulator's code raises into a finding, and stops."""
        try:
            yield
        except Stop:
            raise
        except Exception as error:
            self._add(explain(error, self.simulator, method))
            raise Stop from error

    def method(self, name: str) -> str:
        """A method with the place where it is written."""
        try:
            function = inspect.unwrap(getattr(type(self.simulator), name))
            file, line = inspect.getsourcefile(function), inspect.getsourcelines(function)[1]
        except (AttributeError, OSError, TypeError):
            return name
        return f"{name}, {_short(file)}:{line}"

    def finished(self, looked_at: str) -> Findings:
        ordered = sorted(self.items, key=lambda item: item.severity)
        return Findings(type(self.simulator).__name__, tuple(ordered), looked_at)

    def _add(self, finding: Finding) -> None:
        if finding not in self.items:
            self.items.append(finding)


def explain(error: BaseException, simulator: Any, method: str) -> Finding:
    """An exception of the simulator's code as one finding with file:line."""
    what, mend = _sentence(error)
    frame = _own_frame(error, simulator)
    if frame is None:
        return Finding("error", method, what, mend)
    where = f"{method}, {_short(frame.filename)}:{frame.lineno}"
    return Finding("error", where, f"{what} In: {frame.line}" if frame.line else what, mend)


def _sentence(error: BaseException) -> tuple[str, str]:
    for kind, what, mend in _READABLE:
        if isinstance(error, kind):
            return what, mend
    message = (str(error).strip().splitlines() or [""])[0]
    return f"{type(error).__name__}: {message}", "Mend this line; nothing after it was examined."


def _own_frame(error: BaseException, simulator: Any) -> traceback.FrameSummary | None:
    """The deepest frame in the simulator's own file, or else outside of the libraries."""
    frames = traceback.extract_tb(error.__traceback__)
    try:
        home = inspect.getsourcefile(type(simulator))
    except TypeError:
        home = None
    own = [f for f in frames if f.filename == home]
    libraries = (
        f"{os.sep}site-packages{os.sep}",
        os.path.dirname(__file__),
        "<frozen",
        "contextlib",
    )
    other = [f for f in frames if not any(part in f.filename for part in libraries)]
    # The caller of `check` stands first in the traceback; user code is what comes deeper.
    return own[-1] if own else (other[-1] if other else None)


def _short(file: str | None) -> str:
    return os.path.relpath(file) if file and os.path.exists(file) else str(file)


_READABLE = [
    (
        jax.errors.TracerArrayConversionError,
        "NumPy was called on a number that JAX is tracing.",
        "Call jax.numpy (jnp) in place of numpy; NumPy is for fixed tables only.",
    ),
    (
        jax.errors.TracerBoolConversionError,
        "Python decides here (if, while, and, or, min, max) on a number that differs by path.",
        "Write jnp.where, or smooth.indicator, smooth.minimum, smooth.choose for a limit.",
    ),
    (
        jax.errors.TracerIntegerConversionError,
        "Python needs a whole number here (an index, a range), and it is one that JAX is tracing.",
        "Index a jax.numpy array with it (jnp.asarray(table)[i]), or make it static.",
    ),
    (
        jax.errors.NonConcreteBooleanIndexError,
        "A mask selects a number of entries that differs by path.",
        "Keep the shape: jnp.where(mask, x, 0.0).",
    ),
    (
        jax.errors.ConcretizationTypeError,
        "Python needs the value here (float(), int(), a shape), and it is one that JAX is tracing.",
        "Leave it an array: drop the float() or int(); shapes must not depend on numbers.",
    ),
    (
        jax.errors.UnexpectedTracerError,
        "A traced number was kept outside of the call (in a list, a global, an attribute).",
        "Carry it in the state that step returns.",
    ),
]
