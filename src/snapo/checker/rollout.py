"""What `snapo.check` learns from a rollout: numbers, observations, actions and noise.

A few paths under a simple random policy, in float64 with smooth limits; then the same again with
the decisions held and one thing changed.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from snapo.engine import Xla
from snapo.problem.actions import Box, Simplex
from snapo.problem.noise import Stored
from snapo.problem.policy import Policy
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Smooth
from snapo.solver.adjoint import adjoint_gradient

from .findings import Notes, Stop

ENGINE = Xla(precision="float64")
LARGE, SMALL = 30.0, 0.01  # an observed feature whose largest value is outside is badly scaled


class _Probe(Policy):
    """A simple random policy that reacts to everything it sees."""

    offset: Array
    gain: Array
    action: Box | Simplex

    def __call__(self, observation, smooth):
        return self.action.squash(self.offset + self.gain @ jnp.tanh(observation))


class Run(eqx.Module):
    """What the later examinations share."""

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

    def values(self, simulator, **changes) -> dict[str, Any]:
        """Totals with the decisions held and something changed."""
        given = {"schedule": self.schedule, "draws": self.draws, "actions": self.actions} | changes
        return ENGINE.values(
            simulator,
            None,
            given["schedule"],
            given["draws"],
            self.smooth,
            actions=given["actions"],
        ).totals


def rolled(notes: Notes, simulator, schedule, observation, scenarios, paths, smooth, seed) -> Run:
    """A rollout of the random policy, and the first number in it that is not finite."""
    rng = np.random.default_rng(seed)
    T, K, size = simulator.horizon, simulator.noise_size, simulator.action.size
    if scenarios is None:
        initial = rng.normal(size=(paths, simulator.initial_noise_size))
        draws = Stored(initial, rng.normal(size=(T, paths, K)))  # pyright: ignore
    else:
        draws = scenarios.draws(np.arange(paths), simulator)
        if not isinstance(draws, Stored):
            raise TypeError(
                "check: scenarios must be Supplied or Sobol; leave them out for normals."
            )
    gain = rng.normal(size=(size, observation.shape[0])) / np.sqrt(observation.shape[0])
    policy = _Probe(rng.normal(size=size) * 0.5, gain, simulator.action)  # pyright: ignore
    record = ("state", "action", "outputs")
    with notes.during("rollout"):
        out = ENGINE.values(simulator, policy, schedule, draws, smooth, record=record)
    _finite(notes, out, simulator.totals())
    return Run(
        schedule, draws, policy, smooth, out.record["action"], out.record["state"], out.totals
    )


def _finite(notes: Notes, out, kinds) -> None:
    bad = []
    for kind in ("state", "outputs"):
        for path, leaf in jax.tree_util.tree_flatten_with_path(out.record[kind])[0]:
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            wrong = ~np.isfinite(leaf) if leaf.dtype.kind == "f" else np.zeros(leaf.shape, bool)
            if kind == "outputs" and kinds.get(name) == "max":
                wrong &= leaf != -np.inf  # a maximum to which this step adds nothing
            if wrong.any():
                step, number = (int(i) for i in np.argwhere(wrong)[0][:2])
                # The state at step t was made by step t - 1.
                bad.append(
                    (
                        step - (kind == "state"),
                        f"{kind[:-1] if kind == 'outputs' else kind} {name}",
                        number,
                    )
                )
    if bad:
        step, name, path = min(bad)
        where = notes.method("step") if step >= 0 else notes.method("initial")
        notes.error(
            where,
            f"{name} is not finite, first at step {max(step, 0)} (path {path}).",
            "Look for a division, logarithm, root or power at zero, or for growth without bound.",
        )
    elif not all(np.all(np.isfinite(x)) for x in out.totals.values()):
        names = [n for n, x in out.totals.items() if not np.all(np.isfinite(x))]
        notes.error(
            notes.method("terminal"), f"The outputs {names} are not finite.", "Look at terminal."
        )
    notes.stop_on_errors()


def observed(notes: Notes, simulator: Simulator, run: Run) -> None:
    """Observations that are not finite or far from order one."""
    with jax.enable_x64(True):
        over_paths = jax.vmap(simulator.observe, (None, None, 0))
        seen = jax.jit(jax.vmap(over_paths, (None, 0, 0)))(
            run.schedule.constants, run.schedule.steps, run.states
        )
        seen = np.asarray(seen)
    if not np.all(np.isfinite(seen)):
        step, path, feature = (int(i) for i in np.argwhere(~np.isfinite(seen))[0])
        notes.error(
            notes.method("observe"),
            f"Feature {feature} is not finite at step {step} (path {path}).",
            "Look for a division or logarithm at zero.",
        )
        raise Stop
    for feature, largest in enumerate(np.abs(seen).max((0, 1))):
        if largest > LARGE or 0 < largest < SMALL:
            notes.warning(
                f"{notes.method('observe')}: feature {feature}",
                f"Its values reach {largest:.3g} in size; networks learn badly far from order one.",
                f"Divide it by its typical size, about {largest:.2g}.",
            )


def used(notes: Notes, simulator: Simulator, run: Run, seed: int) -> list[int]:
    """Which components of the action and of the noise change anything; the former are returned."""
    rng = np.random.default_rng(seed + 1)
    size, moving = simulator.action.size, []
    with jax.enable_x64(True):
        raw = rng.normal(size=run.actions.shape) * 2
        fresh = np.asarray(jax.vmap(jax.vmap(simulator.action.squash))(jnp.asarray(raw)))
    whole = isinstance(simulator.action, Simplex)
    for component in range(1 if whole else size):
        actions = fresh if whole else run.actions.copy()
        if not whole:
            actions[..., component] = fresh[..., component]
        if _moved(run.totals, run.values(simulator, actions=actions)):
            moving += list(range(size)) if whole else [component]
        else:
            notes.error(
                f"{notes.method('step')}: action{'' if whole else f'[{component}]'}",
                "It changes no output: the step ignores it, or its effect never shows.",
                "Use it, or make the action set smaller.",
            )
    # Paths swap their numbers: the same law, other scenarios.
    for component in range(simulator.noise_size):
        noise = np.array(run.draws.step_noise)
        noise[..., component] = np.roll(noise[..., component], 1, axis=1)
        draws = Stored(run.draws.initial_noise, noise)  # pyright: ignore
        if not _moved(run.totals, run.values(simulator, draws=draws)):
            notes.warning(
                f"{notes.method('step')}: noise[{component}]",
                "It changes no output.",
                f"Use it, or make noise_size (now {simulator.noise_size}) smaller.",
            )
    return moving


def _moved(before: dict, after: dict) -> bool:
    return any(not np.array_equal(before[name], after[name], equal_nan=True) for name in before)


def reachable(notes: Notes, simulator: Simulator, run: Run, moving: list[int]) -> None:
    """Whether a derivative reaches every action that moves an output, and is finite."""
    result = ENGINE.adjoint(
        simulator, run.policy, run.schedule, run.draws, run.smooth, run.each_output()
    )
    if not all(
        np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves((result.policy, result.schedule))
    ):
        locate(notes, simulator, run)
    offset = np.abs(result.policy.offset).max(0)
    for component in moving:
        if offset[component] == 0:
            notes.error(
                f"{notes.method('step')}: action[{component}]",
                "It moves the outputs, but its derivative is exactly zero: nothing can be learnt.",
                "Look for rounding, a comparison, an integer or stop_gradient on its way; "
                "write smooth.indicator or smooth.choose for a jump.",
            )


def locate(notes: Notes, simulator: Simulator, run: Run) -> None:
    """Names the method and step at which a derivative is not finite, and stops.

    The reverse sweep starts at the end, so the last bad step is the one that it meets first.
    """
    constants, T, N = run.schedule.constants, simulator.horizon, run.draws.size

    def finite(function, *arguments):
        """{argument: whether d(sum of floating results) / d argument is finite}, for one path."""
        moving, fixed = eqx.partition(arguments, eqx.is_inexact_array)

        def total(moving):
            results = jax.tree.leaves(function(*eqx.combine(moving, fixed)))
            return sum(jnp.sum(x) for x in results if jnp.issubdtype(x.dtype, jnp.floating))

        return jax.tree.map(lambda g: jnp.all(jnp.isfinite(g)), adjoint_gradient(total)(moving))

    def one(now, state, action, noise):
        def step(state, now, action, constants):
            return simulator.step(constants, now, state, action, noise, run.smooth)

        def observe(state, now, constants):
            return simulator.observe(constants, now, state)

        return {
            "step": finite(step, state, now, action, constants),
            "observe": finite(observe, state, now, constants),
        }

    with jax.enable_x64(True):
        mapped = jax.jit(lambda xs: jax.lax.map(lambda x: jax.vmap(one, (None, 0, 0, 0))(*x), xs))
        marks = mapped((run.schedule.steps, run.states, run.actions, run.draws.step_noise))
        marks = jax.tree.map(np.asarray, marks)
    names = {
        "step": ("state", "now", "action", "constants"),
        "observe": ("state", "now", "constants"),
    }
    bad = []
    for method, arguments in names.items():
        for path, ok in jax.tree_util.tree_flatten_with_path(marks[method])[0]:
            if not ok.all():
                step, number = (int(i) for i in np.argwhere(~ok)[-1])
                leaf = arguments[path[0].idx] + jax.tree_util.keystr(path[1:])
                bad.append((step, method, leaf, number))
    if bad:
        step, method, leaf, path = max(bad)
        notes.error(
            notes.method(method),
            f"Its derivative by {leaf} is not finite, first (from the end) at step {step} of {T} "
            f"(path {path} of {N}).",
            NOT_DIFFERENTIABLE,
        )
    else:
        notes.error(
            notes.method("initial") + " or terminal",
            "A derivative is not finite.",
            NOT_DIFFERENTIABLE,
        )
    raise Stop


NOT_DIFFERENTIABLE = (
    "A root, logarithm, power or division at zero has no derivative, even inside a branch that "
    "jnp.where does not take: give the branch a harmless argument, f(jnp.where(ok, x, 1.0)), too."
)
