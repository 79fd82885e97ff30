"""The time of a training without the time of its valuations; and curves as CSV."""

import csv
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple


class Point(NamedTuple):
    """A rule during its training: simulated steps (of one path each), processor and wall seconds up
    to this point, and the value of the rule on the common paths."""

    problem: str
    method: str
    seed: int
    steps: int
    processor: float
    wall: float
    value: float

    def told(self, shown: Callable[[float], float]) -> str:
        """A line of progress."""
        return f"  {self.steps:>9,} steps {self.processor:7.1f} s: {shown(self.value):.5g}"


Tell = Callable[[Point], None]  # gets every point as soon as it is measured


class Clock:
    """Processor time of all threads, and wall time, since the clock was made, without pauses."""

    def __init__(self) -> None:
        self._started = _now()
        self._paused = (0.0, 0.0)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Stops the clock within this block."""
        before = _now()
        yield
        after = _now()
        self._paused = tuple(p + b - a for p, a, b in zip(self._paused, before, after))  # pyright: ignore

    def read(self) -> tuple[float, float]:
        """(processor, wall) seconds."""
        processor, wall = (
            n - s - p for n, s, p in zip(_now(), self._started, self._paused, strict=True)
        )
        return processor, wall

    def age(self) -> float:
        """Wall seconds, pauses included."""
        return _now()[1] - self._started[1]


class Budget(NamedTuple):
    """Limits of a training: processor seconds, and wall seconds, valuations included."""

    processor: float
    wall: float

    def spent(self, clock: Clock) -> bool:
        """Whether one of both limits is reached."""
        return clock.read()[0] > self.processor or clock.age() > self.wall


def _now() -> tuple[float, float]:
    return time.process_time(), time.perf_counter()


def write(file: Path, points: Iterable[Point]) -> None:
    """Appends points to a CSV; a new file gets its header."""
    new = not file.exists()
    with file.open("a", newline="", encoding="utf-8") as out:
        rows = csv.writer(out)
        if new:
            rows.writerow(Point._fields)
        rows.writerows(points)


def read(file: Path) -> list[Point]:
    """The points of a CSV."""
    kinds = (str, str, int, int, float, float, float)
    with file.open(newline="", encoding="utf-8") as lines:
        rows = list(csv.reader(lines))[1:]
    return [Point(*(kind(cell) for kind, cell in zip(kinds, row))) for row in rows]
