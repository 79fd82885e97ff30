"""Reactor under a gas, such as hydrogen, which dissolves and reacts in the liquid.

The gas is one of the species: kL a (c* - c) of it enters a m3 of liquid each second, c* = p / He by
Henry's law. Either its concentration is a state, or it follows at every moment from the balance of
transfer and reaction. If the reaction is slow compared with kL a, the second model is wrong only at
the start.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.table import doc
from snapo.problem.record.arrays import Array, jax, jnp

from ..flowsheet.network import GAS_CONSTANT, rate_constants, rates
from ..flowsheet.stream import NO_CRYSTALS, LedgerFinish, clear, ledger
from ..given import use
from ..read.declared import ABSOLUTE, ENERGY, PRESSURE, RATE, TIME, UnitQuantity, key, species_key
from ..read.numbers import POSITIVE
from ..time.dynamics import Dynamics
from ..time.profile import Profile
from .operation import Inlet, Timed
from .reactor import extended

NEWTON = 12  # steps for the gas that reacts by an order that is neither 0 nor 1


@dataclass(frozen=True, eq=False)
class Hydrogenation(Timed):
    """Batch of liquid under a gas.

    `henry`: He = p / c* at `reference`; `enthalpy`: the enthalpy of dissolution; if it is
    negative, c* falls with temperature.
    """

    duration: CaseInput = TIME("reaction time", example="3 h")
    temperature: Profile = ABSOLUTE.profile("temperature of the reactor")
    gas: int = species_key("species of the gas", "name of the species that is the gas")
    pressure: Profile = PRESSURE.profile("partial pressure of the gas")
    transfer: CaseInput = RATE("kL a of the gas", range=POSITIVE, example="0.05 1/s")
    henry: CaseInput = UnitQuantity("Pa*m3/kmol", POSITIVE, example="3.4e7 Pa*L/mol")(
        "Henry's constant at the reference"
    )
    enthalpy: CaseInput = ENERGY(
        "enthalpy of dissolution of the gas", "0 J/mol", example="5 kJ/mol"
    )
    reference: float = ABSOLUTE.number("temperature of Henry's constant", "298.15 K")
    dissolved: Literal["dynamic", "pseudo-steady"] = key(
        doc("whether dissolved gas is a state, or in balance with its consumption", "dynamic")
    )

    type = "hydrogenation"
    variant = ""
    title = "hydrogenation"
    reacts = True
    symbols = (
        ("c", "concentration"),
        ("r", "rates of reaction"),
        ("ν", "stoichiometry"),
        ("kLa", "kLa, the transfer coefficient of the gas per volume"),
        ("p", "partial pressure of the gas"),
        ("He", "Henry's constant"),
    )
    assumptions = (
        "The gas is pure or its partial pressure is known; the liquid keeps its volume.",
    )

    @property
    def inlets(self):
        return (Inlet("feed", "refused"),)

    @property
    def outlets(self):
        return ("product",)

    @property
    def error_controlled(self):
        return True

    @property
    def steps_transfer(self):
        return True

    def sizes(self, inlets):
        return (NO_CRYSTALS,)

    def measures(self, species):
        return self.states(species)

    def states(self, species):
        """ "uptake" is kmol of gas per m3 of liquid so far, "saturation" c / c*."""
        texts = {f"concentration.{s}": "kmol/m3" for s in species}
        return texts | {"uptake": "kmol/m3", "saturation": "1", "temperature": "K"}

    def equations(self):
        balance = "c' = νᵀ r + kLa (c* − c)"
        if self.dissolved == "pseudo-steady":
            balance = "kLa (c* − c) = −Σ νᵢ rᵢ(c) of the gas at every moment"
        return [
            f"gas: {balance}; others: c' = νᵀ r",
            "c* = p/He exp(−ΔH/R (1/T − 1/T_ref)), He at T_ref",
            "rᵢ = kᵢ exp(−Eᵢ/(R T)) Π c^order, R = 8.314 J/mol/K",
        ]

    def dynamics(self, network, inlets, inputs):
        """y: extents [R] and, for the dynamic kind, the gas absorbed so far, all in kmol/m3."""
        feed, gas, count = inlets[0], self.gas, len(network.reactions)
        charge, transfer = feed.concentration(), use(inputs, self.transfer)
        dynamic = self.dissolved == "dynamic"
        henry, energy = use(inputs, self.henry), use(inputs, self.enthalpy) / GAS_CONSTANT

        def drive(temperature, pressure):
            inverse = 1 / temperature - 1 / self.reference
            maximum = pressure / henry * jnp.exp(-energy * inverse)
            constants = rate_constants(network, inputs, temperature)
            return jnp.concatenate([constants, maximum[..., None]], -1)

        def composition(y, driven) -> list[Array]:
            c = extended(network, charge, y)
            c[gas] = c[gas] + y[count] if dynamic else self._steady(network, driven, c, transfer)
            return c

        def rate(y, driven):
            c = composition(y, driven)
            slope = rates(network, driven, c)
            return jnp.stack([*slope, transfer * (driven[count] - c[gas])][: len(y)])

        def states(y, *controls):
            driven = drive(*(jnp.asarray(control) for control in controls))
            c = composition(y, driven)
            table = {f"concentration.{s}": item for s, item in zip(network.species, c)}
            taken = y[count] if dynamic else c[gas] - extended(network, charge, y)[gas]
            share = c[gas] / jnp.where(driven[count] > 0, driven[count], 1.0)
            warm = jnp.asarray(controls[0])
            return table | {"uptake": taken, "saturation": share, "temperature": warm}

        def finish(y, *controls):
            result, volume = states(y, *controls), feed.volume
            c = jnp.stack([result[f"concentration.{s}"] for s in network.species])
            product = clear(c * volume, feed.solvent, volume, result["temperature"])
            made = jnp.stack(extended(network, jnp.zeros_like(charge), y)) * volume
            added = jnp.zeros_like(charge).at[gas].set(result["uptake"] * volume)
            book = ledger(len(charge), made=made, added=added)
            return LedgerFinish((product.replace(antisolvent=feed.antisolvent),), result, book)

        both = self.temperature, self.pressure
        controls = tuple((entry, use(inputs, entry.value)) for entry in both)
        duration, start = use(inputs, self.duration), jnp.zeros(count + dynamic)
        return Dynamics(start, rate, drive, controls, duration, None, states, finish, True)

    def _steady(self, network, driven, c: list[Array], transfer) -> Array:
        """The concentration of the gas at which kL a (c* - c) equals the rate of reaction.

        Newton's method starts at c*. One step is sufficient if the orders in the gas are 0 and 1
        and the gas does not run out; if it runs out, steps that lead below 0 end at 0.
        """
        order, maximum = network.order[:, self.gas], driven[-1]
        taken = network.stoichiometry[:, self.gas]

        def gap(now):
            speed = rates(network, driven, [*c[: self.gas], now, *c[self.gas + 1 :]])
            used = sum(-float(nu) * r for nu, r in zip(taken, speed) if nu)
            return transfer * (now - maximum) + used

        spent = bool(network.runs_out[:, self.gas].any())
        result, linear = maximum, bool(np.isin(order, (0, 1)).all()) and not spent
        for _ in range(1 if linear else NEWTON):
            value, slope = jax.jvp(gap, (result,), (jnp.ones_like(result),))
            result = result - value / slope
            result = jnp.where(result > 0, result, 0.0) if spent else result
        return result
