"""Feeds: material that enters the flowsheet."""

from dataclasses import dataclass
from typing import Any, ClassVar

from snapo.case.given import CaseInput
from snapo.case.table import doc

from ..given import use
from ..read.declared import ABSOLUTE, TIME, VOLUME, TableRecord, UnitQuantity
from ..read.numbers import LIQUID
from .stream import Stream, clear


@dataclass(frozen=True, eq=False, kw_only=True)
class Feed(TableRecord):
    """Material that enters: amounts of one batch, or of `duration` seconds of a continuous run.

    - `concentration`: kmol/m3, index [S], labels are the species.
    - `duration`: the time over which a continuous unit takes it in; None for a batch.
    """

    name: str
    volume: CaseInput = VOLUME("volume fed", example="60 L")
    temperature: CaseInput = ABSOLUTE("temperature of the feed")
    concentration: CaseInput
    solvent: CaseInput = UnitQuantity("kg/m3", LIQUID, example="887.6 kg/m^3")(
        "mass of solvent per volume fed"
    )
    duration: float | None = TIME.number("time over which it is fed", None, example="2 h")

    heading = "`[feeds.NAME]`"
    more_keys: ClassVar = {
        "concentration": (
            dict[str, Any],
            doc("concentrations of the species", {}, 'concentrations such as { A = "0.33 mol/L" }'),
        )
    }


def feed(record: Feed, inputs: dict[str, Any]) -> Stream:
    """The stream of a feed."""
    volume = use(inputs, record.volume)
    species = use(inputs, record.concentration) * volume
    solvent = use(inputs, record.solvent) * volume
    temperature = use(inputs, record.temperature)
    return clear(species, solvent, volume, temperature, record.duration or 0.0)
