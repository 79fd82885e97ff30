"""Drying of a cake on a heated shelf under vacuum: one moisture and one temperature.

Per kg of crystals, X kg/kg of liquid leaves at w = k a max(f p_v(T) - p, 0), where a = 6 / (rho
d32) is the crystals' surface in m2/kg, p_v the liquid's vapour pressure and p the pressure above
the cake. Wet, f = 1: the rate is constant once the cake has warmed to where the shelf's heat, U A
(T_shelf - T), is what evaporation takes. Below the critical moisture X_c the surface dries out
and f = X / X_c; in between f = r (1 + r^8)^(-1/8), r = X / X_c, which is within 0.1 % of either
branch outside 0.6 < r < 1.7. What is left in the end is X_c p / p_v, in equilibrium.

Heat: (cp_s + X cp_l) m T' = U A (T_shelf - T) - m w lambda. It is integrated as what the cake
holds, what the shelf gave and what the vapour took, so that energy closes to rounding.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from .dynamics import Dynamics, Finish, ledger
from .inputs import use
from .population import mean_sizes
from .records_units import Liquid, TrayDryer
from .stream import Stream, clear

SHARPNESS = 8  # of the passage from constant to falling rate
ROUNDING = 1e-4  # of where evaporation begins, as a share of the pressure above the cake


def vapour_pressure(liquid: Liquid, inputs: dict[str, Any], temperature) -> Array:
    """Pa by Antoine's equation, 10^(A - B / (C + T)), T in K."""
    a, b, c = use(inputs, liquid.antoine)
    return jnp.exp(jnp.log(10.0) * (a - b / (c + temperature)))


def wetness(ratio) -> Array:
    """f at `ratio` = X / X_c: 1 where the surface is wet, and the ratio where it is not."""
    return ratio * (1 + ratio**SHARPNESS) ** (-1 / SHARPNESS)


def evaporating(excess, pressure) -> Array:
    """The positive part of f p_v - p, rounded over a small share of p; exact in vacuum."""
    # The constant keeps the square root's derivative finite where both are zero.
    return (excess + jnp.sqrt(excess**2 + (2 * ROUNDING * pressure) ** 2 + 1e-30)) / 2


def tray(unit: TrayDryer, cake: Stream, inputs: dict[str, Any]) -> Dynamics:
    """The dryer as an initial value problem. y: X in kg per kg of crystals; then, per crystals'
    heat capacity and so in K, the heat the cake holds, what the shelf gave and the vapour took."""
    crystals = cake.density * cake.shape * cake.moments[3]
    liquid, critical = unit.liquid, use(inputs, unit.critical)
    solid_heat, latent = use(inputs, unit.heat_capacity), use(inputs, liquid.latent_heat)
    liquid_heat = use(inputs, liquid.heat_capacity)
    surface = 6 / (cake.density * mean_sizes(cake.moments)["d32"])
    exchange = use(inputs, unit.area) * use(inputs, unit.heat_transfer) / (crystals * solid_heat)
    transfer = use(inputs, unit.mass_transfer) * surface
    first = (cake.solvent + cake.antisolvent) / crystals
    duration, species = use(inputs, unit.duration), len(cake.species)

    def temperature(y):
        return y[1] / (1 + y[0] * liquid_heat / solid_heat)

    def speed(y, pressure):
        pull = wetness(y[0] / critical) * vapour_pressure(liquid, inputs, temperature(y))
        return transfer * evaporating(pull - pressure, pressure)

    def rate(y, drive):
        shelf, pressure = drive
        warm, left = temperature(y), speed(y, pressure)
        given = exchange * (shelf - warm)
        taken = left * (latent + liquid_heat * warm) / solid_heat
        return jnp.stack([-left, given - taken, given, taken])

    def states(y, shelf, pressure):
        found = {"solvent": y[0], "temperature": temperature(y), "rate": speed(y, pressure)}
        return found | {"shelf": jnp.asarray(shelf), "pressure": jnp.asarray(pressure)}

    def finish(y, *_):
        share, end = y[0] / first, temperature(y)
        product = cake._replace(
            solvent=cake.solvent * share, antisolvent=cake.antisolvent * share, temperature=end
        )
        gone = cake.solvent * (1 - share), cake.antisolvent * (1 - share)
        vapour = clear(jnp.zeros_like(cake.species), gone[0], jnp.zeros(()), end)
        held = crystals * solid_heat
        out = held * y[3] + crystals * (solid_heat + y[0] * liquid_heat) * end
        energy = held * (start[1] + y[2]), out, jnp.zeros(())
        measures = {"solvent": y[0], "temperature": end}
        book = ledger(species, energy=energy)
        return Finish((product, vapour._replace(antisolvent=gone[1])), measures, book)

    begin = cake.temperature * (1 + first * liquid_heat / solid_heat)
    start = jnp.stack([first, begin, jnp.zeros(()), jnp.zeros(())])
    controls = tuple((each, use(inputs, each.value)) for each in (unit.temperature, unit.pressure))

    def drive(shelf, pressure):
        return jnp.stack([shelf, pressure], -1)

    return Dynamics(start, rate, drive, controls, duration, None, states, finish, True)
