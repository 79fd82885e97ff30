"""Thickener: separates crystals and liquor of a flow, like a clarifier or a hydrocyclone."""

from dataclasses import dataclass

from snapo.case.given import CaseInput

from ..flowsheet.stream import NO_CRYSTALS, LedgerFinish, clear, ledger
from ..given import use
from ..read.declared import UnitQuantity
from ..read.numbers import INSIDE
from .operation import Inlet, Instant


@dataclass(frozen=True, eq=False)
class Thickener(Instant):
    """All crystals leave with the share `underflow` of the liquor; the rest is clear."""

    underflow: CaseInput = UnitQuantity(range=INSIDE)(
        "share of the liquor that stays with the crystals"
    )

    type = "thickener"
    variant = ""
    title = "thickener"
    reacts = False
    symbols = ()
    assumptions = ("The overflow of a thickener is clear, for any sizes of the crystals.",)

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
        return [
            "outlet thick: crystals with a share of the liquor; outlet liquor: the rest of "
            "the liquor"
        ]

    def deliver(self, network, inlets, inputs):
        """The outlets, and the measure `crystals`: kg of crystals per m3 of the underflow."""
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
