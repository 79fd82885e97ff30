"""Feeds: material that enters the flowsheet."""

from dataclasses import dataclass
from typing import Any

from snapo.case.given import CaseInput

from ..given import use
from .stream import Stream, clear


@dataclass(frozen=True, eq=False)
class Feed:
    """Material that enters: amounts of one batch, or of `duration` seconds of a continuous run.

    - `volume`: m3, index []; `temperature`: K, []; `concentration`: kmol/m3, index [S], labels are
      the species; `solvent`: kg/m3 of solvent per volume fed, [].
    - `duration`: s over which a continuous unit takes it in; None for a batch.
    """

    name: str
    volume: CaseInput
    temperature: CaseInput
    concentration: CaseInput
    solvent: CaseInput
    duration: float | None


def feed(record: Feed, inputs: dict[str, Any]) -> Stream:
    """The material of a feed."""
    volume = use(inputs, record.volume)
    species = use(inputs, record.concentration) * volume
    solvent = use(inputs, record.solvent) * volume
    temperature = use(inputs, record.temperature)
    return clear(species, solvent, volume, temperature, record.duration or 0.0)
