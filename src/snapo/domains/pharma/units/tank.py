"""Tank: mixes streams."""

from dataclasses import dataclass
from typing import Any, ClassVar

from snapo.case.table import doc
from snapo.problem.record.arrays import Array, jnp

from ..flowsheet.stream import LedgerFinish, Stream, ledger, together
from ..read.reader import Texts
from .operation import Inlet, Instant


@dataclass(frozen=True, eq=False)
class Tank(Instant):
    """Holds and mixes its inlets, one for each name of `ports`."""

    ports: tuple[str, ...]

    type = "tank"
    more_keys: ClassVar = {
        "inlets": (
            Texts,
            doc("inlets that are mixed", allowed='a list of names, such as ["first", "second"]'),
        )
    }
    variant = ""
    title = "tank"
    reacts = False
    symbols = ()
    assumptions = ()

    @classmethod
    def read(cls, read, species):
        return cls(read.name, read.ports("inlets"))

    @property
    def inlets(self):
        return tuple(Inlet(name, "allowed") for name in self.ports)

    @property
    def outlets(self):
        return ("product",)

    def sizes(self, inlets):
        return (together(inlets),)

    def lasts(self, inlets):
        return (max(inlets) if all(inlets) else 0.0,)

    def measures(self, species):
        return {}

    def equations(self):
        return [
            "amounts and moments add up; temperature by volume",
            "flows are mixed over the longest of their durations; if one of them is a batch, the "
            "mixture is a batch",
        ]

    def deliver(self, network, inlets, inputs):
        return LedgerFinish((mixed(inlets),), {}, ledger(len(network.species)))


AMOUNTS = ("species", "solid", "seed", "solvent", "antisolvent", "volume", "solids", "moments")


def mixed(streams: tuple[Stream, ...]) -> Stream:
    """The sum of the amounts, over the longest of their durations, or as one batch if one of them
    is a batch; temperatures are weighted by volume, as if heat capacities per volume were equal.
    Crystals must be of one kind: density and shape come from the streams with crystals. The
    mixture has counted crystals if all are counted on one grid.
    """
    total = {name: sum(getattr(stream, name) for stream in streams) for name in AMOUNTS}
    times = jnp.stack([item.duration for item in streams])
    duration = jnp.where(jnp.all(times > 0), jnp.max(times), 0.0)
    warmth = sum(entry.suspension() * entry.temperature for entry in streams)

    def counted(name: str, of: str) -> dict[str, Any]:
        """The grid on which the crystals of all streams are counted (field `of`), and their numbers
        on it."""
        grid = together(tuple(getattr(each, of) for each in streams))
        numbers = jnp.zeros(grid.cells if grid else 0)
        for each in streams:
            if grid and getattr(each, of) == grid:
                numbers = numbers + getattr(each, name)
        return {name: numbers, of: grid}

    def of_crystals(name: str) -> Array:
        crystals = jnp.zeros(())
        for each in reversed(streams):
            value = getattr(each, name)
            crystals = jnp.where(value > 0, value, crystals)
        return crystals

    return streams[0].replace(
        **total,
        temperature=warmth / (total["volume"] + total["solids"]),
        duration=duration,
        density=of_crystals("density"),
        shape=of_crystals("shape"),
        inner_size=of_crystals("inner_size"),
        inner_density=of_crystals("inner_density"),
        **counted("numbers", "grid"),
        **counted("inner_numbers", "inner_grid"),
    )
