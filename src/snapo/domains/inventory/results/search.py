"""The best numbers of a classical rule, by trying neighbours on common paths."""

from collections.abc import Callable, Sequence


def search(
    cost: Callable[[tuple[float, ...]], float],
    start: Sequence[float],
    step: float,
    least: float,
    most: int = 300,
    together: Sequence[tuple[int, int]] = (),
) -> tuple[float, ...]:
    """The numbers at which `cost` is smallest, among points of a grid of width `least`.

    Moves by `step` along every number, and of two along both diagonals, while that helps, then by
    half, down to `least`; at most `most` costs are asked for.

    - `together`: of more than two numbers, pairs that move along their diagonals too.
    """
    seen: dict[tuple[float, ...], float] = {}

    def of(point: tuple[float, ...]) -> float:
        if point not in seen:
            seen[point] = cost(point)
        return seen[point]

    ways = _ways(len(start), together)
    best = tuple(least * round(x / least) for x in start)
    while step >= least and len(seen) < most:
        grid = max(1, round(step / least)) * least
        near = [tuple(x + grid * d for x, d in zip(best, way)) for way in ways]
        found = min(near, key=of)
        if of(found) < of(best):
            best = found
        else:
            step = grid / 2 if grid > least else 0.0
    return best


def _ways(size: int, together: Sequence[tuple[int, int]]) -> list[tuple[int, ...]]:
    """Every neighbour of a point of two numbers; of others, those along one number, and along the
    diagonals of the pairs that move together."""
    if size == 2:
        return [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
    found = [{i: way} for i in range(size) for way in (1, -1)]
    found += [{i: a, j: b} for i, j in together for a in (1, -1) for b in (1, -1)]
    return [tuple(way.get(i, 0) for i in range(size)) for way in found]
