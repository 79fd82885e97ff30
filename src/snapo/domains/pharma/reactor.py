"""Reactors: tanks of the case's network, one or many in series, fed at the start or all the time.

Batch and semi-batch: the extents of reaction x (kmol per m3 of the first charge) are what is
integrated, and amounts follow, n = n_0 + nu^T x V_0 + dosed; so species balance by construction.
Stirred and plug-flow: cells of equal volume with c_j' = nu^T r + (c_(j-1) - c_j) q / V_cell, and
what left the last one. With a jacket the heat of a cell is a state beside.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from .dynamics import Dynamics, Finish, ledger
from .inputs import use
from .network import rate_constants, rates
from .profile import mean_value
from .records import Network
from .records_units import Jacket, Reactor
from .stream import Stream, clear


class _Heat(NamedTuple):
    """heat_capacity J/m3/K, conductance W/K, heats of reaction [R] in J per kmol."""

    capacity: Array
    conductance: Array
    reaction: Array


def reactor(
    unit: Reactor, network: Network, inlets: tuple[Stream, ...], inputs: dict[str, Any]
) -> Dynamics:
    """The reactor with what flows into it, as an initial value problem."""
    if unit.kind in ("batch", "semi-batch"):
        return _filled(unit, network, inlets, inputs)
    return _flown_through(unit, network, inlets[0], inputs)


def _heat(jacket: Jacket | None, network: Network, inputs) -> _Heat | None:
    if jacket is None:
        return None
    reaction = use(inputs, network.heat) * 1000  # J/mol to J/kmol
    return _Heat(use(inputs, jacket.heat_capacity), use(inputs, jacket.conductance), reaction)


def _controls(unit: Reactor, inputs):
    """Temperature (of the jacket, where there is one), then dosing."""
    profile = unit.jacket.temperature if unit.jacket else unit.temperature
    found = [(profile, use(inputs, profile.value))]
    if unit.dosing is not None:
        found.append((unit.dosing, use(inputs, unit.dosing.value)))
    return tuple(found)


def _mixed(network: Network, base, extents) -> list[Array]:
    """[S] base + nu^T extents, species by species."""
    found = []
    for s in range(len(network.species)):
        total = base[..., s]
        for i, factor in enumerate(network.stoichiometry[:, s]):
            if factor:
                total = total + float(factor) * extents[i]
        found.append(total)
    return found


def _drive(network: Network, inputs, jacketed: bool):
    """What the time loop reads: rate constants, or the jacket's temperature; then dosing."""

    def drive(temperature, *dosing):
        first = temperature[..., None] if jacketed else rate_constants(network, inputs, temperature)
        return jnp.concatenate([first, *(each[..., None] for each in dosing)], -1)

    return drive


def _filled(unit: Reactor, network: Network, inlets, inputs) -> Dynamics:
    """Batch and semi-batch. y: extents [R], volume dosed per first volume, then with a jacket
    heat held per first volume and heat capacity (K), and heat from the jacket (K)."""
    feed, dose = inlets[0], inlets[1] if len(inlets) > 1 else None
    count, heat = len(network.reactions), _heat(unit.jacket, network, inputs)
    controls = _controls(unit, inputs)
    charge, volume = feed.concentration(), feed.volume
    dosed = dose is not None
    more = dose.concentration() if dose is not None else jnp.zeros_like(charge)
    first = use(inputs, unit.temperature.value)[0]

    def composition(y):
        """kmol/m3 of each species, and the volume per first volume."""
        if not dosed:
            return _mixed(network, charge, y), 1.0
        size = 1 + y[count]
        amounts = _mixed(network, charge + more * y[count], y)
        return [each / size for each in amounts], size

    def temperature(y, size, control):
        return control if heat is None else y[-2] / size

    def rate(y, drive):
        c, size = composition(y)
        if heat is None:
            constants = drive[:count]
        else:
            constants = rate_constants(network, inputs, temperature(y, size, None))
        speed = [each * size for each in rates(network, constants, c)]
        slope = speed + ([drive[-1] / volume] if dosed else [])
        if heat is not None:
            ua = heat.conductance / (heat.capacity * volume)
            from_jacket = ua * (drive[0] - temperature(y, size, None))
            made = -sum(h * r for h, r in zip(heat.reaction, speed)) / heat.capacity
            carried = drive[-1] / volume * dose.temperature if dose is not None else 0.0
            slope += [made + from_jacket + carried, from_jacket]
        return jnp.stack(slope)

    def states(y, control, *_):
        c, size = composition(y)
        found = {f"concentration.{s}": each for s, each in zip(network.species, c)}
        return found | {"temperature": jnp.asarray(temperature(y, size, control))}

    def finish(y, control, *_):
        c, size = composition(y)
        end = jnp.asarray(temperature(y, size, control))
        made = jnp.stack(_mixed(network, jnp.zeros_like(charge), y)) * volume
        solvent, held, left = feed.solvent, jnp.zeros_like(charge), jnp.zeros(())
        if dose is not None:
            share = y[count] * volume / dose.volume
            solvent, left = solvent + share * dose.solvent, (1 - share) * dose.solvent
            held = (1 - share) * dose.species
        product = clear(jnp.stack(c) * size * volume, solvent, volume * size, end)
        product = product._replace(antisolvent=feed.antisolvent)
        book = ledger(len(charge), made=made, held=held, solvent_held=left)
        if heat is not None:
            sensible = heat.capacity * volume
            brought = y[count] * dose.temperature if dose is not None else 0.0
            released = -sum(h * x for h, x in zip(heat.reaction, y)) * volume
            into = sensible * (first + brought + y[-1]) + released
            book = book._replace(energy=(into, sensible * size * end, jnp.zeros(())))
        return Finish((product,), states(y, control), book)

    start = jnp.zeros(count + dosed)
    if heat is not None:
        start = jnp.append(start, jnp.stack([first, jnp.zeros_like(first)]))
    drive = _drive(network, inputs, heat is not None)
    duration = use(inputs, unit.duration)
    return Dynamics(start, rate, drive, controls, duration, None, states, finish, True)


def _flown_through(unit: Reactor, network: Network, feed: Stream, inputs) -> Dynamics:
    """Stirred and plug-flow, N cells. y: [N S] concentrations, [S] left per volume of all cells,
    [R] extents over the volume, then with a jacket [N] temperatures, heat left and heat from the
    jacket (both K)."""
    assert unit.volume is not None
    cells = unit.cells if unit.kind == "plug-flow" else 1
    species, count = len(network.species), len(network.reactions)
    heat, duration = _heat(unit.jacket, network, inputs), use(inputs, unit.duration)
    volume, flow = use(inputs, unit.volume), feed.volume / feed.duration
    entering, first = feed.concentration(), use(inputs, unit.temperature.value)[0]
    inside = entering if unit.filled == "feed" else jnp.zeros(species)
    turnover, size = flow / volume, cells * species
    ends = [size, size + species, size + species + count, size + species + count + cells]

    def rate(y, drive):
        c = y[:size].reshape(cells, species)
        warm = y[ends[2] : ends[3]]
        constants = drive if heat is None else rate_constants(network, inputs, warm)
        speed = rates(network, constants, [c[:, s] for s in range(species)])
        before = jnp.concatenate([entering[None], c[:-1]])
        made = jnp.stack(_mixed(network, jnp.zeros((cells, species)), speed), -1)
        slope = (made + (before - c) * (turnover * cells)).ravel()
        extent = jnp.stack([jnp.mean(each) for each in speed])
        parts = [slope, turnover * c[-1], extent]
        if heat is not None:
            ua = heat.conductance / (heat.capacity * volume)
            from_jacket = ua * (drive[0] - warm)
            released = -sum(h * r for h, r in zip(heat.reaction, speed)) / heat.capacity
            ahead = jnp.concatenate([feed.temperature[None], warm[:-1]])
            change = released + from_jacket + (ahead - warm) * (turnover * cells)
            parts += [change, turnover * warm[-1:], jnp.mean(from_jacket)[None]]
        return jnp.concatenate(parts)

    def states(y, control, *_):
        found = {f"concentration.{s}": y[size - species + i] for i, s in enumerate(network.species)}
        return found | {"temperature": y[ends[3] - 1] if heat is not None else control}

    def finish(y, control, *_):
        ran = flow * duration
        out = y[size : ends[1]] * volume
        extent = list(y[ends[1] : ends[2]] * volume)
        made = jnp.stack(_mixed(network, jnp.zeros(species), extent))
        gained = (jnp.mean(y[:size].reshape(cells, species), 0) - inside) * volume
        waiting = 1 - ran / feed.volume
        held = gained + waiting * feed.species
        mean = mean_value(unit.temperature, use(inputs, unit.temperature.value))
        if heat is not None:
            mean = y[ends[3]] / (turnover * duration)
        leaving = feed.solvent * ran / feed.volume
        product = clear(out, leaving, ran, mean, duration)
        book = ledger(species, made=made, held=held, solvent_held=waiting * feed.solvent)
        if heat is not None:
            sensible = heat.capacity * volume
            released = -sum(h * x for h, x in zip(heat.reaction, extent))
            into = sensible * (turnover * duration * feed.temperature + y[-1]) + released
            kept = sensible * (jnp.mean(y[ends[2] : ends[3]]) - first)
            book = book._replace(energy=(into, sensible * y[ends[3]], kept))
        return Finish((product,), states(y, control), book)

    start = [jnp.tile(inside, cells), jnp.zeros(species + count)]
    if heat is not None:
        start += [jnp.full(cells, first), jnp.zeros(2)]
    drive = _drive(network, inputs, heat is not None)
    controls = _controls(unit, inputs)
    start = jnp.concatenate(start)
    return Dynamics(start, rate, drive, controls, duration, None, states, finish, True)
