"""Problems at moved inputs, with all that a domain builds from them rebuilt.

Tables of a long problem, such as the fitted value of 8,760 hours, take longer than the paths that
are valued with them. They are rebuilt at one move of each input; at other moves of the same input
they are interpolated linearly, if the moves lie on one line.
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from snapo.problem.problem import Problem

LONG = 2190  # steps: three months by the hour
PARTS = 16  # of a table
FEWEST = 512  # paths, for all that is measured next to the value


def fewer(paths: int, horizon: int) -> int:
    """The number of paths that together have no more steps than all paths would have with `LONG`
    steps each; at least 512, if there are that many.

    A path of one year by the hour has as many days as four paths of three months, so that a mean
    over days is as accurate with a quarter of the paths.
    """
    if horizon <= LONG:
        return paths
    return min(paths, max(FEWEST, paths * LONG // horizon))


def problems_at(problem: Problem) -> Callable[[dict[str, Any]], Problem]:
    """The problem at other values of one input; for long problems see above."""
    if not rebuilt_once(problem):
        return problem.at_values
    return _RebuiltOnce(problem)


def forget(at_values: Callable[[dict[str, Any]], Problem]) -> None:
    """Frees the problem that `problems_at` remembers, if no other move of its input follows."""
    if isinstance(at_values, _RebuiltOnce):
        at_values.last = None


class _RebuiltOnce:
    """The last input that was moved, by how much at first, and the problem there."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.last: tuple[str, np.ndarray, Problem] | None = None

    def __call__(self, values: dict[str, Any]) -> Problem:
        ((name, value),) = values.items()
        move = value - self.problem.inputs_by_name[name].value
        if self.last is not None and self.last[0] == name:
            _, by, other = self.last
            share = float(np.vdot(move, by) / np.vdot(by, by))
            parallel = np.allclose(move, share * by, atol=0.0)
            between = on_line(self.problem, other, values, share) if parallel else None
            if between is not None:
                return between
        self.last = None  # its memory is free before that of the next one is needed
        result = self.problem.at_values(values)
        self.last = name, move, result
        return result


def on_line(
    problem: Problem, other: Problem, values: Mapping[str, Any], share: float
) -> Problem | None:
    """The problem at `values`, a share of the way to `other`, with everything that depends on the
    inputs interpolated linearly: x + share (y - x) for a number that is x in `problem` and y in
    `other`. None if `other` has a different structure.

    Building a problem takes longer than a few paths. The line neglects curvature, whose effect on
    a value near its maximum is far smaller.
    """
    here, there = (jax.tree.flatten(item.simulator) for item in (problem, other))
    if here[1] != there[1] or list(map(np.shape, here[0])) != list(map(np.shape, there[0])):
        return None
    leaves = []
    for x, y in zip(here[0], there[0]):
        if np.issubdtype(np.asarray(x).dtype, np.floating):
            leaves.append(_on_line(np.asarray(x), np.asarray(y), share))
        elif np.array_equal(x, y):
            leaves.append(x)
        else:
            return None
    return replace(problem.at(dict(values)), simulator=jax.tree.unflatten(here[1], leaves))


def _on_line(x: np.ndarray, y: np.ndarray, share: float) -> np.ndarray:
    """x + share (y - x), in parts: of large tables no other ones of their size are made."""
    result = (1 - share) * x
    if not x.ndim:
        return np.asarray(result + share * y)
    edges = np.linspace(0, len(x), PARTS + 1).astype(int)
    for first, last in itertools.pairwise(edges):
        result[first:last] += share * y[first:last]
    return result


def rebuilt_once(problem: Problem) -> bool:
    """Whether tables are rebuilt at only one move of an input."""
    return problem.rebuild is not None and problem.simulator.horizon > LONG
