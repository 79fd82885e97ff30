"""The dissolution test of the product: spheres that shrink by diffusion through a film."""

from dataclasses import dataclass
from typing import Any

from snapo.case.given import CaseInput
from snapo.problem.record.arrays import Array, Float

from ..flowsheet.stream import LedgerFinish, Stream, ledger
from ..given import use
from ..read.declared import CONCENTRATION, DIFFUSIVITY, LENGTH, TIME
from .operation import Inlet, Instant
from .solids.release import BY_MEAN, gone, lasting, over_sizes


@dataclass(frozen=True, eq=False)
class Dissolution(Instant):
    """Dissolution test of the product: shrinking spheres of the counted sizes, or of the size d32.

    Dissolved share at `test_time`: 1 - (1 - D Cs t / (rho_s h r))^3, 1 once a sphere is gone; the
    stream supplies the density of the crystals.
    """

    diffusivity: CaseInput = DIFFUSIVITY("diffusivity in the film")
    solubility: CaseInput = CONCENTRATION("solubility in the test's liquid", example="0.5 kg/m^3")
    film: CaseInput = LENGTH("thickness of the film", example="30 um")
    test_time: CaseInput = TIME("time of the test", alias="time", example="30 min")

    type = "dissolution"
    variant = ""
    title = "dissolution"
    reacts = False
    symbols = (
        ("D", "diffusivity"),
        ("Cₛ", "solubility"),
        ("h", "film of the dissolution test"),
        ("ρₛ", "density of crystals"),
        ("d₃₂", "mean size by surface"),
    )
    assumptions = (BY_MEAN,)

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
            "sizes 2 r if they are counted, otherwise with r = d₃₂/2"
        ]

    def deliver(self, network, inlets, inputs):
        measures = {"dissolved": self.dissolved(inlets[0], inputs)}
        return LedgerFinish((), measures, ledger(len(network.species)))

    def dissolved(self, product: Stream, inputs: dict[str, Any]) -> Float[Array, ""]:
        """The mean of 1 - (1 - D Cs t / (rho h r))^3 over all sizes 2 r of the crystals, and 1 for
        dissolved ones. Granules release their crystals at time 0."""
        time = use(inputs, self.test_time)
        return over_sizes(lambda complete: gone(time, complete), lasting(self, product, inputs))
