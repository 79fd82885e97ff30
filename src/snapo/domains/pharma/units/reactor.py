"""Reactors: tanks with the case's reactions, one or several in series, filled at once or fed over
time.

Batch and semi-batch: the extents of reaction x (kmol per m3 of the first charge) are integrated,
and amounts follow, n = n_0 + nu^T x V_0 + dosed; so the balance of every species closes by
construction. Stirred and plug-flow: c_t = nu^T r - q/V c_z at points along a tube (`length`), of
which a stirred tank has one, and the amounts that left the last point. With a jacket the heat at a
point is a further state.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.table import doc
from snapo.problem.record.arrays import Array, jnp

from ..flowsheet.network import FlowNetwork, fastest_rate, rate_constants, rates
from ..flowsheet.stream import NO_CRYSTALS, LedgerFinish, Stream, clear, ledger
from ..given import use
from ..read.declared import ABSOLUTE, FLOW, TIME, VOLUME, TableRecord, UnitQuantity, inner, key
from ..read.numbers import NOT_NEGATIVE, POSITIVE
from ..read.reader import whole
from ..time.dynamics import Dynamics
from ..time.profile import Profile, flow_of, mean_value
from .operation import Inlet, Timed
from .reactors.length import ELEMENTS, POINTS, Along


@dataclass(frozen=True, eq=False)
class Jacket(TableRecord):
    """Heat balance: rho cp V dT/dt = -sum(H_i r_i) V - UA (T - T_jacket) + inflow's sensible heat.

    `conductance`: UA, for a plug-flow reactor over its whole length.
    """

    heat_capacity: CaseInput = UnitQuantity("J/m3/K", POSITIVE, example="1.9e6 J/m^3/K")(
        "heat capacity of the mixture"
    )
    conductance: CaseInput = UnitQuantity("W/K", NOT_NEGATIVE, example="120 W/K")(
        "heat conductance to the jacket"
    )
    temperature: Profile = ABSOLUTE.profile("temperature of the jacket")

    heading = "`[units.NAME.jacket]`"


@dataclass(frozen=True, eq=False)
class Reactor(Timed):
    """Reactor of the case's network.

    - `kind`: "batch"; "semi-batch" (the stream at `dose` enters over the duration, in proportion to
      the flow `dosing`); "stirred" (continuous, `volume` m3); "plug-flow" (residence time V /
      flow; `cells` stirred tanks in series, or with None a tube without mixing along its length,
      computed in `elements`). A continuous reactor ends with its feed at the latest.
    - `filled`: the content of a continuous reactor at the start: its feed, or only the solvent.
    - Continuous kinds deliver the mixed outflow over the duration.
    - `temperature`: with a `jacket`, its first value is the initial temperature.
    """

    duration: CaseInput = TIME("reaction time")
    kind: Literal["batch", "semi-batch", "stirred", "plug-flow"] = key(
        doc("kind of the reactor", "batch")
    )
    temperature: Profile = ABSOLUTE.profile("temperature of the reactor")
    volume: CaseInput | None = VOLUME("volume of the reactor", None)
    dosing: Profile | None = FLOW.profile("flow that is dosed", None)
    jacket: Jacket | None = inner("heat balance with a jacket", Jacket, None)
    cells: int | None = key(
        whole(
            "number of stirred tanks in series that a plug-flow reactor is; by default it is a "
            "tube without mixing",
            1,
            1000,
            default=None,
        )
    )
    filled: Literal["feed", "solvent"] = key(doc("content at the start", "feed"))
    elements: int = ELEMENTS

    type = "reactor"
    variant = ""
    title = "reactor"
    reacts = True
    symbols = (
        ("c", "concentration"),
        ("r", "rates of reaction"),
        ("ν", "stoichiometry"),
        ("q", "flow"),
        ("V", "volume"),
        ("H", "heats of reaction"),
        ("U A", "conductance"),
    )
    assumptions = ()

    @classmethod
    def read(cls, read, species):
        read.only(("stirred", "plug-flow"), ("volume",), needed=True)
        read.only(("semi-batch",), ("dosing",), needed=True)
        table = read.table
        if table.kind != "plug-flow" and table.cells is not None:
            message = f'kind "{table.kind}" has no such key; it belongs to "plug-flow"'
            raise read.section.error("cells", table.cells, message)
        if table.kind not in ("stirred", "plug-flow") and "filled" in table.model_fields_set:
            message = f'kind "{table.kind}" has no such key; it belongs to "stirred" or "plug-flow"'
            raise read.section.error("filled", table.filled, message)
        return super().read(read, species)

    @property
    def inlets(self):
        if self.kind == "semi-batch":
            return Inlet("feed", "refused"), Inlet("dose", "refused", dosed=self.dosing)
        return (Inlet("feed", "refused", lasting=self.kind in ("stirred", "plug-flow")),)

    @property
    def outlets(self):
        return ("product",)

    @property
    def error_controlled(self):
        return self.jacket is not None

    @property
    def steps_transfer(self):
        """False for cells in series, because every implicit step would factorise a large matrix."""
        return self.kind != "plug-flow"

    def sizes(self, inlets):
        return (NO_CRYSTALS,)

    def lasts(self, inlets):
        continuous = self.kind in ("stirred", "plug-flow")
        return (min(float(self.duration.used()), inlets[0]) if continuous else 0.0,)

    def measures(self, species):
        return self.states(species)

    def states(self, species):
        return {f"concentration.{s}": "kmol/m3" for s in species} | {"temperature": "K"}

    def equations(self):
        flows = {
            "batch": "c' = νᵀ r",
            "semi-batch": "n' = V νᵀ r + q c_dose, V' = q",
            "stirred": "c' = νᵀ r + (c_in − c) q/V",
            "plug-flow": "c_t = νᵀ r − (q/V) c_z, z from 0 to 1 along the tube",
        }
        if self.kind == "plug-flow" and self.cells is not None:
            tanks = f"c_j' = νᵀ r + (c_(j−1) − c_j) q/V_cell, {self.cells} stirred cells in series"
            flows["plug-flow"] = tanks
        heat = "ρcₚV T' = −Σ Hᵢ rᵢ V − UA (T − T_jacket)" if self.jacket else "temperature as given"
        return [flows[self.kind], "rᵢ = kᵢ exp(−Eᵢ/(R T)) Π c^order, R = 8.314 J/mol/K", heat]

    def fastest(self, network, feeds):
        """A bound in 1/s; by mass, a species is at most as concentrated as if the whole inflow
        consisted of it."""
        if self.jacket is not None:
            return np.inf
        mass = max(network.molar_mass @ feed.concentration.used() for feed in feeds)
        result = fastest_rate(network, self.temperature.value.used(), mass / network.molar_mass)
        if self.volume is not None:
            flow = max(item.volume.used() / (item.duration or 1.0) for item in feeds)
            result += self.along().fastest * flow / self.volume.used()
        return float(result)

    def along(self) -> Along:
        """The points along the reactor."""
        if self.kind == "stirred":
            return Along.of(1, 1)
        return Along.of(self.elements, POINTS) if self.cells is None else Along.of(self.cells, 1)

    def finer(self):
        plain = self.kind == "plug-flow" and self.cells is None
        return replace(self, elements=2 * self.elements) if plain else self

    def dynamics(self, network, inlets, inputs):
        if self.kind in ("batch", "semi-batch"):
            return _filled(self, network, inlets, inputs)
        return _flown_through(self, network, inlets[0], inputs)


class _Heat(NamedTuple):
    """heat_capacity J/m3/K, conductance W/K, heats of reaction [R] in J per kmol."""

    capacity: Array
    conductance: Array
    reaction: Array


def _heat(jacket: Jacket | None, network: FlowNetwork, inputs) -> _Heat | None:
    if jacket is None:
        return None
    reaction = use(inputs, network.heat) * 1000  # J/mol to J/kmol
    return _Heat(use(inputs, jacket.heat_capacity), use(inputs, jacket.conductance), reaction)


def _controls(unit: Reactor, inputs):
    """Temperature, of the jacket if there is one."""
    profile = unit.jacket.temperature if unit.jacket else unit.temperature
    return ((profile, use(inputs, profile.value)),)


def extended(network: FlowNetwork, base, extents) -> list[Array]:
    """[S] base + nu^T extents, species by species."""
    totals = []
    for s in range(len(network.species)):
        total = base[..., s]
        for i, factor in enumerate(network.stoichiometry[:, s]):
            if factor:
                total = total + float(factor) * extents[i]
        totals.append(total)
    return totals


def _drive(network: FlowNetwork, inputs, jacketed: bool):
    """The inputs of the time loop: rate constants, or the jacket's temperature; then dosing."""

    def drive(temperature, *dosing):
        first = temperature[..., None] if jacketed else rate_constants(network, inputs, temperature)
        return jnp.concatenate([first, *(item[..., None] for item in dosing)], -1)

    return drive


def _filled(unit: Reactor, network: FlowNetwork, inlets, inputs) -> Dynamics:
    """Batch and semi-batch. y: extents [R] and the dosed volume per initial volume; with a jacket
    also the heat content (K) and the heat from the jacket (K), both per initial volume and heat
    capacity."""
    feed, dose = inlets[0], inlets[1] if len(inlets) > 1 else None
    count, heat = len(network.reactions), _heat(unit.jacket, network, inputs)
    duration, controls = use(inputs, unit.duration), _controls(unit, inputs)
    charge, volume = feed.concentration(), feed.volume
    dosed, to_dose = dose is not None, None
    if dose is not None and unit.dosing is not None:
        controls = (*controls, flow_of(unit.dosing, inputs, duration, dose.volume))
        to_dose = lambda y: dose.volume - volume * y[count]  # noqa: E731
    more = dose.concentration() if dose is not None else jnp.zeros_like(charge)
    first = use(inputs, unit.temperature.value)[0]

    def composition(y):
        """kmol/m3 of each species, and the volume per initial volume."""
        if not dosed:
            return extended(network, charge, y), 1.0
        size = 1 + y[count]
        amounts = extended(network, charge + more * y[count], y)
        return [amount / size for amount in amounts], size

    def temperature(y, size, control):
        return control if heat is None else y[-2] / size

    def rate(y, drive):
        c, size = composition(y)
        if heat is None:
            constants = drive[:count]
        else:
            constants = rate_constants(network, inputs, temperature(y, size, None))
        speed = [item * size for item in rates(network, constants, c)]
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
        table = {f"concentration.{s}": entry for s, entry in zip(network.species, c)}
        return table | {"temperature": jnp.asarray(temperature(y, size, control))}

    def finish(y, control, *_):
        c, size = composition(y)
        end = jnp.asarray(temperature(y, size, control))
        made = jnp.stack(extended(network, jnp.zeros_like(charge), y)) * volume
        solvent, left, solvent_left = feed.solvent, jnp.zeros_like(charge), jnp.zeros(())
        if dose is not None:
            share = y[count] * volume / dose.volume
            solvent, solvent_left = solvent + share * dose.solvent, (1 - share) * dose.solvent
            left = (1 - share) * dose.species
        product = clear(jnp.stack(c) * size * volume, solvent, volume * size, end)
        product = product.replace(antisolvent=feed.antisolvent)
        book = ledger(len(charge), made=made, left=left, solvent_left=solvent_left)
        if heat is not None:
            sensible = heat.capacity * volume
            brought = y[count] * dose.temperature if dose is not None else 0.0
            released = -sum(h * x for h, x in zip(heat.reaction, y)) * volume
            into = sensible * (first + brought + y[-1]) + released
            book = book._replace(energy=(into, sensible * size * end, jnp.zeros(())))
        return LedgerFinish((product,), states(y, control), book)

    start = jnp.zeros(count + dosed)
    if heat is not None:
        start = jnp.append(start, jnp.stack([first, jnp.zeros_like(first)]))
    drive = _drive(network, inputs, heat is not None)
    return Dynamics(start, rate, drive, controls, duration, None, states, finish, True, to_dose)


def _flown_through(unit: Reactor, network: FlowNetwork, feed: Stream, inputs) -> Dynamics:
    """Stirred and plug-flow, N points. y: [N S] concentrations, [S] left per volume of all, [R]
    extents over the volume, then with a jacket [N] temperatures, heat left and heat from the jacket
    (both K)."""
    assert unit.volume is not None
    along = unit.along()
    points = len(along.positions)
    species, count = len(network.species), len(network.reactions)
    heat, duration = _heat(unit.jacket, network, inputs), use(inputs, unit.duration)
    # At the feed's end itself the derivative is that of a shorter run.
    duration = jnp.where(duration > feed.duration, feed.duration, duration)
    volume, flow = use(inputs, unit.volume), feed.volume / feed.duration
    entering, first = feed.concentration(), use(inputs, unit.temperature.value)[0]
    inside = entering if unit.filled == "feed" else jnp.zeros(species)
    turnover, size = flow / volume, points * species
    endpoints = [size, size + species, size + species + count, size + species + count + points]

    def rate(y, drive):
        c = y[:size].reshape(points, species)
        warm = y[endpoints[2] : endpoints[3]]
        constants = drive if heat is None else rate_constants(network, inputs, warm)
        speed = rates(network, constants, [c[:, s] for s in range(species)])
        made = jnp.stack(extended(network, jnp.zeros((points, species)), speed), -1)
        slope = (made + turnover * along.carried(c, entering)).ravel()
        extent = jnp.stack([along.mean(item) for item in speed])
        parts = [slope, turnover * c[-1], extent]
        if heat is not None:
            ua = heat.conductance / (heat.capacity * volume)
            from_jacket = ua * (drive[0] - warm)
            released = -sum(h * r for h, r in zip(heat.reaction, speed)) / heat.capacity
            carried = along.carried(warm[:, None], feed.temperature[None])[:, 0]
            change = released + from_jacket + turnover * carried
            parts += [change, turnover * warm[-1:], along.mean(from_jacket)[None]]
        return jnp.concatenate(parts)

    def states(y, control, *_):
        table = {f"concentration.{s}": y[size - species + i] for i, s in enumerate(network.species)}
        return table | {"temperature": y[endpoints[3] - 1] if heat is not None else control}

    def finish(y, control, *_):
        ran = flow * duration
        out = y[size : endpoints[1]] * volume
        extent = list(y[endpoints[1] : endpoints[2]] * volume)
        made = jnp.stack(extended(network, jnp.zeros(species), extent))
        held = (along.mean(y[:size].reshape(points, species)) - inside) * volume
        waiting = 1 - ran / feed.volume
        mean = mean_value(unit.temperature, use(inputs, unit.temperature.value))
        if heat is not None:
            mean = y[endpoints[3]] / (turnover * duration)
        leaving = feed.solvent * ran / feed.volume
        product = clear(out, leaving, ran, mean, duration)
        waits = {"left": waiting * feed.species, "solvent_left": waiting * feed.solvent}
        book = ledger(species, made=made, held=held, **waits)
        if heat is not None:
            sensible = heat.capacity * volume
            released = -sum(h * x for h, x in zip(heat.reaction, extent))
            into = sensible * (turnover * duration * feed.temperature + y[-1]) + released
            selected = sensible * (along.mean(y[endpoints[2] : endpoints[3]]) - first)
            book = book._replace(energy=(into, sensible * y[endpoints[3]], selected))
        return LedgerFinish((product,), states(y, control), book)

    start = [jnp.tile(inside, points), jnp.zeros(species + count)]
    if heat is not None:
        start += [jnp.full(points, first), jnp.zeros(2)]
    drive = _drive(network, inputs, heat is not None)
    controls = _controls(unit, inputs)
    start = jnp.concatenate(start)
    return Dynamics(start, rate, drive, controls, duration, None, states, finish, True)
