"""Scenarios: the noise of every path, a function only of (seed, path, step, component).

Path p is therefore the same whatever the number of paths, chunks, devices or windows, and
nothing is stored: an engine draws the numbers where it uses them. `Pseudo` counts with
threefry, `Sobol` supplies scrambled low-discrepancy points through a Brownian bridge, and
`Supplied` contains user-supplied numbers.

Steps are counted in a calendar that simulators share: a simulator whose `first_step` is 30 uses for
its step t the noise of the calendar's step 30 + t, and path p is the same scenario in all of them.
If the initial state is not a function of the noise of earlier steps, a simulator counts from its
own start. `Scenarios.world` is equal for scenarios that share their paths.
"""

import abc
from collections.abc import Hashable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .noise.counter import INITIAL_STREAM, STEP_STREAM, Counter, Draws, Stored
from .quickly import compiled_sooner
from .simulator import Simulator

BLOCKS = 32
FEWEST = 160  # supplied paths that can be divided: 32 blocks to evaluate on
SOBOL_DIMENSIONS = 21201  # of the direction numbers that scipy holds (Joe and Kuo 2008)


@dataclass(frozen=True)
class Scenarios(abc.ABC):
    """A source of noise: `draws` returns it for selected paths, `groups` the independent units."""

    @abc.abstractmethod
    def draws(self, paths: np.ndarray, simulator: Simulator) -> Draws:
        """The noise of the paths with these numbers."""

    def batch(self, step: int, paths: int, simulator: Simulator) -> Draws:
        """The noise of one training step: other paths at every step, the same in every run."""
        raise ValueError(f"{type(self).__name__}: these scenarios are for evaluation only.")

    def available(self, requested: int) -> int:
        """The number of available paths when `paths` are requested."""
        return requested

    def describe(self, paths: int) -> str:
        """A description of the paths when `paths` are requested: "512 pseudo-random paths"."""
        return f"{self.available(paths):,} paths of {type(self).__name__}"

    def batch_words(self, paths: int) -> str:
        """A description of the paths of one training step."""
        return self.describe(paths)

    def world(self, simulator: Simulator) -> tuple[Hashable, ...]:
        """Path p is the same scenario in all simulators for which this is equal."""
        return (repr(self), simulator.noise_size, _counted_from(simulator), *simulator.calendar)

    @abc.abstractmethod
    def groups(self, paths: np.ndarray) -> np.ndarray:
        """The smallest independent unit to which each path belongs (a pair, a scramble, itself)."""

    def blocks(self, paths: int, count: int = BLOCKS) -> list[np.ndarray]:
        """Path numbers 0 … paths - 1 in `count` independent blocks of nearly equal size."""
        return [b for b in np.array_split(np.arange(paths), count) if b.size]


@dataclass(frozen=True)
class Pseudo(Scenarios):
    """Counter-based pseudo-random normals; antithetic paths 2i and 2i + 1 have opposite signs.

    `stream` separates uses of one seed (training step, validation, evaluation).
    """

    seed: int = 0
    antithetic: bool = True
    stream: int = 0

    def batch(self, step: int, paths: int, simulator: Simulator) -> Counter:
        fresh = replace(self, stream=self.stream + step)
        return fresh.draws(np.arange(fresh.available(paths)), simulator)

    def available(self, requested: int) -> int:
        """As many as requested; for an odd number the last pair is completed."""
        return requested + requested % 2 if self.antithetic else requested

    def describe(self, paths: int) -> str:
        pairs = ", in antithetic pairs" if self.antithetic else ""
        return f"{self.available(paths):,} pseudo-random paths{pairs}"

    def draws(self, paths: np.ndarray, simulator: Simulator) -> Counter:
        start = _start(simulator)
        return self.counter(paths, start, simulator.initial_steps if start else 0)

    def counter(self, paths: np.ndarray, first: int = 0, before: int = 0) -> Counter:
        """The noise of a simulator that begins on step `first` of the calendar; see `Counter`."""
        uses = STEP_STREAM, INITIAL_STREAM
        keys = np.stack([_key(self.seed, self.stream, use) for use in uses])
        numbers = np.asarray(paths, np.uint32), np.asarray(first, np.uint32)
        return Counter(keys, *numbers, self.antithetic, before)  # pyright: ignore

    def groups(self, paths: np.ndarray) -> np.ndarray:
        return paths // 2 if self.antithetic else paths

    def blocks(self, paths: int, count: int = BLOCKS) -> list[np.ndarray]:
        if not self.antithetic:
            return Scenarios.blocks(self, paths, count)
        if paths % 2:
            raise ValueError(
                f"Pseudo: {paths} antithetic paths; their number must be even. `available` "
                "completes the last pair."
            )
        pairs = Scenarios.blocks(self, paths // 2, count)
        return [np.stack([2 * p, 2 * p + 1], axis=-1).reshape(-1) for p in pairs]


@dataclass(frozen=True)
class Sobol(Scenarios):
    """Scrambled Sobol points through a Brownian bridge, for evaluation.

    Path p is point p // 32 of scramble p % 32, so standard errors come from 32 independent
    scrambles. A bridge is built for each component over equal steps. Its first coefficients take
    the first Sobol dimensions; the coefficients beyond Sobol's dimensions are pseudo-random. The
    bridge spans the calendar up to the simulator's last step, so that paths depend on this step.
    """

    seed: int = 0
    scrambles: int = BLOCKS

    def describe(self, paths: int) -> str:
        return f"{paths:,} Sobol points in {self.scrambles} scrambles"

    def draws(self, paths: np.ndarray, simulator: Simulator) -> Stored:
        start, size = _start(simulator), simulator.noise_size
        horizon, separate = start + simulator.horizon, self._separate(simulator)
        width = separate + horizon * size
        z = np.empty((len(paths), width))
        for scramble in np.unique(paths % self.scrambles):
            rows = paths % self.scrambles == scramble
            z[rows] = self._points(int(scramble), paths[rows] // self.scrambles, width)
        noise = bridge(z[:, separate:].reshape(len(paths), horizon, size))
        initial = z[:, :separate]
        if start:
            initial = np.zeros((len(paths), simulator.initial_noise_size))
            initial[:, : start * size] = noise[:, :start].reshape(len(paths), start * size)
        return Stored(initial, noise[:, start:].transpose(1, 0, 2))  # pyright: ignore

    def world(self, simulator: Simulator) -> tuple[Hashable, ...]:
        last = simulator.first_step + simulator.horizon
        return *super().world(simulator), last, self._separate(simulator)

    def _separate(self, simulator: Simulator) -> int:
        """How many normals of the start belong to no step; they take the first dimensions."""
        return 0 if _start(simulator) else simulator.initial_noise_size

    def groups(self, paths: np.ndarray) -> np.ndarray:
        return paths % self.scrambles

    def blocks(self, paths: int, count: int = BLOCKS) -> list[np.ndarray]:
        number = np.arange(paths)
        return [number[number % self.scrambles == s] for s in range(min(self.scrambles, paths))]

    def _points(self, scramble: int, points: np.ndarray, width: int) -> np.ndarray:
        """Normals [points, width]; `points` ascend."""
        from scipy.stats import qmc  # late: it takes a second to load

        sobol = qmc.Sobol(
            min(width, SOBOL_DIMENSIONS), rng=np.random.default_rng([self.seed, scramble])
        )
        # Only point 0: scipy cannot skip nothing, and warns of a number that is no power of 2.
        zeroth, start = sobol.random(1), max(1, int(points[0]))
        if start > 1:
            sobol.fast_forward(start - 1)
        later = sobol.random(max(1, int(points[-1]) - start + 1))
        drawn = np.concatenate([zeroth, later])[np.where(points == 0, 0, points - start + 1)]
        # Points lie on a grid of 2^-30 that holds 0: the middle of a cell represents the cell.
        from scipy.special import ndtri  # late: a case is checked without it

        z = ndtri(drawn + 2.0**-31)
        if width == z.shape[1]:
            return z
        rest = Pseudo(self.seed, antithetic=False, stream=1 + scramble).counter(points)
        with jax.enable_x64(True):
            return np.concatenate([z, _stored(rest, width - z.shape[1])], axis=1)


@dataclass(frozen=True, eq=False)
class Supplied(Scenarios):
    """Scenarios supplied by the user instead of normals.

    - `step_noise`: [T, paths, K]; `initial_noise`: [paths, K0], or None. The paths are assumed to
      be independent.
    - `seed`: the seed of the choice of paths at every training step.
    - `first`: the index of the first path of this part among the supplied ones.
    """

    step_noise: np.ndarray
    initial_noise: np.ndarray | None = None
    seed: int = 0
    first: int = 0

    def describe(self, paths: int) -> str:
        return f"{self.available(paths):,} of {self._where()}"

    def batch_words(self, paths: int) -> str:
        return f"{paths:,} drawn from {self._where()}"

    def _where(self) -> str:
        return f"the supplied paths {self.first + 1:,} to {self.first + self.size:,}"

    @property
    def size(self) -> int:
        """The number of paths."""
        return self.step_noise.shape[1]

    def available(self, requested: int) -> int:
        return min(requested, self.size)

    def batch(self, step: int, paths: int, simulator: Simulator) -> Stored:
        random = np.random.default_rng([self.seed, TRAIN, step])
        return self.draws(random.choice(self.size, paths), simulator)

    def part(self, first: int, last: int) -> "Supplied":
        """The paths from number `first` to `last`, which is not included, as scenarios."""
        initial = None if self.initial_noise is None else self.initial_noise[first:last]
        noise = self.step_noise[:, first:last]
        return replace(self, step_noise=noise, initial_noise=initial, first=self.first + first)

    def draws(self, paths: np.ndarray, simulator: Simulator) -> Stored:
        steps, available, size = self.step_noise.shape
        if steps != simulator.horizon or size != simulator.noise_size:
            raise ValueError(
                f"Supplied: step_noise has shape {self.step_noise.shape}; this simulator needs "
                f"({simulator.horizon}, paths, {simulator.noise_size})."
            )
        if len(paths) and paths.max() >= available:
            raise ValueError(
                f"Supplied: path {paths.max()} was requested, but there are only {available} paths "
                "(numbered from 0)."
            )
        initial = self.initial_noise
        if initial is None:
            initial = np.zeros((available, simulator.initial_noise_size))
        return Stored(initial[paths], self.step_noise[:, paths])  # pyright: ignore

    def world(self, simulator: Simulator) -> tuple[Hashable, ...]:
        # Who supplies as many rows for two simulators means the same worlds by them.
        return self._where(), simulator.noise_size

    def groups(self, paths: np.ndarray) -> np.ndarray:
        return paths


@dataclass(frozen=True)
class EqualPaths(Scenarios):
    """Scenarios of a problem without randomness: all paths are equal.

    At least two are used, since one path has no standard error; that of equal paths is zero.
    """

    inner: Scenarios

    def describe(self, paths: int) -> str:
        return f"{self.available(paths):,} equal paths, since nothing is random"

    def available(self, requested: int) -> int:
        return min(2, self.inner.available(requested))

    def draws(self, paths: np.ndarray, simulator: Simulator) -> Draws:
        return self.inner.draws(paths, simulator)

    def world(self, simulator: Simulator) -> tuple[Hashable, ...]:
        return self.inner.world(simulator)

    def groups(self, paths: np.ndarray) -> np.ndarray:
        return paths


TRAIN, VALIDATE, EVALUATE = 1, 2, 3  # uses of a stream of `Pseudo`, in its upper half


def stream(use: int, number: int = 0) -> int:
    """The number of a stream: streams of different uses never overlap."""
    return (use << 32) + number


@dataclass(frozen=True)
class Sources:
    """A separate source of scenarios for each role.

    - `training`: returns different paths at every step.
    - `validation`: the paths on which policies are compared while training, always the same.
    - `evaluation`: the paths on which the value and its sensitivities are measured.
    """

    training: Scenarios
    validation: Scenarios
    evaluation: Scenarios

    @classmethod
    def of(cls, values: "Scenarios | Sources | None", seed: int = 0) -> "Sources":
        """The sources for the argument `scenarios` of a caller; by default fresh normals of `seed`.
        Scenarios of normals are used for the evaluation only. Supplied paths are divided: the first
        three fifths train, the next fifth validates, and the last fifth evaluates.
        """
        if isinstance(values, Sources):
            return values
        if isinstance(values, Supplied):
            return cls.divided(replace(values, seed=seed))
        fresh = (Pseudo(seed, stream=stream(use)) for use in (TRAIN, VALIDATE, EVALUATE))
        training, validation, evaluation = fresh
        return cls(training, validation, values or evaluation)

    def of_equal_paths(self, equal: bool) -> "Sources":
        """The same sources; if all paths are equal, few of them for validation and evaluation."""
        values = self.validation, self.evaluation
        local = [item.inner if isinstance(item, EqualPaths) else item for item in values]
        few = [EqualPaths(entry) for entry in local] if equal else local
        return self if few == list(values) else Sources(self.training, *few)

    def reseeded(self, seed: int) -> "Sources":
        """Sources with other paths for training and validation, and the same evaluation."""
        training, validation = (
            replace(item, seed=seed) if isinstance(item, Pseudo | Sobol | Supplied) else item
            for item in (self.training, self.validation)
        )
        return Sources(training, validation, self.evaluation)

    def roles(
        self, training: int, validation: int, evaluation: int, sensitivities: int
    ) -> dict[str, str]:
        """{role: description of its paths} for these numbers of paths."""
        available = self.evaluation.available(sensitivities)
        return {
            "training": f"{self.training.batch_words(training)}; new ones at every step",
            "validation": f"{self.validation.describe(validation)}; the same at every validation",
            "evaluation": f"{self.evaluation.describe(evaluation)}; used for the results only",
            "sensitivities": f"{available:,} of the evaluation paths",
        }

    @classmethod
    def divided(cls, supplied: Supplied) -> "Sources":
        """Supplied paths in three parts: three fifths, one fifth and one fifth."""
        if supplied.size < FEWEST:
            raise ValueError(
                f"Supplied: {supplied.size} paths are too few to train, validate and evaluate on "
                f"different ones; supply at least {FEWEST}, or Sources(training, validation, "
                "evaluation)."
            )
        first, second = supplied.size * 3 // 5, supplied.size * 4 // 5
        edges = ((0, first), (first, second), (second, supplied.size))
        return cls(*(supplied.part(*edge) for edge in edges))


def _counted_from(simulator: Simulator) -> int:
    """The step of the calendar from which a simulator counts its noise: 0, or its own start if its
    initial state is not a function of earlier noise."""
    return simulator.first_step if simulator.first_step > simulator.initial_steps else 0


def _start(simulator: Simulator) -> int:
    """The number of the simulator's first step, as it counts."""
    return simulator.first_step - _counted_from(simulator)


def _key(seed: int, stream: int, use: int) -> np.ndarray:
    """Two words that separate seeds, streams and uses (numpy's SeedSequence hash)."""
    return np.random.SeedSequence([seed, stream, use]).generate_state(2, np.uint32)


def bridge(levels: Float[np.ndarray, "paths steps k"]) -> Float[np.ndarray, "paths steps k"]:
    """Unit normals per step from normals in order of importance, by a Brownian bridge.

    The first number is the whole displacement, the next the midpoint conditional on both endpoints,
    and so on (Caflisch, Morokoff and Owen 1997). The map is orthogonal, so that the results are
    standard normals too.
    """
    steps = levels.shape[1]
    walk = np.zeros((levels.shape[0], steps + 1, levels.shape[2]))
    walk[:, steps] = np.sqrt(steps) * levels[:, 0]
    intervals, used = [(0, steps)], 1
    while intervals:
        left, right = intervals.pop(0)
        if right - left < 2:
            continue
        middle = (left + right) // 2
        weight = (middle - left) / (right - left)
        deviation = np.sqrt((middle - left) * (right - middle) / (right - left))
        walk[:, middle] = (
            (1 - weight) * walk[:, left] + weight * walk[:, right] + deviation * levels[:, used]
        )
        used += 1
        intervals += [(left, middle), (middle, right)]
    return np.diff(walk, axis=1)


@compiled_sooner
def _stored(counter: Counter, size: int) -> Array:
    return jax.vmap(lambda c: c.initial(size, jnp.float64), in_axes=(counter.axes(),))(counter)
