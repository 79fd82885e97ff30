"""The open-loop recipe with the best chance to keep all limits, over given draws."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .optimum import Recipe, Traced, optimum
from .process import Entry, Process


def within_limits(process: Process, values: Array, width) -> Array:
    """The smooth indicator that all limits hold: a product of logistic curves, each `width`
    times the attribute's margin wide."""
    held = jnp.ones(())
    for q, each in enumerate(process.case.attributes):
        if each.low is not None:
            held = held * jax.nn.sigmoid((values[q] - each.low) / (width * each.margin))
        if each.high is not None:
            held = held * jax.nn.sigmoid((each.high - values[q]) / (width * each.margin))
    return held


def best_recipe(
    process: Process,
    entries: Sequence[Entry],
    low,
    high,
    draws,
    widths: Sequence[float] = (1.0, 0.3, 0.1),
    starts: Sequence[np.ndarray] = (),
) -> Recipe:
    """The entries' values, within [low, high], with the largest chance to keep all limits.

    `draws`: [N, U] of the case's uncertain numbers; the value is of these, smooth, at the last
    of `widths` (of the logistic curves, in margins), each solution being the next one's start.
    `starts`: [n] each, beside the case's own numbers; the best end is kept.
    """
    entries, nominal = tuple(entries), process.given()
    uncertain = process.case.uncertainty
    drawn = tuple(zip(uncertain.inputs, uncertain.entries))
    rows = np.asarray(draws, float)

    def chance(x, width):
        def one(row):
            moved = process.shifted(row, drawn, process.shifted(x, entries, nominal))
            return within_limits(process, process.attributes(moved, along=True), width)

        return jnp.mean(jax.vmap(one)(rows))[None]

    traced = Traced(chance)
    found: Recipe | None = None
    for start in (process.at(entries), *starts):
        recipe, total, x = None, 0, np.asarray(start, float)
        for width in widths:
            recipe = optimum(traced, x, low, high, (width,))
            x, total = recipe.x, total + recipe.iterations
        assert recipe is not None
        if found is None or recipe.value > found.value:
            found = recipe._replace(iterations=total)
    assert found is not None
    return found
