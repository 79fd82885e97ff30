"""Derivatives from one adjoint pass for each block of paths, with their standard errors."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Bound
from snapo.problem.noise import Draws
from snapo.problem.objective import Weights
from snapo.problem.policy import Policy, trainable
from snapo.problem.problem import Problem

from ..adjoint import float64, pull_back
from ..finite_paths import DROPPED, adjoint_of_good_weights, finite
from ..statistics import Estimate
from .changes import Plan, plan


class Found(NamedTuple):
    """Derivatives by every input and by the policy, and the number of paths left out."""

    inputs: dict[str, Estimate]
    policy: Estimate
    dropped: int


class Pulled(NamedTuple):
    """One adjoint pass: derivatives at the schedule, of the policy [P], and its bad paths."""

    schedule: PyTree
    policy: np.ndarray
    bad: int


class Way(NamedTuple):
    """One way to differentiate: with the decisions recorded and replayed, or through the policy."""

    problem: Problem
    bound: Bound
    policy: Policy
    smooth: Any
    held: bool

    def derivatives(self, blocks: list[np.ndarray]) -> Found:
        """From one pass for each block of paths, and a few on a sample of all."""
        plan, blocks, dropped = self._plan(blocks)
        every, edges = np.concatenate(blocks), np.cumsum(plan.sizes)[:-1]
        split = {name: np.split(weight, edges) for name, weight in plan.whole.items()}
        parts = [{name: split[name][i] for name in split} for i in range(len(blocks))]
        passes = [self._pull(block, part) for block, part in zip(blocks, parts)]
        further = [self._joined(every[plan.sample], p, len(blocks[0])) for p in plan.pieces]
        bad = np.array([each.bad for each in passes])
        dropped += int(bad.sum())
        # The paths that are left have the weight of those that are not.
        scale = every.size / max(1, every.size - bad.sum())
        known = all(np.isfinite(weight).all() for weight in plan.whole.values())
        if not known or dropped > DROPPED * (every.size + dropped):
            # Under ruin there is no derivative; nor is there one of what is left of many.
            scale = np.nan
        plan = plan._replace(sizes=plan.sizes - bad)
        sums, pieces = self._carried(passes), self._carried(further)
        found = {n: Estimate(plan.estimate(scale * sums[n], pieces[n])) for n in sums}
        slopes = np.stack([each.policy for each in passes])
        others = np.reshape([e.policy for e in further], (len(further), slopes.shape[1]))
        return Found(found, Estimate(plan.estimate(scale * slopes, others)), dropped)

    def _plan(self, blocks: list[np.ndarray]) -> tuple[Plan, list[np.ndarray], int]:
        """The weights, the blocks without paths that are not finite, and the number of those."""
        objective, sizes = self.problem.objective, [len(block) for block in blocks]
        if objective.linear:
            nothing = {name: np.zeros(sum(sizes)) for name in objective.outputs}
            return plan(objective, nothing, sizes), blocks, 0
        parts = []
        for block in blocks:
            found = self.bound.values(self.policy, self._draws(block), self.smooth).totals
            parts.append(float64({name: found[name] for name in objective.outputs}))
        good = [finite(part, objective.outputs) for part in parts]
        dropped = sum(int(np.sum(~each)) for each in good)
        if dropped and dropped <= DROPPED * sum(sizes):
            blocks = [block[each] for block, each in zip(blocks, good)]
            parts = [{n: x[each] for n, x in part.items()} for part, each in zip(parts, good)]
        totals = {n: np.concatenate([part[n] for part in parts]) for n in objective.outputs}
        return plan(objective, totals, [len(block) for block in blocks]), blocks, dropped

    def _draws(self, paths: np.ndarray) -> Draws:
        return self.problem.sources.evaluation.draws(paths, self.problem.simulator)

    def _pull(self, paths: np.ndarray, weights: Weights) -> Pulled:
        draws, policy, options = self._draws(paths), self.policy, {}
        if self.held:
            rolled = self.bound.values(policy, draws, self.smooth, record=("action",))
            policy, options = None, {"actions": rolled.record["action"], "wrt": ("schedule",)}
        result, bad = adjoint_of_good_weights(
            self.bound, policy, draws, self.smooth, weights, **options
        )
        leaves = [] if self.held else jax.tree.leaves(trainable(result.policy)[0])
        slope = np.concatenate([np.zeros(0), *(np.ravel(leaf) for leaf in leaves)])
        return Pulled(jax.tree.map(np.asarray, result.schedule), slope, bad)

    def _joined(self, paths: np.ndarray, weights: Weights, most: int) -> Pulled:
        """The sum of passes on no more than so many paths each."""
        passes = [
            self._pull(paths[k : k + most], {n: w[k : k + most] for n, w in weights.items()})
            for k in range(0, len(paths), most)
        ]
        return jax.tree.map(lambda *each: sum(each[1:], each[0]), *passes)

    def _carried(self, passes: list[Pulled]) -> dict[str, np.ndarray]:
        """Derivatives by every input, {name: [passes, *shape]}."""
        problem, found = self.problem, [each.schedule for each in passes]
        if not found:
            return {name: np.zeros((0, *x.value.shape)) for name, x in problem.named.items()}
        return pull_back(problem.simulator, problem.inputs, found)
