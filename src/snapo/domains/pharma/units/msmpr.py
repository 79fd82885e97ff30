"""Continuous crystalliser at steady state, mixed suspension and mixed product removal (MSMPR).

Randolph and Larson, Theory of Particulate Processes (1971): with growth G that does not depend on
size and residence time tau the crystals obey G n' = (n_in - n) / tau with n(0) = B / G. Its moments
are mu_0 = mu_0,in + B tau and mu_k = mu_k,in + k G tau mu_(k-1); for a clear feed, n = n0 exp(-L /
(G tau)), so that mu_k = k! n0 (G tau)^(k + 1). Growth is G = growth S^growth_order, nucleation B =
nucleation (G / G_r)^i (M_T / M_r)^j at a reference, the suspension holds M_T = rho kv mu_3, and a
mass balance closes it: one equation for S = (c - c*) / c*. With c per volume of suspension that is
M_T = M_T,in + c_in - c; per volume of solution, of which the suspension holds 1 - M_T / rho, M_T =
M_T,in + (1 - M_T,in / rho) (c_in - c) / (1 - c / rho).

This equation is solved by bisection without derivatives; two Newton steps then give them, which is
the implicit function theorem. With j below 1, or with crystals in the feed, there is one steady
state with crystals. With a clear feed and j = 1 there is none if nuclei are washed out faster than
they form; the outlet is then the feed. Crystals in a feed below saturation would dissolve, which is
not modelled: the outlet is then NaN.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.table import TableContext, doc, subtable
from snapo.problem.record.arrays import Array, Float, jax, jnp

from ..flowsheet.stream import MOMENTS, NO_CRYSTALS, Grid, LedgerFinish, Sizes, ledger
from ..given import fixed, use
from ..read.declared import (
    ABSOLUTE,
    CONCENTRATION,
    CRYSTALS,
    POWER,
    SHAPE,
    VOLUME,
    UnitQuantity,
    inner,
    key,
    species_key,
    values,
)
from ..read.numbers import POSITIVE, SHARE
from .crystals.population import SIZE, cell_powers, mean_sizes
from .crystals.sizes import SizesTable, halved, read_edges
from .crystals.solubility import Solubility, solubility
from .operation import Inlet, Instant

ROUNDS = 60  # of bisection: to the last digit
EDGE = 1e-12  # how far inside the supersaturation of the feed the search begins and ends


GROWTH = UnitQuantity("m/s", POSITIVE, example="5 um/s")
BALANCE = {
    "solution": "(1 − M_T,in/ρ) (c_in − c)/(1 − c/ρ), c per volume of solution",
    "suspension": "c_in − c, c per volume of suspension",
}


class Steady(NamedTuple):
    """The steady state: `supersaturation`, `growth` m/s, `nucleation` 1/m3/s, `crystals` kg/m3."""

    supersaturation: Array
    growth: Array
    nucleation: Array
    crystals: Array


@dataclass(frozen=True, eq=False)
class Msmpr(Instant):
    """Continuous crystalliser of `volume` m3, fed evenly over its feed's duration.

    - `nucleation`: the rate at `reference_growth` and `reference_suspension`, with the powers i and
      j.
    - `edges`: [N + 1] the edges in m of cells in which the product's crystals are counted, or None.
    - `basis`: the basis of concentrations, as for a batch crystalliser.
    """

    solute: str = species_key("species that crystallises", "the name of a species")
    volume: CaseInput = VOLUME("volume of the suspension")
    temperature: CaseInput = ABSOLUTE("temperature of the crystalliser", example="283 K")
    solubility: Solubility = inner("solubility of the solute", Solubility)
    growth: CaseInput = GROWTH("growth at a supersaturation of 1")
    growth_order: CaseInput = POWER("order of growth", 1.0, range=POSITIVE)
    nucleation: CaseInput = UnitQuantity("1/m3/s", POSITIVE, example="1e7 1/m^3/s")(
        "nucleation at the reference"
    )
    reference_growth: CaseInput = GROWTH("growth to which nucleation refers", example="0.1 um/s")
    reference_suspension: CaseInput = CONCENTRATION(
        "mass of suspended crystals to which the nucleation rate refers"
    )
    growth_power: CaseInput = POWER("power of growth in nucleation", 1.0)
    suspension_power: CaseInput = POWER(
        "power of the suspended crystals in nucleation", 1.0, range=SHARE
    )
    shape: CaseInput = SHAPE("volume of a crystal per size^3")
    density: CaseInput = CRYSTALS("density of crystals")
    edges: np.ndarray | None = None
    basis: Literal["solution", "suspension"] = key(
        doc("whether concentrations are per volume of liquid or of suspension", "solution")
    )

    type = "msmpr"
    more_keys: ClassVar = {
        "sizes": (dict | None, subtable("cells over the size of crystals", "sizes", None))
    }
    variant = ""
    title = "continuous crystalliser"
    reacts = False
    symbols = (
        ("τ", "residence time"),
        ("n₀", "density by number at size 0"),
        ("M_T", "crystals per volume"),
        ("ρ", "density of crystals"),
    )
    assumptions = ("A continuous crystalliser is at its steady state all the time.",)

    @classmethod
    def read(cls, read, species):
        sized = read.table.sizes is not None
        edges = read_edges(read.inner("sizes", SizesTable)) if sized else None
        raw = read.raw["solubility"].get("antisolvent")
        if raw is not None:
            name = f"{read.section.name}.solubility"
            message = "no anti-solvent can reach a continuous crystalliser; remove this key"
            section = TableContext(read.section.file, name, read.section.notes)
            raise section.error("antisolvent", raw, message)
        return cls(name=read.name, edges=edges, **values(cls, read, species))

    @property
    def inlets(self):
        grid = None if self.edges is None else Grid.of(self.edges)
        return (Inlet("feed", "allowed", grid=grid, lasting=True),)

    @property
    def outlets(self):
        return ("slurry",)

    def sizes(self, inlets):
        return (None if self.edges is None else Grid.of(self.edges),)

    def lasts(self, inlets):
        return inlets

    def finer(self):
        return self if self.edges is None else replace(self, edges=halved(self.edges))

    def measures(self, species):
        table = {"concentration": "kg/m3", "crystals": "kg/m3", "supersaturation": "1"}
        table |= {"growth": "m/s", "nucleation": "1/m3/s", "residence_time": "s"}
        return table | {"d32": "m", "d43": "m"}

    def equations(self):
        return [
            "G n′ = (n_in − n)/τ, n(0) = B/G; n = n₀ exp(−L/(G τ)) for a clear feed",
            "M_T = ρ kᵥ μ₃ = M_T,in + " + BALANCE[self.basis],
            "G = g S^a; B = B_r (G/G_r)^i (M_T/M_r)^j",
            f"solubility c*: {self.solubility.kind} in temperature",
        ]

    def deliver(self, network, inlets, inputs):
        feed, mass = inlets[0], network.molar_mass[network.species.index(self.solute)]
        solute = network.species.index(self.solute)
        temperature = use(inputs, self.temperature)
        saturated = solubility(self.solubility, inputs, temperature)
        entering = feed.concentration()[solute] * mass
        density, shape = use(inputs, self.density), use(inputs, self.shape)
        apart = 1.0 if self.basis == "solution" else 0.0
        volume = feed.volume + apart * shape * feed.moments[3]
        residence = use(inputs, self.volume) * feed.duration / volume
        fed = feed.moments / volume
        result = self.steady(entering, saturated, residence, fed, inputs)
        per_volume = self.moments(result, residence, fed)
        change = result.crystals - density * shape * fed[3]
        solids = apart * result.crystals / density  # of the suspension
        left = (entering * feed.volume / volume - change) / (1 - solids)
        grown = change * volume / mass  # kmol
        slurry = feed.replace(
            species=feed.species.at[solute].add(-grown),
            solid=feed.solid.at[solute].add(grown),
            temperature=temperature,
            volume=volume * (1 - solids),
            solids=volume * solids,
            moments=per_volume * volume,
            density=density,
            shape=shape,
            numbers=self.counted(result, per_volume, residence, feed.numbers / volume, feed.grid)
            * volume,
            grid=self.sizes((feed.grid,))[0],
        )
        measures = {
            "concentration": left,
            "crystals": result.crystals,
            "supersaturation": left / saturated - 1,
            "growth": result.growth,
            "nucleation": result.nucleation,
            "residence_time": residence,
        } | mean_sizes(per_volume)
        return LedgerFinish((slurry,), measures, ledger(len(network.species)))

    def steady(self, entering, saturated, residence, fed, inputs: dict[str, Any]) -> Steady:
        """The steady state: `entering` dissolved solute and `saturated` in kg/m3, `residence` in s,
        moments `fed` per m3."""
        excess, weight = entering - saturated, use(inputs, self.density) * use(inputs, self.shape)
        above, solution = excess > 0, self.basis == "solution"
        room = 1 - use(inputs, self.shape) * fed[3] if solution else 1.0
        maximum = jnp.where(above, excess, saturated) / saturated  # supersaturation of the feed

        def rates(level) -> tuple[Array, Array, Array]:
            growth = use(inputs, self.growth) * level ** use(inputs, self.growth_order)
            new = room * (maximum - level) * saturated
            if solution:
                new = new / (1 - (1 + level) * saturated / use(inputs, self.density))
            crystals = weight * fed[3] + new
            faster = growth / use(inputs, self.reference_growth)
            denser = crystals / use(inputs, self.reference_suspension)
            born = use(inputs, self.nucleation) * faster ** use(inputs, self.growth_power)
            return growth, born * denser ** use(inputs, self.suspension_power), crystals

        def gap(level):
            """The logarithm of the ratio of the crystals that grow to those of the mass balance,
            which rises with the supersaturation."""
            growth, born, crystals = rates(level)
            grown = self.moments(Steady(level, growth, born, crystals), residence, fed)[3]
            return jnp.log(weight * grown) - jnp.log(crystals)

        low, high = maximum * EDGE, maximum * (1 - EDGE)
        grows = above & (jax.lax.stop_gradient(gap(high)) > 0)
        level = jnp.where(grows, _root(gap, low, high), maximum / 2)
        growth, born, crystals = rates(level)
        none = jnp.where((excess < 0) & (fed[3] > 0), jnp.nan, 0.0)  # crystals that would dissolve
        return Steady(
            jnp.where(grows, level, excess / saturated),
            jnp.where(grows, growth, none),
            jnp.where(grows, born, none),
            jnp.where(grows, crystals, weight * fed[3] + none),
        )

    def moments(self, result: Steady, residence, fed) -> Float[Array, " 6"]:
        """mu_0 = mu_0,in + B tau, mu_k = mu_k,in + k G tau mu_(k-1), m^k/m3."""
        moments = [fed[0] + result.nucleation * residence]
        for k in range(1, MOMENTS):
            moments.append(fed[k] + k * result.growth * residence * moments[-1])
        return jnp.stack(moments)

    def counted(self, result: Steady, moments, residence, fed, grid: Sizes) -> Float[Array, " N"]:
        """The number of crystals in each cell per m3, consistent with the third moment of all
        crystals.

        The number of nuclei decreases as exp(-L / (G tau)). Crystals `fed`, per m3 on their `grid`,
        are spread evenly over the sizes of their cell; a share exp(-x) of them remains over an
        interval x of L / (G tau), in that cell and in later ones.
        """
        if self.edges is None:
            return jnp.zeros(0)
        scale = result.growth * residence
        some = scale > 0
        edges = fixed(self.edges) / jnp.where(some, scale, 1.0)
        # Cells far out hold few crystals: no difference of two numbers that are nearly 1.
        width = jnp.diff(edges)
        lost = -jnp.expm1(-width)
        numbers = result.nucleation * residence * jnp.exp(-edges[:-1]) * lost
        if grid != NO_CRYSTALS:

            def cell(before, here):
                """`before`: the density by number at the cell's lower edge, per size / (G tau)."""
                new, wide, out = here
                after = before + (new / wide - before) * out
                return after, new + before - after

            _, grown = jax.lax.scan(cell, jnp.zeros(()), (fed, width, lost))
            numbers = jnp.where(some, numbers + grown, fed)
        volume = SIZE**3 * jnp.sum(fixed(cell_powers(self.edges / SIZE)[3]) * numbers)
        held = volume > 0
        return jnp.where(held, numbers * moments[3] / jnp.where(held, volume, 1.0), 0.0)


def _root(gap, low, high) -> Array:
    """The zero of a rising function, with its first and second derivatives."""
    still = jax.lax.stop_gradient

    def halve(_, endpoints):
        below, above = endpoints
        middle = jnp.sqrt(below * above)
        under = still(gap(middle)) < 0
        return jnp.where(under, middle, below), jnp.where(under, above, middle)

    below, above = jax.lax.fori_loop(0, ROUNDS, halve, (still(low), still(high)))
    level = still((below + above) / 2)
    for _ in range(2):
        value, slope = jax.jvp(gap, (level,), (jnp.ones_like(level),))
        level = level - value / slope
    return level
