"""Wet mill: crystals of a slurry break, by the population balance over their size.

Crystals of volume v break at S(v) per s into p fragments on average, whose number density over
volume is b(w | v) = (2 + z) (w / v)^z / v with z = (2 - p) / (p - 1): p = 2 is uniform binary
breakage, and the fragments of one crystal have its weight. If S is proportional to v and p = 2,
Ziff and McGrady (Journal of Physics A 18, 3027, 1985) have the solution in closed form.

Cells represent crystals of their mean volume. A fragment is shared between the two cells next to
its volume so that number and volume are both conserved (Kumar and Ramkrishna, Chemical Engineering
Science 51, 1311, 1996). So mass is conserved to rounding on any grid. Fragments below the first
cell are added to it by their volume; only there is their number lost.
"""

from dataclasses import dataclass

from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.problem.record.arrays import Array, Float, jnp

from ..flowsheet.stream import LedgerFinish, ledger
from ..given import fixed, use
from ..read.declared import LENGTH, POWER, RATE, SPEED, TIME, UnitQuantity
from ..read.numbers import POSITIVE
from ..time.dynamics import Dynamics
from ..time.profile import Profile
from .crystals.population import (
    NUMBER,
    QUANTILES,
    SIZE,
    UNITS,
    cell_powers,
    mean_sizes,
    size_measures,
    size_states,
)
from .operation import Inlet, Timed


@dataclass(frozen=True, eq=False)
class WetMill(Timed):
    """Breakage at S = `rate` (L / `reference_size`)^`size_power` (`speed` / `reference_speed`) to
    the power of `speed_power`."""

    duration: CaseInput = TIME("milling time", example="30 min")
    speed: Profile = SPEED.profile("tip speed of the rotor")
    rate: CaseInput = RATE("rate of breakage at the reference size and speed", example="1e-3 1/s")
    reference_size: CaseInput = LENGTH("size to which the rate refers", example="100 um")
    reference_speed: CaseInput = SPEED("speed to which the rate refers", range=POSITIVE)
    size_power: CaseInput = POWER("power of the size in the rate", 3.0)
    speed_power: CaseInput = POWER("power of the speed in the rate", 2.0)
    fragments: CaseInput = UnitQuantity(range=Range(2.0, 100.0))("mean number of fragments", 2.0)

    type = "wet-mill"
    variant = ""
    title = "wet mill"
    reacts = False
    symbols = (
        ("L, v", "size and volume of a crystal"),
        ("n", "crystals by number"),
        ("S", "rate of breakage"),
        ("u", "tip speed"),
        ("b", "fragments of a crystal"),
    )
    assumptions = ("In a mill crystals neither grow nor dissolve, and the slurry keeps its heat.",)

    @property
    def inlets(self):
        return (Inlet("slurry", "counted"),)

    @property
    def outlets(self):
        return ("slurry",)

    @property
    def error_controlled(self):
        """The rate of the largest cell limits the length of a step."""
        return True

    def sizes(self, inlets):
        return inlets

    def measures(self, species):
        quantiles = {"d32": "m", "d43": "m", "number": "1/m3"} | QUANTILES
        return quantiles | {"span": "1", "at_largest": "1"}

    def states(self, species):
        return {"number": "1/m3", "d43": "m", "d32": "m", "speed": "m/s"} | QUANTILES

    def equations(self):
        return [
            "n_t(v) = −S(v) n(v) + ∫_v^∞ b(v|w) S(w) n(w) dw",
            "S = S₀ (L/L₀)^a (u/u₀)^b; b(w|v) = (2 + z) (w/v)^z/v, z = (2 − p)/(p − 1)",
            "cells keep number and volume of fragments (Kumar and Ramkrishna)",
        ]

    def dynamics(self, network, inlets, inputs):
        """y: crystals in each cell, NUMBER per m3 of slurry."""
        slurry = inlets[0]
        assert slurry.grid is not None  # reading ensures that crystals are counted
        edges, volume = slurry.grid.array / SIZE, slurry.suspension()
        powers = fixed(cell_powers(edges))
        volumes = powers[3]
        change = shares(volumes, use(inputs, self.fragments)) - jnp.eye(len(volumes))
        relative = jnp.cbrt(volumes) * SIZE / use(inputs, self.reference_size)
        selection = use(inputs, self.rate) * relative ** use(inputs, self.size_power)
        speed, power = use(inputs, self.speed.value), use(inputs, self.speed_power)

        def rate(y, drive):
            return drive[0] * (change @ (selection * y))

        def drive(control):
            relative = control / use(inputs, self.reference_speed)
            running = relative > 0
            return jnp.where(running, jnp.where(running, relative, 1.0) ** power, 0.0)[..., None]

        def states(y, control):
            moments = (powers @ y) * fixed(UNITS)
            result = {"number": moments[0], "speed": jnp.asarray(control)} | mean_sizes(moments)
            return result | size_states(y * volumes, edges)

        def finish(y, control):
            moments = (powers @ y) * fixed(UNITS)
            measures = {"number": moments[0]} | mean_sizes(moments)
            measures |= size_measures(y * volumes, edges)
            milled = slurry.replace(moments=moments * volume, numbers=y * NUMBER * volume)
            return LedgerFinish((milled,), measures, ledger(len(network.species)))

        start = slurry.numbers / (volume * NUMBER)
        controls = ((self.speed, speed),)
        duration = use(inputs, self.duration)
        return Dynamics(start, rate, drive, controls, duration, None, states, finish, False)


def shares(volumes: Float[Array, " N"], fragments) -> Float[Array, "N N"]:
    """[i, j] the number of crystals that appear in cell i when one breaks in cell j; `volumes`: the
    volumes of the cells' crystals, rising. Columns add up to `fragments` except for sizes below the
    first cell; weighted by the volumes, they add up to the volume of the broken crystal."""
    power = (2 - fragments) / (fragments - 1)
    parent = volumes[None, :]
    # A fragment of relative size x: numbers below it, and volume below it over the parent's.
    inside = jnp.minimum(volumes[:, None] / parent, 1.0)
    numbers = fragments * inside ** (power + 1)
    weight = parent * inside ** (power + 2)
    gap = jnp.diff(volumes)[:, None]
    count, mass = jnp.diff(numbers, axis=0), jnp.diff(weight, axis=0)
    upper = (mass - volumes[:-1, None] * count) / gap  # to the larger of both neighbours
    lower = (volumes[1:, None] * count - mass) / gap
    none = jnp.zeros_like(parent)
    finest = weight[:1] / volumes[0]
    return jnp.concatenate([finest, upper]) + jnp.concatenate([lower, none])
