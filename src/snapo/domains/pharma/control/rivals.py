"""The control rules of a case as policies, with their connections, setpoints and first settings."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact

from ..flowsheet.case import PharmaCase
from ..units.operation import timed
from .records import PI, Control, ControlRule
from .rules import LoopConnection, Loops
from .stages import Stage

LAGS, DEADS = 60, 41  # time constants and dead times tried
LONGEST = 20.0  # time constants of that many horizons are tried: a process that integrates


class FirstOrder(NamedTuple):
    """k exp(-theta s) / (tau s + 1): `gain` k, `lag` tau and `dead` theta in s."""

    gain: float
    lag: float
    dead: float


def first_order(times: np.ndarray, response: np.ndarray, step: float) -> FirstOrder:
    """The process that best fits a response [n] at `times` s [n] after a step of this size.

    The fit is by least squares over pairs of time constant and dead time, with the best gain of
    every pair.

    **Raises:** `ValueError` if nothing responds.
    """
    times, response = np.asarray(times, float), np.asarray(response, float)
    if not np.isfinite(response).all() or np.abs(response).max() < 1e-9 * abs(step):
        raise ValueError("the reading does not respond to the control")
    end = times[-1]
    lags = np.geomspace(end / len(times) / 4, LONGEST * end, LAGS)
    dead = np.linspace(0.0, 0.75 * end, DEADS)
    after = np.maximum(times - dead[:, None, None], 0.0)
    shape = -np.expm1(-after / lags[:, None])  # [dead, lag, n]
    square = (shape**2).sum(-1)
    gain = np.where(square > 0, (shape @ response) / np.where(square > 0, square, 1.0), 0.0)
    missed = ((response - gain[..., None] * shape) ** 2).sum(-1)
    i, j = np.unravel_index(np.argmin(missed), missed.shape)
    return FirstOrder(float(gain[i, j] / step), float(lags[j]), float(dead[i]))


def simc(process: FirstOrder, closed: float | None = None) -> tuple[float, float]:
    """Gain and integral time in s: Kc = tau / k / s and Ti = min(tau, 4 s), s = tau_c + theta.

    `closed`: tau_c in s, by default theta. S. Skogestad, J. Process Control 13 (2003) 291.
    """
    requested = process.dead if closed is None else closed
    room = requested + process.dead
    return process.lag / process.gain / room, min(process.lag, 4 * room)


def ziegler_nichols(process: FirstOrder) -> tuple[float, float]:
    """Gain and integral time in s: Kc = 0.9 tau / (k theta), Ti = theta / 0.3.

    The settings from the reaction curve. J. G. Ziegler and N. B. Nichols, Trans. ASME 64 (1942)
    759.
    """
    return 0.9 * process.lag / process.gain / process.dead, process.dead / 0.3


FORMULAS = {"simc": simc, "ziegler-nichols": ziegler_nichols}

STEP = 0.05  # of a control's range, or of an inner setpoint's: the step from which loops are tuned


class Tuned(NamedTuple):
    """A rule with its initial settings; `processes` [L]: the fitted processes that the formulas
    used, None for a controller whose gain and time are both specified; `loops`: the controllers, in
    the order of the connections."""

    policy: Loops
    processes: tuple[FirstOrder | None, ...]
    loops: tuple[PI, ...]


def connected(
    case: PharmaCase, stages: tuple[Stage, ...], rule: ControlRule
) -> tuple[list, list[PI]]:
    """The connections and controllers of a rule; in a cascade the outer one comes before the inner
    one."""
    control = case.control
    assert control is not None
    connections, loops = [], []
    for item in rule.loops:
        stage = next(s for s in stages if item.of in s.decided)
        unit = next((unit for unit in timed(case.units) if unit.name == stage.name), None)
        if unit is None:
            raise ValueError(f"rule {rule.name!r}: a number decided once cannot have a loop")
        seconds = float(unit.duration.used()) / stage.horizon
        position = stage.decided.index(item.of)
        applied = 2 + len(control.measurements) + item.of
        both = [item.outer] if item.inner is None else [item.outer, item.inner]
        for number, loop in enumerate(both):
            outer = number == 0 and item.inner is not None
            low, high = (_reading(control, both[1], x) if outer else i
                         for i, x in enumerate((item.low, item.high)))  # fmt: skip
            connections.append(
                LoopConnection(stage.before, stage.horizon, seconds, 2 + loop.sensor, applied,
                position,
                     len(connections) + 1 if outer else -1, low, high)
            )  # fmt: skip
            loops.append(loop)
    return connections, loops


def _reading(control: Control, loop: PI, value: float) -> float:
    sensor = control.measurements[loop.sensor]
    return (value - sensor.centre) / sensor.width


def first_settings(
    case: PharmaCase,
    stages: tuple[Stage, ...],
    problem: Problem,
    rule: ControlRule,
    recipe: np.ndarray,
) -> Tuned:
    """A rule around a recipe, [T, size] actions; missing settings follow from step responses."""
    connections, loops = connected(case, stages, rule)
    control = case.control
    assert control is not None
    policy = Loops(
        np.zeros_like(recipe), tuple(connections), np.zeros((len(connections), len(recipe)))
    )
    policy = policy.on(recipe)
    nominal = readings(problem, policy)
    requested = np.stack([nominal[:, wire.sensor] for wire in connections])
    for i, (connection, loop) in enumerate(zip(connections, loops)):
        if loop.setpoint is not None:
            nodes = [_reading(control, loop, value) for value in loop.setpoint]
            share = (np.arange(connection.count) + 0.5) / connection.count
            row = np.interp(share, np.linspace(0, 1, len(nodes)), nodes)
            requested[i, connection.first : connection.first + connection.count] = row
    policy, processes = (
        policy.with_setpoints(requested),
        list[FirstOrder | None]([None] * len(connections)),
    )
    # An inner loop is closed before the outer one is tuned.
    for i in reversed(range(len(connections))):
        loop, connection = loops[i], connections[i]
        gain, time = loop.gain, loop.integral
        if gain is not None:
            gain = gain * _scale(control, connection, connections)
        if gain is None or time is None:
            try:
                processes[i] = observed = respond(problem, policy, recipe, i)
            except ValueError as error:
                raise ValueError(f"rule {rule.name!r}, loop {i + 1}: {error}") from None
            formulas = FORMULAS[rule.tuning](observed)
            gain, time = (a if a is not None else b for a, b in zip((gain, time), formulas))
            # Within one decision an integral cannot do more than all of its work.
            time = max(time, connection.seconds)
        policy = policy.tuned(i, gain, time)
    return Tuned(policy, tuple(processes), tuple(loops))


def _scale(
    control: Control, connection: LoopConnection, connections: list[LoopConnection]
) -> float:
    """The factor from a gain in the domain's units to shares of the range per scaled reading."""
    sensor = control.measurements[connection.sensor - 2]
    if connection.inner < 0:
        moved = control.manipulated[connection.control - 2 - len(control.measurements)]
        return sensor.width / (moved.high - moved.low)
    return sensor.width / control.measurements[connections[connection.inner].sensor - 2].width


def in_units(control: Control, policy: Loops) -> np.ndarray:
    """[L] gains in the domain's units: control per reading."""
    connections = list(policy.connections)
    return policy.gains() / [_scale(control, connection, connections) for connection in connections]


def respond(problem: Problem, policy: Loops, recipe: np.ndarray, number: int) -> FirstOrder:
    """The response of loop `number` to a step of its control, from the start of its unit."""
    connection = policy.connections[number]
    rows = slice(connection.first, connection.first + connection.count)
    if connection.inner < 0:
        size = STEP if recipe[rows, connection.position].mean() < 0.5 else -STEP
        moved = recipe.copy()
        moved[rows, connection.position] += size
        # At a limit not all of the step is made.
        size = float(
            (np.clip(moved, 0, 1) - np.clip(recipe, 0, 1))[rows, connection.position].mean()
        )
        other = policy.on(moved)
    else:
        size = STEP * (connection.high - connection.low)
        setpoints = np.array(policy.setpoints.array)
        setpoints[connection.inner, rows] += size
        other = policy.with_setpoints(setpoints)
    apart = readings(problem, other) - readings(problem, policy)
    response = apart[rows, connection.sensor]
    times = np.arange(connection.count) * connection.seconds
    result = first_order(times, response, size)
    return result._replace(dead=result.dead + connection.seconds / 2)


def readings(problem: Problem, policy: Loops) -> np.ndarray:
    """[T, features] observations of a policy in the nominal batch, without sensor errors."""
    schedule = problem.schedule
    with jax.enable_x64(True):
        return np.asarray(_followed(problem.simulator, policy, schedule.constants, schedule.steps))


@eqx.filter_jit
def _followed(simulator, policy, constants, steps):
    quiet = jnp.zeros(simulator.noise_size)
    first = simulator.initial(constants, jnp.zeros(simulator.initial_noise_size))
    first = jax.tree.map(jnp.asarray, first)

    def step(carry, now):
        state, memory = carry
        observed = simulator.observe(constants, now, state)
        action, memory = policy.decide(observed, memory, Exact())
        after, _ = simulator.step(constants, now, state, action, quiet, Exact())
        after = jax.tree.map(
            lambda new, old: jnp.asarray(new, jnp.asarray(old).dtype), after, state
        )
        return (after, memory), observed

    start = first, jnp.zeros(policy.memory)
    return jax.lax.scan(step, start, steps)[1]
