"""Tablet press: granules, or crystals, compacted into tablets; their strength, dose and release.

Compaction, where D is the relative density under the pressure P: Heckel's equation is dD/dP = K (1
- D), so that ln(1/(1 - D)) = P/P_y + A with the yield pressure P_y = 1/K (R. W. Heckel,
  "Density-Pressure Relationships in Powder Compaction", Trans. Metall. Soc. AIME 221, 671-675,
  1961), and A = -ln(1 - D_0 - D_B), with the relative density D_0 of the loose bed and the increase
  D_B by rearrangement. Kawakita's equation is (V_0 - V)/V_0 = a b P/(1 + b P) (K. Kawakita and
  K.-H. Luedde, "Some considerations on powder compression equations", Powder Technology 4, 61-68,
  1971). Strength falls exponentially with porosity (E. Ryshkewitch, J. Am. Ceram. Soc. 36, 65,
  1953, and W. Duckworth's discussion of it there), and breaks a flat tablet across its diameter at
  F = pi d h sigma/2 (J. T. Fell and J. M. Newton, "Determination of Tablet Strength by the
  Diametral-Compression Test", J. Pharm. Sci. 59, issue 5, 1970, doi 10.1002/jps.2600590523).

Content: the acceptance value of USP <905> for ten tablets, |M - X| + 2.4 s in per cent of the
label, where M is X if X is between 98.5 and 101.5, and otherwise the nearer of these two. The mean
X and the standard deviation s are those of the batch instead of a sample.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.case.table import doc
from snapo.problem.record.arrays import Array, Float, jnp

from ...flowsheet.stream import LedgerFinish, Stream, ledger
from ...given import use
from ...read.declared import (
    CONCENTRATION,
    DIFFUSIVITY,
    LENGTH,
    POWER,
    PRESSURE,
    TIME,
    UnitQuantity,
    species_key,
)
from ...read.numbers import DENSITY, INSIDE, POSITIVE, SHARE
from ..operation import Inlet, Instant
from .release import BY_MEAN, lasting, over_sizes, released

ACCEPTED = (0.985, 1.015)  # of the label: a mean within them adds nothing to the acceptance value
TEN = 2.4  # acceptability constant of ten tablets
STRESS = UnitQuantity("Pa", POSITIVE, example="80 MPa")
WEIGHT = UnitQuantity("kg", POSITIVE, example="100 mg")
PART = UnitQuantity(range=INSIDE)


HECKEL, KAWAKITA = ("yield_pressure", "rearrangement"), ("kawakita_a", "kawakita_b")


@dataclass(frozen=True, eq=False)
class TabletPress(Instant):
    """Press, and the tests of its tablets.

    - `yield_pressure` and `rearrangement`, or `kawakita_a` and `kawakita_b`.
    - `bonding`: k in exp(-k porosity); `disintegration`: the mean disintegration time at
      `reference_porosity`; at other porosities it is multiplied by (reference /
      porosity)^`porosity_power`.
    """

    drug: int = species_key("species of the drug", "name of the species that is the drug")
    weight: CaseInput = WEIGHT("weight of a tablet", example="300 mg")
    label: CaseInput = WEIGHT("mass of drug in a tablet according to its label")
    diameter: CaseInput = LENGTH("diameter of a flat tablet", example="10 mm")
    pressure: CaseInput = PRESSURE("pressure of compaction", example="150 MPa")
    true_density: CaseInput = UnitQuantity("kg/m3", DENSITY, example="1450 kg/m^3")(
        "true density of the solids"
    )
    packing: CaseInput = PART("share of a bed that particles fill")
    yield_pressure: CaseInput | None = STRESS("Heckel's mean yield pressure", None)
    rearrangement: CaseInput | None = PART("relative density by rearrangement", None, range=SHARE)
    kawakita_a: CaseInput | None = PART("Kawakita's a", None)
    kawakita_b: CaseInput | None = UnitQuantity("1/Pa", POSITIVE, example="0.1 1/MPa")(
        "Kawakita's b", None
    )
    strength: CaseInput = STRESS("tensile strength without pores", example="10 MPa")
    bonding: CaseInput = POWER("fall of ln(strength) with porosity")
    deviation: CaseInput = PART("relative deviation of the content", 0.0, range=Range(0.0, 0.5))
    disintegration: CaseInput = TIME("mean disintegration time of a tablet", example="2 min")
    reference_porosity: CaseInput = PART("porosity to which the disintegration time refers", 0.1)
    porosity_power: CaseInput = POWER("power of the porosity in the disintegration time", 0.0)
    diffusivity: CaseInput = DIFFUSIVITY("diffusivity in the film")
    solubility: CaseInput = CONCENTRATION("solubility in the test's liquid", example="0.5 kg/m^3")
    film: CaseInput = LENGTH("thickness of the film", example="30 um")
    test_time: CaseInput = TIME("time of the dissolution test", alias="time", example="30 min")

    type = "tablet-press"
    more_keys: ClassVar = {
        "compaction": (
            Literal["heckel", "kawakita"],
            doc("equation of compaction", "heckel"),
        )
    }
    variant = ""
    title = "tablet press"
    reacts = False
    symbols = (
        ("D, ε", "relative density and porosity of a tablet"),
        ("P", "pressure of compaction"),
        ("d, h", "diameter and thickness of a tablet"),
        ("σ", "tensile strength"),
        ("F", "breaking force"),
        ("X, s", "mean and deviation of the content, as shares of the label"),
        ("τ", "mean time of disintegration"),
        ("r", "radius of the drug's crystals"),
    )
    assumptions = (
        BY_MEAN,
        "Tablets are flat and do not expand after compaction; the dissolution test is at sink "
        "conditions, and crystals of the drug keep their size in granulation and compaction.",
    )

    @classmethod
    def read(cls, read, species):
        table = read.table
        local, other = (HECKEL, KAWAKITA) if table.compaction == "heckel" else (KAWAKITA, HECKEL)
        for key in (*local, *other):
            if (getattr(table, key) is None) == (key in local):
                says = "needs this key" if key in local else "has no such key"
                displayed = read.raw.get(key)
                raise read.section.error(key, displayed, f'compaction "{table.compaction}" {says}')
        return super().read(read, species)

    @property
    def inlets(self):
        return (Inlet("granules", "needed"),)

    @property
    def outlets(self):
        return ("tablets",)

    def sizes(self, inlets):
        return inlets

    def measures(self, species):
        return {
            "porosity": "1", "thickness": "m", "strength": "Pa", "force": "N", "assay": "1",
            "acceptance": "1", "disintegration": "s", "dissolved": "1", "tablets": "1",
        }  # fmt: skip

    def equations(self):
        heckel = "ln(1/ε) = P/P_y − ln(1 − D₀ − D_B), D₀ = packing × density of the particles"
        kawakita = "1 − D₀/D = a b P/(1 + b P), D₀ = packing × density of the particles"
        return [
            (kawakita if self.yield_pressure is None else heckel) + "/true density; ε = 1 − D",
            "σ = σ₀ exp(−k ε), F = π d h σ/2, h = 4 m/(π d² ρ D)",
            "assay X = drug/label; acceptance |M − X| + 2.4 s, M = X from 98.5 % to 101.5 %",
            "dissolved: ∫₀ᵗ exp(−z/τ)/τ (1 − (1 − D_f Cₛ (t − z)/(ρₛ h_f r))³) dz",
        ]

    def deliver(self, network, inlets, inputs):
        fed = inlets[0]
        dense = self.compacted(fed, inputs)
        porosity, weight = 1 - dense, use(inputs, self.weight)
        diameter = use(inputs, self.diameter)
        thickness = 4 * weight / (jnp.pi * diameter**2 * use(inputs, self.true_density) * dense)
        strength = use(inputs, self.strength) * jnp.exp(-use(inputs, self.bonding) * porosity)
        total = network.molar_mass @ (fed.species + fed.solid) + fed.solvent + fed.antisolvent
        drug = (fed.species + fed.solid)[self.drug] * network.molar_mass[self.drug]
        assay = weight * drug / total / use(inputs, self.label)
        relative = use(inputs, self.reference_porosity) / porosity
        time = use(inputs, self.disintegration) * relative ** use(inputs, self.porosity_power)
        measures = {
            "porosity": porosity,
            "thickness": thickness,
            "strength": strength,
            "force": jnp.pi * diameter * thickness * strength / 2,
            "assay": assay,
            "acceptance": acceptance(assay, use(inputs, self.deviation) * assay),
            "disintegration": time,
            "dissolved": self.dissolved(fed, time, inputs),
            "tablets": total / weight,
        }
        return LedgerFinish((fed,), measures, ledger(len(network.species)))

    def compacted(self, fed: Stream, inputs: dict[str, Any]) -> Float[Array, ""]:
        """The relative density of a tablet."""
        loose = use(inputs, self.packing) * fed.density / use(inputs, self.true_density)
        pressure = use(inputs, self.pressure)
        if self.yield_pressure is not None:
            assert self.rearrangement is not None
            start = loose + use(inputs, self.rearrangement)
            return 1 - (1 - start) * jnp.exp(-pressure / use(inputs, self.yield_pressure))
        assert self.kawakita_a is not None and self.kawakita_b is not None
        pressed = use(inputs, self.kawakita_b) * pressure
        return loose / (1 - use(inputs, self.kawakita_a) * pressed / (1 + pressed))

    def dissolved(self, fed: Stream, mean, inputs: dict[str, Any]) -> Float[Array, ""]:
        """The share of the drug in solution at the end of the test."""
        time = use(inputs, self.test_time)
        return over_sizes(
            lambda complete: released(time, complete, mean), lasting(self, fed, inputs)
        )


def acceptance(mean, deviation) -> Float[Array, ""]:
    """The acceptance value of USP <905> for ten tablets, as a share of the label like the
    arguments; at most 0.15 is allowed."""
    low, high = ACCEPTED
    off = jnp.maximum(low - mean, 0.0) + jnp.maximum(mean - high, 0.0)
    return off + TEN * deviation
