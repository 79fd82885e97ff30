"""Batch crystalliser: cooling, anti-solvent, seed and nuclei.

Its crystals are a `Population`, by moments or by finite volumes. Dissolved solute is c = c_0 + rho
kv (mu3_0 - mu3), so the mass balance closes by construction. With dosing, all numbers are amounts
per m3 of the first charge.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.table import TableContext, doc, subtable
from snapo.problem.record.arrays import Array, jnp

from ..flowsheet.stream import MOMENTS, NO_CRYSTALS, Grid, LedgerFinish, Stream, ledger
from ..given import absent, fixed, use
from ..read.declared import (
    ABSOLUTE,
    CONCENTRATION,
    CRYSTALS,
    FLOW,
    LENGTH,
    SHAPE,
    TIME,
    inner,
    key,
    species_key,
    values,
)
from ..read.numbers import NOT_NEGATIVE
from ..read.reader import Reader
from ..time.dynamics import Dynamics
from ..time.profile import Profile, flow_of, saturation_share
from .crystals.kinetics import Kinetics, kinetics
from .crystals.population import (
    NUMBER,
    QUANTILES,
    SIZE,
    UNITS,
    Population,
    by_finite_volumes,
    by_moments,
    disappeared,
    mean_sizes,
)
from .crystals.seed import Seed, seed_moments, seed_numbers
from .crystals.sizes import SizesTable, check_seed, halved, read_edges
from .crystals.solubility import Solubility, antisolvent_factor, solubility
from .operation import Inlet, Timed


@dataclass(frozen=True, eq=False)
class Crystalliser(Timed):
    """Batch crystalliser; anti-solvent is dosed in proportion to the flow `dosing`.

    - `initial_concentration`: replaces the concentration of the feed (for a single crystalliser),
      or None.
    - `separate`: whether seed and nuclei have separate moments.
    - `edges`: [N + 1] the edges in m of N cells over the crystals' size, if finite volumes are
      used; crystals of the feed are then counted on the same grid. None if the moments 0 to 5 are
      used.
    - `basis`: with "solution" concentrations are per volume of liquid, which is smaller by the
      volume of the crystals; with "suspension" per volume of liquid and crystals together, an
      approximation for few crystals.
    """

    solute: str = species_key("species that crystallises", "the name of a species")
    duration: CaseInput = TIME("time of crystallisation", example="7200 s")
    temperature: Profile = ABSOLUTE.profile("temperature of the crystalliser")
    initial_concentration: CaseInput | None = CONCENTRATION(
        "concentration of the solute at the start", None, example="49 kg/m^3"
    )
    solubility: Solubility = inner("solubility of the solute", Solubility)
    kinetics: Kinetics = inner("growth, nucleation and dissolution", Kinetics)
    shape: CaseInput = SHAPE("volume of a crystal per cube of its size")
    density: CaseInput = CRYSTALS("density of crystals")
    nuclei_size: CaseInput = LENGTH(
        "size of new crystals", "0 m", range=NOT_NEGATIVE, example="1 um"
    )
    seed: Seed = inner("crystals at the start", Seed)
    separate: bool = key(doc("whether seed and nuclei have separate moments", False))
    dosing: Profile | None = FLOW.profile("flow of anti-solvent", None)
    edges: np.ndarray | None = None
    basis: Literal["solution", "suspension"] = key(
        doc("whether concentrations are per volume of liquid or of suspension", "solution")
    )

    type = "crystalliser"
    more_keys: ClassVar = {
        "method": (
            Literal["moments", "finite-volumes"],
            doc("how crystals are counted: by moments, or in cells over size", "moments"),
        ),
        "sizes": (dict | None, subtable("cells over the size of crystals", "sizes", None)),
    }
    variant = ""
    title = "crystalliser"
    reacts = False
    symbols = (
        ("c", "concentration"),
        ("c*", "solubility"),
        ("S", "supersaturation"),
        ("L", "size, and n the density by number over it"),
        ("μₖ", "moments of the size"),
        ("kᵥ", "shape"),
    )
    assumptions = (
        "Crystals are pure; impurities come from the liquor retained in the cake.",
        "A stream contains one population of crystals, of one density and shape.",
    )

    @classmethod
    def read(cls, read, species):
        edges = _edges(read, read.table.seed)
        return cls(name=read.name, edges=edges, **values(cls, read, species))

    @property
    def inlets(self):
        grid = None if self.edges is None else Grid.of(self.edges)
        inlets = (Inlet("feed", "allowed", grid=grid),)
        if self.dosing is None:
            return inlets
        return (*inlets, Inlet("antisolvent", "refused", dosed=self.dosing))

    @property
    def outlets(self):
        return ("slurry",)

    @property
    def error_controlled(self):
        """True if the concentration changes while nothing grows, or if cells limit the length of a
        step."""
        dissolves = bool(self.kinetics.dissolution.values.any())
        return dissolves or self.dosing is not None or self.edges is not None

    def sizes(self, inlets):
        return (None if self.edges is None else Grid.of(self.edges),)

    def unsound(self, track, inputs):
        if self.edges is not None or absent(inputs, self.kinetics.dissolution):
            return ""
        volume = use(inputs, self.shape) * track["mu3"]
        speed = kinetics(self.kinetics, inputs, track["supersaturation"], volume)
        metadata = disappeared(track, speed, float(use(inputs, self.nuclei_size)))
        return metadata and f"{self.name}: {metadata}"

    def finer(self):
        return self if self.edges is None else replace(self, edges=halved(self.edges))

    def measures(self, species):
        sizes = {"d32": "m", "d43": "m"}
        table = {"concentration": "kg/m3", "crystals": "kg/m3", "supersaturation": "1"}
        if self.separate:
            table |= {"seed_volume": "m3/m3", "nuclei_volume": "m3/m3"}
        if self.edges is not None:
            sizes |= QUANTILES | {"span": "1", "at_largest": "1"}
        return table | sizes

    def states(self, species):
        """ "mu0" to "mu5" are m^k per m3."""
        table = {"concentration": "kg/m3", "supersaturation": "1", "temperature": "K"}
        moments = {f"mu{k}": "1/m3" if k == 0 else f"m^{k}/m3" for k in range(MOMENTS)}
        sizes = {"d43": "m", "d32": "m"} | (QUANTILES if self.edges is not None else {})
        return table | sizes | moments

    def equations(self):
        return [
            "S = (c − c*)/c*, S₊ its rounded positive part",
            "growth G = g S₊^a − d S₋^b; nucleation B = B₁ S₊^p + B₂ S₊^q (kᵥ μ₃)^r",
            self.balance(),
            f"solubility c*: {self.solubility.kind} in temperature",
        ]

    def balance(self) -> str:
        """The population balance in the form that is solved."""
        if self.edges is None:
            return "μ₀' = B, μₖ' = k G μₖ₋₁ + B L₀^k, k = 1 … 5; solute by difference of μ₃"
        low, high = 1e6 * self.edges[[0, -1]]
        return (
            f"n_t + (G n)_L = 0, B at the smallest size; {len(self.edges) - 1} cells from "
            f"{low:.4g} to {high:.4g} µm, limited slopes (van Albada); solute by difference of the "
            "cells' μ₃"
        )

    def population(self, feed: Stream, inputs: dict[str, Any]) -> Population:
        """The population at the start, with the seed and the crystals of the feed."""
        shape, density = use(inputs, self.shape), use(inputs, self.density)
        if self.edges is not None:
            seed = seed_numbers(self.seed, inputs, shape, density, self.edges / SIZE)
            fed = None if feed.grid == NO_CRYSTALS else feed.numbers / (feed.volume * NUMBER)
            return by_finite_volumes(self.edges, seed, fed)
        size = None if absent(inputs, self.nuclei_size) else use(inputs, self.nuclei_size)
        seed = seed_moments(self.seed, inputs, shape, density)
        return by_moments(shape, size, self.separate, seed, feed.moments / feed.volume)

    def dynamics(self, network, inlets, inputs):
        """y: the crystals' `Population` per initial volume of liquid and, with dosing, the dosed
        volume per initial volume."""
        feed, dose = inlets[0], inlets[1] if len(inlets) > 1 else None
        solute, mass = network.species.index(self.solute), network.molar_mass
        shape, density = use(inputs, self.shape), use(inputs, self.density)
        duration, dosed = use(inputs, self.duration), dose is not None
        volume, temperature = feed.volume, use(inputs, self.temperature.value)
        charge = feed.concentration()
        if self.initial_concentration is not None:
            replaced = use(inputs, self.initial_concentration) / mass[solute]
            charge = charge.at[solute].set(replaced)
        crystals = self.population(feed, inputs)
        weight = density * shape  # kg/m3 of slurry per m3/m3 of mu3
        dissolved = charge[solute] * mass[solute]
        dosed_solute = dose.concentration()[solute] * mass[solute] if dose is not None else 0.0
        units, count = fixed(UNITS), len(crystals.start)
        first = crystals.moments(crystals.start)[3]
        controls = [(self.temperature, temperature)]
        to_dose = None
        if dose is not None and self.dosing is not None:
            controls.append(flow_of(self.dosing, inputs, duration, dose.volume))
            to_dose = lambda y: dose.volume - volume * y[-1]  # noqa: E731

        def taken(mu3):
            """The volume of crystals that adds to that of the liquid, per initial volume of
            liquid."""
            return shape * units[3] * mu3 if self.basis == "solution" else jnp.zeros(())

        def scaled(y) -> tuple[Array, Array]:
            """Scaled moments of all crystals, and the volume of the suspension, per initial volume
            of liquid."""
            size = 1 + taken(first)
            return crystals.moments(y[:count]), size + y[-1] if dosed else size

        def liquid(y):
            """Solute in kg/m3, the factor of the anti-solvent on the solubility, and mu3 per
            initial volume."""
            moments, size = scaled(y)
            mu3, size = moments[3] * units[3], size - taken(moments[3])
            solute_amount = dissolved + weight * units[3] * (first - moments[3])
            other = feed.antisolvent
            if dose is not None:
                solute_amount = solute_amount + y[-1] * dosed_solute
                other = other + y[-1] * volume * dose.solvent / dose.volume
            factor = antisolvent_factor(self.solubility, inputs, other, feed.solvent)
            return solute_amount / size, factor, mu3

        def supersaturation(y, saturated):
            c, factor, _ = liquid(y)
            return (c - saturated * factor) / (saturated * factor)

        def rate(y, drive):
            size = scaled(y)[1]
            speed = kinetics(
                self.kinetics, inputs, supersaturation(y, drive[0]), shape * liquid(y)[2] / size
            )
            born = speed.nucleation * size / NUMBER
            slope = crystals.slope(y[:count], speed.growth / SIZE, born)
            return jnp.append(slope, drive[1] / volume) if dosed else slope

        def drive(control, *dosing):
            saturated = solubility(self.solubility, inputs, control)
            return jnp.stack([saturated, *dosing], -1)

        def states(y, control, *_):
            moments, size = scaled(y)
            moments = moments * units / size
            saturated = solubility(self.solubility, inputs, control)
            result = {f"mu{k}": moments[k] for k in range(MOMENTS)} | mean_sizes(moments)
            result |= crystals.states(y[:count])
            result["concentration"] = liquid(y)[0]
            return result | {
                "supersaturation": supersaturation(y, saturated),
                "temperature": control,
            }

        def finish(y, control, *_):
            moments, size = scaled(y)
            solids = volume * taken(moments[3])
            moments, left_liquid = moments * units, volume * size - solids
            c, _, mu3 = liquid(y)
            saturated = solubility(self.solubility, inputs, control)
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
                species=species.at[solute].set(c * left_liquid / mass[solute]),
                solid=nothing.at[solute].set(weight * mu3 * kmol),
                seed=feed.seed + seeded,
                solvent=feed.solvent,
                antisolvent=feed.antisolvent + antisolvent,
                volume=left_liquid,
                solids=solids,
                temperature=control,
                duration=jnp.zeros(()),
                moments=moments * volume,
                density=density,
                shape=shape,
                inner_size=jnp.zeros(()),
                inner_density=jnp.zeros(()),
                numbers=crystals.numbers(y[:count]) * NUMBER * volume,
                grid=self.sizes(tuple(inlet.grid for inlet in inlets))[0],
            )
            added = seeded + (charge - feed.concentration()) * volume
            book = ledger(len(mass), added=added, left=left, solvent_left=solvent_left)
            return LedgerFinish((slurry_out,), measures, book)

        def excess(control):
            """Solubility minus concentration at the start, at any temperature."""
            c, factor, _ = liquid(start)
            return solubility(self.solubility, inputs, control) * factor - c

        start = jnp.append(crystals.start, 0.0) if dosed else crystals.start
        event = saturation_share(excess, self.temperature, temperature)
        ways = drive, tuple(controls), duration, event, states, finish, False, to_dose
        return Dynamics(start, rate, *ways)


def _edges(read: Reader, seed: Seed) -> np.ndarray | None:
    """Edges of the cells over size, in m, for finite volumes; else None."""
    table, method = read.table, read.table.method
    if method == "moments":
        if table.sizes is not None:
            message = 'method "moments" has no such key; it belongs to "finite-volumes"'
            raise read.section.error("sizes", table.sizes, message)
        return None
    if table.sizes is None:
        raise read.section.error("sizes", None, f'method "{method}" needs this key')
    for name, owned in (("separate", "has no separate moments"),
                        ("nuclei_size", "has nuclei of the smallest size")):  # fmt: skip
        if name in table.model_fields_set:
            message = f'method "{method}" {owned} and has no such key'
            raise read.section.error(name, read.raw[name], message)
    if seed.spread is None:
        seeded = TableContext(read.section.file, f"{read.section.name}.seed", read.section.notes)
        message = f'method "{method}" needs a seed with loading, size and spread'
        raise seeded.error("spread", None, message)
    inner = read.inner("sizes", SizesTable)
    edges = read_edges(inner)
    check_seed(inner, edges, seed)
    return edges
