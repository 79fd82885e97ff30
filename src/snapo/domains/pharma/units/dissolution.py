"""The product's dissolution test: spheres that shrink in a film, of all sizes that were counted."""

from dataclasses import dataclass
from typing import Any, Literal

from jaxtyping import Array, Float

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable

from ..flowsheet.ledger import LedgerFinish, ledger
from ..flowsheet.stream import Stream
from ..given import use
from ..read.fields import quantity
from ..read.numbers import POSITIVE
from .operation import Inlet, Instant
from .solids.release import BY_MEAN, gone, lasting, over_sizes


class DissolutionTable(CaseTable):
    """`type = "dissolution"`"""

    type: Literal["dissolution"]
    diffusivity: Any = quantity('"7e-10 m^2/s"', meaning="diffusivity in the film")
    solubility: Any = quantity('"0.5 kg/m^3"', meaning="solubility in the test's liquid")
    film: Any = quantity('"30 um"', meaning="thickness of the film")
    time: Any = quantity('"30 min"', meaning="time of the test")


@dataclass(frozen=True, eq=False)
class Dissolution(Instant):
    """Dissolution test of the product, shrinking spheres of the sizes that are counted, or of d32.

    Dissolved share at `test_time` s: 1 - (1 - D Cs t / (rho_s h r))^3, 1 once a sphere is gone;
    the crystals' density comes with the stream. `diffusivity`: m2/s; `solubility`: kg/m3; `film`:
    m; each index [].
    """

    diffusivity: CaseInput
    solubility: CaseInput
    film: CaseInput
    test_time: CaseInput

    type = "dissolution"
    variant = ""
    title = "dissolution"
    table = DissolutionTable
    reacts = False
    symbols = (
        ("D", "diffusivity"),
        ("Cₛ", "solubility"),
        ("h", "film of the dissolution test"),
        ("ρₛ", "density of crystals"),
        ("d₃₂", "mean size by surface"),
    )
    assumptions = (BY_MEAN,)

    @classmethod
    def read(cls, read, species):
        return cls(
            name=read.name,
            diffusivity=read.number("diffusivity", "m2/s", POSITIVE),
            solubility=read.number("solubility", "kg/m3", POSITIVE),
            film=read.number("film", "m", POSITIVE),
            test_time=read.number("time", "s", POSITIVE),
        )

    @property
    def inlets(self):
        return (Inlet("product", "needed"),)

    @property
    def outlets(self):
        return ()

    def sizes(self, inlets):
        return ()

    def measures(self, species):
        return {"dissolved": "1"}

    def equations(self):
        return [
            "dissolved share 1 − (1 − D Cₛ t/(ρₛ h r))³, 1 once dissolved, summed over the "
            "sizes 2 r that are counted; else r = d₃₂/2"
        ]

    def deliver(self, network, inlets, inputs):
        measures = {"dissolved": self.dissolved(inlets[0], inputs)}
        return LedgerFinish((), measures, ledger(len(network.species)))

    def dissolved(self, product: Stream, inputs: dict[str, Any]) -> Float[Array, ""]:
        """1 - (1 - D Cs t / (rho h r))^3, 1 once they are gone, over all sizes 2 r of the crystals;
        they fall out of granules at once."""
        time = use(inputs, self.test_time)
        return over_sizes(lambda complete: gone(time, complete), lasting(self, product, inputs))
