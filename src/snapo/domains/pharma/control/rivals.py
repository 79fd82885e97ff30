"""The rules of a case as policies: connected, their setpoints known, and first settings found."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact

from ..flowsheet.case import PharmaCase
from .records import PI, Control, Rule
from .rules import Loops, Wire
from .stages import Stage

LAGS, DEADS = 60, 41  # time constants and dead times tried
LONGEST = 20.0  # time constants of that many horizons are tried: a process that integrates


class FirstOrder(NamedTuple):
    """k exp(-theta s) / (tau s + 1): `gain` k, `lag` tau and `dead` theta in s."""

    gain: float
    lag: float
    dead: float


def first_order(times: np.ndarray, response: np.ndarray, step: float) -> FirstOrder:
    """The process that fits a response [n] at `times` s [n] after a step of this size best.

    By least squares over time constants and dead times, each with its best gain.

    **Raises:** `ValueError` where nothing responds.
    """
    times, response = np.asarray(times, float), np.asarray(response, float)
    if not np.isfinite(response).all() or np.abs(response).max() < 1e-9 * abs(step):
        raise ValueError("the reading does not answer to what is moved")
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
    wanted = process.dead if closed is None else closed
    room = wanted + process.dead
    return process.lag / process.gain / room, min(process.lag, 4 * room)


def ziegler_nichols(process: FirstOrder) -> tuple[float, float]:
    """Gain and integral time in s: Kc = 0.9 tau / (k theta), Ti = theta / 0.3.

    From the reaction curve. J. G. Ziegler and N. B. Nichols, Trans. ASME 64 (1942) 759.
    """
    return 0.9 * process.lag / process.gain / process.dead, process.dead / 0.3


FORMULAS = {"simc": simc, "ziegler-nichols": ziegler_nichols}

STEP = 0.05  # of a control's range, or of an inner setpoint's: the step from which loops are tuned


class Tuned(NamedTuple):
    """A rule with its first settings; `processes` [L]: as the formulas saw them, None where both
    numbers are given; `loops`: their controllers, in the order of its wires."""

    policy: Loops
    processes: tuple[FirstOrder | None, ...]
    loops: tuple[PI, ...]


def connected(case: PharmaCase, stages: tuple[Stage, ...], rule: Rule) -> tuple[list, list[PI]]:
    """Its wires and controllers, the outer one of a cascade before the inner one."""
    control = case.control
    assert control is not None
    wires, loops = [], []
    for each in rule.loops:
        stage = next(s for s in stages if each.of in s.decided)
        if stage.unit is None:
            raise ValueError(f"rule {rule.name!r}: what is decided once has no loop")
        seconds = float(stage.unit.duration.used()) / stage.horizon
        place = stage.decided.index(each.of)
        applied = 2 + len(control.measurements) + each.of
        both = [each.outer] if each.inner is None else [each.outer, each.inner]
        for number, loop in enumerate(both):
            outer = number == 0 and each.inner is not None
            low, high = (_reading(control, both[1], x) if outer else i
                         for i, x in enumerate((each.low, each.high)))  # fmt: skip
            wires.append(
                Wire(stage.before, stage.horizon, seconds, 2 + loop.sensor, applied, place,
                     len(wires) + 1 if outer else -1, low, high)
            )  # fmt: skip
            loops.append(loop)
    return wires, loops


def _reading(control: Control, loop: PI, value: float) -> float:
    sensor = control.measurements[loop.sensor]
    return (value - sensor.centre) / sensor.width


def first_settings(
    case: PharmaCase, stages: tuple[Stage, ...], problem: Problem, rule: Rule, recipe: np.ndarray
) -> Tuned:
    """A rule about a recipe, [T, size] actions: what is not given is found from steps."""
    wires, loops = connected(case, stages, rule)
    control = case.control
    assert control is not None
    policy = Loops(np.zeros_like(recipe), tuple(wires), np.zeros((len(wires), len(recipe))))
    policy = policy.on(recipe)
    nominal = readings(problem, policy)
    wanted = np.stack([nominal[:, wire.sensor] for wire in wires])
    for i, (wire, loop) in enumerate(zip(wires, loops)):
        if loop.setpoint is not None:
            nodes = [_reading(control, loop, value) for value in loop.setpoint]
            share = (np.arange(wire.count) + 0.5) / wire.count
            row = np.interp(share, np.linspace(0, 1, len(nodes)), nodes)
            wanted[i, wire.first : wire.first + wire.count] = row
    policy, processes = policy.following(wanted), list[FirstOrder | None]([None] * len(wires))
    # An inner loop is closed before the outer one is tuned.
    for i in reversed(range(len(wires))):
        loop, wire = loops[i], wires[i]
        gain, time = loop.gain, loop.integral
        if gain is not None:
            gain = gain * _scale(control, wire, wires)
        if gain is None or time is None:
            try:
                processes[i] = seen = respond(problem, policy, recipe, i)
            except ValueError as error:
                raise ValueError(f"rule {rule.name!r}, loop {i + 1}: {error}") from None
            found = FORMULAS[rule.tuning](seen)
            gain, time = (a if a is not None else b for a, b in zip((gain, time), found))
            # Within one decision an integral cannot do more than all of its work.
            time = max(time, wire.seconds)
        policy = policy.tuned(i, gain, time)
    return Tuned(policy, tuple(processes), tuple(loops))


def _scale(control: Control, wire: Wire, wires: list[Wire]) -> float:
    """What a gain in the domain's units is multiplied by, for shares of the range per reading."""
    sensor = control.measurements[wire.sensor - 2]
    if wire.inner < 0:
        moved = control.manipulated[wire.control - 2 - len(control.measurements)]
        return sensor.width / (moved.high - moved.low)
    return sensor.width / control.measurements[wires[wire.inner].sensor - 2].width


def in_units(control: Control, policy: Loops) -> np.ndarray:
    """[L] gains in the domain's units: of what is moved per what is measured."""
    wires = list(policy.wires)
    return policy.gains() / [_scale(control, wire, wires) for wire in wires]


def respond(problem: Problem, policy: Loops, recipe: np.ndarray, number: int) -> FirstOrder:
    """What loop `number` sees of a step in what it moves, from the start of its unit."""
    wire = policy.wires[number]
    rows = slice(wire.first, wire.first + wire.count)
    if wire.inner < 0:
        size = STEP if recipe[rows, wire.place].mean() < 0.5 else -STEP
        moved = recipe.copy()
        moved[rows, wire.place] += size
        # At a limit not all of the step is made.
        size = float((np.clip(moved, 0, 1) - np.clip(recipe, 0, 1))[rows, wire.place].mean())
        other = policy.on(moved)
    else:
        size = STEP * (wire.high - wire.low)
        setpoints = np.array(policy.setpoints.array)
        setpoints[wire.inner, rows] += size
        other = policy.following(setpoints)
    apart = readings(problem, other) - readings(problem, policy)
    response = apart[rows, wire.sensor]
    times = np.arange(wire.count) * wire.seconds
    found = first_order(times, response, size)
    return found._replace(dead=found.dead + wire.seconds / 2)


def readings(problem: Problem, policy: Loops) -> np.ndarray:
    """[T, features] what a policy sees in the nominal batch, without errors of sensors."""
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
        seen = simulator.observe(constants, now, state)
        action, memory = policy.decide(seen, memory, Exact())
        after, _ = simulator.step(constants, now, state, action, quiet, Exact())
        after = jax.tree.map(
            lambda new, old: jnp.asarray(new, jnp.asarray(old).dtype), after, state
        )
        return (after, memory), seen

    start = first, jnp.zeros(policy.memory)
    return jax.lax.scan(step, start, steps)[1]
