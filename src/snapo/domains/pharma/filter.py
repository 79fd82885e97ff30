"""Filter and wash at constant pressure: how long it takes, and what stays in the cake.

The cake keeps a share of the liquor in its voids; of what was dissolved in it the wash leaves a
share, and wash liquid takes the place of the liquor. The filtrate is what is left of the slurry.
"""

from typing import Any

import jax.numpy as jnp
from jax.scipy.special import erfc
from jaxtyping import Array, Float

from .dynamics import Finish, ledger
from .inputs import use
from .population import mean_sizes
from .records import Network
from .records_units import Filter
from .stream import Stream, clear


def filtration(unit: Filter, network: Network, slurry: Stream, inputs: dict[str, Any]) -> Finish:
    """What the filter delivers; its ledger adds the wash liquid, which is the slurry's solvent."""
    porosity, volume = use(inputs, unit.porosity), slurry.volume
    density, mass = slurry.density, network.molar_mass
    crystals = density * slurry.shape * slurry.moments[3]
    measures = _flow(unit, slurry, crystals, porosity, inputs)
    voids = porosity / ((1 - porosity) * density)  # m3 per kg of crystals
    kept = use(inputs, unit.saturation) * voids
    stay, ratio = remaining(unit, inputs), use(inputs, unit.wash_ratio)
    liquor = slurry.species / volume * kept * crystals  # kmol held before the wash
    solvent, other = slurry.solvent / volume, slurry.antisolvent / volume
    held, wash_volume = kept * crystals, ratio * voids * crystals
    replaced = other * held * (1 - stay)
    cake = slurry._replace(
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
    )._replace(antisolvent=slurry.antisolvent - other * held)
    washings = clear(
        liquor * (1 - stay), solvent * wash_volume - replaced, wash_volume, slurry.temperature
    )._replace(antisolvent=replaced)
    measures["liquor"] = kept
    for s, name in enumerate(network.species):
        measures[f"impurity.{name}"] = mass[s] * slurry.species[s] / volume * kept * stay
    book = ledger(len(mass), solvent_added=solvent * wash_volume)
    return Finish((cake, filtrate, washings), measures, book)


def _flow(unit: Filter, slurry: Stream, crystals, porosity, inputs) -> dict[str, Array]:
    """t = mu / dP (alpha c_s / 2 (V_f / A)^2 + R_m V_f / A), and alpha."""
    if unit.resistance is not None:
        resistance = use(inputs, unit.resistance)
    else:
        d32 = mean_sizes(slurry.moments)["d32"]
        resistance = 180 * (1 - porosity) / (porosity**3 * d32**2 * slurry.density)
    solid = crystals / slurry.density
    filtrate = slurry.volume - solid - solid * porosity / (1 - porosity)
    per_area = filtrate / use(inputs, unit.area)
    cake = resistance * crystals / filtrate / 2 * per_area**2
    medium = use(inputs, unit.medium_resistance) * per_area
    time = use(inputs, unit.viscosity) / use(inputs, unit.pressure) * (cake + medium)
    return {"time": time, "resistance": resistance}


def remaining(unit: Filter, inputs: dict[str, Any]) -> Float[Array, ""]:
    """The share of a solute in the retained liquor that the wash leaves behind."""
    ratio = use(inputs, unit.wash_ratio)
    if unit.wash == "exponential":
        assert unit.efficiency is not None
        return jnp.exp(-use(inputs, unit.efficiency) * ratio)
    assert unit.peclet is not None
    return displacement(ratio, use(inputs, unit.peclet))


def displacement(ratio, peclet) -> Float[Array, ""]:
    """Lapidus and Amundson (1952): the share left at the outlet after `ratio` void volumes.

    1 - (erfc(a) + e^Pe erfc(b)) / 2, a = (1 - W) / 2 sqrt(Pe / W), b = (1 + W) / 2 sqrt(Pe / W);
    e^Pe erfc(b) is written exp(-a^2) erfcx(b), which does not overflow. 1 without wash.
    """
    washed = ratio > 0
    w = jnp.where(washed, ratio, 1.0)
    root = jnp.sqrt(peclet / w) / 2
    a, b = (1 - w) * root, (1 + w) * root
    left = 1 - (erfc(a) + jnp.exp(-a * a) * scaled_erfc(b)) / 2
    return jnp.where(washed, left, 1.0)


def scaled_erfc(x) -> Array:
    """exp(x^2) erfc(x) for x >= 0: directly below 4, by Laplace's continued fraction beyond."""
    near = jnp.minimum(x, 4.0)
    far = jnp.maximum(x, 4.0)
    fraction = far
    for k in range(30, 0, -1):
        fraction = far + k / 2 / fraction
    return jnp.where(x < 4, jnp.exp(near * near) * erfc(near), 1 / (fraction * jnp.sqrt(jnp.pi)))
