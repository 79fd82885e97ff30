"""Tablet press: granules, or crystals, compacted into tablets; their strength, dose and release.

Compaction, D being the relative density under the pressure P: Heckel's dD/dP = K (1 - D), so that
ln(1/(1 - D)) = P/P_y + A with the yield pressure P_y = 1/K (R. W. Heckel, "Density-Pressure
Relationships in Powder Compaction", Trans. Metall. Soc. AIME 221, 671-675, 1961), and A = -ln(1 -
D_0 - D_B) of the density at rest D_0 and by rearrangement D_B; or Kawakita's (V_0 - V)/V_0 = a b
P/(1 + b P) (K. Kawakita and K.-H. Luedde, "Some considerations on powder compression equations",
Powder Technology 4, 61-68, 1971). Strength falls exponentially with porosity (E. Ryshkewitch, J.
Am. Ceram. Soc. 36, 65, 1953, and W. Duckworth's discussion of it there; its page, 68, from memory),
and breaks a flat tablet across its diameter at F = pi d h sigma/2 (J. T. Fell and J. M. Newton,
"Determination of Tablet Strength by the Diametral-Compression Test", J. Pharm. Sci. 59, issue 5,
1970, doi 10.1002/jps.2600590523; its page, 688, from memory).

Content: the acceptance value of USP <905> for ten tablets, |M - X| + 2.4 s in per cent of the
label, M being X between 98.5 and 101.5 and else the nearer of both, with the mean and the standard
deviation of the batch in place of a sample's.
"""

from dataclasses import dataclass
from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array, Float
from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable

from ...flowsheet.ledger import LedgerFinish, ledger
from ...flowsheet.stream import Stream
from ...given import use
from ...read.fields import TextKey, number, quantity, word
from ...read.numbers import DENSITY, INSIDE, NOT_NEGATIVE, POSITIVE, SHARE, ValueRange
from ..operation import Inlet, Instant
from .release import BY_MEAN, lasting, over_sizes, released

ACCEPTED = (0.985, 1.015)  # of the label: a mean within them adds nothing to the acceptance value
TEN = 2.4  # acceptability constant of ten tablets
FEW = ValueRange(0.0, 0.5, False, "a share from 0 to 0.5")


class TabletPressTable(CaseTable):
    """`type = "tablet-press"`"""

    type: Literal["tablet-press"]
    drug: TextKey = Field(description="the species that is the drug")
    weight: Any = quantity('"300 mg"', meaning="weight of a tablet")
    label: Any = quantity('"100 mg"', meaning="drug in a tablet as labelled")
    diameter: Any = quantity('"10 mm"', meaning="diameter of a flat tablet")
    pressure: Any = quantity('"150 MPa"', meaning="pressure of compaction")
    true_density: Any = quantity('"1450 kg/m^3"', meaning="true density of the solids")
    packing: Any = number("a share between 0 and 1", meaning="share of a bed that particles fill")
    compaction: Literal["heckel", "kawakita"] = word("heckel", "kawakita", default="heckel")
    yield_pressure: Any = quantity('"80 MPa"', None, meaning="Heckel's mean yield pressure")
    rearrangement: Any = number("a share from 0 to 1", None, "relative density by rearrangement")
    kawakita_a: Any = number("a share between 0 and 1", None, "Kawakita's a")
    kawakita_b: Any = quantity('"0.1 1/MPa"', None, meaning="Kawakita's b")
    strength: Any = quantity('"10 MPa"', meaning="tensile strength without pores")
    bonding: Any = number("a number, 0 or more", meaning="fall of ln(strength) with porosity")
    deviation: Any = number("a share from 0 to 0.5", 0.0, "relative deviation of the content")
    disintegration: Any = quantity('"2 min"', meaning="mean time in which a tablet falls apart")
    reference_porosity: Any = number("a share", 0.1, "porosity to which that time refers")
    porosity_power: Any = number("a number, 0 or more", 0.0, "power of the porosity in that time")
    diffusivity: Any = quantity('"7e-10 m^2/s"', meaning="diffusivity in the film")
    solubility: Any = quantity('"0.5 kg/m^3"', meaning="solubility in the test's liquid")
    film: Any = quantity('"30 um"', meaning="thickness of the film")
    time: Any = quantity('"30 min"', meaning="time of the dissolution test")


HECKEL, KAWAKITA = ("yield_pressure", "rearrangement"), ("kawakita_a", "kawakita_b")


@dataclass(frozen=True, eq=False)
class TabletPress(Instant):
    """Press, and the tests of its tablets.

    - `drug`: number of the species; `weight`, `label`: kg; `diameter`: m; `pressure`: Pa;
      `true_density`: kg/m3; `packing`: the share of a bed that granules or crystals fill.
    - `yield_pressure` in Pa and `rearrangement`, or `kawakita_a` and `kawakita_b` in 1/Pa.
    - `strength`: Pa; `bonding`: k of exp(-k porosity); `deviation`: relative, of the drug content.
    - `disintegration`: s at `reference_porosity`, times (reference / porosity)^`porosity_power`.
    - `diffusivity`: m2/s; `solubility`: kg/m3; `film`: m; `test_time`: s.
    """

    drug: int
    weight: CaseInput
    label: CaseInput
    diameter: CaseInput
    pressure: CaseInput
    true_density: CaseInput
    packing: CaseInput
    yield_pressure: CaseInput | None
    rearrangement: CaseInput | None
    kawakita_a: CaseInput | None
    kawakita_b: CaseInput | None
    strength: CaseInput
    bonding: CaseInput
    deviation: CaseInput
    disintegration: CaseInput
    reference_porosity: CaseInput
    porosity_power: CaseInput
    diffusivity: CaseInput
    solubility: CaseInput
    film: CaseInput
    test_time: CaseInput

    type = "tablet-press"
    variant = ""
    title = "tablet press"
    table = TabletPressTable
    reacts = False
    symbols = (
        ("D, ε", "relative density and porosity of a tablet"),
        ("P", "pressure of compaction"),
        ("d, h", "diameter and thickness of a tablet"),
        ("σ", "tensile strength"),
        ("F", "breaking force"),
        ("X, s", "mean and deviation of the content, of the label"),
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
            values = getattr(table, key)
            if (values is None) == (key in local):
                says = "needs this key" if key in local else "has no such key"
                raise read.section.error(key, values, f'compaction "{table.compaction}" {says}')
        return cls(
            name=read.name,
            drug=species.index(read.one_of("drug", species, "species")),
            weight=read.number("weight", "kg", POSITIVE),
            label=read.number("label", "kg", POSITIVE),
            diameter=read.number("diameter", "m", POSITIVE),
            pressure=read.number("pressure", "Pa", NOT_NEGATIVE),
            true_density=read.number("true_density", "kg/m3", DENSITY),
            packing=read.number("packing", "1", INSIDE),
            yield_pressure=read.optional("yield_pressure", "Pa", POSITIVE),
            rearrangement=read.optional("rearrangement", "1", SHARE),
            kawakita_a=read.optional("kawakita_a", "1", INSIDE),
            kawakita_b=read.optional("kawakita_b", "1/Pa", POSITIVE),
            strength=read.number("strength", "Pa", POSITIVE),
            bonding=read.number("bonding", "1", NOT_NEGATIVE),
            deviation=read.number("deviation", "1", FEW),
            disintegration=read.number("disintegration", "s", POSITIVE),
            reference_porosity=read.number("reference_porosity", "1", INSIDE),
            porosity_power=read.number("porosity_power", "1", NOT_NEGATIVE),
            diffusivity=read.number("diffusivity", "m2/s", POSITIVE),
            solubility=read.number("solubility", "kg/m3", POSITIVE),
            film=read.number("film", "m", POSITIVE),
            test_time=read.number("time", "s", POSITIVE),
        )

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
    """USP <905> for ten tablets; shares of the label, as is the result (allowed is 0.15)."""
    low, high = ACCEPTED
    off = jnp.maximum(low - mean, 0.0) + jnp.maximum(mean - high, 0.0)
    return off + TEN * deviation
