"""Thickener: crystals and liquor of a flow taken apart, as by a clarifier or a hydrocyclone."""

from dataclasses import dataclass
from typing import Any, Literal

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable

from ..flowsheet.grid import NO_CRYSTALS
from ..flowsheet.ledger import LedgerFinish, ledger
from ..flowsheet.stream import clear
from ..given import use
from ..read.fields import number
from ..read.numbers import INSIDE
from .operation import Inlet, Instant


class ThickenerTable(CaseTable):
    """`type = "thickener"`"""

    type: Literal["thickener"]
    underflow: Any = number(
        "a share between 0 and 1", meaning="share of the liquor that stays with the crystals"
    )


@dataclass(frozen=True, eq=False)
class Thickener(Instant):
    """All crystals leave with the share `underflow`, index [], of the liquor; the rest is clear."""

    underflow: CaseInput

    type = "thickener"
    variant = ""
    title = "thickener"
    table = ThickenerTable
    reacts = False
    symbols = ()
    assumptions = ("The overflow of a thickener is clear, whatever the sizes of the crystals.",)

    @classmethod
    def read(cls, read, species):
        return cls(read.name, read.number("underflow", "1", INSIDE))

    @property
    def inlets(self):
        return (Inlet("feed", "needed"),)

    @property
    def outlets(self):
        return ("thick", "liquor")

    def sizes(self, inlets):
        return (inlets[0], NO_CRYSTALS)

    def lasts(self, inlets):
        return inlets * 2

    def measures(self, species):
        return {"crystals": "kg/m3"}

    def equations(self):
        return ["crystals, with a share of the liquor: thick; the rest of it: liquor"]

    def deliver(self, network, inlets, inputs):
        """Its measure: kg of crystals per m3 of what is thick."""
        feed, share = inlets[0], use(inputs, self.underflow)
        thick = feed.replace(
            species=feed.species * share,
            solvent=feed.solvent * share,
            antisolvent=feed.antisolvent * share,
            volume=feed.volume * share,
        )
        rest = 1 - share
        liquor = clear(
            feed.species * rest,
            feed.solvent * rest,
            feed.volume * rest,
            feed.temperature,
            feed.duration,
        ).replace(antisolvent=feed.antisolvent * rest)
        measures = {"crystals": feed.crystals() / thick.suspension()}
        return LedgerFinish((thick, liquor), measures, ledger(len(network.species)))
