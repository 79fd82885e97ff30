"""Drying of the cake at a falling rate, in closed form along the temperature profile."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from snapo.case.given import CaseInput
from snapo.case.table import doc
from snapo.problem.record.arrays import Array, Float, jnp

from ..flowsheet.network import GAS_CONSTANT
from ..flowsheet.stream import NO_CRYSTALS, LedgerFinish, Stream, clear, ledger
from ..given import use
from ..read.declared import ABSOLUTE, ENERGY, LENGTH, RATE, TIME
from ..time.dynamics import Track
from ..time.mesh import edges_of, make_mesh
from ..time.profile import Profile
from .crystals.population import mean_sizes
from .operation import Inlet, Outcome, Unit

STEPS = 32  # per piece of the profile, by Simpson's rule; exact where temperature is constant


@dataclass(frozen=True, eq=False)
class Dryer(Unit):
    """Dryer with a rate constant for the falling rate.

    Falling rate: X' = -k X, k = rate exp(-activation / R (1/T - 1/reference_temperature))
    (reference_size / d32); X is solvent per crystals, kg/kg.
    """

    duration: CaseInput = TIME("drying time", example="3 h")
    temperature: Profile = ABSOLUTE.profile("temperature of the shelf")
    rate: CaseInput = RATE("drying rate at the reference")
    activation: CaseInput = ENERGY("activation energy of drying")
    reference_temperature: float = ABSOLUTE.number(
        "temperature to which the drying rate refers", example="323.15 K"
    )
    reference_size: CaseInput = LENGTH("size to which the drying rate refers", example="40 um")

    type = "dryer"
    more_keys: ClassVar = {
        "kind": (
            Literal["falling-rate"],
            doc("model of the dryer", "falling-rate", '"falling-rate" or "tray"'),
        )
    }
    variant = "falling-rate"
    title = "dryer"
    reacts = False
    symbols = (
        ("X", "solvent per crystals"),
        ("d₃₂", "mean size by surface"),
    )
    assumptions = ()

    @property
    def inlets(self):
        return (Inlet("cake", "needed"),)

    @property
    def outlets(self):
        return ("product", "vapour")

    @property
    def time(self):
        return self.duration

    def sizes(self, inlets):
        return (inlets[0], NO_CRYSTALS)

    def measures(self, species):
        return {"solvent": "1", "temperature": "K"}

    def states(self, species):
        """ "solvent" is kg per kg of crystals."""
        return {"solvent": "1", "temperature": "K"}

    def equations(self):
        return ["X' = −k X, k = k₀ exp(−E/R (1/T − 1/T₀)) (d₀/d₃₂)"]

    def operate(self, network, numerics, inlets, inputs, record=False, end=None):
        finish, track = self.dry(inlets[0], inputs)
        zero = jnp.zeros(())
        return Outcome(finish, zero, zero, track, of_track)

    def dry(self, cake: Stream, inputs: dict[str, Any]) -> tuple[LedgerFinish, Track]:
        """X = X0 exp(-integral of k) at the end, and over time: the track's state is X."""
        profile, value = self.temperature, use(inputs, self.temperature.value)
        mesh = make_mesh(edges_of((profile,)), STEPS, None)
        duration = use(inputs, self.duration)
        size = mean_sizes(cake.moments)["d32"]
        inverse = 1 / mesh.values(profile, value) - 1 / self.reference_temperature
        rate = use(inputs, self.rate) * jnp.exp(
            -use(inputs, self.activation) / GAS_CONSTANT * inverse
        )
        rate = rate * use(inputs, self.reference_size) / size
        step = duration * (mesh.stages[:, 2] - mesh.stages[:, 0])
        integral = jnp.cumsum(step / 6 * (rate[:, 0] + 4 * rate[:, 1] + rate[:, 2]))
        trajectory = loading(cake) * jnp.exp(-jnp.append(0.0, integral))
        share = jnp.exp(-integral[-1])
        product = cake.replace(
            solvent=cake.solvent * share,
            antisolvent=cake.antisolvent * share,
            temperature=value[-1],
        )
        vapour = clear(
            jnp.zeros_like(cake.species), cake.solvent * (1 - share), jnp.zeros(()), value[-1]
        ).replace(antisolvent=cake.antisolvent * (1 - share))
        measures = {"solvent": trajectory[-1], "temperature": value[-1]}
        slope = -jnp.append(rate[:1, 0], rate[:, 2]) * trajectory
        controls = mesh.point_values(profile, value)
        track = Track(
            duration * mesh.times(), trajectory[:, None], slope[:, None], controls[:, None]
        )
        return LedgerFinish((product, vapour), measures, ledger(len(cake.species))), track


def loading(cake: Stream) -> Float[Array, ""]:
    """X0: liquid per crystals, kg/kg."""
    return (cake.solvent + cake.antisolvent) / cake.crystals()


def of_track(y, control) -> dict[str, Array]:
    """States of a dryer from its track."""
    return {"solvent": y[0], "temperature": control}
