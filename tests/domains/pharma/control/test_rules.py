"""PI controllers on a first-order process with dead time, against closed forms."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from snapo.domains.pharma.control.policy import history_length, initial_history, reading, shifted
from snapo.domains.pharma.control.records import Measurement
from snapo.domains.pharma.control.rivals import (
    FirstOrder,
    first_order,
    readings,
    respond,
    simc,
    ziegler_nichols,
)
from snapo.domains.pharma.control.rules import LoopConnection, Loops
from snapo.engine import Native, Xla
from snapo.problem.actions import Box
from snapo.problem.objective import Mean
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

GAIN, LAG, DEAD = 2.0, 20.0, 5.0  # s
RECIPE = 0.2


class Delayed(Simulator):
    """k exp(-theta s) / (tau s + 1) about a recipe, its control held for `seconds` at a time.

    It is exact: y' = a y + k (1 - a) (u a dead time ago - recipe), a = exp(-seconds / tau).
    """

    horizon: int  # pyright: ignore[reportIncompatibleVariableOverride]
    seconds: float = 1.0
    high: float = 1.0
    ramp: float = 1e9
    load: float = 0.0
    noise_size: int = 0
    action: Box = Box(0.0, 1.0)

    def prepare(self, inputs):
        return Schedule({}, {"clock": np.arange(self.horizon) / self.horizon})

    def initial(self, constants, noise):
        dead = round(DEAD / self.seconds)
        return {"y": jnp.zeros(()), "u": jnp.full(dead + 1, RECIPE)}

    def observe(self, constants, now, state):
        return jnp.stack([now["clock"], now["clock"], state["y"], state["u"][0]])

    def step(self, constants, now, state, action, noise, smooth):
        share, most = jnp.exp(-self.seconds / LAG), self.ramp * self.seconds
        last = state["u"][0]
        u = smooth.clip(action[0], last - most, last + most, scale=1.0)
        u = smooth.minimum(u, self.high, scale=1.0)
        past = jnp.concatenate([u[None], state["u"][:-1]])
        y = share * state["y"] + GAIN * (1 - share) * (past[-1] - RECIPE + self.load)
        return {"y": y, "u": past}, {"error": self.seconds * jnp.abs(1 - y)}


def rule(horizon: int, seconds: float, setpoint: float = 1.0) -> Loops:
    wire = LoopConnection(0, horizon, seconds, 2, 3, 0, -1, 0.0, 1.0)
    loops = Loops(np.zeros((horizon, 1)), (wire,), np.full((1, horizon), setpoint))
    return loops.on(np.full((horizon, 1), RECIPE))


def problem(simulator: Simulator) -> Problem:
    return Problem(simulator, {}, -Mean("error"))


def response(times: np.ndarray, terms: int = 40) -> np.ndarray:
    """The setpoint response where Ti = tau and tau_c = theta: y' = (1 - y) / (2 theta), delayed.

    sum over n >= 1 of (-1)^(n + 1) ((t - n theta) / (2 theta))^n / n!, of the t above n theta.
    """
    n = np.arange(1, terms + 1)[:, None]
    part = np.maximum(times - n * DEAD, 0.0) / (2 * DEAD)
    factorial = np.array([math.factorial(int(k)) for k in n[:, 0]], float)[:, None]
    return ((-1.0) ** (n + 1) * part**n / factorial).sum(0)


def test_simc_is_as_published():
    """Skogestad 2003: g = exp(-theta s) / (tau s + 1) has Kc = 0.5 tau / theta, Ti = min(tau, 8
    theta). After a step of the setpoint the closed form of the response has an integral of the
    absolute error of 2.17 theta, and an overshoot of 4 %."""
    gain, time = simc(FirstOrder(1.0, 1.0, 1.0))
    assert (gain, time) == (0.5, 1.0)
    assert simc(FirstOrder(1.0, 100.0, 1.0))[1] == 8.0
    assert ziegler_nichols(FirstOrder(2.0, 10.0, 1.0)) == pytest.approx((4.5, 1 / 0.3))
    times = np.linspace(0, 30 * DEAD, 30_001)
    error = np.abs(1 - response(times))
    iae = np.sum((error[1:] + error[:-1]) / 2) * times[1]
    assert iae / DEAD == pytest.approx(2.17, abs=0.005)
    assert response(times).max() == pytest.approx(1.04, abs=0.005)


def test_a_first_order_process_is_found_from_its_step():
    times = np.arange(200.0)
    shape = -np.expm1(-np.maximum(times - DEAD, 0) / LAG)
    found = first_order(times, 0.1 * GAIN * shape, 0.1)
    assert found.gain == pytest.approx(GAIN, rel=0.02)
    assert found.lag == pytest.approx(LAG, rel=0.1) and abs(found.dead - DEAD) < 3
    with pytest.raises(ValueError, match="does not respond"):
        first_order(times, 0 * times, 0.1)


def apart(seconds: float) -> float:
    """The largest distance of the loop's response from the closed form."""
    horizon = round(60 / seconds)
    loop = rule(horizon, seconds, 0.5).tuned(0, *simc(FirstOrder(GAIN, LAG, DEAD)))
    seen = readings(problem(Delayed(horizon, seconds=seconds)), loop)[:, 2]
    return float(np.abs(seen - 0.5 * response(np.arange(horizon) * seconds)).max())


@pytest.mark.prove
def test_a_loop_follows_its_setpoint_as_the_closed_form_does():
    """The controller decides every dt: it is off the continuous one by a part of dt."""
    coarse, fine = apart(0.5), apart(0.125)
    assert coarse < 0.02 and 3.5 < coarse / fine < 4.5


def test_an_integral_does_not_wind_up_at_a_limit():
    """At a limit I tends to the limit as applied - (applied - I0) (1 - dt / Ti)^n, and no further."""
    horizon, seconds, time = 20, 1.0, 8.0
    loop = rule(horizon, seconds).tuned(0, 5.0, time)
    memory, held = jnp.zeros(1), []
    for t in range(horizon):
        # The error stays at 1, and the control at its upper limit of 1.
        clock = np.float32(t / horizon)
        seen = jnp.array([clock, clock, 0.0, RECIPE if t == 0 else 1.0], jnp.float32)
        action, memory = loop.decide(seen, memory, Exact())
        assert action[0] == 1.0
        held.append(float(memory[0]) + (seconds / time))
    # I after n decisions is memory + dt / Ti times what was applied: base + I tends to the limit.
    n = np.arange(1, horizon)
    assert held[:-1] == pytest.approx((1 - RECIPE) * (1 - (1 - seconds / time) ** n), rel=1e-5)


@pytest.mark.prove
def test_a_load_is_taken_out_and_limits_and_ramps_are_kept():
    simulator = Delayed(400, seconds=0.5, high=0.6, ramp=0.01, load=-0.1)
    loop = rule(400, 0.5, 0.4).tuned(0, *simc(FirstOrder(GAIN, LAG, DEAD)))
    seen = readings(problem(simulator), loop)
    assert seen[-1, 2] == pytest.approx(0.4, abs=1e-3)
    assert seen[:, 3].max() <= 0.6 and np.abs(np.diff(seen[:, 3])).max() <= 0.005 + 1e-6
    # 0.5 of the control is needed, so that the limit binds on the way, and y overshoots little.
    assert seen[:, 2].max() < 0.4 * 1.08


@pytest.mark.prove
def test_both_engines_run_a_loop_and_give_the_slope_of_its_settings():
    """Gain and integral time by one adjoint pass, against central differences."""
    simulator = Delayed(60, seconds=1.0, high=0.9)
    loop = rule(60, 1.0).tuned(0, *simc(FirstOrder(GAIN, LAG, DEAD)))
    asked = problem(simulator)
    draws = Pseudo(0).draws(np.arange(2), simulator)
    weights = {"error": np.full(2, -0.5)}

    def value(gain: float, time: float) -> float:
        moved = loop.tuned(0, gain, time)
        seen = np.asarray(Xla("float64").bind(asked).values(moved, draws, Exact()).totals["error"])
        return -float(seen.mean())

    gain, time = (float(x[0]) for x in (loop.gains(), loop.times()))
    slopes = []
    for engine in (Xla("float64"), Native("float64")):
        bound = engine.bind(asked)
        totals = np.asarray(bound.values(loop, draws, Exact()).totals["error"])
        slopes.append(bound.adjoint(loop, draws, Exact(), weights).policy)
        assert -totals.mean() == pytest.approx(value(gain, time), rel=1e-9)
    h = 1e-3
    by_gain = (value(gain * math.exp(h), time) - value(gain * math.exp(-h), time)) / (2 * h)
    by_time = (value(gain, time * math.exp(h)) - value(gain, time * math.exp(-h))) / (2 * h)
    # A policy's numbers are float32: a step of 1e-3 is known to 1e-4 of itself.
    for found in slopes:
        assert float(found.log_gain[0]) == pytest.approx(by_gain, rel=2e-3)
        assert float(found.log_time[0]) == pytest.approx(by_time, rel=2e-3)


def test_a_sensor_shows_the_state_a_dead_time_ago():
    """Of a state that rises evenly it shows t - delay, also between two decisions; its first
    reading before that."""
    sensors = [Measurement("reactor.x", 0.0, 0.0, 1.0, 7.0), Measurement("reactor.y", 0, 0, 1)]
    past = initial_history(jnp.array([0.0, 5.0]), history_length(sensors, 3.0))
    seen = []
    for t in np.arange(1, 8) * 3.0:
        past = shifted(jnp.array([t, 5.0]), past)
        seen.append(float(reading(t, past[0], sensors[0], 3.0)))
        assert reading(5.0, past[1], sensors[1], 3.0) == 5.0
    assert seen == pytest.approx(np.maximum(np.arange(1, 8) * 3.0 - 7.0, 0.0), abs=1e-6)


class Jacketed(Delayed):
    """The process behind a jacket: u moves the jacket j (4 s), and j what is to be held (40 s)."""

    def initial(self, constants, noise):
        return {"y": jnp.zeros(()), "j": jnp.zeros(()), "u": jnp.full(1, RECIPE)}

    def observe(self, constants, now, state):
        return jnp.stack([now["clock"], now["clock"], state["y"], state["j"], state["u"][0]])

    def step(self, constants, now, state, action, noise, smooth):
        jacket, share = jnp.exp(-self.seconds / 4.0), jnp.exp(-self.seconds / 40.0)
        j = jacket * state["j"] + (1 - jacket) * (3 * (action[0] - RECIPE) + self.load)
        y = share * state["y"] + (1 - share) * j
        return {"y": y, "j": j, "u": action}, {"error": self.seconds * jnp.abs(1 - y)}


@pytest.mark.prove
def test_a_cascade_is_tuned_from_the_inside_and_holds_its_setpoint():
    """The jacket's load is taken out, and the outer loop asks for no more than it may."""
    horizon, most = 400, 1.3
    wires = (
        LoopConnection(0, horizon, 1.0, 2, 4, 0, 1, -most, most),
        LoopConnection(0, horizon, 1.0, 3, 4, 0, -1, 0.0, 1.0),
    )
    recipe = np.full((horizon, 1), RECIPE)
    loops = Loops(np.zeros((horizon, 1)), wires, np.zeros((2, horizon))).on(recipe)
    quiet = problem(Jacketed(horizon))
    inner = respond(quiet, loops, recipe, 1)
    assert inner.gain == pytest.approx(3.0, rel=0.02) and inner.lag == pytest.approx(4.0, rel=0.2)
    loops = loops.tuned(1, *simc(inner))
    outer = respond(quiet, loops, recipe, 0)
    assert outer.gain == pytest.approx(1.0, rel=0.05)
    loops = loops.tuned(0, *simc(outer)).with_setpoints(
        np.stack([np.ones(horizon), np.zeros(horizon)])
    )
    seen = readings(problem(Jacketed(horizon, load=-0.5)), loops)
    assert seen[-1, 2] == pytest.approx(1.0, abs=2e-3)
    assert seen[:, 3].max() < 1.1 * most and seen[:, 2].max() < 1.1
