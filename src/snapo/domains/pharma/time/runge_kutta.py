"""Classical Runge-Kutta steps, and the derivatives of their final state, for all steps at once.

A step is y_(t+1) = y_t + h/6 (k1 + 2 k2 + 2 k3 + k4), k_i = f(Y_i, u_i). To first order

    d y_(t+1) = A_t dy_t + sum_i M_i,t g_i,t + c_t dh_t,

where g is the derivative of f at the point Y_i with respect to everything except Y_i. Once the
points are known, A, M and c follow for all steps at once, and d y_n = sum_t P_t (sum_i M_i,t g_i,t
+ c_t dh_t) + P dy_0 with the products P_t = A_(n-1) ... A_(t+1). The linear part has no loop, so
its transpose, the adjoint, has none either.
"""

from collections.abc import Callable
from math import isqrt

import numpy as np

from snapo.problem.record.arrays import Array, Float, custom_jvp, jax, jnp

RateFunction = Callable[[Array, Array], Array]


def runge_kutta(rate: RateFunction, y: Array, step: Array, drive: Float[Array, "3 D"]) -> Array:
    """One classical step of order four; `drive` at its start, middle and end."""
    return _step(rate, y, step, drive)[0]


def _step(rate: RateFunction, y, step, drive) -> tuple[Array, Float[Array, "4 m"]]:
    """The state after the step, and the points at which the rate was evaluated."""
    k1 = rate(y, drive[0])
    y2 = y + step / 2 * k1
    k2 = rate(y2, drive[1])
    y3 = y + step / 2 * k2
    k3 = rate(y3, drive[1])
    y4 = y + step * k3
    k4 = rate(y4, drive[2])
    return y + step / 6 * (k1 + 2 * (k2 + k3) + k4), jnp.stack([y, y2, y3, y4])


def final_state(
    rate: RateFunction,
    start: Float[Array, " m"],
    step: Float[Array, " n"],
    drive: Float[Array, "n 3 D"],
) -> Float[Array, " m"]:
    """The state after all steps. Its derivatives need memory for some 10 n m^2 numbers. Second
    derivatives are possible, with forward mode for the second one."""
    rate, held = jax.closure_convert(rate, start, drive[0, 0])
    return _last(rate, start, step, drive, tuple(held))


def _last_tangent(rate, primals, tangents):
    start, step, drive, held = primals
    d_start, d_step, d_drive, d_held = tangents

    def advance(y, now):
        return _step(lambda y, u: rate(y, u, *held), y, *now)

    final, points = jax.lax.scan(advance, start, (step, drive))
    points = jnp.transpose(points, (1, 2, 0))  # steps last: they are worked on side by side

    def at_stages(drive):
        return jnp.transpose(drive[:, np.array([0, 1, 1, 2])], (1, 2, 0))

    def slopes(points, drive, held):
        def one(y, u):
            return rate(y, u, *held)

        return jax.vmap(jax.vmap(one, -1, -1))(points, drive)

    drive, d_drive = at_stages(drive), at_stages(d_drive)
    map_, weights, by_step = _linear(lambda y: slopes(y, drive, held), points, step)
    others = jax.jvp(lambda u, held: slopes(points, u, held), (drive, held), (d_drive, d_held))[1]
    moved = by_step * d_step + sum(_times(w, g) for w, g in zip(weights, others))
    after, complete = _products(map_)
    return final, complete @ d_start + jnp.sum(_times(after, moved), -1)


@custom_jvp(_last_tangent, fixed=(0,))
def _last(rate, start, step, drive, held):
    def advance(y, now):
        return runge_kutta(lambda y, u: rate(y, u, *held), y, *now), None

    return jax.lax.scan(advance, start, (step, drive))[0]


def _linear(slopes: Callable, points: Float[Array, "4 m n"], step: Float[Array, " n"]):
    """A [m, m, n], M [4 of m, m, n] and c [m, n] of every step."""
    eye = jnp.eye(points.shape[1])

    def along(direction):
        tangent = jnp.broadcast_to(direction[:, None], points.shape)
        return jax.jvp(slopes, (points,), (tangent,))

    k, jacobian = jax.vmap(along, out_axes=(None, 2))(eye)
    one, h = eye[:, :, None], step
    w4 = h / 6 * one
    w4_j = h / 6 * jacobian[3]
    w3 = h / 3 * one + h * w4_j
    w3_j = _product(w3, jacobian[2])
    w2 = h / 3 * one + h / 2 * w3_j
    w2_j = _product(w2, jacobian[1])
    w1 = h / 6 * one + h / 2 * w2_j
    map_ = one + _product(w1, jacobian[0]) + w2_j + w3_j + w4_j
    by_step = (k[0] + 2 * (k[1] + k[2]) + k[3]) / 6
    by_step = by_step + (_times(w2_j, k[0]) + _times(w3_j, k[1])) / 2 + _times(w4_j, k[2])
    return map_, (w1, w2, w3, w4), by_step


def _product(a: Float[Array, "i j ..."], b: Float[Array, "j k ..."]) -> Float[Array, "i k ..."]:
    """Products of many small matrices at once; the sums are written out and act on whole rows of
    matrices."""
    return sum(a[:, j, None] * b[j] for j in range(len(b)))  # pyright: ignore[reportReturnType]


def _times(a: Float[Array, "i j n"], v: Float[Array, "j n"]) -> Float[Array, "i n"]:
    return sum(a[:, j] * v[j] for j in range(len(v)))  # pyright: ignore[reportReturnType]


def _products(a: Float[Array, "m m n"]) -> tuple[Float[Array, "m m n"], Float[Array, "m m"]]:
    """The product of all matrices after each step, A_(n-1) ... A_(t+1), and the product of all. It
    is computed within about sqrt(n) blocks at once, and then from block to block.
    """
    m, n = a.shape[0], a.shape[2]
    long = max(1, isqrt(n))
    blocks = -(-n // long)
    eye = jnp.eye(m)
    filled = jnp.broadcast_to(eye[:, :, None], (m, m, blocks * long - n))
    parts = jnp.concatenate([a, filled], 2).reshape(m, m, blocks, long)

    def before(product, factor):
        return _product(product, factor), product

    first = jnp.broadcast_to(eye[:, :, None], (m, m, blocks))
    block, within = jax.lax.scan(before, first, jnp.moveaxis(parts, 3, 0), reverse=True)
    complete, later = jax.lax.scan(before, eye, jnp.moveaxis(block, 2, 0), reverse=True)
    result = _product(jnp.moveaxis(later, 0, 2)[..., None], jnp.moveaxis(within, 0, 3))
    return result.reshape(m, m, blocks * long)[:, :, :n], complete
