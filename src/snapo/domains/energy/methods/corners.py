"""The nodes around levels between nodes, and their weights."""

from collections.abc import Sequence

import numpy as np


def corners(nodes, levels: np.ndarray, signs: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of the nodes [corners, points] around levels [points, levels], and the weights
    of these nodes.

    Cells are cut into simplices along the flows, so that an interpolated function is piecewise
    linear along every flow, with kinks only where a level is on a node. The best volumes therefore
    lead to levels on nodes.
    """
    ahead, count, sizes = np.array(signs), len(levels), [len(x) for x in nodes]
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
        corner[axis, everyone] += ahead[axis]
        rows.append(corner.copy())
    inside = [np.clip(row, 0, highest) for row in rows]
    return np.stack([np.ravel_multi_index(tuple(x), sizes) for x in inside]), -np.diff(ends, axis=0)
