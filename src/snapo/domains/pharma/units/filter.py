"""Filter and wash at constant pressure: the time needed, and the liquor in the cake.

The cake retains a share of the liquor in its voids; the wash leaves a share of the species
dissolved in it, and wash liquid replaces the liquor. The filtrate is the rest of the slurry.
"""

from dataclasses import dataclass
from typing import Any, Literal

from snapo.case.given import CaseInput
from snapo.case.table import doc
from snapo.problem.record.arrays import Array, Float, jax, jnp

from ..flowsheet.stream import NO_CRYSTALS, LedgerFinish, Stream, clear, ledger
from ..given import use
from ..read.declared import AREA, PRESSURE, UnitQuantity, key
from ..read.numbers import NOT_NEGATIVE, POROSITY, POSITIVE, SHARE
from .crystals.population import mean_sizes
from .operation import Inlet, Instant


@dataclass(frozen=True, eq=False)
class Filter(Instant):
    """Filter and wash at constant pressure.

    - `wash_ratio`: W. `wash`: with "exponential" exp(-efficiency W) of a solute stays; "dispersion"
      is the formula of Lapidus and Amundson with the Peclet number `peclet`.
    - `resistance`: None if it follows from porosity and d32 by Carman and Kozeny.
    """

    area: CaseInput = AREA("filter area", example="200 cm^2")
    pressure: CaseInput = PRESSURE("pressure difference", range=POSITIVE)
    viscosity: CaseInput = UnitQuantity("Pa*s", POSITIVE, example="0.46 mPa*s")(
        "viscosity of the liquor"
    )
    medium_resistance: CaseInput = UnitQuantity("1/m", NOT_NEGATIVE, example="1e10 1/m")(
        "resistance of the filter medium"
    )
    porosity: CaseInput = UnitQuantity(range=POROSITY)("porosity of the cake")
    saturation: CaseInput = UnitQuantity(range=SHARE)(
        "share of the cake's voids in which liquor stays"
    )
    resistance: CaseInput | None = UnitQuantity("m/kg", POSITIVE, example="1e11 m/kg")(
        "specific resistance of the cake", None
    )
    wash: Literal["exponential", "dispersion"] = key(doc("model of the wash", "exponential"))
    wash_ratio: CaseInput = UnitQuantity(range=NOT_NEGATIVE)("wash liquid per void volume")
    efficiency: CaseInput | None = UnitQuantity(range=NOT_NEGATIVE)("efficiency of the wash", None)
    peclet: CaseInput | None = UnitQuantity(range=POSITIVE)("Peclet number of the wash", None)

    type = "filter"
    variant = ""
    title = "filter"
    reacts = False
    symbols = (
        ("ε", "porosity"),
        ("s", "saturation"),
        ("W", "wash ratio"),
        ("α", "specific resistance"),
        ("cₛ", "crystals per volume of filtrate V_f"),
        ("R_m", "resistance of the medium"),
        ("μ", "viscosity"),
        ("Δp", "pressure"),
        ("A", "area"),
        ("ρₛ", "density of crystals"),
        ("d₃₂", "mean size by surface"),
    )
    assumptions = ("Wash liquid is clean solvent and replaces liquor one to one.",)

    @classmethod
    def read(cls, read, species):
        check_wash(read)
        return super().read(read, species)

    @property
    def inlets(self):
        return (Inlet("slurry", "needed"),)

    @property
    def outlets(self):
        return ("cake", "filtrate", "washings")

    def sizes(self, inlets):
        return (inlets[0], NO_CRYSTALS, NO_CRYSTALS)

    def measures(self, species):
        table = {"time": "s", "resistance": "m/kg", "liquor": "m3/kg"}
        return table | {f"impurity.{s}": "1" for s in species}

    def equations(self):
        wash = "exp(−η W)" if self.wash == "exponential" else "Lapidus–Amundson in W and Pe"
        return [
            "t = (μ/Δp) (α cₛ/2 (V_f/A)² + R_m V_f/A)",
            "α = 180 (1 − ε)/(ε³ d₃₂² ρₛ)" if self.resistance is None else "α as given",
            f"liquor kept h = s ε/((1 − ε) ρₛ) per kg; share of a solute that stays: {wash}",
        ]

    def deliver(self, network, inlets, inputs):
        """The ledger includes the wash liquid, which is the solvent of the slurry."""
        slurry = inlets[0]
        porosity, volume = use(inputs, self.porosity), slurry.volume
        density, mass = slurry.density, network.molar_mass
        crystals = slurry.crystals()
        measures = self.flow(slurry, crystals, porosity, inputs)
        voids = porosity / ((1 - porosity) * density)  # m3 per kg of crystals
        selected = use(inputs, self.saturation) * voids
        stay, ratio = self.remaining(inputs), use(inputs, self.wash_ratio)
        liquor = slurry.species / volume * selected * crystals  # kmol held before the wash
        solvent, other = slurry.solvent / volume, slurry.antisolvent / volume
        held, wash_volume = selected * crystals, ratio * voids * crystals
        replaced = other * held * (1 - stay)
        cake = slurry.replace(
            species=liquor * stay,
            solvent=solvent * held + replaced,
            antisolvent=other * held * stay,
            volume=held,
        )
        filtrate = clear(
            slurry.species - liquor,
            slurry.solvent - solvent * held,
            volume - held,
            slurry.temperature,
        ).replace(antisolvent=slurry.antisolvent - other * held)
        washings = clear(
            liquor * (1 - stay), solvent * wash_volume - replaced, wash_volume, slurry.temperature
        ).replace(antisolvent=replaced)
        measures["liquor"] = selected
        for s, name in enumerate(network.species):
            measures[f"impurity.{name}"] = mass[s] * slurry.species[s] / volume * selected * stay
        book = ledger(len(mass), solvent_added=solvent * wash_volume)
        return LedgerFinish((cake, filtrate, washings), measures, book)

    def flow(self, slurry: Stream, crystals, porosity, inputs) -> dict[str, Array]:
        """t = mu / dP (alpha c_s / 2 (V_f / A)^2 + R_m V_f / A), and alpha."""
        if self.resistance is not None:
            resistance = use(inputs, self.resistance)
        else:
            d32 = mean_sizes(slurry.moments)["d32"]
            resistance = 180 * (1 - porosity) / (porosity**3 * d32**2 * slurry.density)
        solid = crystals / slurry.density
        filtrate = slurry.suspension() - solid - solid * porosity / (1 - porosity)
        per_area = filtrate / use(inputs, self.area)
        cake = resistance * crystals / filtrate / 2 * per_area**2
        medium = use(inputs, self.medium_resistance) * per_area
        time = use(inputs, self.viscosity) / use(inputs, self.pressure) * (cake + medium)
        return {"time": time, "resistance": resistance}

    def remaining(self, inputs: dict[str, Any]) -> Float[Array, ""]:
        """The share of a solute in the retained liquor that the wash leaves behind."""
        ratio = use(inputs, self.wash_ratio)
        if self.wash == "exponential":
            assert self.efficiency is not None
            return jnp.exp(-use(inputs, self.efficiency) * ratio)
        assert self.peclet is not None
        return displacement(ratio, use(inputs, self.peclet))


def displacement(ratio, peclet) -> Float[Array, ""]:
    """The share of a solute that is left at the outlet after `ratio` void volumes, by Lapidus and
    Amundson (1952).

    1 - (erfc(a) + e^Pe erfc(b)) / 2, a = (1 - W) / 2 sqrt(Pe / W), b = (1 + W) / 2 sqrt(Pe / W);
    e^Pe erfc(b) is written exp(-a^2) erfcx(b), which does not overflow. The share is 1 without a
    wash.
    """
    washed = ratio > 0
    w = jnp.where(washed, ratio, 1.0)
    root = jnp.sqrt(peclet / w) / 2
    a, b = (1 - w) * root, (1 + w) * root
    left = 1 - (jax.scipy.special.erfc(a) + jnp.exp(-a * a) * scaled_erfc(b)) / 2
    return jnp.where(washed, left, 1.0)


def scaled_erfc(x) -> Array:
    """exp(x^2) erfc(x) for x >= 0, computed directly if x is below 4, otherwise by Laplace's
    continued fraction."""
    near = jnp.minimum(x, 4.0)
    far = jnp.maximum(x, 4.0)
    fraction = far
    for k in range(30, 0, -1):
        fraction = far + k / 2 / fraction
    return jnp.where(
        x < 4,
        jnp.exp(near * near) * jax.scipy.special.erfc(near),
        1 / (fraction * jnp.sqrt(jnp.pi)),
    )


def check_wash(read) -> None:
    """**Raises:** `CaseError` if a key that the kind of wash needs is missing, or a key of another
    kind is present."""
    table = read.table
    for wash, name in (("exponential", "efficiency"), ("dispersion", "peclet")):
        if table.wash == wash and getattr(table, name) is None:
            raise read.section.error(name, None, f'wash "{wash}" needs this key')
        if table.wash != wash and getattr(table, name) is not None:
            message = f'wash "{table.wash}" has no such key; it belongs to "{wash}"'
            raise read.section.error(name, read.raw[name], message)
