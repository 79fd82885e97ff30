"""The surprises of a fitted value along a path: the control variate of a store's value."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..bounds.surprise import SurpriseTable
from .fitted_guide import functions
from .value_table import between


class Place(NamedTuple):
    """The value on one date: `bounds.surprise.SurpriseTable`."""

    low: Array
    high: Array
    coefficients: Array


class Reading(NamedTuple):
    """How the functions of one date read the price factors."""

    whiten: Array
    common: Array
    shift: Array


class SurpriseDay(NamedTuple):
    """One day: its own value, the expectation of the next date's, and its functions."""

    now: Place
    ahead: Place
    reading: Reading


class SurpriseEnd(NamedTuple):
    """The end date, and the expectation on the valuation date."""

    now: Place
    reading: Reading
    first: Array


class Surprises(eqx.Module):
    """`days` has leaves with a leading axis of days."""

    days: Any
    end: Any

    @classmethod
    def of(cls, found: SurpriseTable) -> "Surprises":
        place = Place(found.low, found.high, found.now)  # pyright: ignore
        reading = Reading(found.whiten, found.common, found.shift)  # pyright: ignore
        first = Place(*(each[:-1] for each in place))
        ahead = Place(found.low[1:], found.high[1:], found.ahead)  # pyright: ignore
        days = SurpriseDay(first, ahead, Reading(*(each[:-1] for each in reading)))
        last = Place(*(each[-1] for each in place)), Reading(*(each[-1] for each in reading))
        return cls(days, SurpriseEnd(*last, np.asarray(found.first)))  # pyright: ignore


def of_day(row: SurpriseDay, factors: Array, before: Array, after: Array) -> Array:
    """The value at the start of a day less what is expected of it for the next date.

    Summed over the days, with the end date's value and less `first`, it is the sum of the
    surprises. `before` and `after` are the inventories at the start and the end of the day.
    """
    # Data, and nobody's derivative: an adjoint need not form any.
    row, factors, before, after = jax.lax.stop_gradient((row, factors, before, after))
    seen = functions(row.reading, factors, row.now.coefficients.shape[-1])
    return _worth(row.now, before, seen) - _worth(row.ahead, after, seen)


def of_end(row: SurpriseEnd, factors: Array, left: Array) -> Array:
    """The end date's part of the sum."""
    row, factors, left = jax.lax.stop_gradient((row, factors, left))
    seen = functions(row.reading, factors, row.now.coefficients.shape[-1])
    return _worth(row.now, left, seen) - row.first


def _worth(place: Place, inventory: Array, seen: Array) -> Array:
    inside = jnp.clip(inventory, place.low, place.high)
    return between(place, place.coefficients, inside, lambda row: row @ seen)
