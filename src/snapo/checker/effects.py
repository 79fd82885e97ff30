"""Actions and noise without effect, actions that no derivative reaches, and repeated stopping."""

from typing import Any

import jax
import numpy as np

from snapo.problem.actions import Stop, squashed
from snapo.problem.noise import Stored
from snapo.problem.simulator import Simulator

from .bumps import locate
from .findings import Notes
from .rollout import ENGINE, CheckedRollout

RIGHTS = 3  # of a `Stop`, at most: every right takes a rollout


def used(notes: Notes, simulator: Simulator, runs: list[CheckedRollout], seed: int) -> list[int]:
    """The components of the action that change an output in any of the runs.

    Components of the action or the noise that have no effect in any run are findings.
    """
    moving = []
    fresh = _fresh_actions(simulator, runs[0], seed)

    def other_action(run: CheckedRollout, group: list[int]) -> dict[str, Any]:
        actions = np.array(run.actions)
        actions[..., group] = fresh[..., group]
        return {"actions": actions}

    def other_noise(run: CheckedRollout, component: int) -> dict[str, Any]:
        # Paths swap their numbers: the same law, other scenarios.
        noise = np.array(run.draws.step_noise)
        noise[..., component] = np.roll(noise[..., component], 1, axis=1)
        return {"draws": Stored(run.draws.initial_noise, noise)}  # pyright: ignore

    for group in simulator.action.together():
        if _matters(simulator, runs, other_action, group):
            moving += group
        else:
            notes.error(
                f"{notes.method('step')}: action{_numbered(group, simulator.action.size)}",
                "It changes no output: the step ignores it, or its effect never reaches an output.",
                "Use it, or make the action set smaller.",
            )
    for component in range(simulator.noise_size):
        # A measurement error moves the observations, and through them the decisions.
        matters = (
            _matters(simulator, runs, other_noise, component, held) for held in (True, False)
        )
        if not any(matters):
            notes.warning(
                f"{notes.method('step')}: noise[{component}]",
                "It changes no output.",
                f"Use it, or make noise_size (now {simulator.noise_size}) smaller.",
            )
    return moving


def _fresh_actions(simulator: Simulator, run: CheckedRollout, seed: int) -> np.ndarray:
    """Random actions anywhere in the set: [T, paths, size]."""
    raw = np.random.default_rng(seed + 1).normal(size=run.actions.shape) * 2
    with jax.enable_x64(True):
        return np.asarray(squashed(simulator.action, raw, run.smooth))


def _numbered(group: list[int], size: int) -> str:
    """The index of components that move together; empty if these are all components."""
    if len(group) == 1:
        return f"[{group[0]}]"
    return "" if len(group) == size else f"[{group[0]}:{group[-1] + 1}]"


def _matters(
    simulator: Simulator, runs: list[CheckedRollout], change, which, held: bool = True
) -> bool:
    """Whether a change of one component, or of a group, changes an output of any run."""
    return any(
        not run.same(run.totals, run.values(simulator, held, **change(run, which))) for run in runs
    )


def reached(
    notes: Notes, simulator: Simulator, runs: list[CheckedRollout], moving: list[int]
) -> None:
    """Whether every action that affects an output has a finite derivative in some run."""
    left = set(moving)
    for k, run in enumerate(runs):
        if k and not left:
            break
        result = ENGINE.adjoint(
            simulator, run.policy, run.schedule, run.draws, run.smooth, run.each_output()
        )
        leaves = jax.tree.leaves((result.policy, result.schedule))
        if not all(np.all(np.isfinite(leaf)) for leaf in leaves):
            locate(notes, simulator, run)
        offset = np.abs(result.policy.offset).max(0)
        left -= {component for component in left if offset[component] != 0}
    for component in sorted(left):
        notes.error(
            f"{notes.method('step')}: action[{component}]",
            "It moves the outputs, but the derivatives of the outputs with respect to it are "
            "exactly zero: nothing can be learned.",
            "Look for rounding, a comparison, an integer or a stop_gradient between the decision "
            "and the outputs; write smooth.indicator or smooth.choose for a jump.",
        )


def stopped_once(notes: Notes, simulator: Simulator, run: CheckedRollout) -> None:
    """Whether a `Stop` is used up. If all steps stop, only as many of them count as there are
    rights; so in a group with one step more than there are rights, at least one step has no
    effect."""
    action = simulator.action
    if not isinstance(action, Stop) or action.rights > min(RIGHTS, len(run.actions) - 1):
        return
    always = np.ones_like(run.actions)
    totals = run.values(simulator, actions=always)

    def counts(part: np.ndarray) -> bool:
        held = always.copy()
        held[part] = 0.0
        return not run.same(totals, run.values(simulator, actions=held))

    if all(counts(part) for part in np.array_split(np.arange(len(always)), action.rights + 1)):
        notes.warning(
            f"{notes.method('step')}: action",
            f"It can stop more often than there are rights ({action.rights}): if every step "
            f"stops, more than {action.rights} of them change an output.",
            'Keep the right in the state: right, used = self.action.use(state["right"], action). '
            "Multiply the payment by `used`.",
        )
