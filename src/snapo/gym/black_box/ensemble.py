"""A small ensemble of smooth networks that is fitted to transitions, so that a policy can be
trained in it.

Members differ in their initial weights and in the batches that they see, so they agree where there
are data and disagree elsewhere (Chua and others 2018, "Deep reinforcement learning in a handful of
trials"; whose networks also predict differences of observations).
"""

from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PyTree

from .real import Transitions, scale_of

BATCH, ROUND = 256, 250  # rows of a step; steps between two looks at the rows held out
HELD_OUT = 0.1
RATES = (3e-3, 3e-5)  # at the first and last step


class Fit(NamedTuple):
    """A fitted ensemble.

    - `layers`: [(weights [E, out, in], biases [E, out])] in the units of the environment, from
      observation and action to the difference of the observation, the reward of a step that does
      not end the episode, the reward of a step that ends it, and the log odds of the end.
    - `raw`: the same layers for numbers scaled to order one, from which the next fit starts.
    - `error`: [k + 2] root mean square errors of the members' mean on held-out rows, divided by the
      standard deviation of each number: first the differences, then the reward. The last number is
      the share of ends that were predicted wrongly.
    - `spread`: [k] the standard deviation of the environment's noise.
    """

    layers: PyTree
    raw: PyTree
    error: Float[np.ndarray, " k_2"]
    spread: Float[np.ndarray, " k"]
    steps: int


class _Scales(NamedTuple):
    """Shift and scale of the networks' inputs and outputs."""

    x: tuple[np.ndarray, np.ndarray]
    y: tuple[np.ndarray, np.ndarray]


def first_layers(size: int, outputs: int, hidden: tuple[int, ...], members: int, seed: int):
    """The weights of all members before any fit."""
    rng = np.random.default_rng((seed, 77))
    widths = (size, *hidden, outputs)
    return [
        (
            (rng.standard_normal((members, out, into)) / np.sqrt(into)).astype(np.float32),
            np.zeros((members, out), np.float32),
        )
        for into, out in pairwise(widths)
    ]


def fit(
    transitions: Transitions, raw: PyTree, capacity: int, maximum: int, seed: int, patience: int = 4
) -> Fit:
    """Fits the ensemble further, starting from the weights `raw`; returns it with its error on
    held-out rows.

    A tenth of the rows is held out. Every member keeps the weights that were best on these rows;
    the fit stops after `maximum` steps, or after `patience` checks without an improvement.
    `capacity` is the maximum number of rows: arrays have that length, so that all fits are compiled
    once.
    """
    rng = np.random.default_rng((seed, transitions.count))
    order = rng.permutation(transitions.count)
    cut = max(1, int(HELD_OUT * transitions.count))
    held, taught = order[:cut], order[cut:]
    scales, x, y = _numbers(transitions, taught)
    room = max(1, int(HELD_OUT * capacity))
    data, test = (_rows(x, y, transitions, *item) for item in ((taught, capacity), (held, room)))
    state = _ADAM.init(raw)
    best, lowest = raw, np.full(raw[0][0].shape[0], np.inf)
    stale = steps = 0
    while steps < maximum and stale < patience:
        rates = _rates(steps, maximum)
        raw, state = _taught(raw, state, data, rates, jax.random.key(int(rng.integers(2**31))))
        steps += ROUND
        loss = np.asarray(_losses(raw, test))
        better = loss < lowest
        best = _either(better, raw, best)
        stale = 0 if np.any(loss < 0.99 * lowest) else stale + 1
        lowest = np.minimum(loss, lowest)
    error, spread = _misses(best, test, scales, transitions.before.shape[1])
    return Fit(_in_units(best, scales), best, error, spread, steps)


class _Data(NamedTuple):
    x: Any
    y: Any
    ended: Any
    count: int


def _numbers(
    transitions: Transitions, taught: np.ndarray
) -> tuple[_Scales, np.ndarray, np.ndarray]:
    """Scales from the training rows, and the inputs and outputs of all rows, scaled to numbers of
    order one."""
    x = np.concatenate([transitions.before, transitions.action], 1).astype(np.float64)
    change = (transitions.after - transitions.before).astype(np.float64)
    y = np.concatenate([change, transitions.reward[:, None], transitions.reward[:, None]], 1)
    rows = np.zeros(transitions.count, bool)
    rows[taught] = True
    going, ended = rows & ~transitions.ended, rows & transitions.ended
    moves, on, last = y[rows, :-2], y[going, -2:-1], y[ended, -1:]
    parts = [scale_of(item) for item in (moves, on, last)]
    shift, scale = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    scales = _Scales(scale_of(x[rows]), (shift, scale))
    x, y = ((entry - s[0]) / s[1] for entry, s in zip((x, y), scales))
    return scales, x.astype(np.float32), y.astype(np.float32)


def _rows(
    x: np.ndarray, y: np.ndarray, transitions: Transitions, rows: np.ndarray, length: int
) -> _Data:
    """Some rows, in arrays of fixed length."""
    x, y, ended = (_padded(item, rows, length) for item in (x, y, transitions.ended))
    return _Data(x, y, ended, rows.size)


def _padded(values: np.ndarray, rows: np.ndarray, length: int) -> np.ndarray:
    result = np.zeros((length, *values.shape[1:]), np.float32)
    result[: rows.size] = values[rows][:length]
    return result


def _rates(done: int, maximum: int) -> np.ndarray:
    """The learning rate of every step, with cosine decay."""
    share = np.minimum(1.0, (done + np.arange(ROUND)) / maximum)
    high, low = RATES
    return (low + (high - low) * (1 + np.cos(np.pi * share)) / 2).astype(np.float32)


def _forward(layers, x: Float[Array, "n i"]) -> Float[Array, "n o"]:
    """The outputs of one member."""
    *hidden, (weight, bias) = layers
    for w, b in hidden:
        x = jnp.tanh(x @ w.T + b)
    return x @ weight.T + bias


def _parts(layers, x, y, ended) -> Array:
    """[n, k + 3] the squared errors that count, and the cross entropy of the end."""
    summary = _forward(layers, x)
    moves = (summary[:, :-3] - y[:, :-2]) ** 2
    on = (1 - ended)[:, None] * (summary[:, -3:-2] - y[:, -2:-1]) ** 2
    last = ended[:, None] * (summary[:, -2:-1] - y[:, -1:]) ** 2
    odds = optax.sigmoid_binary_cross_entropy(summary[:, -1:], ended[:, None])
    return jnp.concatenate([moves, on, last, odds], 1)


_ADAM = optax.adam(1.0)


@jax.jit
def _taught(raw, state, data: _Data, rates, key):
    """`ROUND` steps of Adam for all members at once."""
    members = raw[0][0].shape[0]

    def loss(raw, rows):
        def one(layers, rows):
            return _parts(layers, data.x[rows], data.y[rows], data.ended[rows]).mean(0).sum()

        return jax.vmap(one)(raw, rows).sum()

    def step(carry, values):
        raw, state = carry
        rate, key = values
        rows = jax.random.randint(key, (members, BATCH), 0, data.count)
        change, state = _ADAM.update(jax.grad(loss)(raw, rows), state)
        return (jax.tree.map(lambda w, d: w + rate * d, raw, change), state), None

    keys = jax.random.split(key, ROUND)
    return jax.lax.scan(step, (raw, state), (rates, keys))[0]


@jax.jit
def _losses(raw, test: _Data) -> Float[Array, " E"]:
    """The loss of every member on the held-out rows."""
    count = jnp.arange(test.x.shape[0]) < test.count

    def one(layers):
        losses = _parts(layers, test.x, test.y, test.ended).sum(1)
        return jnp.sum(jnp.where(count, losses, 0.0)) / test.count

    return jax.vmap(one)(raw)


_all_told = jax.jit(jax.vmap(_forward, (0, None)))


def _misses(raw, test: _Data, scales: _Scales, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The error of the members' mean, and the part of it that is noise."""
    predictions = np.asarray(_all_told(raw, test.x))[:, : test.count]
    y, ended = np.asarray(test.y)[: test.count], np.asarray(test.ended)[: test.count]
    middle = predictions.mean(0)
    moves = ((middle[:, :size] - y[:, :size]) ** 2).mean(0)
    on = (1 - ended) @ (middle[:, size] - y[:, size]) ** 2 / max(1.0, np.sum(1 - ended))
    wrong = np.mean((middle[:, -1] > 0) != (ended > 0.5))
    error = np.concatenate([np.sqrt(moves), [np.sqrt(on), wrong]])
    # The mean is off by noise and by its members' errors, which their spread shows.
    count, means = len(predictions), predictions[:, :, :size]
    disagreement = means.var(0, ddof=1).mean(0) if count > 1 else np.zeros(size)
    noise = np.sqrt(np.maximum(0.0, moves - disagreement / count))
    return error, noise * scales.y[1][:size]


def _in_units(raw, scales: _Scales):
    """The same networks, with inputs and outputs in the units of the environment."""
    (first, bias), *rest = [tuple(np.asarray(a, np.float64) for a in item) for item in raw]
    shift, scale = scales.x
    layers = [(first / scale, bias - (first / scale) @ shift), *rest]
    weight, bias = layers[-1]
    shift, scale = (np.append(entry, end) for entry, end in zip(scales.y, (0.0, 1.0)))
    layers[-1] = (weight * scale[:, None], bias * scale + shift)
    return layers


def _either(better: np.ndarray, raw, best):
    """The new weights of the members that improved, and the old weights of the others."""

    def one(new, old):
        return np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    return jax.tree.map(one, raw, best)
