"""Comparison of curves: when snapo reaches the best value of each agent."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from .clock import Point
from .told import NAMES

NEEDED = {"processor": 20, "steps": 50}  # times less than an agent


class Reached(NamedTuple):
    """The best value of a run, the steps and processor seconds to it, and those of another run to
    the same value (None: it never reaches it)."""

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
    """The best value of an agent's run, compared with a run of snapo."""
    best = max(theirs, key=lambda each: each.value)
    found = {column: when(ours, best.value, column) for column in NEEDED}
    return Reached(best.value, best.steps, best.processor, found["steps"], found["processor"])


def lines(points: Sequence[Point], shown: dict) -> Iterator[str]:
    """A row for every run: for an agent with the comparison, for snapo with its last value.

    `shown`: {problem: function from a value to the number in the table}.
    """
    yield (
        "| problem | method, seed | best value | steps to it | CPU seconds to it "
        "| snapo to the same value: steps | CPU seconds | times fewer steps | times faster |"
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


def summary(points: Sequence[Point], shown: dict) -> Iterator[str]:
    """A row for every method, with all its seeds: the table of docs/reinforcement.md.

    Values and ratios of seconds are lists in the order of the seeds; steps and seconds are ranges.
    Ratios of twenty and more are bold.
    """
    yield (
        "| problem | method, seeds | best value, by seed | CPU seconds to this value "
        "| snapo: times faster, by seed | snapo: times fewer steps |"
    )
    yield "|---|---|---|---|---|---|"
    found = runs(points)
    before = None
    for problem, method in _methods(found, shown):
        seeds = sorted(seed for name, other, seed in found if (name, other) == (problem, method))
        mine = [found[problem, method, seed] for seed in seeds]
        best = [max(run, key=lambda each: each.value) for run in mine]
        values = _list([f"{shown[problem](each.value):.5g}" for each in best])
        seconds = _range([each.processor for each in best], ".1f")
        head = "|" if problem == before else f"| `{problem}`"
        head += f" | {NAMES[method]}, {_ranges(seeds)} | {values} | {seconds} |"
        before = problem
        ours = [found.get((problem, "snapo", seed)) for seed in seeds]
        if method == "snapo" or None in ours:
            yield f"{head} | |"
            continue
        compared = [reached(run, our) for run, our in zip(mine, ours) if our is not None]
        yield f"{head} {', '.join(map(_sooner, compared))} | {_fewer(compared)} |"


def _methods(found: Iterable[tuple[str, str, int]], shown: dict) -> list[tuple[str, str]]:
    """(problem, method) in the order of the page, snapo last."""
    pairs = {(problem, method) for problem, method, _ in found}
    order = sorted(NAMES, key=lambda name: name == "snapo")
    return [each for each in itertools.product(shown, order) if each in pairs]


def _ranges(seeds: Sequence[int]) -> str:
    """ "0 to 4, 6"."""
    told, start = [], 0
    for i, seed in enumerate(seeds):
        if i + 1 == len(seeds) or seeds[i + 1] != seed + 1:
            run = seeds[start : i + 1]
            told += [f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run)
            start = i + 1
    return ", ".join(told)


def _list(words: Sequence[str]) -> str:
    return f"{words[0]} (all)" if len(words) > 1 and len(set(words)) == 1 else ", ".join(words)


def _range(numbers: Sequence[float], form: str) -> str:
    low, high = (f"{each:{form}}" for each in (min(numbers), max(numbers)))
    return low if low == high else f"{low} to {high}"


def _sooner(one: Reached) -> str:
    if one.other_processor is None:
        return "never"
    times = one.processor / one.other_processor
    told = f"{times:.0f}" if times >= 10 else f"{times:.1f}"
    return f"**{told}**" if times >= NEEDED["processor"] else told


def _fewer(compared: Sequence[Reached]) -> str:
    """The range of the ratios, and how many have none."""
    ratios = [each.steps / each.other_steps for each in compared if each.other_steps]
    told = [_range(ratios, ".3g")] if ratios else []
    for words, steps in (("none needed", 0), ("never", None)):
        many = sum(each.other_steps == steps for each in compared)
        if many:
            told.append(words if many == len(compared) else f"{words} ({many})")
    return ", ".join(told)
