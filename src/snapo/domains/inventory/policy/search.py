"""Searches for the best numbers of a classical rule among neighbours, on common paths."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from snapo.problem.policy import Policy
from snapo.problem.scenarios import EVALUATE, Pseudo, Sources, stream
from snapo.solver.evaluate import path_totals, value_of
from snapo.study.study import Setup

SEARCH_PATHS = 4096
OTHER_PATHS = stream(EVALUATE, 1)  # of the scenarios on which rules look for their numbers


def search(
    cost: Callable[[tuple[float, ...]], float],
    start: Sequence[float],
    step: float,
    minimum: float,
    maximum: int = 300,
    together: Sequence[tuple[int, int]] = (),
) -> tuple[float, ...]:
    """The numbers at which `cost` is smallest, among points of a grid of width `minimum`.

    The search moves by `step` along every number, and for two numbers also along both diagonals,
    while the cost falls. It then halves the step, down to `minimum`. At most `maximum` costs are
    computed.

    - `together`: pairs of numbers for which the search also moves along diagonals, if there are
      more than two numbers.
    """
    costs: dict[tuple[float, ...], float] = {}

    def of(point: tuple[float, ...]) -> float:
        if point not in costs:
            costs[point] = cost(point)
        return costs[point]

    steps = _steps(len(start), together)
    best = tuple(minimum * round(x / minimum) for x in start)
    while step >= minimum and len(costs) < maximum:
        grid = max(1, round(step / minimum)) * minimum
        near = [tuple(x + grid * d for x, d in zip(best, direction)) for direction in steps]
        neighbour = min(near, key=of)
        if of(neighbour) < of(best):
            best = neighbour
        else:
            step = grid / 2 if grid > minimum else 0.0
    return best


def _steps(size: int, together: Sequence[tuple[int, int]]) -> list[tuple[int, ...]]:
    """The neighbours of a point: all of them if it has two numbers; otherwise those along one
    number, and along the diagonals of the pairs that move together."""
    if size == 2:
        return [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
    steps = [{i: step} for i in range(size) for step in (1, -1)]
    steps += [{i: a, j: b} for i, j in together for a in (1, -1) for b in (1, -1)]
    return [tuple(step.get(i, 0) for i in range(size)) for step in steps]


def cost_on_other_paths(setup: Setup) -> Callable[[Policy], float]:
    """The cost of a rule on scenarios other than those of its value, for the search."""
    sources, seed = setup.problem.sources, setup.training.seed
    other = Sources(sources.training, sources.validation, Pseudo(seed, stream=OTHER_PATHS))
    problem = replace(setup.problem, sources=other)

    def cost(rule: Policy) -> float:
        totals = path_totals(problem, rule, SEARCH_PATHS, engine=setup.engines.evaluate)
        return -value_of(problem.objective, totals)

    return cost
