"""One unit of any kind, as a function of what flows into it and of its numbers."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .crystalliser import crystalliser
from .dissolution import dissolved
from .dryer import dry, dryer_states
from .dynamics import Dynamics, Finish, Track, ledger
from .filter import filtration
from .integrate import ended, integrate
from .mixing import mixed, split
from .reactor import reactor
from .records import Network, Numerics
from .records_units import (
    Crystalliser,
    Dissolution,
    Dryer,
    Filter,
    Reactor,
    Splitter,
    Tank,
    Timed,
    TrayDryer,
    Unit,
)
from .stream import Stream
from .tray import tray


class Outcome(NamedTuple):
    """What a unit delivered; `reached` of `duration` s (equal where all went well; both 0 for a
    unit without time), its `track`, and from the track's rows to states."""

    finish: Finish
    duration: Float[Array, ""]
    reached: Float[Array, ""]
    track: Track | None
    states: Callable[..., dict[str, Array]] | None


def timed(unit: Unit) -> bool:
    """Whether the unit is integrated over time."""
    return isinstance(unit, Timed)


def dynamics(
    unit: Timed, network: Network, inlets: tuple[Stream, ...], inputs: dict[str, Any]
) -> Dynamics:
    """The initial value problem of a unit that is integrated over time."""
    match unit:
        case Reactor():
            return reactor(unit, network, inlets, inputs)
        case Crystalliser():
            return crystalliser(unit, network, inlets, inputs)
        case TrayDryer():
            return tray(unit, inlets[0], inputs)


def operate(
    unit: Unit,
    network: Network,
    numerics: Numerics,
    inlets: tuple[Stream, ...],
    inputs: dict[str, Any],
    record: bool = False,
    end: Float[Array, " m"] | None = None,
) -> Outcome:
    """Runs a unit; with `record`, its track is kept. `end`: its final y, where that is known."""
    still, zero = len(network.species), jnp.zeros(())
    match unit:
        case Reactor() | Crystalliser() | TrayDryer():
            problem = dynamics(unit, network, inlets, inputs)
            solved = integrate(problem, numerics, record) if end is None else ended(problem, end)
            finish = problem.finish(solved.final, *solved.controls)
            return Outcome(finish, problem.duration, solved.reached, solved.track, problem.states)
        case Filter():
            finish = filtration(unit, network, inlets[0], inputs)
        case Dryer():
            finish, track = dry(unit, inlets[0], inputs)
            return Outcome(finish, zero, zero, track, dryer_states)
        case Dissolution():
            measures = {"dissolved": dissolved(unit, inlets[0], inputs)}
            finish = Finish((), measures, ledger(still))
        case Tank():
            finish = Finish((mixed(inlets),), {}, ledger(still))
        case Splitter():
            finish = Finish(split(unit, inlets[0], inputs), {}, ledger(still))
    return Outcome(finish, zero, zero, None, None)
