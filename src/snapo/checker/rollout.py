"""Rollouts of a few paths in float64 with smooth limits, and the numbers seen in them.

The first follows a simple random policy; three more stay at low, middle and high actions, because
one policy may never reach states at which an input or an action matters.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from snapo.engine import Xla
from snapo.problem.actions import Actions
from snapo.problem.noise import Stored
from snapo.problem.policy import Policy, as_observation
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import EXACT, Smooth

from .findings import Notes, StopCheck

ENGINE = Xla(precision="float64")
LARGE, SMALL = 30.0, 0.01  # an observed feature whose largest value is outside is badly scaled
ROUNDING = 1e-14  # of an output's largest total
EPSILONS = 10 * np.finfo(np.float64).eps  # of the largest number on the way to it


class _Probe(Policy):
    """A simple random policy that depends on every observation."""

    offset: Array
    gain: Array
    action: Actions

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        return self.action.squash(self.offset + self.gain @ jnp.tanh(observation), smooth)


class CheckedRollout(eqx.Module):
    """One rollout, shared by the later examinations."""

    schedule: Schedule
    draws: Stored
    policy: _Probe
    smooth: Smooth
    actions: Any
    states: PyTree
    totals: dict[str, Any]

    def each_output(self) -> dict[str, Any]:
        """Weights [outputs, paths] of every output's mean."""
        eye, paths = np.eye(len(self.totals)), self.draws.size
        return {
            name: np.outer(eye[k], np.full(paths, 1 / paths)) for k, name in enumerate(self.totals)
        }

    def values(self, simulator, held: bool = True, **changes) -> dict[str, Any]:
        """Totals after a change, with the decisions held fixed or those of the policy."""
        values = {"schedule": self.schedule, "draws": self.draws, "actions": self.actions} | changes
        return ENGINE.values(
            simulator,
            None if held else self.policy,
            values["schedule"],
            values["draws"],
            self.smooth,
            actions=values["actions"] if held else None,
        ).totals

    def rounding(self) -> float:
        """The rounding error of an output: a difference of large states, such as demand that is
        met, has the rounding error of these states."""
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves((self.states, self.totals))]
        finite = (leaf[np.isfinite(leaf)] for leaf in leaves if leaf.dtype.kind == "f")
        return EPSILONS * float(max((np.abs(leaf).max(initial=0.0) for leaf in finite), default=0))

    def same(self, one: dict[str, Any], other: dict[str, Any]) -> bool:
        """Whether totals of two compiled programs are equal up to rounding."""
        rounding = self.rounding()

        def equal(mine: np.ndarray, theirs: np.ndarray) -> bool:
            size = np.max(np.abs(mine), where=np.isfinite(mine), initial=0.0)
            allowed = max(ROUNDING * size, rounding)
            return np.allclose(mine, theirs, rtol=0, atol=allowed, equal_nan=True)

        return all(equal(one[name], result) for name, result in other.items())


LEVELS = (-4.0, 0.0, 4.0)  # before they are squashed: low, middle and high actions


def rollouts(
    notes: Notes, simulator, schedule, observation, scenarios, paths, smooth, seed
) -> list[CheckedRollout]:
    """The rollout of a random policy, then rollouts near low, middle and high actions, as far as
    they are finite. The first non-finite number of the random policy is an error.
    """
    rng = np.random.default_rng(seed)
    T, K, size = simulator.horizon, simulator.noise_size, simulator.action.size
    if scenarios is None:
        initial = rng.normal(size=(paths, simulator.initial_noise_size))
        draws = Stored(initial, rng.normal(size=(T, paths, K)))  # pyright: ignore
    else:
        draws = scenarios.draws(np.arange(paths), simulator)
        if not isinstance(draws, Stored):
            notes.error(
                "scenarios",
                "Engines draw their noise during a rollout; this check needs stored noise.",
                "Pass Supplied or Sobol scenarios, or none.",
            )
            raise StopCheck
    features = observation.shape[0]
    gain = rng.normal(size=(size, features)) / np.sqrt(max(features, 1))
    random = _Probe(rng.normal(size=size) * 0.5, gain, simulator.action)  # pyright: ignore
    first = _run(notes, simulator, random, schedule, draws, smooth)
    _finite(notes, first[1], simulator.totals())
    runs = [first[0]]
    for level in LEVELS:
        policy = _Probe(np.full(size, level), 0.3 * gain, simulator.action)  # pyright: ignore
        run, out = _run(notes, simulator, policy, schedule, draws, smooth)
        if all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(out.totals)):
            runs.append(run)
    return runs


def _run(notes: Notes, simulator, policy, schedule, draws, smooth) -> tuple[CheckedRollout, Any]:
    record = ("state", "action", "outputs")
    with notes.during("rollout"):
        out = ENGINE.values(simulator, policy, schedule, draws, smooth, record=record)
    selected = out.record["action"], out.record["state"], out.totals
    return CheckedRollout(schedule, draws, policy, smooth, *selected), out


def _finite(notes: Notes, out, kinds) -> None:
    invalid = []
    for kind in ("state", "outputs"):
        for path, leaf in jax.tree_util.tree_flatten_with_path(out.record[kind])[0]:
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            wrong = ~np.isfinite(leaf) if leaf.dtype.kind == "f" else np.zeros(leaf.shape, bool)
            if kind == "outputs" and kinds.get(name) == "max":
                wrong &= leaf != -np.inf  # a maximum to which this step adds nothing
            if wrong.any():
                step, number = (int(i) for i in np.argwhere(wrong)[0][:2])
                # The state at step t was made by step t - 1.
                text = f"output {name}" if kind == "outputs" else f"state {name}"
                invalid.append((step - (kind == "state"), text, number))
    if invalid:
        step, name, path = min(invalid)
        where = notes.method("step") if step >= 0 else notes.method("initial")
        notes.error(
            where,
            f"{name} is non-finite; this occurs first at step {max(step, 0)} (path {path}).",
            "Look for a division, logarithm, root or power at zero, or for growth without bound.",
        )
    elif not all(np.all(np.isfinite(x)) for x in out.totals.values()):
        names = [n for n, x in out.totals.items() if not np.all(np.isfinite(x))]
        notes.error(
            notes.method("terminal"), f"The outputs {names} are non-finite.", "Look at terminal."
        )
    notes.stop_on_errors()


def observed(notes: Notes, simulator: Simulator, run: CheckedRollout) -> None:
    """Observations that are non-finite or far from order one."""
    with jax.enable_x64(True):
        over_paths = jax.vmap(simulator.observe, (None, None, 0))
        visited = jax.jit(jax.vmap(over_paths, (None, 0, 0)))(
            run.schedule.constants, run.schedule.steps, run.states
        )
        visited = np.asarray(visited)
    if not np.all(np.isfinite(visited)):
        step, path, feature = (int(i) for i in np.argwhere(~np.isfinite(visited))[0])
        notes.error(
            notes.method("observe"),
            f"Feature {feature} is non-finite at step {step} (path {path}).",
            "Look for a division or logarithm at zero.",
        )
        raise StopCheck
    for feature, largest in enumerate(np.abs(visited).max((0, 1))):
        if largest > LARGE or 0 < largest < SMALL:
            notes.warning(
                f"{notes.method('observe')}: feature {feature}",
                f"Its values reach {largest:.3g} in size; networks learn poorly far from order "
                "one.",
                f"Divide it by its typical size, about {largest:.2g}.",
            )
