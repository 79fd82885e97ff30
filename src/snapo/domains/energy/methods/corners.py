"""Nodes around levels between them, and their weights."""

import numpy as np

from ..core.contract import ContractLayout


def flow_signs(layout: ContractLayout) -> np.ndarray:
    """[levels] 1, or -1 for a level that flows move against the first level that they move."""
    signs = np.ones(len(layout.levels), int)
    for flow in layout.flows:
        touched = np.flatnonzero(flow.effects)
        if len(touched) > 1:
            first = signs[touched[0]] * np.sign(flow.effects[touched[0]])
            signs[touched] = first * np.sign(np.array(flow.effects)[touched])
    return signs


def corners(nodes, levels: np.ndarray, signs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of nodes [corners, points] around levels [points, levels], and their weights.

    Cells are cut into simplices along the flows, so that a function between nodes is linear along
    every flow, and the best volumes lead to nodes.
    """
    count, sizes = len(levels), [len(x) for x in nodes]
    if not sizes:
        return np.zeros((1, count), int), np.ones((1, count))
    lefts, shares = [], []
    for x, level, sign in zip(nodes, levels.T, signs):
        position = np.interp(level, x, np.arange(len(x), dtype=float))
        left = np.minimum(position.astype(int), max(len(x) - 2, 0))
        share = position - left
        lefts.append(left if sign > 0 else np.minimum(left + 1, len(x) - 1))
        shares.append(share if sign > 0 else 1 - share)
    order, share = np.argsort(-np.stack(shares), axis=0, kind="stable"), np.stack(shares)
    corner, highest = np.stack(lefts), np.array(sizes)[:, None] - 1
    sorted_shares = np.take_along_axis(share, order, axis=0)
    ends = np.concatenate([np.ones((1, count)), sorted_shares, np.zeros((1, count))])
    rows, everyone = [corner.copy()], np.arange(count)
    for axis in order:
        corner[axis, everyone] += signs[axis]
        rows.append(corner.copy())
    inside = [np.clip(row, 0, highest) for row in rows]
    return np.stack([np.ravel_multi_index(tuple(x), sizes) for x in inside]), -np.diff(ends, axis=0)
