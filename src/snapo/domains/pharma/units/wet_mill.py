"""Wet mill: crystals of a slurry break, by the population balance over their size.

Crystals of volume v break at S(v) per s into p fragments on average, whose number density over
volume is b(w | v) = (2 + z) (w / v)^z / v with z = (2 - p) / (p - 1): p = 2 is uniform binary
breakage, and the fragments of one crystal have its weight. Where S is proportional to v and
p = 2, Ziff and McGrady (Journal of Physics A 18, 3027, 1985) have the solution in closed form.

Cells stand for crystals of their mean volume, and a fragment is shared between the two cells on
both sides of it so that number and volume are both kept (Kumar and Ramkrishna, Chemical Engineering
Science 51, 1311, 1996). So mass closes to rounding on any grid; what is finer than the first cell
joins it by its volume, and number is lost there alone.
"""

from dataclasses import dataclass
from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable

from ..flowsheet.ledger import LedgerFinish, ledger
from ..given import fixed, use
from ..read.fields import number, profile, quantity
from ..read.numbers import NOT_NEGATIVE, POSITIVE, ValueRange
from ..time.dynamics import Dynamics
from ..time.profile import Profile
from .crystals.population import NUMBER, SIZE, UNITS, cell_powers, mean_sizes
from .crystals.quantiles import QUANTILES, size_measures, size_states
from .operation import Inlet, Timed

AT_LEAST_TWO = ValueRange(2.0, 100.0, False, "2 or more, and at most 100")


class WetMillTable(CaseTable):
    """`type = "wet-mill"`"""

    type: Literal["wet-mill"]
    duration: Any = quantity('"30 min"', meaning="milling time")
    speed: Any = profile(meaning="tip speed of the rotor")
    rate: Any = quantity('"1e-3 1/s"', meaning="rate of breakage at the reference size and speed")
    reference_size: Any = quantity('"100 um"', meaning="size to which the rate refers")
    reference_speed: Any = quantity('"20 m/s"', meaning="speed to which the rate refers")
    size_power: Any = number("a number, 0 or more", 3.0, "power of the size in the rate")
    speed_power: Any = number("a number, 0 or more", 2.0, "power of the speed in the rate")
    fragments: Any = number("a number, 2 or more", 2.0, "mean number of fragments")


@dataclass(frozen=True, eq=False)
class WetMill(Timed):
    """Breakage at S = rate (L / reference_size)^size_power (speed / reference_speed)^speed_power.

    `speed`: profile in m/s; `rate`: 1/s; `reference_size`: m; `reference_speed`: m/s; the powers
    and the mean number of `fragments`: "1"; each but the profile index [].
    """

    speed: Profile
    rate: CaseInput
    reference_size: CaseInput
    reference_speed: CaseInput
    size_power: CaseInput
    speed_power: CaseInput
    fragments: CaseInput

    type = "wet-mill"
    variant = ""
    title = "wet mill"
    table = WetMillTable
    reacts = False
    symbols = (
        ("L, v", "size and volume of a crystal"),
        ("n", "crystals by number"),
        ("S", "rate of breakage"),
        ("u", "tip speed"),
        ("b", "fragments of a crystal"),
    )
    assumptions = ("In a mill crystals neither grow nor dissolve, and the slurry keeps its heat.",)

    @classmethod
    def read(cls, read, species):
        return cls(
            name=read.name,
            duration=read.number("duration", "s", POSITIVE),
            speed=read.profile("speed", "m/s", NOT_NEGATIVE),
            rate=read.number("rate", "1/s", NOT_NEGATIVE),
            reference_size=read.number("reference_size", "m", POSITIVE),
            reference_speed=read.number("reference_speed", "m/s", POSITIVE),
            size_power=read.number("size_power", "1", NOT_NEGATIVE),
            speed_power=read.number("speed_power", "1", NOT_NEGATIVE),
            fragments=read.number("fragments", "1", AT_LEAST_TWO),
        )

    @property
    def inlets(self):
        return (Inlet("slurry", "counted"),)

    @property
    def outlets(self):
        return ("slurry",)

    @property
    def error_controlled(self):
        """The largest cell sets how long a step may be."""
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
        assert slurry.grid is not None  # reading has made sure that crystals are counted
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
    """[i, j] crystals that appear in cell i when one breaks in cell j; `volumes`: of the cells'
    crystals, rising. Columns add up to `fragments` but for what is finer than the first cell, and
    weighted by the volumes to the volume that broke."""
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
