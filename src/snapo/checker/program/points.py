"""Moments of the recorded runs at which a method is evaluated: many points, in one call."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.problem.simulator import Simulator
from snapo.problem.smooth import Smooth

from ..rollout import CheckedRollout
from .methods import Method, methods, preparation
from .watch import Change, Observed, Watched, tainted_by

POINTS, PATHS, STEPS = 2048, 8, 256  # at most; paths of each run


class SamplePoints:
    """A method's program, and its arguments at [steps * paths] points in order of the steps.

    - `moving`: of each argument, whether it differs from point to point.
    - `steps`: how many steps the points are of.
    """

    def __init__(
        self,
        method: Method,
        recorded: dict[str, Any],
        steps: int,
        tainted: dict[str, list[bool]] | None = None,
    ):
        self.method, self.steps = method, steps
        self.arguments: list[Any] = []
        self.moving: list[bool] = []
        dirty: list[bool] = []
        for name, tree in method.arguments.items():
            leaves = jax.tree.leaves(recorded.get(name, tree))
            self.arguments += leaves
            self.moving += [name in recorded] * len(leaves)
            dirty += (tainted or {}).get(name, [name in ("state", "action")] * len(leaves))
        self.recorder = Watched(method.traced(), dirty)
        axes = tuple(0 if moves else None for moves in self.moving)
        changed = Change(None, 0, None, None)  # pyright: ignore[reportArgumentType]
        self.compiled = jax.jit(jax.vmap(self.recorder, (axes, changed)))

    @cached_property
    def met(self) -> Observed:
        """All that is met at all points."""
        return self.observe(self.arguments)

    def observe(self, arguments: Sequence[Any], change: Change | None = None) -> Observed:
        """All that is met at these arguments; the truths of a change have an entry a point."""
        if change is None:
            many = next(len(x) for x, moves in zip(arguments, self.moving) if moves)
            change = self.recorder.nothing(many)
        return jax.tree.map(np.asarray, self.compiled(tuple(arguments), change))

    def some(self, which: np.ndarray) -> list[Any]:
        """The arguments of some of the points."""
        return [x[which] if moves else x for x, moves in zip(self.arguments, self.moving)]


def moments(
    simulator: Simulator, inputs: PyTree, runs: Sequence[CheckedRollout]
) -> Iterator[SamplePoints]:
    """Every method at the inputs and at moments of the runs."""
    run, times = runs[0], _times(simulator.horizon)
    paths = min(PATHS, run.draws.size, max(2, POINTS // (len(runs) * len(times))))
    made = preparation(simulator, inputs)
    alone = jax.tree.map(lambda x: jnp.asarray(x)[None], made.arguments)
    yield SamplePoints(made, alone, 1)

    smooth = Smooth(jnp.asarray(run.smooth.temperature, float))
    initial, observe, step, terminal = methods(simulator, run.schedule, smooth)
    yield SamplePoints(initial, {"noise": jnp.asarray(run.draws.initial_noise[:paths])}, 1)

    by_inputs = _tainted(made, run.schedule)
    recorded = {
        "state": _joined([item.states for item in runs], times, paths),
        "action": _joined([entry.actions for entry in runs], times, paths),
        "noise": _joined([value.draws.step_noise for value in runs], times, paths),
        "now": jax.tree.map(
            lambda x: jnp.repeat(jnp.asarray(x)[times], len(runs) * paths, 0), run.schedule.steps
        ),
    }
    yield SamplePoints(observe, {name: recorded[name] for name in ("now", "state")}, len(times))
    stepped = SamplePoints(step, recorded, len(times), by_inputs)
    yield stepped
    # The state after the last step is not recorded: it is made again.
    last = np.arange((len(times) - 1) * len(runs) * paths, len(times) * len(runs) * paths)
    leaves, tree = jax.tree.flatten(step.arguments["state"])
    after = stepped.observe(stepped.some(last)).results
    endpoints = jax.tree.unflatten(tree, [jnp.asarray(after[k]) for k in range(len(leaves))])
    yield SamplePoints(terminal, {"state": endpoints}, 1, by_inputs)


def _tainted(made: Method, schedule: Any) -> dict[str, list[bool]]:
    """Of the leaves of `constants` and `now`, whether inputs move them."""
    result = iter(tainted_by(made.function, *made.arguments.values()))
    parts = (("constants", schedule.constants), ("now", schedule.steps))
    return {name: [next(result) for _ in jax.tree.leaves(tree)] for name, tree in parts}


def _times(horizon: int) -> np.ndarray:
    """All steps, or some of many, the first and the last among them."""
    return np.unique(np.linspace(0, horizon - 1, min(horizon, STEPS)).astype(int))


def _joined(trees: Sequence[Any], times: np.ndarray, paths: int) -> Any:
    """Recorded arrays [T, paths, ...] of the runs as one [times * runs * paths, ...]."""

    def joined(*leaves):
        taken = np.concatenate([np.asarray(x)[times][:, :paths] for x in leaves], 1)
        steps, many, *rest = taken.shape  # without noise the last is 0
        return jnp.asarray(taken.reshape(steps * many, *rest))

    return jax.tree.map(joined, *trees)
