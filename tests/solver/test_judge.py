"""Where the held derivative is the one to believe, where the smooth one is, and where neither."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import ndtr

import snapo
from snapo.solver.certificate import certify_derivatives
from snapo.solver.judge import UNKNOWN, Verdict, judge

PATHS = 4096


def judged(simulator, inputs, policy, output, smooth):
    problem = snapo.Problem(simulator, inputs, snapo.Mean(output))
    table = snapo.sensitivities(problem, policy, PATHS, smooth=snapo.Smooth(np.float64(smooth)))
    verdicts = judge(problem, policy, PATHS, table.held, table.smooth)
    return table._replace(verdicts=verdicts)


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

    action: snapo.Box = snapo.Box(1)
    noise_size: int = 0
    initial_noise_size: int = 2

    def initial(self, constants, noise):
        x = jnp.sqrt(constants["v"]) * noise[0]
        return {"x": x, "seen": x + jnp.sqrt(constants["w"]) * noise[1]}

    def observe(self, constants, now, state):
        return state["seen"][None]

    def step(self, constants, now, state, action, noise, smooth):
        return state, {"reward": -((state["x"] - action[0]) ** 2)}


def test_where_the_state_is_not_seen_the_smooth_one_is_believed():
    """E (x - k y)^2 = (1 - k)^2 v + k^2 w with the best k = v / (v + w): -k^2 by w, held nothing."""
    v, w = 2.0, 1.0
    k = v / (v + w)
    inputs = {"v": snapo.Input(v), "w": snapo.Input(w)}
    table = judged(Signal(), inputs, Gain(k), "reward", 0.01)
    assert table.believed("w") == "smooth"
    assert table.held["w"].value == 0 and table.held["w"].standard_error == 0
    error = float(table.smooth["w"].standard_error)
    assert abs(table.smooth["w"].value + k**2) < 4 * error
    assert abs(table.verdicts["w"].change + 0.01 * w * k**2) < 4 * table.verdicts["w"].error


class Reservoir(Once):
    """One inflow: `worth` a unit of water, and a prize for a level above fifty."""

    hidden: bool = False
    action: snapo.Box = snapo.Box(1, 0.0, 1.0)

    def initial(self, constants, noise):
        return constants["water"]

    def observe(self, constants, now, state):
        return state[None] / 50

    def step(self, constants, now, state, action, noise, smooth):
        level = state + 5 * noise[0]
        above = level > 50 if self.hidden else smooth.indicator(level - 50, 10.0)
        return level, {"cash": constants["worth"] * level + constants["prize"] * above}


@pytest.mark.parametrize(("hidden", "believed"), [(False, "smooth"), (True, UNKNOWN)])
def test_across_a_jump_the_held_one_is_not_believed(hidden, believed):
    """By the water worth + prize phi / 5; held decisions see the worth alone."""
    water, worth, prize = 48.0, 2.0, 100.0
    given = {"water": water, "worth": worth, "prize": prize}
    inputs = {name: snapo.Input(value) for name, value in given.items()}
    table = judged(Reservoir(hidden=hidden), inputs, Gain(0.0), "cash", 0.02)
    assert table.believed("water") == believed
    assert table.believed("worth") == table.believed("prize") == "held"
    z = np.array([0.99, 1.01]) * water / 5 - 10
    chance = np.diff(ndtr(z))[0] / 2  # half the difference of the two moves
    expected = 0.01 * water * worth + prize * chance
    verdict = table.verdicts["water"]
    assert abs(verdict.change - expected) < 4 * verdict.error
    row = next(row for row in table.rows() if row.input == "water")
    assert row.believed == believed and believed in str(table)


class Sale(Once):
    """A sale of the lesser of two amounts that are equal."""

    action: snapo.Box = snapo.Box(1, 0.0, 1.0)

    def initial(self, constants, noise):
        return jnp.zeros(())

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def step(self, constants, now, state, action, noise, smooth):
        sold = smooth.minimum(constants["stock"], constants["room"])
        return state, {"cash": sold * jnp.exp(0.1 * noise[0] - 0.005)}


def test_at_a_tie_both_sides_are_told():
    """One unit more of either is worth nothing, one unit less one: any share of it is believed."""
    inputs = {"stock": snapo.Input(10.0), "room": snapo.Input(10.0), "none": snapo.Input(0.0)}
    table = judged(Sale(), inputs, Gain(0.0), "cash", 0.01)
    assert set(table.verdicts) == {"stock", "room"}  # of a zero nobody said by how much it moves
    for name in ("stock", "room"):
        verdict = table.verdicts[name]
        assert verdict.up == pytest.approx(0, abs=1e-12)
        assert verdict.down == pytest.approx(0.1, abs=3 * verdict.error + 1e-12)
        assert verdict.supported == "held" and verdict.two_sided and verdict.tie
    problem = snapo.Problem(Sale(), inputs, snapo.Mean("cash"))
    bumps = {each.input: each for each in certify_derivatives(problem, Gain(0.0), 64)}
    # The adjoint at the reported inputs is one of the two sides.
    for name in ("stock", "room"):
        assert bumps[name].passed and bumps[name].kink
        assert sorted((bumps[name].up, bumps[name].down))[0] == pytest.approx(0, abs=1e-9)


def test_three_standard_errors_decide_and_the_likelier_one():
    assert Verdict(1.0, 1.0, 0.1, (1.29, 0.0), None).supported == "held"
    assert Verdict(1.0, 1.0, 0.1, (1.31, 0.0), (0.8, 0.0)).supported == "smooth"
    assert Verdict(1.0, 1.0, 0.1, (1.31, 0.0), (0.6, 0.0)).supported == UNKNOWN
    assert Verdict(1.0, 1.0, 0.1, (np.nan, 0.0), None).supported == UNKNOWN
    # Both within three errors: by likelihoods of z 2.5 and 1, of 2 and 1.
    assert Verdict(1.0, 1.0, 0.1, (1.25, 0.0), (0.9, 0.0)).supported == "smooth"
    assert Verdict(1.0, 1.0, 0.1, (1.20, 0.0), (0.9, 0.0)).supported == "held"
    curved = Verdict(0.5, 1.5, 0.1, (1.6, 0.0), None)
    assert (curved.supported, curved._replace(tie=True).supported) == (UNKNOWN, "held")
    assert Verdict.of([1, 2, 0.1, [1, 0], None, True]) == Verdict(1, 2, 0.1, (1, 0), None, True)


class Sure(Once):
    """No noise at all, and a value that bends: the cube of an input."""

    noise_size: int = 0
    action: snapo.Box = snapo.Box(1, 0.0, 1.0)

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
    assert table.believed("size") == "held"
    assert table.believed("width") == UNKNOWN


def test_a_smooth_derivative_with_a_wide_error_is_not_believed_for_its_width():
    """Near to the move in its own wide error, while the held one is 2.3 errors away and sharp."""
    verdict = Verdict(1.0, 1.0, 0.2, (0.5, 0.08), (3.0, 4.0))
    assert verdict.supported == "held"
    assert verdict._replace(smooth=(1.0, 0.08)).supported == "smooth"
