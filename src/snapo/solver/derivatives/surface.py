"""The value around a trained policy, as a quadratic surface in a few coordinates.

The EXACT simulator is valued on fixed paths at a few dozen points around the policy. The fitted
surface V = G z + z H z / 2 has its maximum near the policy: there the value is slightly higher, and
H measures the loss of a suboptimal policy. Both enter the interval of every derivative, and the
policy at the maximum is a candidate for the reported one.

The coordinates are a few directions in the space of the policy's parameters.

For a network they are a shift and a gain of every raw output of its last layer, which move all
decisions together; for many outputs a common gain, the change in the second half of training, and a
few mixtures of the shifts. A rule with few parameters has one coordinate for each.
"""

from collections.abc import Callable
from itertools import combinations_with_replacement
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Engine
from snapo.problem.inputs import Frozen
from snapo.problem.policies.memory import GRU
from snapo.problem.policy import Network, Policy, trainable
from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, Scenarios, stream

from ..evaluate import path_totals
from ..statistics import Estimate
from .bump import block_means

EACH = 4  # maximum number of outputs with a separate shift and gain
MIXTURES = 4  # of the shifts of more outputs
FEW = 8  # numbers at most of a rule without a network that has a coordinate for each
SMALL = 1e-3  # the size that a number of a rule has at least, in its own coordinate


class Coordinates(NamedTuple):
    """Directions [n, P] in the P trained numbers of a policy; `policy` is their origin."""

    policy: Policy
    directions: np.ndarray

    def at(self, position: np.ndarray) -> Policy:
        """The policy at coordinates [n]."""
        return shifted_policy(self.policy, position @ self.directions)

    def leading(self, count: int) -> "Coordinates":
        """The first `count` coordinates only."""
        return self._replace(directions=self.directions[:count])

    def random(self, rng: np.random.Generator) -> np.ndarray:
        """[P] a random direction; the size of each number is the typical one in its array."""
        # In float64: JAX's arrays and NumPy's would round the same numbers to other deviations.
        leaves = [np.asarray(x, np.float64) for x in jax.tree.leaves(trainable(self.policy)[0])]
        drawn = [
            rng.standard_normal(x.shape) * max(float(np.std(x)), SMALL) for x in leaves if x.size
        ]
        return np.concatenate([np.zeros(0), *map(np.ravel, drawn)])


def shifted_policy(policy: Policy, by: np.ndarray) -> Policy:
    """The policy whose trained numbers, as one vector [P], are moved by this vector."""
    numbers, rest = trainable(policy)
    leaves, structure = jax.tree.flatten(numbers)
    after, first = [], 0
    for leaf in leaves:
        old = np.asarray(leaf)
        step = by[first : first + old.size].reshape(old.shape)
        new = (old.astype(np.float64) + step).astype(old.dtype)
        # A policy may index its arrays as JAX's: they stay unchanged.
        after.append(jnp.asarray(new) if isinstance(leaf, jax.Array) else new)
        first += old.size
    return eqx.combine(jax.tree.unflatten(structure, after), rest)


def coordinates(policy: Policy, earlier: Policy | None = None) -> Coordinates:
    """The coordinates of a policy; `earlier` is the one from halfway through its training."""
    numbers = _vector(policy)
    past = [] if earlier is None else [numbers - _vector(earlier)]
    past = [change for change in past if np.any(change)]
    shifts, gains = _of_outputs(policy)
    if not len(shifts) and numbers.size <= FEW:
        return Coordinates(policy, np.diag(np.maximum(np.abs(numbers), SMALL)))
    if not len(shifts):
        return Coordinates(policy, np.stack([numbers, *past]))
    if len(shifts) <= EACH:
        pairs = np.stack([shifts, gains], axis=1)
        return Coordinates(policy, pairs.reshape(-1, numbers.size))
    rng = np.random.default_rng(len(shifts))
    mixtures = np.linalg.qr(rng.standard_normal((len(shifts), MIXTURES)))[0].T @ shifts
    return Coordinates(policy, np.stack([gains.sum(0), *past, *mixtures]))


def _of_outputs(policy: Policy) -> tuple[np.ndarray, np.ndarray]:
    """[outputs, P] directions: a raw output plus one, and a raw output doubled."""
    leaves = jax.tree.leaves(trainable(policy)[0])
    shifts, gains = [], []
    for network in _deciding(policy):
        weights, bias = network.weights[-1], network.biases[-1]
        for one in np.eye(len(bias)):
            shifts.append(_vector_of(leaves, {id(bias): one}))
            rows = {
                id(weights): np.asarray(weights) * one[:, None],
                id(bias): np.asarray(bias) * one,
            }
            gains.append(_vector_of(leaves, rows))
    size = sum(int(np.size(leaf)) for leaf in leaves)
    return np.reshape(shifts, (-1, size)), np.reshape(gains, (-1, size))


def _vector_of(leaves: list, changes: dict[int, np.ndarray]) -> np.ndarray:
    """Changes of some arrays, by their identity, as a vector of all numbers."""
    parts = [np.ravel(changes.get(id(leaf), np.zeros(np.shape(leaf)))) for leaf in leaves]
    return np.concatenate([np.zeros(0), *parts])


def _deciding(policy: PyTree) -> list[Network]:
    """The trained networks whose outputs become decisions."""
    if isinstance(policy, GRU):
        return [] if policy.readout is None else [policy.readout]
    kinds = Network | GRU | Frozen
    nodes = jax.tree.leaves(policy, is_leaf=lambda node: isinstance(node, kinds))
    networks = [_deciding(x) if isinstance(x, GRU) else [x] for x in nodes]
    return [x for group in networks for x in group if isinstance(x, Network)]


def _vector(policy: Policy) -> np.ndarray:
    leaves = jax.tree.leaves(trainable(policy)[0])
    return np.concatenate([np.zeros(0), *(np.ravel(np.asarray(x, np.float64)) for x in leaves)])


SEARCH = 4  # of the evaluation's streams
SEEN, SHARE = 4.0, 5e-4  # a target is this number of standard errors, and this share of the value
FIRST, WIDEST = 0.02, 4.0  # radii of a coordinate
BEYOND, MINIMUM, MAXIMUM = 1.2, 1.5, 8.0  # of the distance to a loss; how far a try goes at a time
CLIFF = 4.0  # targets: a fall that is no longer a slope
POINTS = 1.6  # places for each coefficient of the surface
LACK, CLOSER, TRIES = 0.2, 1.7, 2  # of a target; closer places where the surface does not fit
FLAT = 0.5  # of a target: the minimum curvature over a radius
STEP, ROUNDS = 1.3, 2  # radii that one step takes at most; surfaces, one at the top of the other


class Surface(NamedTuple):
    """A quadratic surface around a policy, in radii from `centre` along the coordinates.

    - `coordinates`, `centre` [n], `radius` [n]: the coordinates, with their centre and radii;
      `top`: [n] the position of the maximum.
    - `points`: [M, n] where the value was measured, in radii from `centre`.
    - `inverse`: [n, n] the inverse of minus the curvature; `covariance`: [n, n] the covariance of
      the top.
    - `target`: the loss at one radius; `gain`: the gain of the surface from its centre to its top.
    - `source`, `paths`: scenarios and paths on which the values were measured.
    """

    coordinates: Coordinates
    centre: np.ndarray
    radius: np.ndarray
    top: np.ndarray
    points: np.ndarray
    inverse: np.ndarray
    covariance: np.ndarray
    target: float
    gain: float
    source: Scenarios
    paths: int

    @property
    def policy(self) -> Policy:
        """The policy at the top."""
        return self.coordinates.at(self.top)

    def at(self, position: np.ndarray) -> Policy:
        """The policy at coordinates in radii from the centre."""
        return self.coordinates.at(self.centre + self.radius * position)


class _Value:
    """The exact value at places of the coordinates, minus that at their origin, by block."""

    def __init__(
        self,
        problem: Problem,
        coordinates: Coordinates,
        source: Scenarios,
        paths: int,
        engine: Engine,
    ):
        self.problem, self.coordinates, self.engine = problem, coordinates, engine
        self.source, self.paths = source, paths
        self.blocks = source.blocks(paths)
        self.origin = self._at(np.zeros(len(coordinates.directions)))

    def __call__(self, position: np.ndarray) -> np.ndarray:
        return self._at(position) - self.origin

    def _at(self, position: np.ndarray) -> np.ndarray:
        result = path_totals(
            self.problem,
            self.coordinates.at(position),
            self.paths,
            engine=self.engine,
            source=self.source,
            controls=False,
        )
        return block_means(self.problem.objective, result, self.blocks)


def fresh(source: Scenarios, number: int) -> Scenarios:
    """Scenarios that are used for nothing else; Sobol or supplied ones are returned unchanged."""
    if not isinstance(source, Pseudo):
        return source
    return Pseudo(source.seed, source.antithetic, stream(EVALUATE, number))


def rollouts(count: int) -> int:
    """The approximate number of valuations for a surface in `count` coordinates."""
    return 14 * count + 3 * (count + 1) * (count + 2)


def surface_of(
    problem: Problem, coordinates: Coordinates, paths: int, seed: int, engine: Engine
) -> Surface | None:
    """The surface on `paths` of fresh scenarios; None if no coordinate affects the value."""
    count = len(coordinates.directions)
    source = fresh(problem.sources.evaluation, SEARCH)
    paths = source.available(paths)
    value = _Value(problem, coordinates, source, paths, engine)
    level = float(np.mean(value.origin))
    if not count or not np.isfinite(level):
        return None
    radius, targets = _radii(value, count, abs(level))
    target = float(np.median(targets))
    if not target > 0:
        return None
    rng, centre = np.random.default_rng(seed), np.zeros(count)
    for number in range(ROUNDS):
        radius, fit = _fitted(value, centre, radius, rng, target)
        if fit is None:
            return None
        step = _step(fit, lambda position, c=centre, r=radius: value(c + r * position))
        top = centre + radius * step
        if number + 1 < ROUNDS:
            centre = top
    return Surface(
        coordinates, centre, radius, top, fit.points, fit.inverse,
        fit.covariance, target, max(fit.gain, 0.0), source, paths,
    )  # fmt: skip


def distance_factor(loss: float, target: float) -> float:
    """The factor on the distance at which the loss is `target`, if the loss is quadratic."""
    return float(
        np.clip(BEYOND * np.sqrt(target / loss) if loss > 0 else MAXIMUM, MINIMUM, MAXIMUM)
    )


def _radii(value: _Value, count: int, level: float) -> tuple[np.ndarray, np.ndarray]:
    """For every coordinate the move at which the worse side falls by a target, and the target."""
    radius, targets = np.zeros(count), np.zeros(count)

    def fall(one: np.ndarray) -> tuple[float, float]:
        sides = [Estimate(value(sign * one)) for sign in (1.0, -1.0)]
        error = max(float(side.standard_error) if len(side.blocks) > 1 else 0.0 for side in sides)
        loss = -min(float(side.value) for side in sides)
        return np.inf if np.isnan(loss) else loss, max(SEEN * np.nan_to_num(error), SHARE * level)

    for j, unit in enumerate(np.eye(count)):
        low, r = FIRST / 2, FIRST
        loss, target = fall(r * unit)
        while loss < target and r < WIDEST:
            low, r = r, min(r * distance_factor(loss, target), WIDEST)
            loss, target = fall(r * unit)
        for _ in range(3):  # not over a cliff
            if loss < CLIFF * target:
                break
            middle = np.sqrt(low * r)
            inner, inner_target = fall(middle * unit)
            if inner > inner_target:
                r, loss, target = middle, inner, inner_target
            else:
                low = middle
        radius[j], targets[j] = r, target
    return radius, targets


class _Fitted(NamedTuple):
    """Coefficients of a surface: gradient and curvature, with the error of the gradient."""

    points: np.ndarray
    gradient: np.ndarray
    inverse: np.ndarray
    noise: np.ndarray
    lack: float

    @property
    def step(self) -> np.ndarray:
        return self.inverse @ self.gradient

    @property
    def gain(self) -> float:
        return float(0.5 * self.gradient @ self.step)

    @property
    def covariance(self) -> np.ndarray:
        """The covariance of the maximum, with a prior of one radius."""
        inverse = self.inverse @ self.noise @ self.inverse
        return inverse @ np.linalg.inv(np.eye(len(inverse)) + inverse)


def _fitted(
    value: _Value, centre: np.ndarray, radius: np.ndarray, rng: np.random.Generator, target: float
) -> tuple[np.ndarray, _Fitted | None]:
    """The surface around a centre, over smaller radii where no quadratic fits."""
    fit = None
    for _ in range(TRIES + 1):
        fit = _fit(value, centre, radius, rng, target)
        if fit is None or fit.lack < LACK * target:
            break
        radius = radius / CLOSER
    return radius, fit


def _fit(value: _Value, centre, radius, rng, target: float) -> _Fitted | None:
    """Least squares over pairs of opposite places, 0.5 to 1.3 radii away."""
    count = len(centre)
    pairs = list(combinations_with_replacement(range(count), 2))
    size = 1 + count + len(pairs)
    half = rng.standard_normal((int(np.ceil(POINTS * size / 2)) + 2, count))
    half *= (rng.uniform(0.5, 1.3, len(half)) / np.linalg.norm(half, axis=1))[:, None]
    positions = np.concatenate([np.zeros((1, count)), half, -half])
    heights = np.stack([value(centre + radius * position) for position in positions])
    if not np.isfinite(heights).all():
        return None
    squares = np.stack([positions[:, i] * positions[:, j] for i, j in pairs], axis=1)
    solve = np.linalg.pinv(
        np.concatenate([np.ones((len(positions), 1)), positions, squares], axis=1)
    )
    by_block = solve @ heights
    means = by_block.mean(1)
    curvature = np.zeros((count, count))
    for (i, j), coefficient in zip(pairs, means[1 + count :]):
        curvature[i, j] += coefficient
        curvature[j, i] += coefficient
    design = np.concatenate([np.ones((len(positions), 1)), positions, squares], axis=1)
    missing = heights.mean(1) - design @ means
    variance = float(missing @ missing) / max(1, len(positions) - size)
    slopes = by_block[1 : 1 + count]
    noise = variance * (solve @ solve.T)[1 : 1 + count, 1 : 1 + count]
    if slopes.shape[1] > 1:
        noise = noise + np.atleast_2d(np.cov(slopes)) / slopes.shape[1]
    values, vectors = np.linalg.eigh(curvature)
    inverse = (vectors / -np.minimum(values, -FLAT * target)) @ vectors.T
    return _Fitted(positions, means[1 : 1 + count], inverse, noise, float(np.sqrt(variance)))


def _step(result: _Fitted, height: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """The step to the top in radii, shrunk according to its noise, and taken if the value rises."""
    step, count = result.step, len(result.gradient)
    ridge = 1e-30 * np.eye(count)
    chi = float(result.gradient @ np.linalg.solve(result.noise + ridge, result.gradient))
    shrink = max(0.0, 1 - max(count - 2, 1) / chi) if chi > 0 else 0.0
    length = float(np.linalg.norm(step))
    step = shrink * (min(1.0, STEP / length) if length else 1.0) * step
    here = float(np.mean(height(np.zeros(count))))
    for part in (1.0, 0.5, 0.25):
        if float(np.mean(height(part * step))) > here:
            return part * step
    return np.zeros(count)
