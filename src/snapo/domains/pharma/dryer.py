"""Falling-rate drying of the cake, in closed form along the temperature profile."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .dynamics import Finish, Track, ledger
from .inputs import use
from .mesh import edges_of, make_mesh
from .network import GAS_CONSTANT
from .population import mean_sizes
from .records_units import Dryer
from .stream import Stream, clear

STEPS = 32  # per piece of the profile, by Simpson's rule; exact where temperature is constant


def loading(cake: Stream) -> Float[Array, ""]:
    """X0: liquid per crystals, kg/kg."""
    return (cake.solvent + cake.antisolvent) / (cake.density * cake.shape * cake.moments[3])


def dry(unit: Dryer, cake: Stream, inputs: dict[str, Any]) -> tuple[Finish, Track]:
    """X = X0 exp(-integral of k), and what the dryer delivers; the track's state is X."""
    profile, value = unit.temperature, use(inputs, unit.temperature.value)
    mesh = make_mesh(edges_of((profile,)), STEPS, None)
    duration = use(inputs, unit.duration)
    size = mean_sizes(cake.moments)["d32"]
    inverse = 1 / mesh.values(profile, value) - 1 / unit.reference_temperature
    rate = use(inputs, unit.rate) * jnp.exp(-use(inputs, unit.activation) / GAS_CONSTANT * inverse)
    rate = rate * use(inputs, unit.reference_size) / size
    step = duration * (mesh.stages[:, 2] - mesh.stages[:, 0])
    integral = jnp.cumsum(step / 6 * (rate[:, 0] + 4 * rate[:, 1] + rate[:, 2]))
    course = loading(cake) * jnp.exp(-jnp.append(0.0, integral))
    share = jnp.exp(-integral[-1])
    product = cake._replace(
        solvent=cake.solvent * share, antisolvent=cake.antisolvent * share, temperature=value[-1]
    )
    vapour = clear(
        jnp.zeros_like(cake.species), cake.solvent * (1 - share), jnp.zeros(()), value[-1]
    )._replace(antisolvent=cake.antisolvent * (1 - share))
    measures = {"solvent": course[-1], "temperature": value[-1]}
    slope = -jnp.append(rate[:1, 0], rate[:, 2]) * course
    controls = mesh.point_values(profile, value)
    track = Track(duration * mesh.times(), course[:, None], slope[:, None], controls[:, None])
    return Finish((product, vapour), measures, ledger(len(cake.species))), track


def dryer_states(y, control) -> dict[str, Array]:
    """States of a dryer from its track."""
    return {"solvent": y[0], "temperature": control}
