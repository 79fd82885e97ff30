"""The common measure of the volumes of a contract, and the spacing of nodes if that measure is too
small. The common measure is the largest number of which all volumes are multiples.
"""

from collections.abc import Iterable
from fractions import Fraction
from functools import reduce
from math import ceil, gcd, lcm, prod, sqrt

import numpy as np

from ..core.contract import ContractLayout

COUNTED, BALANCES = 400, (5, 65)  # most nodes of a level with a bank; and of its balance
ROUND_OFF = 1e-9  # of a count
DIGITS = 10**7  # largest denominator of a volume that counts as a fraction


def measures_of(layout: ContractLayout, terms, start) -> list[float | None]:
    """The common divisor of all volumes of each level; levels that a flow joins have the same
    divisor."""
    result: list[float | None] = [None] * len(layout.levels)
    for group in joined_levels(layout):
        volumes: set[float] = set()
        for i in group:
            volumes.add(float(start[i]))
            volumes |= {move.changes[i] for move in layout.every_move}
            limits = [terms.low[:, i], terms.high[:, i], terms.owed[:, i]]
            limits += [x[:, :, i] for x in terms.of_moves or ()]
            limits += [] if i else list(terms.falling or ())
            for numbers in limits:
                volumes |= set(np.unique(numbers[np.isfinite(numbers)]).tolist())
            for flow in range(len(layout.flows)):
                effect = layout.flows[flow].effects[i]
                for numbers in (terms.least[:, flow], terms.most[:, flow]):
                    volumes |= set(np.unique(effect * numbers).tolist())
        found = common_measure(volumes)
        for i in group:
            result[i] = found
    return result


def joined_levels(layout: ContractLayout) -> list[set[int]]:
    """The levels in groups; no flow moves levels of two groups."""
    groups = [{i} for i in range(len(layout.levels))]
    if layout.banks:  # units of the first level become its balances
        counted = len(layout.levels) - layout.banks
        groups = [{0, *range(counted, len(layout.levels))}, *groups[1:counted]]
    for flow in layout.flows:
        touched = {i for i, effect in enumerate(flow.effects) if effect}
        if touched:
            joined = set().union(touched, *(g for g in groups if g & touched))
            groups = [g for g in groups if not g & touched] + [joined]
    return groups


def node_widths(layout: ContractLayout, widest, measures, apart, nodes: float) -> list[float]:
    """The spacing of the levels with which there are at most `nodes` evenly spaced nodes; a
    multiple of the common measure, if there is one. Levels that share flows have the same spacing,
    so that a flow goes from node to node in all of them; between nodes the value would be
    interpolated. `apart`: the smallest spacing of each level."""
    widths = [1.0] * len(widest)
    for group in joined_levels(layout):
        members = sorted(group)
        unit, sides = measures[members[0]] or 0.0, [widest[i] for i in members]
        count = nodes ** (len(members) / len(widest)) * (1 + ROUND_OFF)
        width = max(max(sides) / count, *(apart[i] for i in members)) or 1.0
        while True:
            width = unit * max(ceil(width / unit - ROUND_OFF), 1) if unit else width
            if prod(side / width + 1 for side in sides) <= count:
                break
            width *= 1.01
        for i in members:
            widths[i] = width
    return widths


def banked_widths(visited, measures, apart, nodes: float) -> list[float]:
    """The spacing of a counted level and its balances, if they have too many nodes together.

    Flows move only the counted level, so its nodes are multiples of the measure if there are few
    enough of them. Balances change once a period; they have as many nodes as `nodes`, the total of
    all steps, allows. `visited`: the minimum and maximum of all levels at all steps.
    """
    unit = measures[0] or 0.0
    widest = [float(np.max(high - low)) for low, high in visited]
    counted = max(unit, widest[0] / COUNTED, apart[0]) or 1.0
    low, high = visited[0]
    free = sum((upper > lower).astype(int) for lower, upper in visited[1:])
    # Nodes of the counted level at all steps with one balance that is not fixed, and with two.
    every = (high - low) / counted + 1
    counts = [float(np.sum(every[free == k])) for k in range(1, len(visited))]
    many = _times(counts, nodes)
    gaps = min(max(many, BALANCES[0]), BALANCES[1]) - 1
    balances = [max(unit, x / gaps, y) or 1.0 for x, y in zip(widest[1:], apart[1:])]
    return [unit * ceil(x / unit - ROUND_OFF) if unit else x for x in (counted, *balances)]


def _times(counts: list[float], nodes: float) -> float:
    """The number n for which n counts[0] + n^2 counts[1] is `nodes`."""
    first, second = [*counts, 0.0][:2]
    if not second:
        return nodes / max(first, 1.0)
    return (sqrt(first**2 + 4 * second * nodes) - first) / (2 * second)


def common_measure(volumes: Iterable[float]) -> float | None:
    """The largest number of which all volumes are multiples; None if they are not simple
    fractions."""
    sizes = [abs(x) for x in volumes if x]
    fractions = [Fraction(x).limit_denominator(DIGITS) for x in sizes]
    if not sizes:
        return 1.0
    if any(abs(float(part) - x) > 1e-12 * x for part, x in zip(fractions, sizes)):
        return None
    below = reduce(lcm, (f.denominator for f in fractions))
    return reduce(gcd, (int(f * below) for f in fractions)) / below
