"""The policy of all contracts: the fitted value of a unit of each level and mode, and a network.

A volume flows as long as a unit of it earns more than the value of the levels loses; the move with
the largest gain is made. The network corrects the value of a unit of each level, how it changes
with the volume, and the value of each mode.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.problem.policy import (
    Network,
    Policy,
    as_observation,
    with_idle_network,
    without_idle_network,
)
from snapo.problem.smooth import EXACT

from .contract import ContractLayout
from .gains import SEGMENTS
from .observation import Head, head_size

CORRECTION = 0.1  # of the mean price: the network's numbers are of order one


class UnitValuePolicy(Policy):
    """The policy. Its action has a share of each volume, and a weight for each move that has
    alternatives."""

    network: Network | None
    form: tuple = eqx.field(static=True)

    def __init__(
        self, layout: ContractLayout, features: int, *, key, hidden: tuple[int, ...] = (32, 32)
    ):
        outputs = max(2 * len(layout.levels) + len(layout.modes) - 1, 1)
        widths = (features - head_size(layout), *hidden, outputs)
        self.network = Network(widths, key=key, activation=jax.nn.tanh)
        self.form = layout.plain()

    @property
    def layout(self) -> ContractLayout:
        """The levels, flows, modes and moves of the contract."""
        return ContractLayout.of_plain(self.form)

    @property
    def head(self) -> int:
        """The number of entries of the observation that the network does not see."""
        return head_size(self.layout)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        layout, gains = self.layout, Head.of(observation, self.layout)
        units, base = self.corrected(gains, observation[self.head :])
        parts = [[smooth.share(x[k, 0], x[k, 1]) for k in range(SEGMENTS)] for x in units]
        widths = [jnp.diff(x, prepend=0.0, append=1.0) for x in gains.positions]
        shares = [
            sum((width[k] * share for k, share in enumerate(part)), jnp.zeros(()))
            for width, part in zip(widths, parts)
        ]
        if not layout.choices:
            return jnp.stack(shares)
        if layout.fixed_volumes:
            return jnp.concatenate([jnp.stack(shares), _weights(layout, base, smooth)])
        scores = [base[k] for k in range(len(layout.choices))]
        gained = [_gained(*x, gains.room[i] * widths[i]) for i, x in enumerate(zip(units, parts))]
        for k, m in enumerate(layout.choices):
            for i in layout.places[m]:
                scores[k] = scores[k] + gained[i]
        return jnp.concatenate([jnp.stack(shares), _weights(layout, jnp.stack(scores), smooth)])

    def corrected(self, gains: Head, seen: Array) -> tuple[list[Array], Array]:
        """The gains of the units of each volume, and the gain of each move, after the correction by
        the network."""
        if self.network is None:
            return list(gains.units), gains.base
        layout, numbers = self.layout, CORRECTION * self.network(seen)
        levels, count = numbers[: len(layout.levels)], len(layout.levels)
        bends, modes = numbers[count : 2 * count], numbers[2 * count :]
        effects, changes = layout.effects, layout.changes
        units = []
        for i, (_, flow) in enumerate(layout.pairs):
            more = sum((effects[flow, j] * levels[j] for j in range(count)), jnp.zeros(()))
            bend = sum((effects[flow, j] * bends[j] for j in range(count)), jnp.zeros(()))
            positions = jnp.concatenate([jnp.zeros(1), gains.positions[i], jnp.ones(1)])
            bent = bend * gains.room[i] * positions
            units.append(gains.units[i] + more + jnp.stack([bent[:-1], bent[1:]], axis=1))
        base = gains.base
        if layout.choices:
            mode_values = jnp.concatenate([jnp.zeros(1), modes[: len(layout.modes) - 1]])
            if layout.fixed_volumes:
                choices = np.array(layout.choices)
                after = np.array([layout.moves[m].after for m in layout.choices])
                base = base + mode_values[after]
                if count:
                    base = base + jnp.sum(changes[choices] * levels, axis=1)
                return units, base
            shift = [
                mode_values[layout.moves[m].after]
                + sum((changes[m, j] * levels[j] for j in range(count)), jnp.zeros(()))
                for m in layout.choices
            ]
            base = base + jnp.stack(shift)
        return units, base

    @property
    def value_rule(self) -> "UnitValuePolicy":
        """The policy of the fitted value only: its network adds nothing."""
        return with_idle_network(self)

    @property
    def simplest(self) -> "UnitValuePolicy":
        """The policy without its network, if the network adds nothing; otherwise the policy
        itself."""
        return without_idle_network(self)


def reordered(policy: UnitValuePolicy, layout: ContractLayout) -> UnitValuePolicy:
    """The same policy for a contract that begins in another mode, for which `layout` has the modes
    in another order.

    **Raises:** `ValueError` if anything else differs.
    """
    own, count = policy.layout, len(layout.modes)
    if own.plain() == layout.plain():
        return policy
    named = [
        replaced._replace(modes=(), moves=tuple(
            move._replace(before=replaced.modes[move.before], after=replaced.modes[move.after])  # pyright: ignore
            for move in replaced.moves
        ))
        for replaced in (own, layout)
    ]  # fmt: skip
    if sorted(own.modes) != sorted(layout.modes) or named[0] != named[1]:
        raise ValueError("its contract has other levels, flows or moves")
    # The last features are the modes; the last outputs the value of each mode above the first one.
    order = np.array([own.modes.index(name) for name in layout.modes])
    network = policy.network
    assert network is not None
    first, weights, biases = network.weights[0], network.weights[-1], network.biases[-1]
    head = 2 * len(layout.levels)
    rows, shift = (
        jnp.concatenate([jnp.zeros_like(x[:1]), x[head:]])[order] for x in (weights, biases)
    )
    last = (
        jnp.concatenate([weights[:head], rows[1:] - rows[0]]),
        jnp.concatenate([biases[:head], shift[1:] - shift[0]]),
    )
    seen = first.shape[1] - count
    first = jnp.concatenate([first[:, :seen], first[:, seen:][:, order]], axis=1)

    def parts(x: Any):
        return x.network.weights[0], x.network.weights[-1], x.network.biases[-1]

    hidden = tuple(len(bias) for bias in network.biases[:-1])
    made = UnitValuePolicy(
        layout, policy.head + first.shape[1], key=jax.random.key(0), hidden=hidden
    )
    made = eqx.tree_at(lambda x: x.network, made, network)
    return eqx.tree_at(parts, made, (first, *last))


def _gained(unit: Array, shares: list[Array], widths: Array) -> Array:
    """The gain of the free volume if a share of each of its segments, with these widths, is
    taken."""
    return sum(
        (widths[k] * share * (unit[k, 0] + share * (unit[k, 1] - unit[k, 0]) / 2)
         for k, share in enumerate(shares)),
        jnp.zeros(()),
    )  # fmt: skip


def _weights(layout: ContractLayout, scores: Array, smooth) -> Array:
    """[choices] the weights of the moves of each mode in which there are several."""
    before = np.array([layout.moves[m].before for m in layout.choices])
    groups = [np.flatnonzero(before == mode) for mode in np.unique(before)]
    weights = jnp.concatenate([smooth.weights(scores[group]) for group in groups])
    return weights[np.argsort(np.concatenate(groups))]
