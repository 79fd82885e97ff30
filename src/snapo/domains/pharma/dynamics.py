"""What a unit that works over time is to the integrator: an initial value problem."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .records_units import Profile
from .stream import Stream


class Ledger(NamedTuple):
    """What a unit's balance needs beside its streams, all of one batch.

    - `made`: [S] kmol by reactions; `added`: [S] kmol, such as seed; `held`: [S] kmol more at
      the end than at the start, or not taken in. `solvent_added`, `solvent_held`: kg.
    - `energy`: (into, out of, accumulated) J where a heat balance is part of the unit.
    """

    made: Float[Array, " S"]
    added: Float[Array, " S"]
    held: Float[Array, " S"]
    solvent_added: Float[Array, ""]
    solvent_held: Float[Array, ""]
    energy: tuple[Array, Array, Array] | None = None


def ledger(species: int, **entries: Any) -> Ledger:
    """A ledger in which all is zero but what is named."""
    none, zero = jnp.zeros(species), jnp.zeros(())
    return Ledger(none, none, none, zero, zero)._replace(**entries)


class Finish(NamedTuple):
    """What a unit delivers: its outlets in order of `ports.outlets`, its measures and ledger."""

    outlets: tuple[Stream, ...]
    measures: dict[str, Array]
    ledger: Ledger


class Dynamics(NamedTuple):
    """y' = rate(y, drive(controls)) over `duration` s, y of order one.

    - `start`: [m]; `controls`: profiles and their values, in the order in which `drive` takes
      them: `drive(*values)` maps arrays of any shape to [..., D], outside the time loop.
    - `event`: share of the duration at which the solution has a kink, or None.
    - `states`: from y and the control values at one time to {state: value}.
    - `finish`: from y and the control values at the end.
    - `stiff`: whether an implicit solver is due.
    """

    start: Float[Array, " m"]
    rate: Callable[[Array, Array], Array]
    drive: Callable[..., Array]
    controls: tuple[tuple[Profile, Array], ...]
    duration: Float[Array, ""]
    event: Float[Array, ""] | None
    states: Callable[..., dict[str, Array]]
    finish: Callable[..., Finish]
    stiff: bool


class Track(NamedTuple):
    """A unit over its time: `time` [n + 1] s, `state` y [n + 1, m], `slope` y' per s, `controls`
    [n + 1, C]."""

    time: np.ndarray | Array
    state: np.ndarray | Array
    slope: np.ndarray | Array
    controls: np.ndarray | Array
