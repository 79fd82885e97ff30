"""Batch crystalliser by moments: cooling, anti-solvent, seed and nuclei.

mu_0' = B, mu_k' = k G mu_(k-1) + B L0^k, per m3 of slurry. Dissolved solute follows from the
crystals, c = c_0 + rho kv (mu3_0 - mu3), so that mass closes by construction; with dosing all
of it in amounts per m3 of the first charge.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .dynamics import Dynamics, Finish, ledger
from .event import saturation_share
from .inputs import fixed, use
from .kinetics import absent, kinetics
from .records import Network
from .records_units import Crystalliser, Seed
from .solubility import antisolvent_factor, solubility
from .stream import MOMENTS, Stream

# Moments are integrated in units of NUMBER crystals per m3 of size SIZE, which are of order one.
SIZE, NUMBER = 1e-4, 1e10
UNITS = NUMBER * SIZE ** np.arange(MOMENTS)


def seed_moments(seed: Seed, inputs: dict[str, Any], shape, density) -> Float[Array, " 6"]:
    """m^k/m3 of the seed: as given, or of `loading` kg/m3 crystals of one size."""
    if seed.moments is not None:
        return use(inputs, seed.moments)
    assert seed.loading is not None and seed.size is not None
    size = use(inputs, seed.size)
    number = use(inputs, seed.loading) / (density * shape * size**3)
    return number * jnp.stack([size**k for k in range(MOMENTS)])


def mean_sizes(moments: Float[Array, "... 6"]) -> dict[str, Array]:
    """d32 = mu3 / mu2 and d43 = mu4 / mu3 in m; 0 without crystals."""
    found = {}
    for name, upper in (("d32", 3), ("d43", 4)):
        above, below = moments[..., upper], moments[..., upper - 1]
        present = below > 0
        found[name] = jnp.where(present, above / jnp.where(present, below, 1.0), 0.0)
    return found


def crystalliser(
    unit: Crystalliser, network: Network, inlets: tuple[Stream, ...], inputs: dict[str, Any]
) -> Dynamics:
    """The crystalliser as an initial value problem. y: scaled moments [6] of all crystals (with
    `separate` [6] of the seed, then [6] of the nuclei), then the volume dosed per first volume."""
    feed, dose = inlets[0], inlets[1] if len(inlets) > 1 else None
    solute, mass = network.species.index(unit.solute), network.molar_mass
    shape, density = use(inputs, unit.shape), use(inputs, unit.density)
    duration, dosed = use(inputs, unit.duration), dose is not None
    volume, temperature = feed.volume, use(inputs, unit.temperature.value)
    charge = feed.concentration()
    if unit.initial_concentration is not None:
        replaced = use(inputs, unit.initial_concentration) / mass[solute]
        charge = charge.at[solute].set(replaced)
    seed = seed_moments(unit.seed, inputs, shape, density)
    first = seed + feed.moments / volume
    weight = density * shape  # kg/m3 of slurry per m3/m3 of mu3
    dissolved = charge[solute] * mass[solute]
    dosed_solute = dose.concentration()[solute] * mass[solute] if dose is not None else 0.0
    nuclei_size = None if absent(inputs, unit.nuclei_size) else use(inputs, unit.nuclei_size)
    units = fixed(UNITS)
    controls = [(unit.temperature, temperature)]
    if unit.dosing is not None:
        controls.append((unit.dosing, use(inputs, unit.dosing.value)))

    def scaled(y) -> tuple[Array, Array]:
        """Scaled moments of all crystals per first volume, and the volume per first volume."""
        moments = y[:MOMENTS] + y[MOMENTS : 2 * MOMENTS] if unit.separate else y[:MOMENTS]
        return moments, 1 + y[-1] if dosed else jnp.ones(())

    def liquid(y):
        """Solute in kg/m3, solubility's factor by anti-solvent, mu3 per first volume."""
        moments, size = scaled(y)
        mu3 = moments[3] * units[3]
        solute_amount = dissolved + weight * (first[3] - mu3)
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
        growth = speed.growth / SIZE
        born = speed.nucleation * size / NUMBER

        def grow(moments, source):
            slope = [jnp.zeros(()) if source is None else source]
            for k in range(1, MOMENTS):
                change = k * growth * moments[k - 1]
                if source is not None and nuclei_size is not None:
                    change = change + source * (nuclei_size / SIZE) ** k
                slope.append(change)
            return slope

        slope = grow(y[:MOMENTS], None if unit.separate else born)
        if unit.separate:
            slope += grow(y[MOMENTS : 2 * MOMENTS], born)
        return jnp.stack(slope + ([drive[1] / volume] if dosed else []))

    def drive(control, *dosing):
        saturated = solubility(unit.solubility, inputs, control)
        return jnp.stack([saturated, *dosing], -1)

    def states(y, control, *_):
        moments, size = scaled(y)
        moments = moments * units / size
        saturated = solubility(unit.solubility, inputs, control)
        found = {f"mu{k}": moments[k] for k in range(MOMENTS)} | mean_sizes(moments)
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
        if unit.separate:
            measures["seed_volume"] = shape * y[3] * units[3] / size
            measures["nuclei_volume"] = shape * y[MOMENTS + 3] * units[3] / size
        kmol = volume / mass[solute]
        nothing = jnp.zeros_like(charge)
        seeded = nothing.at[solute].set(weight * seed[3] * kmol)
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

    start = first / units
    if unit.separate:
        start = jnp.concatenate([start, jnp.zeros(MOMENTS)])
    if dosed:
        start = jnp.append(start, 0.0)
    event = saturation_share(excess, unit.temperature, temperature)
    return Dynamics(start, rate, drive, tuple(controls), duration, event, states, finish, False)
