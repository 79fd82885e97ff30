"""Streams between units: the material of one batch, in amounts, with the grid of sizes on which
crystals are counted. Also what a unit delivers, and the terms of its balance other than its
streams.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record import TreeRecord, field
from snapo.problem.record.arrays import Array, Float, jax, jnp


@dataclass(frozen=True)
class Grid:
    """`edges`: [N + 1] m, rising, of N cells; () for a stream without crystals."""

    edges: tuple[float, ...]

    @classmethod
    def of(cls, edges: np.ndarray) -> "Grid":
        return cls(tuple(float(edge) for edge in edges))

    @property
    def cells(self) -> int:
        return max(0, len(self.edges) - 1)

    @property
    def array(self) -> np.ndarray:
        return np.array(self.edges)


NO_CRYSTALS = Grid(())
# Of crystals of which only the moments are known there is no grid.
Sizes = Grid | None


def together(sizes: tuple[Sizes, ...]) -> Sizes:
    """The grid on which the crystals of several streams are counted together; None if they are
    not."""
    some = {size for size in sizes if size != NO_CRYSTALS}
    return NO_CRYSTALS if not some else some.pop() if len(some) == 1 else None


MOMENTS = 6


class Stream(TreeRecord):
    """Material of one batch, or of `duration` seconds of a continuous run. S species.

    - `species`: [S] kmol dissolved. `solid`: [S] kmol in crystals, of which `seed`, [S], was
      added as seed.
    - `solvent`, `antisolvent`: kg. `volume`: m3 of liquid, to which concentrations refer; mixing
      and reactions do not change it. `solids`: m3 of the crystals, which `volume` does not include;
      crystallisation reduces `volume` by as much. 0 if a crystalliser neglects this.
    - `temperature`: K. `duration`: s, 0 for a batch.
    - `moments`: [6] sum over all crystals of their size to the power 0 to 5, m^k.
    - `density`, `shape`: of the crystals: kg/m3, and kv in volume = kv size^3.
    - `inner_size`, `inner_density`: d32 in m and density in kg/m3 of the crystals inside granules,
      to which moments, density and shape then refer; 0 if crystals are not granulated.
    - `numbers`: [N] crystals in each cell of the `grid`; [0] if there is none.
    - `grid`: `NO_CRYSTALS` for a clear liquid; None if only the moments are known.
    - `inner_numbers`, `inner_grid`: the same for the crystals inside granules; None if they are
      not counted.
    """

    species: Float[Array, " S"]
    solid: Float[Array, " S"]
    seed: Float[Array, " S"]
    solvent: Float[Array, ""]
    antisolvent: Float[Array, ""]
    volume: Float[Array, ""]
    solids: Float[Array, ""]
    temperature: Float[Array, ""]
    duration: Float[Array, ""]
    moments: Float[Array, " 6"]
    density: Float[Array, ""]
    shape: Float[Array, ""]
    inner_size: Float[Array, ""]
    inner_density: Float[Array, ""]
    numbers: Float[Array, " N"]
    grid: Sizes = field(static=True)
    inner_numbers: Float[Array, " M"] = field(default_factory=lambda: jnp.zeros(0))
    inner_grid: Sizes = field(static=True, default=None)

    def concentration(self) -> Float[Array, " S"]:
        """kmol/m3 of the dissolved species."""
        return self.species / self.volume

    def suspension(self) -> Float[Array, ""]:
        """m3 of liquid and crystals together."""
        return self.volume + self.solids

    def crystals(self) -> Float[Array, ""]:
        """kg of crystals, or of granules without their liquid."""
        return self.density * self.shape * self.moments[3]

    def replace(self, **fields: Any) -> "Stream":
        """The stream with these `fields` replaced."""
        return replace(self, **fields)


def clear(species, solvent, volume, temperature, duration: Any = 0.0) -> Stream:
    """A stream without crystals."""
    nothing, number = jnp.zeros_like(species), jnp.zeros(())
    return Stream(
        species=species,
        solid=nothing,
        seed=nothing,
        solvent=solvent,
        antisolvent=number,
        volume=volume,
        solids=number,
        temperature=temperature,
        duration=jnp.asarray(duration, float),
        moments=jnp.zeros(MOMENTS),
        density=number,
        shape=number,
        inner_size=number,
        inner_density=number,
        numbers=jnp.zeros(0),
        grid=NO_CRYSTALS,
    )


def blank(species: int, sizes: Sizes) -> Stream:
    """A stream of zeros with this many species and crystals counted on this grid."""
    stream = clear(jnp.zeros(species), *(jnp.zeros(()) for _ in range(3)))
    return stream.replace(numbers=jnp.zeros(sizes.cells if sizes else 0), grid=sizes)


def flat(stream: Stream) -> Float[Array, " K"]:
    """The stream as one vector with the fields in order; `unflat` reverses this."""
    return jax.flatten_util.ravel_pytree(stream)[0]


def unflat(vector: Float[Array, " K"], like: Stream) -> Stream:
    """The stream from the vector that `flat` returned; `like` has its shapes."""
    return jax.flatten_util.ravel_pytree(like)[1](vector)


class Ledger(NamedTuple):
    """The terms of a unit's balance other than its streams, all of one batch.

    - `made`: [S] kmol by reactions; `added`: [S] kmol, such as seed; `held`: [S] kmol more at the
      end than at the start; `left`: [S] kmol of its inlets that the unit has not taken in.
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
    """A ledger in which everything is zero except these entries."""
    none, zero = jnp.zeros(species), jnp.zeros(())
    return Ledger(none, none, none, none, zero, zero)._replace(**entries)


class LedgerFinish(NamedTuple):
    """The results of a unit: its outlets in order, its measures and its ledger."""

    outlets: tuple[Stream, ...]
    measures: dict[str, Array]
    ledger: Ledger
