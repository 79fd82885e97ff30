"""The delivery of a unit, and the terms of its balance other than its streams."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .stream import Stream


class Ledger(NamedTuple):
    """The terms of a unit's balance other than its streams, all of one batch.

    - `made`: [S] kmol by reactions; `added`: [S] kmol, such as seed; `held`: [S] kmol more at
      the end than at the start; `left`: [S] kmol of its inlets that it has not taken in.
    - `solvent_added`, `solvent_left`: kg.
    - `energy`: (into, out of, accumulated) J where a heat balance is part of the unit.
    """

    made: Float[Array, " S"]
    added: Float[Array, " S"]
    held: Float[Array, " S"]
    left: Float[Array, " S"]
    solvent_added: Float[Array, ""]
    solvent_left: Float[Array, ""]
    energy: tuple[Array, Array, Array] | None = None


def ledger(species: int, **entries: Any) -> Ledger:
    """A ledger in which all is zero but these entries."""
    none, zero = jnp.zeros(species), jnp.zeros(())
    return Ledger(none, none, none, none, zero, zero)._replace(**entries)


class LedgerFinish(NamedTuple):
    """The delivery of a unit: its outlets in order, its measures and ledger."""

    outlets: tuple[Stream, ...]
    measures: dict[str, Array]
    ledger: Ledger
