"""Batch crystalliser: cooling, anti-solvent, seed and nuclei.

Its crystals are a `Population`, by moments or by finite volumes. Dissolved solute follows from
them, c = c_0 + rho kv (mu3_0 - mu3), so that mass closes by construction; with dosing all of it
in amounts per m3 of the first charge.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from .dynamics import Dynamics, Finish, ledger
from .event import saturation_share
from .finite_volumes import by_finite_volumes
from .inputs import fixed, use
from .kinetics import kinetics
from .moments import by_moments
from .population import NUMBER, SIZE, UNITS, Population, mean_sizes, seed_moments
from .records import Network
from .records_units import Crystalliser
from .solubility import antisolvent_factor, solubility
from .stream import MOMENTS, Stream


def _population(unit: Crystalliser, feed: Stream, inputs: dict[str, Any]) -> Population:
    shape, density = use(inputs, unit.shape), use(inputs, unit.density)
    if unit.edges is not None:  # reading has made sure that the feed brings no crystals
        return by_finite_volumes(unit, inputs, shape, density)
    seed = seed_moments(unit.seed, inputs, shape, density)
    return by_moments(unit, inputs, seed, feed.moments / feed.volume)


def crystalliser(
    unit: Crystalliser, network: Network, inlets: tuple[Stream, ...], inputs: dict[str, Any]
) -> Dynamics:
    """The crystalliser as an initial value problem. y: the crystals' `Population` per first volume,
    then with dosing the volume dosed per first volume."""
    feed, dose = inlets[0], inlets[1] if len(inlets) > 1 else None
    solute, mass = network.species.index(unit.solute), network.molar_mass
    shape, density = use(inputs, unit.shape), use(inputs, unit.density)
    duration, dosed = use(inputs, unit.duration), dose is not None
    volume, temperature = feed.volume, use(inputs, unit.temperature.value)
    charge = feed.concentration()
    if unit.initial_concentration is not None:
        replaced = use(inputs, unit.initial_concentration) / mass[solute]
        charge = charge.at[solute].set(replaced)
    crystals = _population(unit, feed, inputs)
    weight = density * shape  # kg/m3 of slurry per m3/m3 of mu3
    dissolved = charge[solute] * mass[solute]
    dosed_solute = dose.concentration()[solute] * mass[solute] if dose is not None else 0.0
    units, count = fixed(UNITS), len(crystals.start)
    first = crystals.moments(crystals.start)[3]
    controls = [(unit.temperature, temperature)]
    if unit.dosing is not None:
        controls.append((unit.dosing, use(inputs, unit.dosing.value)))

    def scaled(y) -> tuple[Array, Array]:
        """Scaled moments of all crystals per first volume, and the volume per first volume."""
        return crystals.moments(y[:count]), 1 + y[-1] if dosed else jnp.ones(())

    def liquid(y):
        """Solute in kg/m3, solubility's factor by anti-solvent, mu3 per first volume."""
        moments, size = scaled(y)
        mu3 = moments[3] * units[3]
        solute_amount = dissolved + weight * units[3] * (first - moments[3])
        if dose is None:
            return solute_amount, 1.0, mu3
        other = (feed.antisolvent + y[-1] * volume * dose.solvent / dose.volume) / volume
        fraction = other / (other + feed.solvent / volume)
        factor = antisolvent_factor(unit.solubility, inputs, fraction)
        return (solute_amount + y[-1] * dosed_solute) / size, factor, mu3

    def supersaturation(y, saturated):
        c, factor, _ = liquid(y)
        return (c - saturated * factor) / (saturated * factor)

    def rate(y, drive):
        size = scaled(y)[1]
        speed = kinetics(
            unit.kinetics, inputs, supersaturation(y, drive[0]), shape * liquid(y)[2] / size
        )
        born = speed.nucleation * size / NUMBER
        slope = crystals.slope(y[:count], speed.growth / SIZE, born)
        return jnp.append(slope, drive[1] / volume) if dosed else slope

    def drive(control, *dosing):
        saturated = solubility(unit.solubility, inputs, control)
        return jnp.stack([saturated, *dosing], -1)

    def states(y, control, *_):
        moments, size = scaled(y)
        moments = moments * units / size
        saturated = solubility(unit.solubility, inputs, control)
        found = {f"mu{k}": moments[k] for k in range(MOMENTS)} | mean_sizes(moments)
        found |= crystals.states(y[:count])
        found["concentration"] = liquid(y)[0]
        return found | {"supersaturation": supersaturation(y, saturated), "temperature": control}

    def finish(y, control, *_):
        moments, size = scaled(y)
        moments, slurry = moments * units, volume * size
        c, _, mu3 = liquid(y)
        saturated = solubility(unit.solubility, inputs, control)
        measures = {
            "concentration": c,
            "crystals": weight * mu3 / size,
            "supersaturation": supersaturation(y, saturated),
        } | mean_sizes(moments)
        measures |= crystals.measures(y[:count] / size)
        kmol = volume / mass[solute]
        nothing = jnp.zeros_like(charge)
        seeded = nothing.at[solute].set(weight * crystals.seed * units[3] * kmol)
        species, left, solvent_left, antisolvent = charge * volume, nothing, jnp.zeros(()), 0.0
        if dose is not None:
            share = y[-1] * volume / dose.volume
            species = species + share * dose.species
            left, solvent_left = (1 - share) * dose.species, (1 - share) * dose.solvent
            antisolvent = share * dose.solvent
        slurry_out = Stream(
            species=species.at[solute].set(c * slurry / mass[solute]),
            solid=nothing.at[solute].set(weight * mu3 * kmol),
            seed=feed.seed + seeded,
            solvent=feed.solvent,
            antisolvent=feed.antisolvent + antisolvent,
            volume=slurry,
            temperature=control,
            duration=jnp.zeros(()),
            moments=moments * volume,
            density=density,
            shape=shape,
        )
        added = seeded + (charge - feed.concentration()) * volume
        book = ledger(len(mass), added=added, held=left, solvent_held=solvent_left)
        return Finish((slurry_out,), measures, book)

    def excess(control):
        """Solubility less concentration at the start, at any temperature."""
        c, factor, _ = liquid(start)
        return solubility(unit.solubility, inputs, control) * factor - c

    start = jnp.append(crystals.start, 0.0) if dosed else crystals.start
    event = saturation_share(excess, unit.temperature, temperature)
    return Dynamics(start, rate, drive, tuple(controls), duration, event, states, finish, False)
