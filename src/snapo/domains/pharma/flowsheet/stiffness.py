"""The units of a case that are stiff or need error control, and the steps that they take.

Explicit steps of h seconds are stable while h times the fastest rate at which a state responds
stays below 2.78 (classical Runge-Kutta, on the negative axis). That rate is measured along the
solution of the nominal batch, computed by Rosenbrock steps with error control. If it is above the
limit, these steps are held, and every batch uses them. Units that need error control (a jacket, a
dryer's tray, a gas that dissolves, reactions that may use up a species immediately) hold them in
any case.

For a unit without such steps, and if the case does not set their number, the explicit steps of
every piece are doubled until no attribute of the nominal batch changes. If a bound shows that all
steps are short enough, nothing is computed.
"""

from dataclasses import replace
from math import inf
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..time.dynamics import Dynamics
from ..time.mesh import break_up, edges_of, steps_per_piece
from ..time.step_choice import choose, times_of
from ..units.operation import Timed, timed
from .case import PharmaCase
from .flow import flow, problem_of
from .inputs import pharma_inputs

STABLE = 2.0  # explicit steps times the fastest rate: 2.78, and room for batches that differ
# Relative, on twice the steps: derivatives move some 15 times as much, and may move by 1e-5.
STILL = 2e-7
MAXIMUM = 16  # times as many steps as a case begins with
# Steps times the fastest rate of a reactor, where classical Runge-Kutta is off by about 1e-7; and
# seconds of a step in which crystals and granules, without such a bound, change next to nothing.
PRECISE, SHORT = 0.1, 20.0


def with_steps(case: PharmaCase) -> PharmaCase:
    """The case with the steps of its stiff units, and with a mesh that is fine enough for the
    others."""
    case = with_stiff_steps(case)
    numerics = case.numerics
    if not numerics.open:
        return case
    settled = replace(case, numerics=replace(numerics, open=False))
    doubtful = case.attributes and any(_doubtful(case, unit) for unit in timed(case.units))
    if numerics.method != "mesh" or not doubtful:
        return settled
    steps, here = numerics.steps, _attributes(settled, numerics.steps)
    floor = np.array([attribute.margin for attribute in case.attributes])
    while steps < MAXIMUM * numerics.steps:
        finer = _attributes(settled, 2 * steps)
        if (np.abs(finer - here) <= STILL * np.maximum(np.abs(finer), floor)).all():
            return replace(settled, numerics=replace(settled.numerics, steps=steps))
        steps, here = 2 * steps, finer
    return settled


def with_stiff_steps(case: PharmaCase) -> PharmaCase:
    """The case with the steps of its stiff units, determined at the nominal inputs."""
    numerics = case.numerics
    if numerics.method != "mesh" or numerics.stiff == "none" or numerics.held:
        return case
    for unit in timed(case.units):
        if numerics.stiff == "measured" and not (
            _controlled(case, unit) or _may_be_stiff(case, unit)
        ):
            continue
        times = _measured(case, unit)
        if times is not None:
            held = {**case.numerics.held, unit.name: times}
            case = replace(case, numerics=replace(case.numerics, held=held))
    return case


def _controlled(case: PharmaCase, unit: Timed) -> bool:
    """Whether steps by error control are held, stiff or not."""
    sudden = unit.reacts and bool(case.network.runs_out.any())
    return unit.steps_transfer and (unit.error_controlled or sudden)


def _may_be_stiff(case: PharmaCase, unit: Timed) -> bool:
    """False if a bound from the numbers shows that explicit steps are stable."""
    return unit.reacts and longest_step(case, unit) * fastest(case, unit) > STABLE


def longest_step(case: PharmaCase, unit: Timed) -> float:
    """Seconds of the longest explicit step, from the profiles only."""
    edges = edges_of(unit.profiles)
    within = steps_per_piece(case.numerics.steps, len(edges) - 1)
    return float(unit.duration.used() * np.diff(edges).max() / within)


def fastest(case: PharmaCase, unit: Timed) -> float:
    """1/s: a bound on the rates of the unit's states, from the numbers of the case only; infinite
    if another unit feeds it."""
    into = {connection.source for connection in case.connections if connection.target == unit.name}
    feeds = tuple(feed for feed in case.feeds if feed.name in into)
    return inf if len(feeds) < len(into) else unit.fastest(case.network, feeds)


def _measured(case: PharmaCase, unit: Timed) -> np.ndarray | None:
    """Shares of the duration between which a stiff unit steps; None for one that is not."""
    made: dict[str, Any] = {}

    def nominal(inputs):
        problem = problem_of(case.flowsheet, unit, inputs, {})
        made["event"] = problem.event is not None
        if made["event"]:
            return None
        choice = choose(problem, case.numerics.stiff_tolerance, case.numerics.max_steps)
        return choice, choice.fastest * _longest(problem, case.numerics.steps)

    inputs = {name: entry.value for name, entry in pharma_inputs(case).items()}
    with jax.enable_x64(True):
        result = jax.tree.map(np.asarray, jax.jit(nominal)(inputs))
    if result is None:
        return None
    selected, stiffness = result
    if case.numerics.stiff == "measured" and stiffness <= STABLE and not _controlled(case, unit):
        return None
    return times_of(selected)


def _longest(problem: Dynamics, steps: int):
    """Seconds of the longest explicit step."""
    segments = break_up(edges_of(tuple(profile for profile, _ in problem.controls)), None)
    within = steps_per_piece(steps, len(segments.source))
    return problem.duration * jnp.max(jnp.diff(segments.breaks)) / within


def _doubtful(case: PharmaCase, unit: Timed) -> bool:
    """Whether the unit's steps may be too long; held steps are not, since error control chose
    them."""
    if unit.name in case.numerics.held:
        return False
    step = longest_step(case, unit)
    return step * fastest(case, unit) > PRECISE if unit.reacts else step > SHORT


def _attributes(case: PharmaCase, steps: int) -> np.ndarray:
    """The attributes of the nominal batch with this number of steps."""
    finer = replace(case.flowsheet, numerics=replace(case.numerics, steps=steps))

    def nominal(inputs):
        measures = flow(finer, inputs).measures
        return jnp.stack(
            [attribute.scale * measures[attribute.measure] for attribute in case.attributes]
        )

    inputs = {name: entry.value for name, entry in pharma_inputs(case).items()}
    with jax.enable_x64(True):
        return np.asarray(jax.jit(nominal)(inputs))
