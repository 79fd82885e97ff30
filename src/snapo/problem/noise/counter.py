"""The noise of a path: drawn by threefry when it is used, or stored in arrays.

Words are bit-identical in every engine and precision; normals are made from them by the inverse
of the distribution function.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

STEP_STREAM, INITIAL_STREAM = 0, 1


class Counter(eqx.Module):
    """Noise drawn inside the engine: `keys` [2, 2] for steps and initial states, `paths` [N].

    - `first`: the number of the simulator's first step in the calendar by which steps are counted.
    - `before`: the initial state takes the noise of this many steps from the calendar's start, one
      after another; with 0 its noise is drawn separately.
    """

    keys: UInt32[Array, "2 2"]
    paths: UInt32[Array, " paths"]
    first: UInt32[Array, ""]
    antithetic: bool = eqx.field(static=True)
    before: int = eqx.field(static=True, default=0)

    @property
    def size(self) -> int:
        return self.paths.shape[0]

    def axes(self) -> "Counter":
        """The axis of the paths in every leaf, for `jax.vmap`."""
        return Counter(None, 0, None, self.antithetic, self.before)  # pyright: ignore

    def initial(self, size: int, dtype) -> Float[Array, " size"]:
        if not self.before:
            return self._normals(self.keys[INITIAL_STREAM], jnp.uint32(0), size, dtype)
        steps = jnp.arange(self.before, dtype=jnp.uint32)
        return jax.vmap(lambda t: self.noise(t, size // self.before, dtype))(steps).reshape(-1)

    def steps(self, first, length: int):
        """The carry of the scan over time: the number of the step in the calendar."""
        return self.first + first.astype(jnp.uint32) + jnp.arange(length, dtype=jnp.uint32)

    def noise(self, step: UInt32[Array, ""], size: int, dtype) -> Float[Array, " size"]:
        return self._normals(self.keys[STEP_STREAM], step, size, dtype)

    def _normals(self, key, step, size: int, dtype) -> Float[Array, " size"]:
        """One path: `self.paths` is a scalar here."""
        path = self.paths >> 1 if self.antithetic else self.paths
        pairs = (size + 1) // 2
        counter = step * jnp.uint32(pairs) + jnp.arange(pairs, dtype=jnp.uint32)
        text = threefry(key, path, counter)
        z = normal(jnp.stack(text, axis=-1).reshape(-1)[:size], dtype)
        if not self.antithetic:
            return z
        return jnp.where((self.paths & 1) == 1, -z, z)


class Stored(eqx.Module):
    """Noise given as arrays: `initial_noise` [N, K0] and `step_noise` [T, N, K]."""

    initial_noise: Float[Array, "paths k0"]
    step_noise: Float[Array, "steps paths k"]

    @property
    def size(self) -> int:
        return self.step_noise.shape[1]

    def axes(self) -> "Stored":
        return Stored(0, 1)  # pyright: ignore[reportArgumentType]

    def initial(self, size: int, dtype) -> Float[Array, " size"]:
        return self.initial_noise.astype(dtype)

    def steps(self, first, length: int):
        return jax.lax.dynamic_slice_in_dim(self.step_noise, first, length)

    def noise(self, step: Float[Array, " k"], size: int, dtype) -> Float[Array, " size"]:
        return step.astype(dtype)


Draws = Counter | Stored


def only(draws: Draws, selected: np.ndarray) -> Draws:
    """The noise of chosen paths only."""

    def taken(leaf, axis):
        return leaf if axis is None else np.take(leaf, selected, axis)

    return jax.tree.map(taken, draws, draws.axes(), is_leaf=lambda leaf: leaf is None)


@partial(jax.jit, static_argnums=(1, 2))
def noise_of_steps(draws: Draws, horizon: int, size: int) -> Float[Array, "steps paths k"]:
    """The normals of all steps of a simulator, as engines draw them; call it inside
    `jax.enable_x64(True)`."""

    def one(draws):
        steps = draws.steps(jnp.zeros((), jnp.uint32), horizon)
        return jax.vmap(lambda step: draws.noise(step, size, jnp.float64))(steps)

    return jax.vmap(one, (draws.axes(),), 1)(draws)


def threefry(key: UInt32[Array, "2"], x: UInt32[Array, "..."], y: UInt32[Array, "..."]):
    """Threefry-2x32 with 20 rounds (Salmon et al. 2011): two words for the counter (x, y).

    Written out so that it fuses with later operations and every engine traces the same ones;
    JAX's primitive computes the same words.
    """
    keys = (key[0], key[1], key[0] ^ key[1] ^ jnp.uint32(0x1BD11BDA))
    x, y = x + keys[0], y + keys[1]
    for block in range(5):
        for rotation in _ROTATIONS[block % 2]:
            x = x + y
            y = x ^ ((y << rotation) | (y >> (32 - rotation)))
        x, y = x + keys[(block + 1) % 3], y + keys[(block + 2) % 3] + jnp.uint32(block + 1)
    return x, y


def normal(text: UInt32[Array, "..."], dtype) -> Float[Array, "..."]:
    """Standard normals from 32-bit words, by the inverse of the distribution function.

    The top bit is the sign; the other 31 bits m determine the tail probability (m + 1/2) / 2^32.
    Wichura's AS241 (Applied Statistics 37, 1988): routine PPND16 (relative error 1e-16) in
    float64, PPND7 (1e-7) in float32. The tail probability is exact, so tails lose no digits.
    """
    dtype = jnp.dtype(dtype)
    centre, outer = _PPND16 if dtype == jnp.float64 else _PPND7
    m = text & jnp.uint32(0x7FFFFFFF)
    tail = (m.astype(dtype) + dtype.type(0.5)) * dtype.type(2.0**-32)
    q = (jnp.uint32(0x7FFFFFFF) - m).astype(dtype) * dtype.type(2.0**-32) + dtype.type(2.0**-33)
    z_centre = q * _ratio(centre, dtype.type(0.180625) - q * q, dtype)
    # The smallest tail, 2^-33, gives a root of 4.8: the third region, from 5, is not needed.
    z_tail = _ratio(outer, jnp.sqrt(-jnp.log(tail)) - dtype.type(1.6), dtype)
    z = jnp.where(q <= dtype.type(0.425), z_centre, z_tail)
    return jnp.where(text >> 31 == 1, -z, z)


def _ratio(coefficients, x: Array, dtype) -> Array:
    numerator, denominator = coefficients
    return _horner(numerator, x, dtype) / _horner(denominator, x, dtype)


def _horner(coefficients, x: Array, dtype) -> Array:
    value = jnp.full_like(x, dtype.type(coefficients[-1]))
    for c in coefficients[-2::-1]:
        value = value * x + dtype.type(c)
    return value


_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


_PPND16 = (
    (
        (
            3.3871328727963666080e0,
            1.3314166789178437745e2,
            1.9715909503065514427e3,
            1.3731693765509461125e4,
            4.5921953931549871457e4,
            6.7265770927008700853e4,
            3.3430575583588128105e4,
            2.5090809287301226727e3,
        ),
        (
            1.0,
            4.2313330701600911252e1,
            6.8718700749205790830e2,
            5.3941960214247511077e3,
            2.1213794301586595867e4,
            3.9307895800092710610e4,
            2.8729085735721942674e4,
            5.2264952788528545610e3,
        ),
    ),
    (
        (
            1.42343711074968357734e0,
            4.63033784615654529590e0,
            5.76949722146069140550e0,
            3.64784832476320460504e0,
            1.27045825245236838258e0,
            2.41780725177450611770e-1,
            2.27238449892691845833e-2,
            7.74545014278341407640e-4,
        ),
        (
            1.0,
            2.05319162663775882187e0,
            1.67638483018380384940e0,
            6.89767334985100004550e-1,
            1.48103976427480074590e-1,
            1.51986665636164571966e-2,
            5.47593808499534494600e-4,
            1.05075007164441684324e-9,
        ),
    ),
)


_PPND7 = (
    (
        (3.3871327179e0, 5.0434271938e1, 1.5929113202e2, 5.9109374720e1),
        (1.0, 1.7895169469e1, 7.8757757664e1, 6.7187563600e1),
    ),
    (
        (1.4234372777e0, 2.7568153900e0, 1.3067284816e0, 1.7023821103e-1),
        (1.0, 7.3700164250e-1, 1.2021132975e-1),
    ),
)
