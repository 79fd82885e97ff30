"""High-shear wet granulation of the drug's crystals with an excipient: size, porosity, moisture.

Granules coalesce at a rate that does not depend on their sizes (random coalescence): every granule
meets b partners per s. For the number N of granules, and for M2, the sum of the squares of the
volumes of their solids, with the constant total V,

    N' = -b N / 2,   M2' = b V^2 / N,

the moments 0 and 2 of Smoluchowski's equation with the kernel b / N. They have a closed form: with
b constant N = N0 exp(-b t / 2) and M2 = M2(0) + 2 V^2 / N0 (exp(b t / 2) - 1). Sizes are assumed to
be lognormal with these moments. The granules consolidate: their porosity falls exponentially
towards its minimum (for both see the review of Iveson, Litster, Hapgood and Ennis, Powder
Technology 117, 3, 2001). Both rates depend on speed and moisture by an empirical power law.

In the outlet, a granule is a particle with the density of granules: the stream's moments are those
of granules, and the sizes of the crystals inside are stored with them.
"""

from dataclasses import dataclass

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.problem.record.arrays import Array, Float, jnp

from ...flowsheet.stream import MOMENTS, LedgerFinish, ledger
from ...given import use
from ...read.declared import LENGTH, POWER, RATE, SPEED, TIME, UnitQuantity, species_key
from ...read.numbers import DENSITY, INSIDE, LIQUID, POSITIVE
from ...time.dynamics import Dynamics
from ...time.profile import Profile
from ..crystals.population import mean_sizes
from ..operation import Inlet, Timed

SPHERE = np.pi / 6  # granules are round
DENSITIES = UnitQuantity("kg/m3", DENSITY, example="1540 kg/m^3")
RATIO, PART = UnitQuantity(range=POSITIVE), UnitQuantity(range=INSIDE)


@dataclass(frozen=True, eq=False)
class Granulation(Timed):
    """High-shear wet granulation.

    - Ratios are by mass; `nuclei_size`: the size of a sphere of the mean volume.
    - `coalescence`: b at the saturation 1 and the speed `reference_speed`.
    """

    duration: CaseInput = TIME("time of wet massing", example="10 min")
    speed: Profile = SPEED.profile("tip speed of the impeller", example="8 m/s")
    excipient: int = species_key(
        "species of the excipient", "name of the species that is the excipient"
    )
    excipient_ratio: CaseInput = RATIO(
        "mass of excipient per mass of drug", range=Range(0.0, 1000.0)
    )
    excipient_density: CaseInput = DENSITIES("density of the excipient")
    liquid_ratio: CaseInput = RATIO("granulation liquid per mass of solids")
    liquid_density: CaseInput = DENSITIES(
        "density of the granulation liquid", range=LIQUID, example="1000 kg/m^3"
    )
    nuclei_size: CaseInput = LENGTH("mean size of the first granules, by volume", example="150 um")
    nuclei_spread: CaseInput = RATIO(
        "spread of ln(size) of the first granules", 0.0, range=Range(0.0, 2.0)
    )
    coalescence: CaseInput = RATE(
        "rate of coalescence at saturation 1 and the reference speed", example="0.01 1/s"
    )
    saturation_power: CaseInput = POWER("power of the saturation in the rate of coalescence", 0.0)
    consolidation: CaseInput = RATE("rate at which porosity falls", example="0.005 1/s")
    porosity: CaseInput = PART("porosity of the first granules")
    least_porosity: CaseInput = PART("smallest porosity of granules")
    reference_speed: CaseInput = SPEED(
        "speed to which both rates refer", range=POSITIVE, example="8 m/s"
    )
    speed_power: CaseInput = POWER("power of the speed in both rates", 1.0)
    packing: CaseInput = PART("share of a bed that granules fill")

    type = "granulation"
    variant = ""
    title = "wet granulation"
    reacts = False
    symbols = (
        ("N", "number of granules"),
        ("V", "volume of the solids of all granules"),
        ("M₂", "sum of the squares of the solids' volumes"),
        ("ε", "porosity of a granule"),
        ("s", "saturation of its pores"),
        ("w", "granulation liquid per solids"),
        ("u", "tip speed"),
    )
    assumptions = (
        "Granulation liquid and excipient are present from the start, and nothing dissolves in "
        "the liquid; granules do not break.",
    )

    @property
    def inlets(self):
        return (Inlet("crystals", "needed"),)

    @property
    def outlets(self):
        return ("granules",)

    @property
    def error_controlled(self):
        return False

    def sizes(self, inlets):
        return (None,)

    def measures(self, species):
        return {
            "d32": "m", "d43": "m", "spread": "1", "porosity": "1", "saturation": "1",
            "bulk_density": "kg/m3", "loss_on_drying": "1",
        }  # fmt: skip

    def states(self, species):
        return {"d43": "m", "d32": "m", "porosity": "1", "saturation": "1", "speed": "m/s"}

    def equations(self):
        return [
            "N' = −b N/2, M₂' = b V²/N; b = b₀ sᵃ (u/u₀)ⁿ; sizes lognormal with N, V, M₂",
            "ε' = −k (u/u₀)ⁿ (ε − ε_min); s = w ρₛ (1 − ε)/(ρ_l ε)",
            "bulk density = packing × ρₛ (1 − ε), dry; loss on drying = liquid/(liquid + solids)",
        ]

    def dynamics(self, network, inlets, inputs):
        """y: ln(N0/N), M2 N0 / V^2, and the porosity."""
        fed = inlets[0]
        drug = fed.crystals()
        added = use(inputs, self.excipient_ratio) * drug
        volume = drug / fed.density + added / use(inputs, self.excipient_density)
        dry = (drug + added) / volume  # kg/m3 of the solids
        liquid = use(inputs, self.liquid_ratio) * (drug + added)
        wet = fed.solvent + fed.antisolvent + liquid
        room = use(inputs, self.liquid_density)
        filled = wet / room / volume
        first, minimum = use(inputs, self.porosity), use(inputs, self.least_porosity)
        size, spread = use(inputs, self.nuclei_size), use(inputs, self.nuclei_spread)
        coalescence, settles = use(inputs, self.coalescence), use(inputs, self.consolidation)
        power, speed = use(inputs, self.saturation_power), use(inputs, self.speed.value)
        number = volume / (1 - first) / (SPHERE * size**3)

        def saturation(porosity):
            return filled * (1 - porosity) / porosity

        def rate(y, drive):
            meets = coalescence * drive[0] * saturation(y[2]) ** power
            falls = settles * drive[0] * (y[2] - minimum)
            return jnp.stack([meets / 2, meets * jnp.exp(y[0]), -falls])

        def drive(control):
            relative = control / use(inputs, self.reference_speed)
            running = relative > 0
            safe = jnp.where(running, relative, 1.0) ** use(inputs, self.speed_power)
            return jnp.where(running, safe, 0.0)[..., None]

        def moments(y):
            count = number * jnp.exp(-y[0])
            return lognormal(count, volume / (1 - y[2]) / SPHERE, y[1] * jnp.exp(-y[0]))

        def states(y, control):
            table = {"porosity": y[2], "saturation": saturation(y[2])}
            return table | mean_sizes(moments(y)) | {"speed": jnp.asarray(control)}

        def finish(y, _):
            local, envelope = moments(y), dry * (1 - y[2])
            measures = mean_sizes(local) | {
                "spread": _spread(y[1] * jnp.exp(-y[0])),
                "porosity": y[2],
                "saturation": saturation(y[2]),
                "bulk_density": envelope * use(inputs, self.packing),
                "loss_on_drying": wet / (wet + drug + added),
            }
            nothing = jnp.zeros_like(fed.species)
            more = nothing.at[self.excipient].set(added / network.molar_mass[self.excipient])
            inside = fed.inner_size > 0
            granules = fed.replace(
                solid=fed.solid + more,
                solvent=fed.solvent + liquid,
                volume=fed.volume + liquid / room,
                moments=local,
                density=envelope,
                shape=jnp.asarray(SPHERE),
                inner_size=jnp.where(inside, fed.inner_size, mean_sizes(fed.moments)["d32"]),
                inner_density=jnp.where(inside, fed.inner_density, fed.density),
                inner_numbers=fed.inner_numbers if fed.inner_grid else fed.numbers,
                inner_grid=fed.inner_grid or fed.grid,
                numbers=jnp.zeros(0),
                grid=None,
            )
            book = ledger(len(network.species), added=more, solvent_added=liquid)
            return LedgerFinish((granules,), measures, book)

        start = jnp.stack([jnp.zeros(()), jnp.exp(9 * spread**2), first])
        controls = ((self.speed, speed),)
        duration = use(inputs, self.duration)
        return Dynamics(start, rate, drive, controls, duration, None, states, finish, False)


def lognormal(count, third, ratio) -> Float[Array, " 6"]:
    """Moments 0 to 5 of lognormal sizes with the number `count`, the third moment `third`, and the
    `ratio` of the product of the moments 6 and 0 to the square of moment 3, which is exp(9
    spread^2)."""
    square = _spread(ratio) ** 2
    middle = jnp.log(third / count) / 3 - 1.5 * square
    k = np.arange(MOMENTS)
    return count * jnp.exp(k * middle + k**2 * square / 2)


def _spread(ratio) -> Array:
    """The standard deviation of ln(size), with a finite derivative where all sizes are equal."""
    above = jnp.log(jnp.maximum(ratio, 1.0)) / 9
    same = above <= 0
    return jnp.where(same, 0.0, jnp.sqrt(jnp.where(same, 1.0, above)))
