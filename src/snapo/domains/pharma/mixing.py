"""Tank and splitter: streams put together, and taken apart."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .inputs import use
from .records_units import Feed, Splitter
from .stream import Stream, clear


def feed(record: Feed, inputs: dict[str, Any]) -> Stream:
    """The material of a feed."""
    volume = use(inputs, record.volume)
    species = use(inputs, record.concentration) * volume
    solvent = use(inputs, record.solvent) * volume
    temperature = use(inputs, record.temperature)
    return clear(species, solvent, volume, temperature, record.duration or 0.0)


def mixed(streams: tuple[Stream, ...]) -> Stream:
    """The sum of the amounts, as one batch; temperature by volume, that is with equal heat
    capacities per volume. Crystals must be of one kind: density and shape are those of the
    streams that have any."""
    total = jax.tree.map(lambda *parts: sum(parts), *streams)
    warmth = sum(each.volume * each.temperature for each in streams)

    def of_crystals(name: str) -> Array:
        found = jnp.zeros(())
        for each in reversed(streams):
            value = getattr(each, name)
            found = jnp.where(value > 0, value, found)
        return found

    return total._replace(
        temperature=warmth / total.volume,
        duration=jnp.zeros(()),
        density=of_crystals("density"),
        shape=of_crystals("shape"),
    )


EXTENSIVE = ("species", "solid", "seed", "solvent", "antisolvent", "volume", "moments")


def split(unit: Splitter, stream: Stream, inputs: dict[str, Any]) -> tuple[Stream, ...]:
    """The stream in the shares given, the last outlet taking the rest."""
    shares = use(inputs, unit.share)
    shares = jnp.append(shares, 1 - jnp.sum(shares))
    return tuple(
        stream._replace(**{name: getattr(stream, name) * share for name in EXTENSIVE})
        for share in shares
    )
