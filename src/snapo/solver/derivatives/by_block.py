"""Derivatives from one adjoint pass for each block of paths, with their standard errors."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Adjoint, BoundEngine
from snapo.problem.noise import Draws
from snapo.problem.objective import Objective, Totals, Weights
from snapo.problem.policy import Policy, trainable
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact, Smooth

from ..adjoint import DROPPED, adjoint_of_good_weights, all_finite, finite, float64, pull_back
from ..evaluate import DECIDED, in_a_row
from ..statistics import Estimate
from .changes import BlockPlan, plan

LARGE = 2**26  # bytes of derivatives with respect to a schedule
CHUNK = 8192  # paths in one call of an engine, where a block has no more


class ScheduleDerivatives(NamedTuple):
    """Derivatives with respect to the schedule, of each block of paths.

    The derivatives with respect to all inputs of that schedule can be computed from them.

    - `passes`: the sums over the paths of each block, times `scale`; `further`: the sums for
      pieces of the weights (`BlockPlan.blocks`).
    """

    plan: BlockPlan
    scale: float
    passes: list[PyTree]
    further: list[PyTree]

    def of_inputs(self, problem: Problem) -> dict[str, Estimate]:
        """The derivatives with respect to the inputs of a problem with this schedule."""
        sums, segments = _carried(problem, self.passes), _carried(problem, self.further)
        return {
            name: Estimate(self.plan.estimate(self.scale * item, segments[name]))
            for name, item in sums.items()
        }

    @property
    def bytes(self) -> int:
        """The memory of these derivatives."""
        leaves = jax.tree.leaves((self.passes, self.further))
        return sum(leaf.nbytes for leaf in leaves if any(leaf.strides))


class PassResult(NamedTuple):
    """Derivatives with respect to every input and the policy, and the number of paths left out.

    `schedule`: those with respect to the schedule, from which those of the inputs follow.
    `totals` {output: [paths]} in the order of the blocks; None if some blocks were computed one by
    one.
    """

    inputs: dict[str, Estimate]
    policy: Estimate
    dropped: int
    schedule: ScheduleDerivatives
    totals: Totals | None = None

    @property
    def of_others(self) -> Callable[[Problem], dict[str, Estimate]] | None:
        """Derivatives with respect to the inputs of another problem with this schedule; None if the
        derivatives would take more than `LARGE` bytes."""
        return self.schedule.of_inputs if self.schedule.bytes <= LARGE else None


class Pulled(NamedTuple):
    """One adjoint pass: derivatives with respect to the schedule and the policy [P], its bad paths,
    and the totals of its paths if they are known."""

    schedule: PyTree
    policy: np.ndarray
    non_finite: int
    totals: Totals | None = None


class DerivativePass(NamedTuple):
    """One way to differentiate: with the decisions recorded and replayed, or through the policy.

    `recorded` [T, paths, A]: the decisions by number of the path, if they are known already.
    `totals` {output: [paths]}: the totals of the policy by number of the path, if they are known
    already. `inputs`: whether derivatives with respect to the inputs are computed, in addition to
    those with respect to the policy.
    """

    problem: Problem
    bound_engine: BoundEngine
    policy: Policy
    smooth: Smooth | Exact
    held: bool
    recorded: np.ndarray | None = None
    inputs: bool = True
    totals: Mapping[str, np.ndarray] | None = None

    def derivatives(self, blocks: list[np.ndarray]) -> PassResult:
        """Derivatives from one pass for each block of paths, and a few passes on a sample of all
        paths."""
        return self.of((self.problem.objective,), blocks)[0]

    def compile(self) -> None:
        """Prepares the program of a pass, if it can be used for any number of paths."""
        draws, decider, options = self._asked(np.arange(2))
        nothing = {name: np.zeros(2) for name in self.problem.objective.outputs}
        self.bound_engine.adjoints(decider, draws, self.smooth, nothing, [1, 1], **options)

    def of(self, objectives: Sequence[Objective], blocks: list[np.ndarray]) -> list[PassResult]:
        """Derivatives of several objectives, whose cotangents share every forward sweep."""
        plans, blocks, dropped = self._plans(objectives, blocks)
        every = np.concatenate(blocks)
        passes = self._passes(blocks, _parts(plans, blocks))
        results = []
        for k, local in enumerate(plans):
            further = self._joined(every[local.sample], local.blocks, len(blocks[0]))
            results.append(self._found(local, [item[k] for item in passes], further, dropped))
        return results

    def _found(
        self, plan: BlockPlan, passes: list[Pulled], further: list[Pulled], dropped: int
    ) -> PassResult:
        """One objective's derivatives from the passes of its blocks and of its pieces."""
        count = int(plan.sizes.sum())
        invalid = np.array([item.non_finite for item in passes])
        dropped += int(invalid.sum())
        # The paths that are left have the weight of those that are not.
        scale = count / max(1, count - invalid.sum())
        available = all(np.isfinite(weight).all() for weight in plan.total.values())
        if not available or dropped > DROPPED * (count + dropped):
            # No derivative exists under ruin, nor is one reported where many paths were left out.
            scale = np.nan
        plan = plan._replace(sizes=plan.sizes - invalid)
        trees = [[entry.schedule for entry in part] for part in (passes, further)]
        schedule = ScheduleDerivatives(plan, scale, *trees)
        estimates = schedule.of_inputs(self.problem) if self.inputs else {}
        slopes = np.stack([entry.policy for entry in passes])
        others = np.reshape([e.policy for e in further], (len(further), slopes.shape[1]))
        policy = Estimate(plan.estimate(scale * slopes, others))
        return PassResult(estimates, policy, dropped, schedule, _joined_totals(passes))

    def _plans(
        self, objectives: Sequence[Objective], blocks: list[np.ndarray]
    ) -> tuple[list[BlockPlan], list[np.ndarray], int]:
        """The weights, the blocks without non-finite paths, and the number of those."""
        sizes = [len(block) for block in blocks]
        names = tuple(dict.fromkeys(name for item in objectives for name in item.outputs))
        if all(objective.linear for objective in objectives):
            nothing = {name: np.zeros(sum(sizes)) for name in names}
            return [plan(entry, nothing, sizes) for entry in objectives], blocks, 0
        parts = []
        for local in _batches(blocks):
            result = self._totals(np.concatenate(blocks[local]))
            edges = np.cumsum(sizes[local])[:-1]
            split = {name: np.split(result[name], edges) for name in names}
            parts += [{n: x[k] for n, x in split.items()} for k in range(len(edges) + 1)]
        valid = [finite(part, names) for part in parts]
        dropped = sum(int(np.sum(~value)) for value in valid)
        if dropped and dropped <= DROPPED * sum(sizes):
            blocks = [block[each] for block, each in zip(blocks, valid)]
            parts = [{n: x[each] for n, x in part.items()} for part, each in zip(parts, valid)]
        totals = {n: np.concatenate([part[n] for part in parts]) for n in names}
        sizes = [len(block) for block in blocks]
        return [plan(each, totals, sizes) for each in objectives], blocks, dropped

    def _totals(self, paths: np.ndarray) -> Mapping[str, np.ndarray]:
        if self.totals is not None:
            return {name: total[paths] for name, total in self.totals.items()}
        return float64(
            self.bound_engine.values(self.policy, self._draws(paths), self.smooth).totals
        )

    def _draws(self, paths: np.ndarray) -> Draws:
        return self.problem.sources.evaluation.draws(paths, self.problem.simulator)

    def _passes(self, blocks: list[np.ndarray], weights: list[list[Weights]]) -> list[list[Pulled]]:
        """One pass for each block: several in one call of an engine, if there is one column."""
        if len(weights[0]) > 1:
            return [self._pull(*part) for part in zip(blocks, weights)]
        return [
            item
            for local in _batches(blocks)
            for item in self._together(blocks[local], weights[local])
        ]

    def _together(
        self, blocks: list[np.ndarray], weights: list[list[Weights]]
    ) -> list[list[Pulled]]:
        """One pass for each block in one call; one by one where a number is non-finite."""
        if len(blocks) > 1:
            draws, decider, options = self._asked(np.concatenate(blocks))
            joined = {n: np.concatenate([item[n] for item, *_ in weights]) for n in weights[0][0]}
            sizes = [len(block) for block in blocks]
            result = self.bound_engine.adjoints(
                decider, draws, self.smooth, joined, sizes, **options
            )
            if all_finite(result, joined):
                totals = _split(float64(result.totals), sizes)
                return [
                    [self._pulled(_row(result, k), 0, 1)[0]._replace(totals=totals[k])]
                    for k in range(len(blocks))
                ]
        return [self._pull(block, part) for block, part in zip(blocks, weights)]

    def _pull(self, paths: np.ndarray, weights: list[Weights]) -> list[Pulled]:
        """One pass for all weights {output: [N]} on the same paths."""
        draws, decider, options = self._asked(paths)
        columns = _columns(weights, len(paths))
        result, invalid = adjoint_of_good_weights(
            self.bound_engine, decider, draws, self.smooth, columns, **options
        )
        return self._pulled(result, invalid, len(weights))

    def _asked(self, paths: np.ndarray) -> tuple[Draws, Policy | None, dict[str, Any]]:
        """The noise of these paths, who decides there, and the recorded decisions."""
        draws = self._draws(paths)
        if not self.held:
            return draws, self.policy, {} if self.inputs else {"wrt": ("policy",)}
        if self.recorded is None:
            # By the program that records those of the value, which is compiled already.
            valued = self.bound_engine.engine.bind(self.problem)
            rollout = valued.values(self.policy, draws, self.smooth, record=DECIDED)
            actions = rollout.record["action"]
        else:
            actions = self.recorded[:, in_a_row(paths)]
        return draws, None, {"actions": actions, "wrt": ("schedule",)}

    def _pulled(self, result: Adjoint, invalid: int, count: int) -> list[Pulled]:
        """The derivatives of each of `count` columns of weights."""
        leaves = [] if self.held else jax.tree.leaves(trainable(result.policy)[0])
        schedule, leaves = jax.tree.map(np.asarray, (result.schedule, leaves))
        if count == 1:
            return [Pulled(schedule, _flat(leaves), invalid)]
        return [
            Pulled(
                jax.tree.map(lambda x, k=k: x[k], schedule), _flat(x[k] for x in leaves), invalid
            )
            for k in range(count)
        ]

    def _joined(self, paths: np.ndarray, weights: list[Weights], maximum: int) -> list[Pulled]:
        """For each of the weights, the sum of passes on at most a given number of paths each."""
        if not weights:
            return []
        passes = [
            self._pull(paths[k : k + maximum], _cut(weights, slice(k, k + maximum)))
            for k in range(0, len(paths), maximum)
        ]
        return jax.tree.map(lambda *item: sum(item[1:], item[0]), *passes)


def _carried(problem: Problem, schedules: list[PyTree]) -> dict[str, np.ndarray]:
    """Derivatives with respect to every input, {name: [schedules, *shape]}."""
    if not schedules:
        return {name: np.zeros((0, *x.value.shape)) for name, x in problem.inputs_by_name.items()}
    return pull_back(problem.simulator, problem.inputs, schedules)


def _batches(blocks: list[np.ndarray]) -> Iterator[slice]:
    """Blocks that follow one another, as many as fit into a call; at least one."""
    first = 0
    while first < len(blocks):
        paths = np.cumsum([len(block) for block in blocks[first:]])
        last = first + max(1, int(np.searchsorted(paths, CHUNK, side="right")))
        yield slice(first, last)
        first = last


def _split(totals: Totals, sizes: list[int]) -> list[Totals]:
    """The totals of each part of the paths."""
    edges = np.cumsum(sizes)[:-1]
    parts = {name: np.split(total, edges) for name, total in totals.items()}
    return [{name: part[k] for name, part in parts.items()} for k in range(len(sizes))]


def _joined_totals(passes: list[Pulled]) -> Totals | None:
    """The totals of all passes, where all are known."""
    available = [item.totals for item in passes if item.totals is not None]
    if len(available) < len(passes):
        return None
    return {name: np.concatenate([entry[name] for entry in available]) for name in available[0]}


def _row(result: Adjoint, k: int) -> Adjoint:
    """The derivatives of one part."""
    return jax.tree.map(lambda leaf: leaf[k], result._replace(totals={}))


def _parts(plans: list[BlockPlan], blocks: list[np.ndarray]) -> list[list[Weights]]:
    """By block, the weights of its paths under every plan."""
    endpoints = np.cumsum([0, *map(len, blocks)])
    return [
        _cut([plan.total for plan in plans], slice(first, last))
        for first, last in pairwise(endpoints)
    ]


def _cut(weights: list[Weights], paths: slice) -> list[Weights]:
    return [{name: w[paths] for name, w in weight.items()} for weight in weights]


def _columns(weights: list[Weights], paths: int) -> Weights:
    """{output: [N]} of one, or {output: [K, N]} of several, zero if one has no such output."""
    if len(weights) == 1:
        return weights[0]
    names = dict.fromkeys(name for weight in weights for name in weight)
    nothing = np.zeros(paths)
    return {name: np.stack([item.get(name, nothing) for item in weights]) for name in names}


def _flat(leaves: Iterable[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.zeros(0), *map(np.ravel, leaves)])
