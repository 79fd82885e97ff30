"""Comparisons at which an output or the state jumps: the smooth derivative does not see the jump.

Two points of the same step, on either side of a comparison, are brought together until they meet
at the threshold. There the method is evaluated with the comparison true, and with it false: at a
corner both agree.
"""

from typing import Any, NamedTuple

import jax
import numpy as np

from .findings import Notes
from .watch import SamplePoints

PAIRS, ROUNDS = 6, 52  # pairs of points of each comparison; halvings of the way between them
MINIMUM = 1e-4  # a jump, of the largest value of its result
FLAG = 3  # a state with at most this number of values, all whole, is a flag, which is unchanged


class Jump(NamedTuple):
    """The result that jumps, and the size of the jump."""

    name: str
    size: float


def jumps(notes: Notes, points: SamplePoints) -> None:
    """Comparisons in `step` or `terminal` that make an output or the state jump, as warnings."""
    recorder, reported = points.recorder, set()
    candidates = [
        k
        for k, comparison in enumerate(recorder.comparisons)
        if comparison.line and not comparison.line.internal
    ]
    if points.method.name not in ("step", "terminal") or not candidates:
        return
    observed = points.met
    held = [not moves or _held(x) for x, moves in zip(points.arguments, points.moving)]
    for number in candidates:
        line = recorder.comparisons[number].line
        first, second = _sides(observed.truths[number], points.steps)
        if not first.size or line in reported:
            continue
        largest = _largest(points, number, first, second, held, observed.results)
        if largest is not None and line is not None:
            reported.add(line)
            notes.warning(
                f"{points.method.name}, {line}",
                f"A comparison makes {largest.name} jump, by {largest.size:.4g} on a path: "
                f"training and derivatives ignore the jump. In: {line.text}",
                "Write smooth.indicator(a - b, scale) instead of a > b, or smooth.choose instead "
                "of jnp.where; use snapo.Choice to draw a decision that makes a jump.",
            )


def _held(x: Any) -> bool:
    """Whether an argument is unchanged between the two points: whole numbers, and flags kept as
    floats."""
    x = np.asarray(x)
    if x.dtype.kind != "f":
        return True
    values = np.unique(x)
    return values.size <= FLAG and bool(np.all(values == np.round(values)))


def _sides(truth: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of points of the same step in which a comparison differs."""
    by_step = truth.reshape(steps, len(truth) // steps, int(np.prod(truth.shape[1:], initial=1)))
    many, pairs = by_step.shape[1], []
    for shift in range(1, many):
        step, path = np.nonzero((by_step != np.roll(by_step, -shift, 1)).any(2))
        pairs += zip(step * many + path, step * many + (path + shift) % many)
        if len(pairs) > 16 * PAIRS:
            break
    if not pairs:
        return np.zeros(0, int), np.zeros(0, int)
    selected = np.linspace(0, len(pairs) - 1, min(PAIRS, len(pairs))).astype(int)
    # Always the same number, so that nothing is recompiled.
    first, second = np.array(pairs)[np.resize(selected, PAIRS)].T
    return first, second


def _largest(points: SamplePoints, number: int, first, second, held, results) -> Jump | None:
    """The largest jump of any result at the threshold, if there is one."""
    near, far = points.some(first), points.some(second)
    far = [x if stays else y for x, y, stays in zip(near, far, held)]
    one, other = points.observe(near).truths[number], points.observe(far).truths[number]
    for _ in range(ROUNDS):
        middle = [x if stays else (x + y) / 2 for x, y, stays in zip(near, far, held)]
        truth = points.observe(middle).truths[number]
        left = (truth == one).all(tuple(range(1, truth.ndim)))
        near, far = (
            [x if stays else _chosen(m, x, take) for x, m, stays in zip(side, middle, held)]
            for side, take in ((near, left), (far, ~left))
        )
        other = np.where(left.reshape(-1, *[1] * (truth.ndim - 1)), other, truth)
    at = points.recorder.nothing(len(first))
    truths = list(at.truths)
    sides = []
    for truth in (one, other):
        truths[number] = truth
        change = at._replace(comparison=np.int32(number), truths=list(truths))
        sides.append(points.observe(near, change).results)
    return max(_of_results(points, sides, results), key=lambda jump: jump[0], default=(0, None))[1]


def _chosen(new: Any, old: Any, take: np.ndarray) -> Any:
    return np.where(take.reshape(-1, *[1] * (np.ndim(new) - 1)), new, old)


def _of_results(points: SamplePoints, sides, results):
    """(size relative to the result, jump) of every result that jumps."""
    for name, one, other, all_values in zip(_names(points), *sides, results):
        if one.dtype.kind != "f":
            continue
        finite = np.abs(all_values[np.isfinite(all_values)])
        size = np.nan_to_num(np.abs(one - other), posinf=0.0).max(initial=0.0)
        if size > MINIMUM * finite.max(initial=0.0) and size > 0:
            yield size / finite.max(initial=size), Jump(name, float(size))


def _names(points: SamplePoints) -> list[str]:
    """The results of a method: "state water", "output cash"."""
    made = jax.eval_shape(points.method.function, *points.method.arguments.values())
    parts = [("state", made[0]), ("output", made[1])] if isinstance(made, tuple) else []
    return [
        f"{kind} {jax.tree_util.keystr(path, simple=True, separator='.')}".strip()
        for kind, tree in parts or [("output", made)]
        for path, _ in jax.tree_util.tree_flatten_with_path(tree)[0]
    ]
