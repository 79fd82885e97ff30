"""The native engine: `values` and `adjoint` by kernels compiled for simulator and processor."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar

import jax
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, PyTree

from snapo.lanes.machine.threads import cores
from snapo.problem.noise import Draws
from snapo.problem.policy import Policy
from snapo.problem.simulator import Schedule, Simulator

from ..arrays import adjoint_without, values_without
from ..base import Adjoint, Clip, Engine, Rollout, Window
from .call import NativeCall
from .distributed import Distributed
from .runtime import SUMS, KernelInputs, KernelOutputs, Runner


@dataclass(frozen=True)
class Native(Engine):
    """Rollouts by one compiled kernel per problem: lanes of paths through all steps and back.

    **Arguments:**

    - `precision`: "float32" (training) or "float64" (values and sensitivities).
    - `threads`: None uses every processor available to this process.
    - `distributed`: workers that compute groups of paths, where that saves time. Results depend
      neither on threads nor on workers.

    Results are NumPy arrays. Raises `Unsupported` if a simulator or policy uses something that
    cannot be compiled, or if nothing can be compiled (`unavailable`).
    """

    threads: int | None = None
    distributed: Distributed | None = field(default=None, repr=False)
    steady: ClassVar[bool] = True

    def values(
        self,
        simulator: Simulator,
        policy: Policy | None,
        schedule: Schedule,
        draws: Draws,
        smooth,
        *,
        actions: Float[Array, "T N A"] | None = None,
        record: tuple[str, ...] = (),
        window: Window | None = None,
        start: PyTree = None,
    ) -> Rollout:
        with self.numbers():
            call = NativeCall(
                self, simulator, policy, schedule, draws, smooth, actions, window, start
            )
            runner = call.runner(False, tuple(record), False, ())
            out = self._run(runner, call.inputs(runner, None, None, bool(record)))
            totals, state = call.finals(runner, out.final)
            rollout = Rollout(totals, state, call.recorded(runner, out.records, tuple(record)))
            return values_without(simulator, call.simulator, rollout)

    def adjoint(
        self,
        simulator: Simulator,
        policy: Policy | None,
        schedule: Schedule,
        draws: Draws,
        smooth,
        weights: dict[str, Float[Array, "*K N"]],
        *,
        actions: Float[Array, "T N A"] | None = None,
        clip: Clip | None = None,
        window: Window | None = None,
        start: PyTree = None,
        wrt: tuple[str, ...] = ("policy", "schedule", "start"),
    ) -> Adjoint:
        with self.numbers():
            call = NativeCall(
                self, simulator, policy, schedule, draws, smooth, actions, window, start
            )
            runner = call.runner(True, (), clip is not None, tuple(wrt))
            stacked = any(np.ndim(w) == 2 for w in weights.values())
            count = max(np.shape(w)[0] if np.ndim(w) == 2 else 1 for w in weights.values())
            arrays = {
                name: np.broadcast_to(np.asarray(w, self.dtype), (count, call.paths))
                for name, w in weights.items()
            }
            bounds = (clip or Clip()).bounds(arrays)
            rows, maximum = [], runner.together(call.paths, call.window.length)
            for first in range(0, count, maximum):
                part = {name: w[first : first + maximum] for name, w in arrays.items()}
                out = self._run(runner, call.inputs(runner, part, bounds, False))
                rows += [call.gradients(runner, back) for back in out.back]
            totals, _ = call.finals(runner, out.final)
            gradient = jax.tree.map(lambda *x: np.stack(x), *rows) if stacked else rows[0]
            values = dict(zip(("policy", "schedule", "start"), gradient))
            request = (values[name] if name in wrt else None for name in values)
            return adjoint_without(simulator, call.simulator, Adjoint(totals, *request))

    def adjoints(
        self,
        simulator: Simulator,
        policy: Policy | None,
        schedule: Schedule,
        draws: Draws,
        smooth,
        weights: Mapping[str, ArrayLike],
        parts: Sequence[int],
        *,
        actions: ArrayLike | None = None,
        wrt: tuple[str, ...] = ("policy", "schedule", "start"),
    ) -> Adjoint:
        values = simulator, policy, schedule, draws, smooth
        with self.numbers():
            call = NativeCall(self, *values, actions, None, None)
            runner = call.runner(True, (), False, tuple(wrt))
            if len(parts) * sum(runner.sums(simulator.horizon)) > SUMS:
                return super().adjoints(*values, weights, parts, actions=actions, wrt=wrt)
            rows = {name: np.asarray(w, self.dtype)[None] for name, w in weights.items()}
            filled = call.inputs(runner, rows, Clip().bounds(rows), False, parts)
            out = self._run(runner, filled)
            totals, _ = call.finals(runner, out.final)
            moved, schedules, _ = call.gradients(runner, out.back[0])
            request = moved if "policy" in wrt else None, schedules if "schedule" in wrt else None
            return Adjoint(totals, request[0], request[1], None)

    def _run(self, runner: Runner, inputs: KernelInputs) -> KernelOutputs:
        threads = self.threads or cores()
        if self.distributed is None:
            return runner.run(inputs, threads)
        return runner.run(inputs, threads, partial(self.distributed.groups, runner))
