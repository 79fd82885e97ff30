"""Curves beside each other: when snapo is as good as the best of each agent."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from .clock import Point

NEEDED = {"processor": 20, "steps": 50}  # times less than an agent


class Reached(NamedTuple):
    """The best value of a run, the steps and processor seconds to it, and those of another run
    to the same value (None: it never gets there)."""

    value: float
    steps: float
    processor: float
    other_steps: float | None
    other_processor: float | None


def runs(points: Sequence[Point]) -> dict[tuple[str, str, int], list[Point]]:
    """{(problem, method, seed): points in the order of their steps}."""
    found: dict[tuple[str, str, int], list[Point]] = {}
    for point in sorted(points, key=lambda each: each.steps):
        found.setdefault((point.problem, point.method, point.seed), []).append(point)
    return found


def when(points: Sequence[Point], value: float, column: str) -> float | None:
    """Steps or seconds at which a curve first has a value, linear between its points."""
    before = None
    for point in points:
        here = getattr(point, column)
        if point.value >= value:
            if before is None or before.value >= point.value:
                return here
            share = (value - before.value) / (point.value - before.value)
            start = getattr(before, column)
            return start + share * (here - start)
        before = point
    return None


def reached(theirs: Sequence[Point], ours: Sequence[Point]) -> Reached:
    """The best of an agent's run beside a run of snapo."""
    best = max(theirs, key=lambda each: each.value)
    found = {column: when(ours, best.value, column) for column in NEEDED}
    return Reached(best.value, best.steps, best.processor, found["steps"], found["processor"])


def lines(points: Sequence[Point], shown: dict) -> Iterator[str]:
    """A row for every run: of an agent with the comparison, of snapo with its last value.

    `shown`: {problem: function from a value to the number in the table}.
    """
    yield (
        "| problem | method, seed | best value | its steps | its s | snapo there: steps | s "
        "| steps, times fewer | s, times fewer |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    found = runs(points)
    for (problem, method, seed), run in sorted(found.items()):
        tell, ours = shown[problem], found.get((problem, "snapo", seed))
        best = max(run, key=lambda each: each.value)
        head = f"| {problem} | {method}, {seed} | {tell(best.value):.5g} | {best.steps:,} "
        head += f"| {best.processor:.1f} |"
        if method == "snapo" or ours is None:
            yield head + " | | | |"
            continue
        one = reached(run, ours)
        if one.other_steps is None or one.other_processor is None:
            yield head + " never | never | | |"
            continue
        # The rule that snapo begins with may be as good already.
        fewer = f"{one.steps / one.other_steps:.3g}" if one.other_steps else "none needed"
        sooner = one.processor / one.other_processor
        yield (
            f"{head} {one.other_steps:,.0f} | {one.other_processor:.1f} | {fewer} | {sooner:.3g} |"
        )
