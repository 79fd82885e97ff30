"""The bound from above, with a relaxation of a user's own: a swing put of a few rights.

Fifty dates, S = K = 40, r = 6 %, volatility 20 %, one year; at most one right a date. Exact values
by a fine lattice: 2.3140 for one right, 6.8707 for three.
"""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from snapo import Box, Input, Mean, Policy, Problem, Pseudo, Simulator, Xla
from snapo.cli.answers import bounds, summary
from snapo.problem.noise import Draws
from snapo.problem.simulator import Schedule
from snapo.solver.bound import Between, Bound, bound, nested_mean
from snapo.study.chapters.bound import ValueBounds, sentence

DATES, STRIKE, RATE, VOLATILITY = 50, 40.0, 0.06, 0.2
STEP = 1.0 / DATES
DRIFT, DEVIATION = (RATE - VOLATILITY**2 / 2) * STEP, VOLATILITY * np.sqrt(STEP)
DISCOUNT = np.exp(-RATE * STEP * np.arange(1, DATES + 1))
LOGS = np.linspace(-1.2, 1.2, 961)  # ln(S / 40) of the table of values


class SwingPut(Simulator):
    """The first date is one step from today; the state is ln(S / 40) and the rights left."""

    rights: int = eqx.field(static=True, default=1)
    action: Box = eqx.field(static=True, default=Box(0.0, 1.0))
    horizon: int = eqx.field(static=True, default=DATES)
    noise_size: int = eqx.field(static=True, default=1)
    initial_noise_size: int = eqx.field(static=True, default=1)

    def prepare(self, inputs):
        steps = {"discount": jnp.asarray(DISCOUNT), "kept": jnp.asarray(self.kept())}
        return Schedule({"strike": inputs["strike"]}, steps)

    def kept(self) -> np.ndarray:
        """[T, rights] the price below which an exercise with so many rights left pays best."""
        gain, after = np.maximum(STRIKE * (1 - np.exp(LOGS)), 0.0), table(self.rights)[0]
        found = np.full((DATES, self.rights), -np.inf)
        for t in range(DATES):
            for k in range(1, self.rights + 1):
                use = DISCOUNT[t] * gain + after[t, k - 1] > after[t, k]
                pays = LOGS[use & (gain > 0)]
                found[t, k - 1] = pays[-1] if len(pays) else -9.0
        return found

    def initial(self, constants, noise):
        return {"log": DRIFT + DEVIATION * noise[0], "left": jnp.asarray(float(self.rights))}

    def observe(self, constants, now, state):
        row = jnp.clip(state["left"] - 1, 0, self.rights - 1).astype(int)
        return jnp.stack([now["kept"][row] - state["log"], state["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        used = jnp.minimum(action[0], state["left"])
        gain = constants["strike"] - STRIKE * jnp.exp(state["log"])
        after = {
            "log": state["log"] + DRIFT + DEVIATION * noise[0],
            "left": state["left"] - used,
        }
        return after, {"cash": now["discount"] * used * jnp.maximum(gain, 0.0)}

    def terminal(self, constants, state, smooth):
        return {"cash": jnp.zeros(())}


class Exercise(Policy):
    """Uses a right below a price; `shift` makes it worse."""

    shift: float = 0.0

    def __call__(self, observation, smooth):
        return jnp.stack([jnp.where(observation[0] + self.shift > 0, 1.0, 0.0)])


@cache
def table(rights: int) -> tuple[np.ndarray, np.ndarray]:
    """Values [T, rights + 1, logs] after each date and at the start of each, by quadrature."""
    points, weights = np.polynomial.hermite_e.hermegauss(21)
    weights = weights / weights.sum()
    gain = np.maximum(STRIKE * (1 - np.exp(LOGS)), 0.0)
    after, start = np.zeros((2, DATES, rights + 1, len(LOGS)))
    value = np.zeros((rights + 1, len(LOGS)))
    for t in reversed(range(DATES)):
        after[t] = value
        start[t] = value
        start[t, 1:] = np.maximum(value[1:], DISCOUNT[t] * gain + value[:-1])
        moved = LOGS[:, None] + DRIFT + DEVIATION * points
        value = np.array([np.interp(moved, LOGS, row) @ weights for row in start[t]])
    return after, start


class Rights:
    """The inner problem: which dates to use, all prices known; V by nested draws."""

    terms, description = 1, "surprises of a lattice's value, its expectations from nested draws"

    def __init__(self, rights: int, start: np.ndarray, draws: int = 16, error: float = 0.0):
        self.rights, self.start, self.draws, self.error = rights, start, draws, error

    def surprises(self, logs: np.ndarray, draws: Draws) -> np.ndarray:
        """[T, rights + 1, N] V at each date less its nested mean a date before."""
        found = np.zeros((DATES, self.rights + 1, logs.shape[1]))
        for t in range(1, DATES):
            base = logs[t - 1] + DRIFT

            def value(noise, t=t, base=base):
                rows = [np.interp(base + DEVIATION * noise[0], LOGS, v) for v in self.start[t]]
                return (1 + self.error) * np.stack(rows)

            here = (logs[t] - base) / DEVIATION
            seed = t, int(draws.paths[0])  # of this block of paths
            mean = nested_mean(value, 1, logs.shape[1], self.draws, seed)
            found[t] = value(here[None]) - mean
        return found

    def best(self, rolled, draws, scale):
        logs = np.asarray(rolled.record["state"]["log"])
        gain = DISCOUNT[:, None] * np.maximum(STRIKE * (1 - np.exp(logs)), 0.0)
        charge = scale[0] * self.surprises(logs, draws)
        value = np.zeros((self.rights + 1, logs.shape[1]))
        for t in reversed(range(DATES)):
            value[1:] = np.maximum(value[1:], gain[t] + value[:-1])
            value -= charge[t]
        return value[self.rights]

    def charged(self, rolled, draws, scale):
        state = rolled.record["state"]
        logs, left = np.asarray(state["log"]), np.asarray(state["left"]).astype(int)
        paths = np.arange(logs.shape[1])
        charge = scale[0] * self.surprises(logs, draws)
        return np.sum([charge[t][left[t], paths] for t in range(DATES)], axis=0)


def swing(rights: int, shift: float = 0.0):
    start = table(rights)[1]
    inputs = {"strike": Input(np.float64(STRIKE), unit="EUR")}
    problem = Problem(SwingPut(rights=rights), inputs, Mean("cash"))
    return problem, Exercise(shift), Rights(rights, start)


ENGINE = Xla(precision="float64")


@pytest.mark.prove
@pytest.mark.parametrize(("rights", "exact"), [(1, 2.3140), (3, 6.8707)])
def test_a_swing_put_lies_between_its_bounds(rights, exact):
    problem, policy, relaxation = swing(rights)
    relaxation.draws = 64
    found = bound(problem, policy, relaxation=relaxation, paths=1024, engine=ENGINE)
    assert found.lower.low <= exact <= found.upper.high
    assert found.gap.high <= 0.004 * exact
    assert "95 %" in str(found) and found.penalty == "value"


def test_a_bad_policy_has_a_wide_gap_and_the_bound_stays():
    problem, _, relaxation = swing(1)
    good, bad = (
        bound(problem, Exercise(s), relaxation=relaxation, paths=256, engine=ENGINE)
        for s in (0.0, 0.3)
    )
    assert bad.gap.value > 20 * good.gap.value
    assert bad.upper == good.upper


def test_without_a_penalty_the_bound_is_perfect_foresight_and_wide():
    problem, policy, relaxation = swing(1)
    found = bound(problem, policy, relaxation=relaxation, paths=256, penalty="none", engine=ENGINE)
    assert found.penalty == "none" and found.upper.value > 1.3 * 2.3140


def test_a_trained_scale_undoes_a_penalty_that_is_too_large():
    problem, policy, relaxation = swing(1)
    wrong = Rights(1, relaxation.start, error=0.15)
    plain, trained = (
        bound(problem, policy, relaxation=wrong, paths=256, penalty=each, engine=ENGINE)
        for each in ("value", "trained")
    )
    assert trained.scale[0] == pytest.approx(1 / 1.15, abs=0.03)
    assert trained.upper.high >= 2.3140 and trained.upper.value < plain.upper.value


def test_what_is_no_relaxation_is_refused(monkeypatch):
    problem, policy, relaxation = swing(1)
    monkeypatch.setattr(relaxation, "best", lambda *given: np.zeros(64))
    with pytest.raises(ValueError, match="not a valid relaxation"):
        bound(problem, policy, relaxation=relaxation, paths=64, engine=ENGINE)


def test_only_a_mean_is_bounded():
    from snapo import CVaR

    problem, policy, relaxation = swing(1)
    with pytest.raises(ValueError, match="only for a mean"):
        bound(
            replace(problem, objective=CVaR("cash", 0.9)), policy, relaxation=relaxation, paths=64
        )


def test_intervals_count_antithetic_pairs_once():
    problem, policy, relaxation = swing(1)
    given = {"relaxation": relaxation, "paths": 256, "engine": ENGINE}
    found = bound(problem, policy, source=Pseudo(5), **given)
    plain = bound(problem, policy, source=Pseudo(5, antithetic=False), **given)
    for each in (found.upper, plain.upper):
        assert each.low < each.value < each.high
    # Student's t of 127 and of 255 degrees of freedom.
    reach = (found.upper.high - found.upper.value) / found.upper.standard_error
    assert reach == pytest.approx(1.9788, abs=1e-3)


def bounded(gap: float, error: float, value: float = 40.0) -> Bound:
    """A bound as few paths give it: their own value is lower than that of many."""
    own = Between(value - 5, error, value - 5 - 2 * error, value - 5 + 2 * error)
    above = Between(own.value + gap, error, own.low + gap, own.high + gap)
    between = Between(gap, error, max(gap - 2 * error, 0.0), gap + 2 * error)
    return Bound(own, above, between, "value", "a penalty", (1.0,), 64)


def test_the_bound_of_a_value_is_that_value_and_the_gap():
    """On paths of its own the bound of 40.18 lay below the value of 40.35."""
    found = bounded(4.83, 5.28, 40.35)
    assert found.upper.value < 40.35
    above = found.above(40.35, 0.3, Mean("profit"))
    assert above.lower.value == 40.35 and above.upper.value == pytest.approx(40.35 + 4.83)
    assert above.gap == found.gap and above.upper.low <= above.upper.value <= above.upper.high
    assert above.upper.standard_error == pytest.approx(np.hypot(0.3, 5.28))
    assert above.row()["upper"]["value"] == above.upper.value


@pytest.mark.parametrize(
    ("gap", "error", "little"),
    [(0.7, 0.1, False), (0.9, 0.1, True), (0.1, 0.25, True), (0.1, 0.15, False), (9.0, 5.0, True)],
)
def test_a_wide_bound_says_that_it_says_little(gap, error, little):
    """Above 2 % of the value, or with an error above 0.5 % of it; printed wherever it is shown."""
    found = bounded(gap, error).above(40.0, 0.01, Mean("profit"))
    assert bool(found.says_little) == little
    result = {"bound": found.row(), "references": {"upper_bound": found.upper.value}, "run": "run"}
    places = (str(found), found._repr_html_(), bounds(result), summary(result))
    assert [("says little" in each) for each in places] == [little] * 4
    assert ("says little" in sentence(Shown(), ValueBounds.of(found), 2)) == little  # pyright: ignore


class Shown:
    """As much of a run as the sentence on its bound needs."""

    def value_text(self, value: float, error: None, places: int) -> str:
        return f"EUR {value:.{places}f}"
