"""Where the held derivative is reported, where a bump is, where a range, and where nothing."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import ndtr

import snapo
from snapo.problem.scenarios import Sources
from snapo.solver.certificate import certify_derivatives
from snapo.solver.derivatives.bump import reactions
from snapo.solver.derivatives.interval import HELD, RANGE, THROUGH, UNKNOWN, Verdict
from snapo.solver.derivatives.verdict import holm, reported, verdicts

PATHS = 4096


def judged(simulator, inputs, policy, output, smooth, seed=0):
    sources = Sources.of(None, seed)
    problem = snapo.Problem(simulator, inputs, snapo.Mean(output), sources)
    table = snapo.sensitivities(
        problem, policy, paths=PATHS, smooth=snapo.Smooth(np.float64(smooth))
    )
    bumped = reactions(problem, policy, PATHS, table.held)
    found = verdicts(bumped)
    result = reported(problem, table.held, table.smooth, bumped, found)
    return table._replace(verdicts=found, reported=result)


class Gain(snapo.Policy):
    """The action is a share of the only feature."""

    gain: float

    def __call__(self, features, smooth):
        return self.gain * features[:1]


class Once(snapo.Simulator):
    """One step whose constants are the inputs."""

    horizon: int = 1
    noise_size: int = 1

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.zeros(1)})


class Signal(Once):
    """x ~ N(0, v) is seen through noise of variance w; the cost is (x - action)^2."""

    action: snapo.Box = snapo.Box(-np.inf, np.inf)
    noise_size: int = 0
    initial_noise_size: int = 2

    def initial(self, constants, noise):
        x = jnp.sqrt(constants["v"]) * noise[0]
        return {"x": x, "seen": x + jnp.sqrt(constants["w"]) * noise[1]}

    def observe(self, constants, now, state):
        return state["seen"][None]

    def step(self, constants, now, state, action, noise, smooth):
        return state, {"reward": -((state["x"] - action[0]) ** 2)}


def test_where_the_state_is_not_seen_the_bump_is_reported():
    """E (x - k y)^2 = (1 - k)^2 v + k^2 w with the best k = v / (v + w): -k^2 by w, held nothing."""
    v, w = 2.0, 1.0
    k = v / (v + w)
    inputs = {"v": snapo.Input(v), "w": snapo.Input(w)}
    table = judged(Signal(), inputs, Gain(k), "reward", 0.01)
    assert table.source("w") == THROUGH
    assert table.held["w"].value == 0 and table.held["w"].standard_error == 0
    interval = table.along("w", np.ones(()))
    assert interval.contains(-(k**2)) and interval.high - interval.low < 0.2 * k**2
    assert interval.policy == 0  # no search was made
    assert abs(table.verdicts["w"].bump[0] + 0.01 * w * k**2) < 4 * table.verdicts["w"].bump[1]


class Reservoir(Once):
    """One inflow: `worth` a unit of water, and a prize for a level above fifty."""

    hidden: bool = False
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def initial(self, constants, noise):
        return constants["water"]

    def observe(self, constants, now, state):
        return state[None] / 50

    def step(self, constants, now, state, action, noise, smooth):
        level = state + 5 * noise[0]
        above = level > 50 if self.hidden else smooth.indicator(level - 50, 10.0)
        return level, {"cash": constants["worth"] * level + constants["prize"] * above}


@pytest.mark.prove
@pytest.mark.parametrize("hidden", [False, True])
def test_across_a_jump_the_bump_is_reported(hidden):
    """By the water worth + prize phi / 5; held decisions see the worth alone."""
    water, worth, prize = 48.0, 2.0, 100.0
    given = {"water": water, "worth": worth, "prize": prize}
    inputs = {name: snapo.Input(value) for name, value in given.items()}
    table = judged(Reservoir(hidden=hidden), inputs, Gain(0.0), "cash", 0.02)
    assert table.source("water") == THROUGH
    assert table.source("worth") == table.source("prize") == HELD
    z = np.array([0.99, 1.01]) * water / 5 - 10
    probability = np.diff(ndtr(z))[0] / 2  # half the difference of the two moves
    expected = 0.01 * water * worth + prize * probability
    verdict = table.verdicts["water"]
    assert abs(verdict.bump[0] - expected) < 4 * verdict.bump[1]
    row = next(row for row in table.rows() if row.input == "water")
    assert row.source == THROUGH and THROUGH in str(table)
    assert row.low < expected / (0.01 * water) < row.high


class Callers(Once):
    """A whole number of callers, each served for a fee while there is stock."""

    action: snapo.Box = snapo.Box(0.0, 1.0)

    def initial(self, constants, noise):
        return constants["stock"]

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def step(self, constants, now, state, action, noise, smooth):
        callers = jnp.floor(constants["rate"] * jnp.exp(0.3 * noise[0]))
        return state, {"cash": constants["fee"] * smooth.minimum(callers, state)}


WRONG = {
    "an indicator of an input": (Reservoir(), Gain(0.0), "cash", "water",
                                 {"water": 48.0, "worth": 2.0, "prize": 100.0}),
    "partial observation": (Signal(), Gain(2 / 3), "reward", "v w", {"v": 2.0, "w": 1.0}),
    "a mean of whole numbers": (Callers(), Gain(0.0), "cash", "rate",
                                {"stock": 6.5, "rate": 4.0, "fee": 1.5}),
}  # fmt: skip


@pytest.mark.prove
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_held_derivative_is_refuted_and_the_right_ones_are_kept(name):
    """In nine of ten seeds."""
    simulator, policy, output, wrong, given = WRONG[name]
    inputs = {key: snapo.Input(value) for key, value in given.items()}
    refuted = kept = 0
    for seed in range(10):
        table = judged(simulator, inputs, policy, output, 0.02, seed)
        held = {key for key in given if table.source(key) == HELD}
        refuted += held.isdisjoint(wrong.split())
        kept += held >= set(given) - set(wrong.split())
    assert refuted >= 9 and kept >= 9, (refuted, kept)


class Sale(Once):
    """A sale of the lesser of two amounts that are equal."""

    action: snapo.Box = snapo.Box(0.0, 1.0)

    def initial(self, constants, noise):
        return jnp.zeros(())

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def step(self, constants, now, state, action, noise, smooth):
        sold = smooth.minimum(constants["stock"], constants["room"])
        return state, {"cash": sold * jnp.exp(0.1 * noise[0] - 0.005)}


@pytest.mark.prove
def test_at_a_kink_the_range_of_both_sides_is_reported():
    """One unit more of either is worth nothing, one unit less one: any share is a derivative."""
    inputs = {"stock": snapo.Input(10.0), "room": snapo.Input(10.0), "none": snapo.Input(0.0)}
    table = judged(Sale(), inputs, Gain(0.0), "cash", 0.01)
    assert set(table.verdicts) == {"stock", "room"}  # of a zero nobody said by how much it moves
    for name in ("stock", "room"):
        verdict = table.verdicts[name]
        assert verdict.up == pytest.approx(0, abs=1e-12)
        assert verdict.down == pytest.approx(0.1, abs=3 * verdict.side_error + 1e-12)
        assert verdict.source == RANGE and verdict.two_sided and verdict.corner == "kink"
        interval = table.along(name, np.ones(()))
        assert interval.contains(0.0) and interval.contains(1.0)
        assert interval.low > -0.1 and interval.high < 1.1
    problem = snapo.Problem(Sale(), inputs, snapo.Mean("cash"))
    bumps = {each.input: each for each in certify_derivatives(problem, Gain(0.0), paths=64)}
    # The adjoint at the reported inputs is one of the two sides.
    for name in ("stock", "room"):
        assert bumps[name].passed and bumps[name].kink
        assert sorted((bumps[name].up, bumps[name].down))[0] == pytest.approx(0, abs=1e-9)


def test_holm_refutes_a_right_one_in_one_run_of_a_hundred():
    """Twenty right ones: at 5 % each, two runs of three would lose one by chance."""
    rng = np.random.default_rng(0)
    names = [str(i) for i in range(20)]
    lost = [bool(holm(dict(zip(names, rng.uniform(size=20))))) for _ in range(4000)]
    assert 0.005 < np.mean(lost) < 0.015
    assert holm({"a": 1e-9, "b": 0.004, "c": 0.5}) == {"a", "b"}
    assert holm({"a": 0.004, "b": 0.004, "c": 0.5}) == set()


def test_a_verdict_comes_back_from_plain_data():
    stored = ["held", [1, 0.1], [1.1, 0.2], [0.1, 0.1], 1.0, 1.2, 0.1, 0.3, True, ""]
    assert Verdict.of(stored) == Verdict(
        "held", (1, 0.1), (1.1, 0.2), (0.1, 0.1), 1.0, 1.2, 0.1, 0.3, True
    )


class Sure(Once):
    """No noise at all, and a value that bends: the cube of an input."""

    noise_size: int = 0
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def initial(self, constants, noise):
        return jnp.zeros(())

    def observe(self, constants, now, state):
        return state[None]

    def step(self, constants, now, state, action, noise, smooth):
        jump = jnp.where(constants["width"] > 2.001, 1.0, 0.0)
        return state, {"cash": constants["width"] ** 3 + constants["size"] ** 3 + jump}


def test_without_noise_a_bend_is_no_doubt_and_a_jump_is_one():
    """Sides of a hundredth differ by a ten-thousandth of the third order, and round-off is far
    less; where the value jumps, no move supports a derivative."""
    inputs = {"width": snapo.Input(2.0), "size": snapo.Input(3.0)}
    table = judged(Sure(), inputs, snapo.Constant([0.5]), "cash", 0.01)
    assert float(table.held["size"].value) == pytest.approx(27.0)
    assert table.source("size") == HELD
    assert table.source("width") == UNKNOWN
    size = table.along("size", np.ones(()))
    assert size.contains(27.0) and size.high - size.low < 0.1
    assert not np.isfinite(table.along("width", np.ones(())).value)
