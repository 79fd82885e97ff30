"""Drying of a cake on a heated shelf under vacuum, with one moisture and one temperature.

Per kg of crystals, X kg/kg of liquid leaves at w = k a max(f p_v(T) - p, 0), where a = 6 / (rho
d32) is the crystals' surface in m2/kg, p_v the liquid's vapour pressure and p the pressure above
the cake. If the surface is wet, f = 1: the rate is constant once the cake is so warm that the
shelf's heat, U A (T_shelf - T), equals the heat of evaporation. Below the critical moisture X_c the
surface dries out and f = X / X_c; in between f = r (1 + r^8)^(-1/8), r = X / X_c, which is within
0.1 % of either branch outside 0.6 < r < 1.7. In the end the moisture X_c p / p_v remains, which is
in equilibrium with the pressure p.

Heat: (cp_s + X cp_l) m T' = U A (T_shelf - T) - m w lambda. The heat in the cake, from the shelf
and into the vapour are integrated, so the energy balance closes to rounding.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.table import doc
from snapo.problem.record.arrays import Array, jnp

from ..flowsheet.stream import NO_CRYSTALS, LedgerFinish, clear, ledger
from ..given import use
from ..read.declared import ABSOLUTE, AREA, PRESSURE, TIME, TableRecord, UnitQuantity, inner, values
from ..read.numbers import POSITIVE, ZERO_CELSIUS, case_input, with_units
from ..read.quantities import UnitError, conversion
from ..read.reader import TextKey
from ..time.dynamics import Dynamics
from ..time.profile import Profile
from .crystals.population import mean_sizes
from .operation import Inlet, Timed

SHARPNESS = 8  # of the passage from constant to falling rate
ROUNDING = 1e-4  # of where evaporation begins, as a share of the pressure above the cake


HEAT_TRANSFER = UnitQuantity("W/m2/K", POSITIVE, example="20 W/m^2/K")
HEAT_CAPACITY = UnitQuantity("J/kg/K", POSITIVE, example="1200 J/kg/K")


@dataclass(frozen=True, eq=False)
class Liquid(TableRecord):
    """The liquid in a cake. ln p = ln(10) (A - B / (C + T)) in Pa with T in K (Antoine).

    `antoine`: (A, B, C), index [3].
    """

    antoine: CaseInput
    latent_heat: CaseInput = UnitQuantity("J/kg", POSITIVE, example="448 kJ/kg")(
        "latent heat of the liquid"
    )
    heat_capacity: CaseInput = HEAT_CAPACITY("heat capacity of the liquid")

    heading = "`[units.NAME.liquid]`"
    more_keys: ClassVar = {
        "antoine": (
            list[float],
            doc(
                "A, B and C of Antoine's equation, log10 p = A - B / (C + T)",
                allowed="three numbers, such as [9.23027, 1256.68, -40.529]",
                min_length=3,
                max_length=3,
            ),
        ),
        "unit": (
            TextKey,
            doc("unit of the pressure in Antoine's equation", "Pa", 'a unit such as "Pa"'),
        ),
        "scale": (
            Literal["K", "degC"],
            doc("temperature scale of Antoine's equation", "K"),
        ),
    }

    @classmethod
    def read(cls, read):
        """Antoine coefficients for Pa and K, from those of the case's units."""
        table = read.table
        try:
            scale = conversion(table.unit, "Pa").scale
        except UnitError as error:
            raise read.section.error("unit", table.unit, str(error)) from None
        a, b, c = table.antoine
        if b <= 0:
            message = (
                "its second number, B, must be above 0: vapour pressure rises with temperature"
            )
            raise read.section.error("antoine", table.antoine, message)
        zero = ZERO_CELSIUS if table.scale == "degC" else 0
        numbers, name = np.array([a + np.log10(scale), b, c - zero]), f"{read.name}.antoine"
        units = {} if scale == 1 and zero == 0 else {"unit": "Pa", "scale": "K"}
        antoine = case_input(
            name, numbers, ("A", "B", "C"), "1, K, K", meaning="constant of Antoine's equation",
            positions=with_units(read.section, "antoine", 3, units),
        )  # fmt: skip
        return cls(antoine=antoine, **values(cls, read))


@dataclass(frozen=True, eq=False)
class TrayDryer(Timed):
    """Dryer on a heated shelf under vacuum, its cake ideally mixed.

    `critical`: the moisture of the crystals below which the surface is no longer wet.
    """

    duration: CaseInput = TIME("drying time", example="3 h")
    temperature: Profile = ABSOLUTE.profile("temperature of the shelf")
    pressure: Profile = PRESSURE.profile("pressure above the cake")
    area: CaseInput = AREA("area of the shelf")
    heat_transfer: CaseInput = HEAT_TRANSFER("heat transfer from shelf to cake")
    mass_transfer: CaseInput = UnitQuantity("kg/m2/s/Pa", POSITIVE, example="7e-10 kg/m^2/s/Pa")(
        "mass transfer from the crystals' surface"
    )
    critical: CaseInput = UnitQuantity(range=POSITIVE, example="0.03 kg/kg")(
        "moisture below which the rate falls"
    )
    heat_capacity: CaseInput = HEAT_CAPACITY("heat capacity of the crystals")
    liquid: Liquid = inner("liquid in the cake", Liquid)

    type = "dryer"
    more_keys: ClassVar = {
        "kind": (Literal["tray"], doc("model of the dryer", allowed='"falling-rate" or "tray"'))
    }
    variant = "tray"
    title = "tray dryer"
    reacts = False
    symbols = (
        ("X", "solvent per crystals"),
        ("ρₛ", "density of crystals"),
        ("d₃₂", "mean size by surface"),
        ("p", "pressure above the cake"),
        ("U", "heat transfer"),
        ("A", "area"),
        ("λ", "latent heat"),
    )
    assumptions = ()

    @property
    def inlets(self):
        return (Inlet("cake", "needed"),)

    @property
    def outlets(self):
        return ("product", "vapour")

    @property
    def error_controlled(self):
        return True

    @property
    def steps_transfer(self):
        return True

    def sizes(self, inlets):
        return (inlets[0], NO_CRYSTALS)

    def measures(self, species):
        return {"solvent": "1", "temperature": "K"}

    def states(self, species):
        """ "solvent" is kg per kg of crystals, and "rate" its loss."""
        table = {"solvent": "1", "temperature": "K", "rate": "1/s"}
        return table | {"shelf": "K", "pressure": "Pa"}

    def equations(self):
        return [
            "X' = −w, w = k a max(f p_v(T) − p, 0), a = 6/(ρₛ d₃₂)",
            "f = r (1 + r⁸)^(−1/8), r = X/X_c: 1 where wet, X/X_c below critical moisture",
            "(cₛ + X c_l) m T' = U A (T_shelf − T) − m w λ; log₁₀ p_v = A − B/(C + T)",
        ]

    def dynamics(self, network, inlets, inputs):
        """y: X in kg per kg of crystals; then, per heat capacity of the crystals and so in K, the
        heat in the cake, from the shelf and into the vapour."""
        cake = inlets[0]
        crystals = cake.crystals()
        liquid, critical = self.liquid, use(inputs, self.critical)
        solid_heat, latent = use(inputs, self.heat_capacity), use(inputs, liquid.latent_heat)
        liquid_heat = use(inputs, liquid.heat_capacity)
        surface = 6 / (cake.density * mean_sizes(cake.moments)["d32"])
        exchange = (
            use(inputs, self.area) * use(inputs, self.heat_transfer) / (crystals * solid_heat)
        )
        transfer = use(inputs, self.mass_transfer) * surface
        first = (cake.solvent + cake.antisolvent) / crystals
        duration, species = use(inputs, self.duration), len(cake.species)

        def temperature(y):
            return y[1] / (1 + y[0] * liquid_heat / solid_heat)

        def speed(y, pressure):
            pull = wetness(y[0] / critical) * vapour_pressure(liquid, inputs, temperature(y))
            return transfer * evaporating(pull - pressure, pressure)

        def rate(y, drive):
            shelf, pressure = drive
            warm, left = temperature(y), speed(y, pressure)
            values = exchange * (shelf - warm)
            taken = left * (latent + liquid_heat * warm) / solid_heat
            return jnp.stack([-left, values - taken, values, taken])

        def states(y, shelf, pressure):
            table = {"solvent": y[0], "temperature": temperature(y), "rate": speed(y, pressure)}
            return table | {"shelf": jnp.asarray(shelf), "pressure": jnp.asarray(pressure)}

        def finish(y, *_):
            share, end = y[0] / first, temperature(y)
            product = cake.replace(
                solvent=cake.solvent * share, antisolvent=cake.antisolvent * share, temperature=end
            )
            gone = cake.solvent * (1 - share), cake.antisolvent * (1 - share)
            vapour = clear(jnp.zeros_like(cake.species), gone[0], jnp.zeros(()), end)
            held = crystals * solid_heat
            out = held * y[3] + crystals * (solid_heat + y[0] * liquid_heat) * end
            energy = held * (start[1] + y[2]), out, jnp.zeros(())
            measures = {"solvent": y[0], "temperature": end}
            book = ledger(species, energy=energy)
            return LedgerFinish((product, vapour.replace(antisolvent=gone[1])), measures, book)

        begin = cake.temperature * (1 + first * liquid_heat / solid_heat)
        start = jnp.stack([first, begin, jnp.zeros(()), jnp.zeros(())])
        controls = tuple(
            (item, use(inputs, item.value)) for item in (self.temperature, self.pressure)
        )

        def drive(shelf, pressure):
            return jnp.stack([shelf, pressure], -1)

        return Dynamics(start, rate, drive, controls, duration, None, states, finish, True)


def vapour_pressure(liquid: Liquid, inputs: dict[str, Any], temperature) -> Array:
    """Pa by Antoine's equation, 10^(A - B / (C + T)), T in K."""
    a, b, c = use(inputs, liquid.antoine)
    return jnp.exp(jnp.log(10.0) * (a - b / (c + temperature)))


def wetness(ratio) -> Array:
    """The factor f at `ratio` = X / X_c: 1 if the surface is wet, otherwise the ratio."""
    return ratio * (1 + ratio**SHARPNESS) ** (-1 / SHARPNESS)


def evaporating(excess, pressure) -> Array:
    """The positive part of f p_v - p, rounded over a small share of p; exact in vacuum."""
    # The constant keeps the square root's derivative finite where both are zero.
    return (excess + jnp.sqrt(excess**2 + (2 * ROUNDING * pressure) ** 2 + 1e-30)) / 2
