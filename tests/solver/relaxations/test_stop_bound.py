"""The bound of a stopping problem, with nothing asked of its user: against exact values."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.solver.relaxations.stop import relaxation_of
from snapo.solver.relaxations.value import MAXIMUM, NotStopping, decisions, exponents

STRIKE, RATE, VOLATILITY, DATES = 40.0, 0.06, 0.2, 4
STEP = 1 / DATES
DRIFT, DEVIATION = (RATE - VOLATILITY**2 / 2) * STEP, VOLATILITY * STEP**0.5


class Rights(snapo.Simulator):
    """Rights to sell at 40 on four dates and at the end of a year; waiting costs a fee."""

    horizon: int = DATES
    noise_size: int = 1
    action: snapo.Stop = snapo.Stop(rights=2)
    fee: float = 0.05

    def prepare(self, inputs):
        year = jnp.arange(float(DATES)) / DATES
        steps = {"left": 1 - year, "discount": jnp.exp(-RATE * year)}
        return snapo.Schedule({"spot": inputs["spot"]}, steps)

    def initial(self, constants, noise):
        return {"spot": constants["spot"], "right": self.action.initial()}

    def observe(self, constants, now, state):
        return jnp.stack([jnp.log(state["spot"] / STRIKE), now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        right, used = self.action.use(state["right"], action)
        payoff = jnp.maximum(STRIKE - state["spot"], 0.0)
        spot = state["spot"] * jnp.exp(DRIFT + DEVIATION * noise[0])
        cash = used * now["discount"] * payoff - self.fee * self.action.left(right)
        return {"spot": spot, "right": right}, {"cash": cash}

    def terminal(self, constants, state, smooth):
        payoff = jnp.maximum(STRIKE - state["spot"], 0.0)
        return {"cash": self.action.alive(state["right"]) * jnp.exp(-RATE) * payoff}


class BelowStrike(snapo.Policy):
    """Uses a right whenever it is worth a tenth of the strike."""

    def __call__(self, observation, smooth):
        return jnp.full(2, jnp.where(observation[0] < np.log(0.9), 1.0, 0.0))


def exact(rights: int, fee: float) -> float:
    """The value by quadrature on a fine grid of ln(S / 40), S = 36 today."""
    logs = np.linspace(-1.5, 1.5, 3001)
    points, weights = np.polynomial.hermite_e.hermegauss(41)
    gain = np.maximum(STRIKE * (1 - np.exp(logs)), 0.0)
    value = np.zeros((rights + 1, len(logs)))
    value[1:] = np.exp(-RATE) * gain
    for t in reversed(range(DATES)):
        moved = logs[:, None] + DRIFT + DEVIATION * points
        after = [np.interp(moved, logs, row) @ (weights / weights.sum()) for row in value]
        after = np.array(after) - fee * np.arange(rights + 1)[:, None]
        value[1:] = np.maximum(after[1:], np.exp(-RATE * t * STEP) * gain + after[:-1])
    return float(np.interp(np.log(0.9), logs, value[rights]))


def problem(simulator=None, objective=None) -> snapo.Problem:
    inputs = {"spot": snapo.Input(36.0)}
    return snapo.Problem(simulator or Rights(), inputs, objective or snapo.Mean("cash"))


@pytest.mark.study
def test_two_rights_lie_between_the_bounds_of_a_simple_rule():
    """The upper bound is near the exact value although the rule is not; without the penalty the
    bound is that of perfect foresight."""
    given, relaxation = problem(), relaxation_of(problem())
    found = snapo.bound(given, BelowStrike(), relaxation=relaxation, paths=1024)
    known = exact(2, 0.05)
    assert found.lower.high < known < found.upper.value + 3 * found.upper.standard_error
    assert found.upper.value < 1.005 * known
    blind = snapo.bound(given, BelowStrike(), relaxation=relaxation, paths=1024, penalty="none")
    assert blind.upper.value > 1.2 * known


def test_there_are_never_too_many_functions():
    assert exponents(2)[:4] == [(), (0,), (1,), (0, 0)]
    assert all(len(exponents(many)) <= max(MAXIMUM, many + 1) for many in range(1, 120))


class Moved(Rights):
    """Its decision moves another state than the rights."""

    def initial(self, constants, noise):
        return super().initial(constants, noise) | {"sold": jnp.zeros(())}

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = super().step(constants, now, state, action, noise, smooth)
        return after | {"sold": state["sold"] + action[0]}, outputs


class Boxed(Rights):
    """No stopping problem."""

    action: snapo.Box = snapo.Box(0.0, 1.0)


class Largest(Rights):
    """Its total is no sum."""

    def totals(self):
        return {"cash": "max"}


@pytest.mark.prove
def test_a_decision_that_moves_the_state_is_refused():
    with pytest.raises(NotStopping, match=r"change the state .*sold.*, not only rights"):
        decisions(problem(Moved()))


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (problem(Boxed()), "its action is a Box"),
        (problem(Largest()), "not a mean of outputs that are summed"),
        (problem(objective=snapo.CVaR("cash", 0.9)), "not a mean of outputs that are summed"),
    ],
)
def test_problems_without_this_bound_are_refused_in_words(other, reason):
    with pytest.raises(NotStopping, match=reason):
        decisions(other)


def test_no_relaxation_is_known_of_another_action():
    with pytest.raises(ValueError, match="no method `relaxation` and is not a stopping problem"):
        snapo.bound(problem(Boxed()), BelowStrike())


def test_supplied_paths_are_refused():
    supplied = snapo.Supplied(np.zeros((DATES, 256, 1)))
    given = replace(problem(), sources=snapo.Sources.of(supplied))
    with pytest.raises(ValueError, match="no nested paths can be drawn"):
        snapo.bound(given, BelowStrike())
