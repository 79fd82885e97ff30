"""Arguments of one call as rows of the kernel's memory, and results from its rows."""

import math
from collections import OrderedDict
from collections.abc import Hashable, Sequence
from time import perf_counter
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.lanes import ACCIDENTS, Unsupported, jax_private
from snapo.lanes.machine import pipeline
from snapo.lanes.machine.code_cache import linked_code
from snapo.lanes.machine.linked import KernelMemory
from snapo.lanes.machine.pipeline import host
from snapo.problem.code.version import of_rollout, read_context
from snapo.problem.noise import Counter, Draws
from snapo.problem.policy import Policy
from snapo.problem.simulator import Schedule, Simulator

from ..arrays import with_memory
from ..base import Engine, Window, checked
from .kernel.context import KernelStages
from .kernel.kernel import Kernel, emit
from .rollout import FunctionSetup, SharedTree, cast, traced
from .runtime import Back, KernelInputs, Runner
from .stored import StoredKernel


def unavailable() -> str | None:
    """The reason why nothing can be compiled here, and the remedy; None if it can."""
    missing = pipeline.unavailable()
    if missing is not None:
        return f"{missing} (pip install 'snapo[native]')"
    return jax_private.unavailable()


class Seats(NamedTuple):
    """The path of every lane of all blocks, part by part; the last path of a part is repeated to
    fill its last block.

    - `path`: [blocks x lanes] the number of each lane's path; `inner`: whether the lane counts.
    - `edges`: [parts + 1] the first block of every part, and the number of all blocks.
    """

    path: np.ndarray
    inner: np.ndarray
    edges: np.ndarray

    @classmethod
    def of(cls, sizes: Sequence[int], lanes: int) -> "Seats":
        """The seats for consecutive parts with these numbers of paths."""
        blocks = [-(-size // lanes) for size in sizes]
        starts = np.cumsum([0, *sizes[:-1]])
        slots = [np.arange(count * lanes) for count in blocks]
        path = [
            start + np.minimum(slot, size - 1) for start, slot, size in zip(starts, slots, sizes)
        ]
        inner = [seat < size for seat, size in zip(slots, sizes)]
        return cls(np.concatenate(path), np.concatenate(inner), np.cumsum([0, *blocks]))

    @property
    def blocks(self) -> int:
        """The number of all blocks."""
        return int(self.edges[-1])


KEPT = 64  # compiled kernels in memory
COMPILED = "/snapo/compile"  # event with the compile time of a kernel, like JAX's

_runners: OrderedDict[Any, Runner] = OrderedDict()


def forget_kernels() -> None:
    """Frees the memory of all compiled kernels; their code is on disk."""
    _runners.clear()


class NativeCall:
    """Arguments of one call as rows of the kernel's memory, and results from its rows."""

    def __init__(
        self,
        engine: Engine,
        simulator: Simulator,
        policy: Policy | None,
        schedule: Schedule,
        draws: Draws,
        smooth,
        actions,
        window: Window | None,
        start,
    ):
        simulator, start = with_memory(simulator, policy, actions, start, draws.size)
        self.window = checked(simulator, policy, schedule, draws, actions, window)
        self.engine, self.simulator, self.draws, self.actions = engine, simulator, draws, actions
        self.has_terminal = self.window.is_last(simulator.horizon)
        self.paths = draws.size
        self.start = jax.tree.map(lambda x: cast(x, engine.dtype), start)
        self.version = of_rollout(simulator, policy, schedule, smooth)
        shared = (policy, schedule.constants, smooth, simulator.on_step())
        self.shared = SharedTree(shared, engine.dtype)
        self.steps = SharedTree(schedule.steps, engine.dtype)

    def runner(
        self, adjoint: bool, record: tuple[str, ...], clip: bool, wrt: tuple[str, ...]
    ) -> Runner:
        """The compiled kernel, from memory, from disk, or newly compiled."""
        draws = self.draws
        counted = (draws.antithetic, draws.before) if isinstance(draws, Counter) else (False, 0)
        setup = FunctionSetup(
            self.engine.precision, adjoint, record,
            self.actions is not None, self.start is not None,
            self.has_terminal, clip, wrt, isinstance(draws, Counter), *counted,
        )  # fmt: skip
        like = self._state_like()
        key = self.key(setup, like)
        if key not in _runners:
            started = perf_counter()
            kernel = self.kernel(setup, like)
            _runners[key] = Runner(kernel, linked_code(kernel.text, kernel.code.entries))
            jax.monitoring.record_event_duration_secs(COMPILED, perf_counter() - started)
            while len(_runners) > KEPT:
                _runners.popitem(last=False)
        _runners.move_to_end(key)
        return _runners[key]

    def key(self, setup: FunctionSetup, like) -> Hashable:
        """Everything that the kernel depends on: equal calls share it."""
        leaves, tree = jax.tree.flatten(like)
        starts = tree, tuple((x.shape, x.dtype) for x in leaves)
        kind = type(self.simulator), self.version
        return setup, self.shared.key(), self.steps.key(1), starts, kind

    def kernel(self, setup: FunctionSetup, like, stages: KernelStages | None = None) -> Kernel:
        """The kernel as an earlier process stored it, or a new one; with `stages` always new."""
        missing = unavailable()
        if missing is not None:
            raise Unsupported(missing)
        stored = None if stages is not None else self._stored(setup, like)
        kernel = None if stored is None else stored.read()
        if kernel is None:
            kernel = self._emitted(setup, like, stages)
            if stored is not None:
                stored.write(kernel)
        return kernel

    def _stored(self, setup: FunctionSetup, like) -> StoredKernel | None:
        """The kernel's file; None for code of the user's own."""
        if self.version is not None:
            return None
        noise = self.simulator.initial_noise_size
        return StoredKernel(self.simulator, self.shared, self.steps, like, setup, noise)

    def _emitted(self, setup: FunctionSetup, like, stages: KernelStages | None) -> Kernel:
        """Traces and emits. An error of the emitter is reported as the reason."""
        simulator = self.simulator
        sizes = (simulator.noise_size, simulator.initial_noise_size)
        values = self.shared.split(), self.steps.split()
        with read_context(self.version):
            segments = traced(*values, like, setup, sizes, simulator.action.size)
        try:
            return emit(segments, host(), stages)
        except ACCIDENTS as error:
            raise Unsupported(
                f"{type(simulator).__name__}: {type(error).__name__}: {error}"
            ) from error

    def _state_like(self):
        if self.start is None:
            return None
        return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), self.start)

    # Into rows.

    def inputs(
        self, runner: Runner, weights, bounds, records: bool, parts: Sequence[int] | None = None
    ) -> KernelInputs:
        """All inputs of a run; `parts`: the number of paths in each of its sums, by default all."""
        layouts, lanes, trees = runner.kernel.layouts, runner.kernel.lanes, runner.kernel.trees
        self.slots = Seats.of(parts or (self.paths,), lanes)
        path, inner, blocks = self.slots.path, self.slots.inner, self.slots.blocks
        first, length, _ = self.window
        filled = self._filled(bounds if weights is not None else None)
        columns = 1 if weights is None else len(next(iter(weights.values())))
        values, lent = self._noise(path)
        sizes = {"table": layouts["table"].stride, "steps": length * layouts["steps"].stride}
        sizes |= {name: array.nbytes for name, array in values.items()}
        for name, (_, axes) in filled.items():
            sizes[name] = blocks * math.prod(axes) * layouts[name].stride
        if weights is not None:
            sizes["weights"] = columns * blocks * layouts["weights"].stride
        memory = KernelMemory(sizes)
        for leaf, array in zip(trees.call, self.shared.arrays):
            layouts["table"].view(memory["table"], leaf)[...] = array
        steps = memory["steps"].reshape(length, -1)
        for leaf, array in zip(trees.now, self.steps.arrays):
            layouts["steps"].view(steps, leaf)[...] = array[first : first + length]
        for name, array in values.items():
            memory[name].view(array.dtype)[:] = array
        for name, array in lent.items():
            memory.lend(name, array)
        for name, (arrays, axes) in filled.items():
            rows = memory[name].reshape(blocks, *axes, -1)
            for key, array in arrays.items():
                view = layouts[name].view(rows, key)
                view[...] = _blocks(np.asarray(array), path, lanes, len(axes))
        for name, array in (weights or {}).items():
            rows = memory["weights"].reshape(columns, blocks, -1)
            # Paths that fill a last block count for nothing.
            counted = np.where(inner, np.asarray(array)[:, path], 0)
            view = layouts["weights"].view(rows, ("final", name))
            view[...] = counted.reshape(columns, blocks, lanes)
        edges = None if parts is None else self.slots.edges
        counted = first + (int(self.draws.first) if isinstance(self.draws, Counter) else 0)
        return KernelInputs(self.paths, blocks, length, counted, memory, records, columns, edges)

    def _filled(self, bounds) -> dict[str, tuple[dict, tuple[int, ...]]]:
        """By layout: arrays with numbers of each path, and their axes before that of paths."""
        filled: dict[str, tuple[dict, tuple[int, ...]]] = {}
        if self.actions is not None:
            filled["actions"] = {"action": self.actions}, (self.window.length,)
        if self.start is not None:
            leaves = enumerate(jax.tree.leaves(self.start))
            filled["start"] = {("start", i): x for i, x in leaves}, ()
        if bounds is not None:
            filled["bounds"] = {"bound": bounds}, ()
        return filled

    def _noise(self, path: np.ndarray) -> tuple[dict, dict]:
        """The sources of the noise: small arrays, and large ones that stay where they are."""
        draws = self.draws
        if isinstance(draws, Counter):
            paths = np.asarray(draws.paths, np.uint32)
            return {"keys": np.asarray(draws.keys, np.uint32).ravel(), "paths": paths[path]}, {}
        first, length, _ = self.window
        steps = np.asarray(draws.step_noise)[first : first + length]
        arrays = {"noise": steps, "noise_initial": draws.initial_noise}
        dtype = self.engine.dtype
        lent = {name: np.ascontiguousarray(array, dtype) for name, array in arrays.items()}
        return {"positions": path.astype(np.int64)}, lent

    # Out of rows.

    def lanes_out(
        self, runner: Runner, name: str, memory: np.ndarray, key, *axes: int
    ) -> np.ndarray:
        """[*axes, paths, ...] from rows of lanes."""
        rows = memory.reshape(self.slots.blocks, *axes, -1)
        return _paths(runner.kernel.layouts[name].view(rows, key), self.slots, len(axes))

    def finals(self, runner: Runner, memory: np.ndarray) -> Any:
        trees = runner.kernel.trees
        totals = {
            n: self.lanes_out(runner, "final", memory, ("final", n)) for n in trees.final_names
        }
        leaves = [
            self.lanes_out(runner, "final", memory, ("end", i)) for i in range(len(trees.state))
        ]
        return totals, jax.tree.unflatten(trees.state_tree, leaves)

    def recorded(self, runner: Runner, memory, record: tuple[str, ...]) -> dict[str, PyTree]:
        if not record:
            return {}
        tree = runner.kernel.trees.record_tree
        leaves = [
            self.lanes_out(runner, "records", memory, ("record", i), self.window.length)
            for i in range(tree.num_leaves)
        ]
        return jax.tree.unflatten(tree, leaves)

    def gradients(self, runner: Runner, out: Back):
        """The gradients (policy, schedule, start) of one column, as NumPy arrays in the engine's
        precision.

        Policy and schedule have a leading axis of parts, if each part of the paths has its own sum.
        """
        lead = out.call_sums.shape[:-1]
        trees, layouts, dtype = runner.kernel.trees, runner.kernel.layouts, self.engine.dtype
        first, length, _ = self.window

        def shared(leaf, array, request):
            if not leaf.active:
                return np.zeros((*lead, *np.shape(array)), dtype) if request else None
            return layouts["call_sums"].view(out.call_sums, leaf).astype(dtype)

        result = map(shared, trees.call, self.shared.arrays, trees.requested[0])
        policy, constants, _, _ = self.shared.like(result)
        memory = out.step_sums.reshape(*lead, length, -1)

        def stepwise(leaf, array, requested):
            if not requested:
                return None
            of_all = (*lead, *np.shape(array))
            if not leaf.active:
                return np.broadcast_to(np.zeros((), dtype), of_all)  # takes no memory
            part = layouts["step_sums"].view(memory, leaf)
            if part.shape == of_all:
                return part.astype(dtype)
            full = np.zeros(of_all, dtype)
            full[(slice(None),) * len(lead) + (slice(first, first + length),)] = part
            return full

        steps = self.steps.like(map(stepwise, trees.now, self.steps.arrays, trees.requested[1]))
        start = None
        if self.start is not None:
            start = jax.tree.unflatten(trees.state_tree, [
                self.lanes_out(runner, "start_cotangent", out.start_cotangent, ("start", i))
                if x.dtype == dtype else None
                for i, x in enumerate(trees.state)
            ])  # fmt: skip
        return policy, Schedule(constants, steps), start


def _blocks(array: np.ndarray, path: np.ndarray, lanes: int, axes: int) -> np.ndarray:
    """[*axes, paths, ...] as [blocks, *axes, ..., lanes]."""
    if array.shape[axes] != path.size:
        array = np.take(array, path, axis=axes)
    split = array.reshape(*array.shape[:axes], path.size // lanes, lanes, *array.shape[axes + 1 :])
    lead, rest = range(axes), range(axes + 2, split.ndim)
    return split.transpose(axes, *lead, *rest, axes + 1)


def _paths(view: np.ndarray, slots: Seats, axes: int) -> np.ndarray:
    """[blocks, *axes, ..., lanes] as [*axes, paths, ...], in separate memory whose last axis is
    that of the paths, as in the kernel's."""
    middle = range(1, view.ndim - 1)
    moved = view.transpose(*middle, 0, view.ndim - 1)
    flat = moved.reshape(*moved.shape[:-2], view.shape[0] * view.shape[-1])
    several = len(slots.edges) > 2
    local = np.flatnonzero(slots.inner) if several else slice(0, int(slots.path[-1]) + 1)
    selected = flat[..., local]
    # A view would keep all that the kernel wrote alive.
    selected = selected.copy() if np.may_share_memory(selected, view) else selected
    return np.moveaxis(selected, -1, axes)
