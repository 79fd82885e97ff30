"""The best linear rule of a linear plant with a quadratic cost, in closed form.

P_T = Q_T, K_t = (R + B'P_{t+1} B)^-1 (B'P_{t+1} A + N'), P_t = Q + A'P_{t+1} A - (A'P_{t+1} B + N)
K_t for the cost x'Q x + 2 x'N u + u'R u; the mean cost from x is x'P_0 x + sum trace(P_{t+1} W_t),
where W_t is the covariance of the disturbances (Bertsekas, Dynamic Programming and Optimal Control,
section 3.1).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snapo.problem.quickly import compiled_sooner
from snapo.problem.smooth import Exact

from .kinds import MEASURED, PlantValues
from .plants.linear import LinearQuadratic
from .plants.plant import Plant


class Linearised(NamedTuple):
    """A plant around its target, with state deviations x and action deviations u."""

    A: np.ndarray
    B: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    N: np.ndarray
    Q_T: np.ndarray


class Riccati(NamedTuple):
    """Gains [T, m, n] and costs-to-go [T + 1, n, n]."""

    K: Float[np.ndarray, "T m n"]
    P: Float[np.ndarray, "T+1 n n"]


def riccati(plant: Linearised, steps: int) -> Riccati:
    """Solves the Riccati recursion backwards from the end."""
    A, B, Q, R, N, last = plant
    costs, gains = [last], []
    for _ in range(steps):
        ahead = costs[-1]
        gain = np.linalg.solve(R + B.T @ ahead @ B, B.T @ ahead @ A + N.T)
        costs.append(Q + A.T @ ahead @ A - (A.T @ ahead @ B + N) @ gain)
        gains.append(gain)
    return Riccati(np.stack(gains[::-1]), np.stack(costs[::-1]))


def expected_cost(costs: Riccati, mean, covariance, shocks) -> float:
    """The mean cost from an initial state with this mean [n] and covariance [n, n].

    `shocks`: [n, n] or [T, n, n] covariances of the disturbances.
    """
    start = mean @ costs.P[0] @ mean + np.trace(costs.P[0] @ covariance)
    return float(start + np.sum(costs.P[1:] * np.broadcast_to(shocks, costs.P[1:].shape)))


def linearised(plant: Plant, p: PlantValues, w: PlantValues) -> Linearised:
    """Linearises the plant around its target and the action that holds it there, in float64. The
    states are a vector in the order of their names.
    """
    with jax.enable_x64(True):
        target = {name: jnp.asarray(x, float) for name, x in plant.target_at(p).items()}
        origin, back = jax.flatten_util.ravel_pytree(target)
        rest = jnp.asarray(plant.rest(p), float)
        p, w = (jax.tree.map(lambda x: jnp.asarray(x, float), tree) for tree in (p, w))

        def move(x, u):
            after = plant.move(p, back(origin + x), rest + u, Exact())
            return jax.flatten_util.ravel_pytree(after)[0] - origin

        def cost(x, u):
            return sum(plant.cost(w, p, back(origin + x), rest + u).values())

        def last(x):
            return sum(plant.final_cost(w, p, back(origin + x)).values(), jnp.zeros(()))

        @compiled_sooner
        def derivatives(x, u):
            hessians = jax.hessian(cost, (0, 1))(x, u), jax.hessian(last)(x)
            return jax.jacobian(move, (0, 1))(x, u), *hessians

        zero = np.zeros(origin.shape), np.zeros(rest.shape)
        (A, B), ((Q, N), (_, R)), end = jax.tree.map(np.asarray, derivatives(*zero))
        return Linearised(A, B, Q / 2, R / 2, N / 2, end / 2)


def estimation_cost(
    plant: Linearised,
    result: Riccati,
    start: Float[np.ndarray, "n n"],
    shocks: Float[np.ndarray, "*T n n"],
    errors: Float[np.ndarray, "n n"],
) -> float:
    """The additional mean cost that measurement noise causes.

    `start`, `shocks`, `errors`: covariances of the initial state, of disturbances and of
    measurement errors, all of which are normal.
    """
    total, prior = 0.0, start
    every = np.broadcast_to(shocks, result.P[1:].shape)
    for gain, ahead, shock in zip(result.K, result.P[1:], every):
        # Where a state is measured exactly, or known, the sum may have no inverse.
        available = prior - prior @ np.linalg.pinv(prior + errors, hermitian=True) @ prior
        value = gain.T @ (plant.R + plant.B.T @ ahead @ plant.B) @ gain
        total += float(np.sum(available * value))
        prior = plant.A @ available @ plant.A.T + shock
    return total


def solved(plant: Plant, values: Mapping[str, Any]) -> Riccati | None:
    """Gains and costs-to-go of a linear plant without bounds; None for any other."""
    if not isinstance(plant, LinearQuadratic) or "limit" in values["plant"]:
        return None
    return riccati(linearised(plant, values["plant"], values["cost"]), plant.horizon)


def optimum(plant: Plant, values: Mapping[str, Any]) -> float | None:
    """The largest mean reward of any rule; None if it is unknown."""
    result = solved(plant, values)
    if result is None:
        return None
    start, size = values["start"]["x"], result.P.shape[-1]
    spread = np.zeros((size, size))
    mean = start.get("at", start.get("mean"))
    if "low" in start:
        mean = (start["low"] + start["high"]) / 2
        spread = np.diag((start["high"] - start["low"]) ** 2 / 12)
    if "deviation" in start:
        spread = np.diag(start["deviation"] ** 2)
    shocks = np.zeros((size, size))
    if "x" in values["noise"]:
        inputs = values["noise"]["x"]
        shocks = inputs @ np.swapaxes(inputs, -1, -2)
    best = expected_cost(result, np.asarray(mean), spread, shocks)
    if not plant.measured:
        return -best
    if "low" in start:  # not normal: Kalman's filter is only the best linear one
        return None
    linear, errors = linearised(plant, values["plant"], values["cost"]), values[MEASURED]["x"]
    return -best - estimation_cost(linear, result, spread, shocks, np.diag(errors**2))
