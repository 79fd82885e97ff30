"""Idle levels: levels whose limits no plan can reach, so that nothing depends on them.

Idle levels have one node. If they had a node for each volume, the grids of other levels would be
coarser.
"""

from typing import Any

import numpy as np

from ..core.contract import ContractLayout, MoveLimits, StepTerms

NEAR = 1e-9  # of the largest volume


def idle_levels(
    layout: ContractLayout, terms: StepTerms, intervals: Any, start: np.ndarray
) -> tuple[bool, ...]:
    """[levels] whether a level is idle; no level is if levels have money or joint obligations."""
    if layout.banks or terms.promises is not None or terms.of_levels is not None:
        return (False,) * len(layout.levels)
    numbers, count = (layout, terms, intervals), len(layout.levels)
    needed = () if terms.falling is None else (0, count - 1)
    return tuple(i not in needed and _idle(*numbers, float(start[i]), i) for i in range(count))


def _idle(layout: ContractLayout, terms: StepTerms, intervals: Any, start: float, i: int) -> bool:
    if np.any(terms.short[:, i]):
        return False
    if terms.of_moves is not None:
        low, high = (x[:, :, i] for x in terms.of_moves)
        if np.any(low > terms.low[:, None, i]) or np.any(high < terms.high[:, None, i]):
            return False
    near = NEAR * max(1.0, float(np.max(np.abs(terms.most), initial=0.0)))
    first = last = start
    for t in range(len(terms.low)):
        change = extremes(layout, terms, t, i)
        first, last = first + min(change.min(), 0.0), last + max(change.max(), 0.0)
        low, high = intervals.next_low[t, i], intervals.next_high[t, i]
        if first < low - near or last > high + near:
            return False
        if terms.restarts[t, i]:
            first = last = 0.0
    return True


def at_rest(layout: ContractLayout, idle: tuple[bool, ...]) -> ContractLayout:
    """The layout in which no flow and no move changes these levels."""
    return _with_numbers(layout, lambda x: tuple(0.0 if y else z for y, z in zip(idle, x)))


def without(layout: ContractLayout, terms: StepTerms, intervals: Any, idle: tuple[bool, ...]):
    """The layout, terms and intervals without the idle levels."""
    keep = np.flatnonzero(~np.array(idle, bool))

    def of(numbers: Any) -> Any:
        return numbers[:, keep]

    reduced = _with_numbers(layout, lambda x: tuple(x[i] for i in keep))
    names = "low", "high", "owed", "short", "restarts"
    terms = terms._replace(**{name: of(getattr(terms, name)) for name in names})
    if terms.of_moves is not None:
        terms = terms._replace(of_moves=MoveLimits(*(x[..., keep] for x in terms.of_moves)))
    levels = tuple(layout.levels[i] for i in keep)
    return reduced._replace(levels=levels), terms, type(intervals)(*map(of, intervals))


def with_idle(columns: list, start: np.ndarray, restarts: np.ndarray, idle: tuple[bool, ...]):
    """The nodes of all levels, at the start of each step [T + 1] and after each step [T]."""
    others, result = iter(columns), []
    for i, rests in enumerate(idle):
        if not rests:
            result.append(next(others))
            continue
        restarted = np.append(0, np.cumsum(restarts[:, i])) > 0
        nodes = [np.array([0.0 if ended else start[i]]) for ended in restarted]
        result.append((nodes, nodes[:-1]))
    return result


def extremes(layout: ContractLayout, terms: Any, t: int, i: int) -> np.ndarray:
    """The changes of a level in a step, for the smallest and the largest volume of each flow."""
    result: set[float] = set()
    for move in layout.every_move:
        if all(terms.least[t, flow] <= 0 for flow in move.flows):
            result.add(move.changes[i])
        for flow in move.flows:
            effect = layout.flows[flow].effects[i]
            ends = terms.least[t, flow], terms.most[t, flow]
            result |= {move.changes[i] + effect * volume for volume in ends}
    return np.array(sorted(result))


def _with_numbers(layout: ContractLayout, numbers_of: Any) -> ContractLayout:
    return layout._replace(
        flows=tuple(flow._replace(effects=numbers_of(flow.effects)) for flow in layout.flows),
        moves=tuple(move._replace(changes=numbers_of(move.changes)) for move in layout.moves),
    )
