"""The best numbers of a classical rule, by trying neighbours on common paths."""

from collections.abc import Callable, Sequence


def search(
    cost: Callable[[tuple[float, ...]], float],
    start: Sequence[float],
    step: float,
    least: float,
    most: int = 300,
) -> tuple[float, ...]:
    """The numbers at which `cost` is smallest, among points of a grid of width `least`.

    Moves by `step` along every number, and of two along both diagonals, while that helps, then by
    half, down to `least`; at most `most` costs are asked for.
    """
    seen: dict[tuple[float, ...], float] = {}

    def of(point: tuple[float, ...]) -> float:
        if point not in seen:
            seen[point] = cost(point)
        return seen[point]

    best = tuple(least * round(x / least) for x in start)
    while step >= least and len(seen) < most:
        grid = max(1, round(step / least)) * least
        near = [tuple(x + grid * d for x, d in zip(best, way)) for way in _ways(len(best))]
        found = min(near, key=of)
        if of(found) < of(best):
            best = found
        else:
            step = grid / 2 if grid > least else 0.0
    return best


def _ways(size: int) -> list[tuple[int, ...]]:
    """Every neighbour of a point of two numbers; of others, those along one number."""
    if size != 2:
        each = range(size)
        return [tuple(way * (i == j) for j in each) for i in each for way in (1, -1)]
    return [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
