"""The surprises of a fitted value along a path: the control variate of a store's value."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..bounds.innovation import InnovationTable
from .fitted_guide import functions
from .value_table import between


class DateValues(NamedTuple):
    """The value on one date: bounds.innovation.InnovationTable`."""

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

    now: DateValues
    ahead: DateValues
    reading: Reading


class SurpriseEnd(NamedTuple):
    """The end date, and the expectation on the valuation date."""

    now: DateValues
    reading: Reading
    first: Array


class Innovations(eqx.Module):
    """`days` has leaves with a leading axis of days."""

    days: Any
    end: Any

    @classmethod
    def of(cls, result: InnovationTable) -> "Innovations":
        position = DateValues(result.low, result.high, result.now)  # pyright: ignore
        reading = Reading(result.whiten, result.common, result.shift)  # pyright: ignore
        first = DateValues(*(item[:-1] for item in position))
        ahead = DateValues(result.low[1:], result.high[1:], result.ahead)  # pyright: ignore
        days = SurpriseDay(first, ahead, Reading(*(entry[:-1] for entry in reading)))
        last = (
            DateValues(*(value[-1] for value in position)),
            Reading(*(each[-1] for each in reading)),
        )
        return cls(days, SurpriseEnd(*last, np.asarray(result.first)))  # pyright: ignore


def of_day(row: SurpriseDay, factors: Array, before: Array, after: Array) -> Array:
    """The value at the start of a day less what is expected of it for the next date.

    Summed over the days, with the end date's value and less `first`, it is the sum of the
    surprises. `before` and `after` are the inventories at the start and the end of the day.
    """
    # Data, and nobody's derivative: an adjoint need not form any.
    row, factors, before, after = jax.lax.stop_gradient((row, factors, before, after))
    observed = functions(row.reading, factors, row.now.coefficients.shape[-1])
    return _worth(row.now, before, observed) - _worth(row.ahead, after, observed)


def of_end(row: SurpriseEnd, factors: Array, left: Array) -> Array:
    """The end date's part of the sum."""
    row, factors, left = jax.lax.stop_gradient((row, factors, left))
    observed = functions(row.reading, factors, row.now.coefficients.shape[-1])
    return _worth(row.now, left, observed) - row.first


def _worth(position: DateValues, inventory: Array, observed: Array) -> Array:
    inside = jnp.clip(inventory, position.low, position.high)
    return between(position, position.coefficients, inside, lambda row: row @ observed)
