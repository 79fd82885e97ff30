"""Base class of the engines: arguments, results, and checks of both."""

import abc
import math
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, PyTree

from snapo.problem.noise import Counter, Draws, Stored
from snapo.problem.noise.counter import only
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import Around, Schedule, Simulator


class Uncontrolled(Around):
    """A simulator without the outputs `left_out`, which are used only as control variates."""

    left_out: tuple[str, ...] = eqx.field(static=True)

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = super().step(constants, now, state, action, noise, smooth)
        return after, self._kept(outputs)

    def terminal(self, constants, state, smooth):
        return self._kept(super().terminal(constants, state, smooth))

    def control_variates(self):
        return ()

    def _kept(self, outputs):
        return {name: value for name, value in outputs.items() if name not in self.left_out}


def uncontrolled(simulator: Simulator, outputs: tuple[str, ...]) -> Simulator:
    """The simulator without control variates, except these outputs; unchanged if it has none."""
    left_out = tuple(name for name in simulator.control_variates() if name not in outputs)
    return Uncontrolled(simulator, left_out) if left_out else simulator  # pyright: ignore


class Window(NamedTuple):
    """Steps `first` … `first + length - 1`.

    `terminal`: whether the simulator's `terminal` counts; None: if the window reaches the end.
    """

    first: int
    length: int
    terminal: bool | None = None

    def is_last(self, horizon: int) -> bool:
        """Whether the simulator's `terminal` counts."""
        return self.first + self.length == horizon if self.terminal is None else self.terminal


# Everything about a path. Recording less saves memory but compiles another program.
TRAJECTORY = ("state", "action", "outputs", "slack")


class Rollout(NamedTuple):
    """Result of a forward sweep.

    - `totals`: {output: [N]} the total of each path.
    - `state`: the final state, every leaf with a leading axis of paths.
    - `record`: for every requested name of `TRAJECTORY`, leaves [T, N, …].
    """

    totals: dict[str, Float[Array, " N"]]
    state: PyTree
    record: dict[str, PyTree]


class Adjoint(NamedTuple):
    """Result of an adjoint pass for given weights.

    - `totals`: {output: [N]} of the forward sweep.
    - `policy`, `schedule`, `start`: derivatives of sum over paths and outputs of weight x total,
      shaped like the policy, the schedule and the starting states (None if nothing is
      differentiable). With weights [K, N] every leaf has a leading axis K.
    """

    totals: dict[str, Float[Array, " N"]]
    policy: PyTree
    schedule: PyTree
    start: PyTree


@dataclass(frozen=True)
class Clip:
    """Limits and shrinks the adjoint of each path at every backward step, in training only.

    - `norm`: the norm of the adjoint of the state, times the simulator's `state_scale`, is at most
      this number times the path's weight, so that it has the same meaning for any number of paths.
    - `keep`: the share of the adjoint that is passed from one step to the previous one, 0 to 1. An
      outcome k steps after a decision then counts keep^k in its derivative, like a discount factor;
      outputs of `terminal` count as part of the last step.

    Totals, and the earnings of a decision in the same step, are unchanged.

    >>> snapo.Clip(keep=0.9)
    Clip(norm=inf, keep=0.9)
    """

    norm: float = math.inf
    keep: float = 1.0

    def __post_init__(self):
        for name, valid, allowed in (
            ("norm", self.norm > 0, "a number above 0"),
            ("keep", 0 <= self.keep <= 1, "a number from 0 to 1"),
        ):
            if not valid:
                raise ValueError(f"Clip: {name} is {getattr(self, name)!r}; it must be {allowed}.")

    def bounds(self, weights: Mapping[str, ArrayLike]) -> Float[np.ndarray, "N 2"]:
        """[N, 2]: the bound of each path, from the largest of its weights, and `keep`."""
        sizes = [np.abs(np.asarray(w)).reshape(-1, np.shape(w)[-1]) for w in weights.values()]
        size = np.concatenate(sizes).max(0)
        # A path of no weight has no adjoint: its bound is 0, also where the norm is infinite.
        bound = np.multiply(size, self.norm, out=np.zeros_like(size), where=size > 0)
        return np.stack([bound, np.full_like(size, self.keep)], axis=-1)


def factor_of(norm, limit: Float[Array, " 2"]):
    """The factor for an adjoint of this norm: the share kept, or less if the bound applies."""
    return jnp.minimum(limit[1], limit[0] / norm)


def clipped(packed, packing, simulator: Simulator, constants, limit):
    """The identity function of a path's packed state; its cotangent is bounded and reduced."""
    scale = simulator.state_scale(constants)
    ones = tuple(jnp.ones_like(vector) for vector in packed)
    scales = ones if scale is None else packing.pack(scale)
    return _bounded(packed, scales, limit)


@jax.custom_vjp
def _bounded(packed, scales, limit):
    return packed


def _bounded_forward(packed, scales, limit):
    return packed, (scales, limit)


def _bounded_backward(residual, cotangents):
    scales, bound = residual
    floats = [jnp.issubdtype(s.dtype, jnp.floating) for s in scales]
    square = sum(jnp.sum((g * s) ** 2) for g, s, f in zip(cotangents, scales, floats) if f)
    norm = jnp.sqrt(jnp.maximum(square, jnp.finfo(bound.dtype).tiny))
    factor = factor_of(norm, bound)
    clipped = tuple(g * factor if f else g for g, f in zip(cotangents, floats))
    return clipped, None, None


_bounded.defvjp(_bounded_forward, _bounded_backward)


@dataclass(frozen=True)
class Engine(abc.ABC):
    """Simulates paths, and computes adjoints along the same paths.

    `steady`: whether the bits of a path's totals are independent of what is recorded.
    """

    precision: str = "float32"
    steady: ClassVar[bool] = False

    @property
    def dtype(self):
        return np.dtype(self.precision)

    def numbers(self) -> AbstractContextManager:
        """The context that enables this engine's precision (JAX's switch is thread-local)."""
        return jax.enable_x64(True) if self.precision == "float64" else nullcontext()

    def leave(self, result: PyTree) -> PyTree:
        """Converts float64 results to NumPy arrays: outside `numbers` JAX would truncate them."""
        return jax.tree.map(np.asarray, result) if self.precision == "float64" else result

    def bind(self, problem: Problem, *, controls=True, simplest=True) -> "BoundEngine":
        """This engine bound to the simulator and the schedule of a problem.

        `controls`: whether outputs that are only control variates are computed too; `simplest`:
        whether a policy is replaced by its `simplest` form (not in training).
        """
        simulator, outputs = problem.simulator.on_paths(), problem.objective.outputs
        simulator = simulator if controls else uncontrolled(simulator, outputs)
        return BoundEngine(self, simulator, problem.schedule, simplest)

    @abc.abstractmethod
    def values(
        self,
        simulator: Simulator,
        policy: Policy | None,
        schedule: Schedule,
        draws: Draws,
        smooth,
        *,
        actions=None,
        record: tuple[str, ...] = (),
        window: Window | None = None,
        start: PyTree = None,
    ) -> Rollout:
        """Totals of every path. With `actions` [T, N, A] the policy is not evaluated.

        `window` runs part of the horizon from the states `start` (leaves [N, …]).
        """

    @abc.abstractmethod
    def adjoint(
        self,
        simulator: Simulator,
        policy: Policy | None,
        schedule: Schedule,
        draws: Draws,
        smooth,
        weights: Mapping[str, ArrayLike],
        *,
        actions=None,
        clip: Clip | None = None,
        window: Window | None = None,
        start: PyTree = None,
        wrt: tuple[str, ...] = ("policy", "schedule", "start"),
    ) -> Adjoint:
        """One forward and one reverse sweep: derivatives of sum(weights x totals).

        With weights [K, N], the derivatives of K such sums, from one forward sweep. Derivatives
        that are not in `wrt` may be omitted.
        """

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
        actions=None,
        wrt: tuple[str, ...] = ("policy", "schedule", "start"),
    ) -> Adjoint:
        """`adjoint` for each part of the paths: the first parts[0] paths, the next parts[1] paths …

        Derivatives have a leading axis of parts; those with respect to initial states are omitted.
        """
        adjoints, first = [], 0
        for size in parts:
            local = np.arange(first, first + size)
            taken = {name: np.asarray(weight)[local] for name, weight in weights.items()}
            replayed = None if actions is None else np.asarray(actions)[:, local]
            values = simulator, policy, schedule, only(draws, local), smooth, taken
            adjoints.append(self.adjoint(*values, actions=replayed, wrt=wrt))
            first += size
        totals: dict[str, Any] = {
            name: np.concatenate([np.asarray(item.totals[name]) for item in adjoints])
            for name in adjoints[0].totals
        }
        trees = [(entry.policy, entry.schedule) for entry in adjoints]
        moved, schedules = jax.tree.map(lambda *value: np.stack(value), *trees)
        return Adjoint(totals, moved, schedules, None)


@dataclass(frozen=True, eq=False)
class BoundEngine:
    """An engine bound to a simulator and its schedule; each call supplies the other arguments.

    Made by `Engine.bind`; `values` and `adjoint` are those of the engine.
    """

    engine: Engine
    simulator: Simulator
    schedule: Schedule
    simplest: bool = True

    def values(self, policy: Policy | None, draws: Draws, smooth, **options) -> Rollout:
        valued = policy.simplest if policy is not None and self.simplest else policy
        return self.engine.values(self.simulator, valued, self.schedule, draws, smooth, **options)

    def adjoint(
        self,
        policy: Policy | None,
        draws: Draws,
        smooth,
        weights: Mapping[str, ArrayLike],
        **options,
    ) -> Adjoint:
        return self.engine.adjoint(
            self.simulator, policy, self.schedule, draws, smooth, weights, **options
        )

    def adjoints(
        self,
        policy: Policy | None,
        draws: Draws,
        smooth,
        weights: Mapping[str, ArrayLike],
        parts: Sequence[int],
        **options,
    ) -> Adjoint:
        return self.engine.adjoints(
            self.simulator, policy, self.schedule, draws, smooth, weights, parts, **options
        )


def cast(tree: PyTree, dtype) -> PyTree:
    """Every floating array leaf in this precision; NumPy leaves become JAX arrays."""

    def convert(leaf):
        if not eqx.is_array_like(leaf) or isinstance(leaf, bool | int | float | complex):
            return leaf
        array = np.asarray(leaf) if isinstance(leaf, np.ndarray | np.generic) else leaf
        if jnp.issubdtype(array.dtype, jnp.floating):
            return jnp.asarray(array, dtype)
        return jnp.asarray(array)

    return jax.tree.map(convert, tree)


def checked(
    simulator: Simulator, policy, schedule: Schedule, draws: Draws, actions, window: Window | None
) -> Window:
    """Refuses arguments that do not match; returns the window, by default the whole horizon."""
    check_draws(simulator, draws)
    check_schedule(simulator, schedule)
    check_actions(simulator, policy, actions)
    window = window or Window(0, simulator.horizon)
    check_window(simulator, window)
    return window


def check_actions(simulator: Simulator, policy, actions) -> None:
    """Checks that either a policy or recorded actions decide."""
    if policy is None and actions is None:
        raise ValueError(
            "engine: neither a policy nor actions were specified; one of them is needed."
        )
    if actions is not None and (
        np.ndim(actions) != 3 or np.shape(actions)[2] != simulator.action.size
    ):
        raise ValueError(
            f"engine: actions have shape {np.shape(actions)}; expected "
            f"[steps, paths, {simulator.action.size}]."
        )


def check_draws(simulator: Simulator, draws: Draws) -> None:
    """Checks that there are paths with noise for each step; kernels do not check this."""
    if not draws.size:
        raise ValueError("engine: the draws have no paths; they must have at least one.")
    if isinstance(draws, Counter) and simulator.initial_noise_size % max(draws.before, 1):
        raise ValueError(
            f"engine: the draws pass the noise of {draws.before} steps to `initial`, but "
            f"initial_noise_size, {simulator.initial_noise_size}, is not a multiple of this number."
        )
    if isinstance(draws, Stored):
        shapes = {
            "step_noise": (simulator.horizon, draws.size, simulator.noise_size),
            "initial_noise": (draws.size, simulator.initial_noise_size),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(draws, name)) != shape:
                raise ValueError(
                    f"engine: {name} of the draws has shape {np.shape(getattr(draws, name))}; "
                    f"this simulator needs {shape}."
                )


def check_schedule(simulator: Simulator, schedule: Schedule) -> None:
    """Checks that every step has its numbers, without broadcasting and without a remainder."""
    horizon = simulator.horizon
    other = [
        isinstance(leaf, np.ndarray | jax.Array) and leaf.shape[:1] != (horizon,)
        for leaf in jax.tree.leaves(schedule.steps)
    ]
    if any(other):
        path, leaf = jax.tree.leaves_with_path(schedule.steps)[other.index(True)]
        raise ValueError(
            f"engine: schedule.steps{jax.tree_util.keystr(path)} has shape {leaf.shape}; its "
            f"first axis must have {horizon} steps."
        )


def check_window(simulator: Simulator, window: Window) -> None:
    """Checks that a window is within the horizon."""
    if window.first < 0 or window.length < 1 or window.first + window.length > simulator.horizon:
        raise ValueError(
            f"engine: window {tuple(window)} (first, length) extends beyond the horizon of "
            f"{simulator.horizon} steps."
        )
