"""What random step functions are composed of: functions from one or two arrays [n] to one.

Together they use every kind of operation that the engine supports. Each keeps numbers of moderate
size, so that a composition of many stays finite and its derivatives tell something.
"""

import jax
import jax.numpy as jnp


def position(x, n: int):
    """Integers in [0, n), one for every number."""
    return (jnp.abs(x) * 3).astype(jnp.int32) % n


def rows(x):
    """A matrix of the same numbers, where there is an even number of them."""
    return x.reshape(2, -1) if x.size % 2 == 0 else x.reshape(1, -1)


@jax.custom_jvp
def kinked(x):
    return jnp.maximum(x, 0.1)


kinked.defjvp(lambda x, t: (kinked(x[0]), jnp.where(x[0] > 0, t[0], 0.5 * t[0])))


@jax.custom_vjp
def scaled(x):
    return jnp.sin(x)


scaled.defvjp(lambda x: (jnp.sin(x), x), lambda x, g: (g * jnp.cos(0.9 * x),))


def doubling(x):
    """A scan that gives all its carries, weighted back to one array."""
    carries = jax.lax.scan(lambda c, k: (jnp.tanh(c + k * x), c), x, jnp.arange(3.0))[1]
    return carries.sum(0) / 3


CURVES = {
    "tanh": jnp.tanh, "logistic": jax.nn.sigmoid, "softplus": jax.nn.softplus, "sin": jnp.sin,
    "cos": jnp.cos, "exp": lambda x: jnp.exp(-jnp.abs(x)), "expm1": lambda x: jnp.expm1(jnp.minimum(x, 1)),
    "log": lambda x: jnp.log(jnp.abs(x) + 0.5), "log1p": lambda x: jnp.log1p(x * x), "erf": jax.scipy.special.erf,
    "sqrt": lambda x: jnp.sqrt(jnp.abs(x) + 0.1), "rsqrt": lambda x: jax.lax.rsqrt(x * x + 0.2),
    "atan": jnp.arctan, "cbrt": lambda x: jnp.cbrt(x * x + 0.1), "cosh": lambda x: jnp.cosh(jnp.clip(x, -2, 2)),
    "power": lambda x: jnp.power(jnp.abs(x) + 0.2, 1.3), "cube": lambda x: jnp.clip(x, -2, 2) ** 3 / 4,
    "inverse": lambda x: (1 + jnp.abs(x)) ** -2, "asinh": jnp.arcsinh, "exp2": lambda x: jnp.exp2(-x * x),
    "normal_cdf": lambda x: jax.scipy.stats.norm.cdf(x), "silu": jax.nn.silu,
}  # fmt: skip
KINKS = {
    "abs": jnp.abs, "relu": jax.nn.relu, "clip": lambda x: jnp.clip(x, -0.8, 0.7), "floor": lambda x: x - jnp.floor(x),
    "sign": lambda x: jnp.sign(x) * 0.3 + x, "round": lambda x: x + 0.1 * jnp.round(3 * x),
    "where": lambda x: jnp.where(x > 0.2, x, 0.5 * x), "kinked": kinked, "remainder": lambda x: jnp.mod(x, 0.7),
    "not": lambda x: jnp.where(~(x > 0) & (x < 1) | jnp.isnan(x), x, 0.3),
    "cond": lambda x: jax.lax.cond(x[0] > 0.1, jnp.sin, lambda y: 0.5 * y, x),
    "switch": lambda x: jax.lax.switch(position(x[-1], 4), [jnp.sin, jnp.cos, jnp.tanh], x),
}  # fmt: skip
ARRAYS = {
    "cumsum": lambda x: jnp.cumsum(x) / x.size, "cumprod": lambda x: jnp.cumprod(jnp.cos(x)),
    "cummax": jax.lax.cummax, "cummin": lambda x: jax.lax.cummin(x, reverse=True), "sort": jnp.sort,
    "argsort": lambda x: x[jnp.argsort(-x)], "reverse": lambda x: x[::-1], "roll": lambda x: jnp.roll(x, 2),
    "softmax": jax.nn.softmax, "centre": lambda x: x - x.mean(), "norm": lambda x: x / jnp.sqrt(1 + jnp.sum(x * x)),
    "argmax": lambda x: x[jnp.argmax(x)] * jnp.tanh(x), "argmin": lambda x: x.at[jnp.argmin(x)].set(0.4),
    "max": lambda x: x - x.max() / 2, "min": lambda x: x.min() + 0.5 * x, "prod": lambda x: jnp.prod(jnp.cos(x)) + x,
    "any": lambda x: jnp.where(jnp.any(x > 1) & ~jnp.all(x > -1), x, -x), "pad": lambda x: jnp.pad(x, (1, 2), constant_values=0.2)[1:-2],
    "gather": lambda x: x[position(x, x.size)], "static": lambda x: x.at[0].add(x[-1]).at[-1].mul(0.5),
    "scatter": lambda x: (0.1 * x).at[position(x, x.size)].add(0.2 * x),
    "window": lambda x: jnp.roll(x, 1).at[: max(1, x.size // 2)].set(jax.lax.dynamic_slice(x, (position(x[0], x.size),), (max(1, x.size // 2),))),
    "update": lambda x: jax.lax.dynamic_update_slice(x, jnp.tanh(x[: max(1, x.size // 2)]), (position(x[0], x.size),)),
    "rows": lambda x: (rows(x) - rows(x).mean(0)).reshape(-1) + rows(x).T.reshape(-1), "outer": lambda x: jnp.outer(x, x)[x.size // 2] / 2,
    "loop": lambda x: jax.lax.fori_loop(0, 3, lambda i, c: jnp.tanh(c + 0.1 * i), x), "scan": doubling,
    "remat": lambda x: jax.checkpoint(lambda y: jnp.sin(y) * y)(x), "custom_vjp": scaled,
    "gram": lambda x: (rows(x) @ (rows(x).T @ rows(x))).reshape(-1) / 8, "halves": lambda x: jnp.concatenate(jnp.split(x, [x.size // 2])[::-1]),
    "integers": lambda x: x * (position(x, 5) // 2 - (position(x, 7) << 1) % 3).astype(x.dtype) / 3,
    "one_hot": lambda x: jax.nn.one_hot(position(x[0], x.size), x.size, dtype=x.dtype) + x,
    "repeat": lambda x: jnp.tile(x[: (x.size + 1) // 2], 2)[: x.size], "logsumexp": lambda x: x - jax.nn.logsumexp(x),
    "median": lambda x: x - jnp.median(x), "stop": lambda x: x * jax.lax.stop_gradient(jnp.cos(x)),
}  # fmt: skip
UNARY = list((CURVES | KINKS | ARRAYS).values())
GRID = (-1.5, -0.7, 0.0, 0.3, 0.9, 2.0)
BINARY = [
    jnp.add, jnp.subtract, jnp.multiply, jnp.maximum, jnp.minimum, jnp.arctan2, jnp.logaddexp,
    lambda a, b: a / (1 + b**2), lambda a, b: jnp.where(a > b, a, 0.3 * b), lambda a, b: jnp.dot(a, b) * a / a.size,
    lambda a, b: jnp.interp(a, jnp.array(GRID), jnp.resize(b, len(GRID))), lambda a, b: a[:, None][::-1, 0] * b,
    lambda a, b: jnp.concatenate([a[:1], b[1:]]), lambda a, b: jnp.stack([a, b]).max(0), lambda a, b: jnp.fmod(a, 1 + jnp.abs(b)),
    lambda a, b: jnp.einsum("i,j->ij", a, b).sum(1) / a.size, lambda a, b: jnp.hypot(a, b) - 1, lambda a, b: jnp.where(a >= b, b - a, a * b),
    lambda a, b: a[position(b, a.size)], lambda a, b: jnp.searchsorted(jnp.array(GRID), a, side="right") / 6 * b,
    lambda a, b: jnp.einsum("bi,bi->b", jnp.stack([a, b]), jnp.stack([b, a]))[0] + b, lambda a, b: jnp.clip(a, -jnp.abs(b), 1.0),
    lambda a, b: jax.lax.select(a == b, b, a) - 0.2 * b, lambda a, b: jnp.where((a > 0) ^ (b > 0), a, b), lambda a, b: jnp.linspace(0, 1, a.size) * a + b,
]  # fmt: skip
