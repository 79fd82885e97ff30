"""The findings of `snapo.check`, while they are made and as they are returned."""

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from .mistakes import explained, short

Severity = Literal["error", "warning"]


class Finding(NamedTuple):
    """One mistake: `where` it is (a method, a leaf or an input, with file:line if known), `subject`
    it is, and how to `fix` it."""

    severity: Severity
    where: str
    subject: str
    fix: str

    def sentence(self) -> str:
        """It in one line, for notes."""
        return f"{self.where}: {self.subject} {self.fix}"

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}\n    {self.subject}\n    {self.fix}"


@dataclass(frozen=True)
class Findings:
    """All findings, errors first; `looked_at` is the extent of the examination in words."""

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
    """Findings while they are made."""

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
        """An exception as one finding with file:line."""
        self.error(*self.explained(error, method))

    def explained(self, error: Exception, method: str) -> tuple[str, str, str]:
        """The place of an exception, the mistake, and how to fix it."""
        return explained(error, self.simulator, method)

    def method(self, name: str) -> str:
        """A method with the place where it is written."""
        try:
            function = inspect.unwrap(getattr(type(self.simulator), name))
            file, line = inspect.getsourcefile(function), inspect.getsourcelines(function)[1]
        except (AttributeError, OSError, TypeError):
            return name
        return f"{name}, {short(file)}:{line}"

    def finished(self, looked_at: str) -> Findings:
        ordered = sorted(self.items, key=lambda item: item.severity)
        # A class in place of its object is a finding too.
        kind = self.simulator if isinstance(self.simulator, type) else type(self.simulator)
        return Findings(kind.__name__, tuple(ordered), looked_at)

    def _add(self, finding: Finding) -> None:
        if finding not in self.items:
            self.items.append(finding)
