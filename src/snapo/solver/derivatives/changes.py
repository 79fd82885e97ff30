"""Standard errors of an objective's derivatives: each block of paths is left out in turn.

The derivative of a functional of all paths is D = sum_i w_i dX_i, and the weights depend on all
paths too: they are normalised, ranked or measured from a mean. A block's part of that sum does not
vary as D does: with dX = 1 the derivative of a tail mean is one for any paths. Without block b the
derivative is D_b = sum_{i not in b} w_i^b dX_i, where w^b are the weights of the paths that are
left; the scatter of D_b is that of D (Shao and Wu, A general theory for jackknife variance
estimation, 1989; blocks of different sizes: Busing, Meijer and van der Leeden, Delete-m jackknife
for unequal m, 1999).

This needs no further adjoint pass for each block. With N / (N - n_b) times the old weights the new
sum follows from the blocks' parts; the rest of the change is, to first order, the same few
functions of the paths for every block, times a number (the shift of a mean, of a quantile): the
largest ones are kept, and each is pulled back once, on a sample of paths.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snapo.problem.objective import Objective, Weights

ENOUGH = 512  # paths on which the common changes of the weights are pulled back
FURTHER = 3  # changes kept in addition to that of the weights' sum
SMALL, NOTHING = 0.05, 1e-12  # relative: of a further change that is left out, and of round-off


class BlockPlan(NamedTuple):
    """The weights of all paths, in the order of the blocks, and their changes.

    - `total`: {output: [N]} the weights; `sizes`: [B] the sizes of the blocks.
    - `sample`: [R] positions of paths; `blocks`: K pieces of weights {output: [R]} on these paths.
    - `parts`: [B, K] how much of each piece is added to the weights if a block is left out.
    """

    total: Weights
    sizes: np.ndarray
    sample: np.ndarray
    blocks: list[Weights]
    parts: np.ndarray

    def estimate(self, sums: np.ndarray, further: np.ndarray) -> np.ndarray:
        """[B, *shape] numbers whose mean is the derivative and whose spread gives its error.
        `sums`: the sums of w_i dX_i by block [B, *shape]; `further`: the sums for the pieces [K,
        *shape].
        """
        blocks, shape = len(sums), (len(sums), *(1,) * (sums.ndim - 1))
        value = sums.sum(0)
        if blocks < 2:
            return np.broadcast_to(value, sums.shape)
        times = self.sizes.sum() / self.sizes.reshape(shape)
        left = (value - sums) * times / (times - 1)
        left = left + np.tensordot(self.parts, further, axes=1)
        apart = (times - 1) * (value - left)
        apart = (apart - apart.mean(0)) * np.sqrt((blocks - 1) / (times - 1))
        return value + apart - apart.mean(0)


def plan(objective: Objective, totals: Weights, sizes: Sequence[int]) -> BlockPlan:
    """The change of the weights of these totals without each block; blocks are contiguous."""
    complete, endpoints = objective.weights(totals), np.cumsum(sizes)
    none = BlockPlan(complete, np.asarray(sizes), np.zeros(0, int), [], np.zeros((len(sizes), 0)))
    if objective.linear or len(sizes) < 2:
        return none
    names = list(complete)
    change = _changes(objective, totals, complete, endpoints)
    size = np.sqrt(np.mean(change**2, axis=0))
    largest = max(np.max(np.abs(weight)) for weight in complete.values())
    if not np.max(size) > NOTHING * largest:
        return none
    room = max(int(sizes[0]), min(int(endpoints[-1]), ENOUGH))
    sample, value = _sample(size.sum(0), room)
    owners = np.searchsorted(endpoints, sample, side="right")
    parts, segments = _common(change, size, sample, value, owners)
    split = [dict(zip(names, piece)) for piece in segments]
    return none._replace(sample=sample, blocks=split, parts=parts)


def _changes(objective: Objective, totals, weights: Weights, endpoints: np.ndarray) -> np.ndarray:
    """[B, outputs, N]: weights without block b, minus N / (N - n_b) times the old ones."""
    names, count = list(weights), int(endpoints[-1])
    change = np.zeros((len(endpoints), len(names), count))
    for b, (first, last) in enumerate(zip([0, *endpoints[:-1]], endpoints)):
        selected = np.r_[0:first, last:count]
        left = objective.weights({name: total[selected] for name, total in totals.items()})
        for k, name in enumerate(names):
            change[b, k, selected] = left[name] - weights[name][selected] * (count / len(selected))
    return change


def _sample(size: np.ndarray, room: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions of paths, where paths that change more are drawn more often, and how many each
    represents.

    Systematic sampling with probabilities in proportion to `size` [N], at most one.
    """
    probability = np.zeros(len(size))
    certain = np.zeros(len(size), bool)
    while True:
        rest = size[~certain].sum()
        probability[certain] = 1.0
        probability[~certain] = (
            size[~certain] * ((room - certain.sum()) / rest) if rest > 0 else 0.0
        )
        if not np.any(probability > 1 + NOTHING):
            break
        certain |= probability >= 1
    steps = np.floor(np.cumsum(np.minimum(probability, 1.0)) + 0.5)
    taken = np.diff(steps, prepend=0.0) > 0
    # As many paths as there is room for: those without a change fill it.
    spare = np.flatnonzero(~taken)[: max(0, room - int(taken.sum()))]
    sample = np.union1d(np.flatnonzero(taken), spare)
    value = np.where(taken, 1 / np.where(taken, probability, 1.0), 0.0)[sample]
    return sample, value


def _common(change, size, sample, value, groups) -> tuple[np.ndarray, np.ndarray]:
    """`parts` [B, K] and `segments` [K, outputs, R] whose product is nearly the change.

    The sum of the change over paths is kept exactly, in one piece for each output that changes.
    """
    blocks, outputs = change.shape[:2]
    sums = change.sum(2)
    shape = size[:, sample] * value
    norm = shape.sum(1)
    selected = np.flatnonzero(norm > 0)
    segments = np.zeros((len(selected), outputs, len(sample)))
    segments[np.arange(len(selected)), selected] = shape[selected] / norm[selected, None]
    observed = _filled(change[:, :, sample], groups) * value
    rest = observed - np.tensordot(observed.sum(2)[:, selected], segments, axes=1)
    # Singular vectors, from the small matrix of the blocks' products.
    rest = rest.reshape(blocks, -1)
    squares, vectors = np.linalg.eigh(rest @ rest.T)
    leading = np.flatnonzero(squares > (SMALL * np.linalg.norm(observed)) ** 2)[-FURTHER:]
    left = vectors[:, leading]
    parts = np.concatenate([sums[:, selected], left], 1)
    right = (left.T @ rest).reshape(len(leading), outputs, len(sample))
    return parts, np.concatenate([segments, right])


def _filled(change: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """[B, outputs, R] with a number for the one block of each path that has none, its own.

    To first order the changes of a path add up to zero over the blocks.
    """
    filled = change.copy()
    maximum = np.max(np.abs(change), axis=0)
    paths = np.arange(len(groups))
    filled[groups, :, paths] = np.clip(-np.sum(change, axis=0), -maximum, maximum).T
    return filled
