"""Learning in a model: a line with a closed form (prove), and Gymnasium's classics (study)."""

import numpy as np
import pytest

import snapo
from snapo.checker.check import problem_mistakes, simulator_mistakes
from snapo.solver import statistics

gymnasium = pytest.importorskip("gymnasium")
import snapo.gym  # noqa: E402
from snapo.gym.black_box.model import Model  # noqa: E402
from snapo.gym.black_box.rounds import value  # noqa: E402

ENGINES = ("auto", "xla")

PUSH, CHANCE, DECISIONS = 0.5, 0.1, 12


class Line(gymnasium.Env):
    """x' = x + u / 2 + 0.1 normal at a cost of x^2 + u^2 / 4; 12 steps."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-2.0, 2.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = self.np_random.uniform(-1, 1), 0
        return np.array([self.x], np.float32), {}

    def step(self, action):
        u = float(action[0])
        cost = self.x**2 + u**2 / 4
        self.x += PUSH * u + CHANCE * self.np_random.standard_normal()
        self.t += 1
        return np.array([self.x], np.float32), -cost, False, self.t >= DECISIONS, {}


def riccati() -> tuple[float, float]:
    """The least expected cost, the start's x^2 being 1 / 3 on average; and the first gain."""
    worth, constant, gain = 0.0, 0.0, 0.0
    for _ in range(DECISIONS):
        gain = PUSH * worth / (1 / 4 + PUSH**2 * worth)
        constant += CHANCE**2 * worth
        worth = 1 + gain**2 / 4 + worth * (1 - PUSH * gain) ** 2
    return worth / 3 + constant, gain


@pytest.fixture(scope="module")
def line():
    training = snapo.Training(steps=60, paths=128, learning_rate=0.02, window=None, warmup=5)
    return snapo.learn(
        Line, steps=1200, limit=DECISIONS, rounds=2, hidden=(16, 16), members=2, horizon=DECISIONS,
        training=training,
    )  # fmt: skip


@pytest.mark.prove
def test_a_linear_system_is_learnt_to_its_optimum(line):
    """Beside Riccati's rule on the same starts and chances, and its closed form."""
    least, gain = riccati()
    played = line.play(1000)
    best = snapo.gym.play(lambda seen: np.clip(-gain * seen, -2, 2), _limited, 1000)
    assert abs(best.mean + least) < 4 * best.standard_error
    worse = statistics.mean(best.rewards - played.rewards)
    assert worse.value < 0.03 * least, (worse, least)


def _limited():
    return gymnasium.wrappers.TimeLimit(Line(), DECISIONS)


@pytest.mark.prove
def test_the_result_tells_both_values_and_their_gap(line):
    assert (
        line.steps <= 1200 and line.steps == line.rounds[-1].steps + 12 * line.comparison.episodes
    )
    assert line.gap == pytest.approx(line.value - line.model_value)
    assert abs(line.gap) < 4 * line.comparison.gap_error  # 10 episodes
    assert line.inputs["spread"] == pytest.approx(CHANCE, rel=0.3)  # of 62 rows held out
    assert "gap" in str(line) and "policy of round" in str(line)
    assert isinstance(line.policy, snapo.MLP)


@pytest.mark.prove
def test_the_model_is_a_simulator_as_any_other(line):
    """Without a mistake, and the same in both engines."""
    problem = snapo.Problem(line.model, line.inputs, snapo.Mean("reward"))
    assert not simulator_mistakes(line.model, line.inputs).errors
    assert not problem_mistakes(problem, line.policy).errors
    firsts = np.linspace(-1, 1, 5)[:, None]
    found = [value(line.model, line.inputs, line.policy, firsts, each, 0) for each in ENGINES]
    assert found[0].shape == (5,) and np.allclose(*found, rtol=1e-4)


def constant(told: np.ndarray, chance: float = 0.0):
    """A model of two observed numbers and one action whose networks always say the same."""
    told = np.asarray(told, np.float32)
    hidden = np.zeros((2, 1, 3), np.float32), np.zeros((2, 1), np.float32)
    layers = [hidden, (np.zeros((2, told.size, 1), np.float32), np.stack([told, told]))]
    far = np.full(2, 100.0, np.float32)
    return {
        "layers": layers, "spread": np.full(2, chance, np.float32), "low": -far, "high": far,
        "shift": np.zeros(2, np.float32), "scale": np.ones(2, np.float32),
        "starts": np.array([[0.6, 0.8]] * 4, np.float32),
    }  # fmt: skip


def total(model: Model, inputs, smooth=snapo.Exact(), steps: int = 4):
    """The reward of a path, and the last state; the action is 1 and the noise 0.5 at every step."""
    state, rewards = model.initial(inputs, np.zeros(2, np.float32)), []
    action, noise = np.ones(1, np.float32), np.full(2, 0.5, np.float32)
    for _ in range(steps):
        state, outputs = model.step(inputs, {}, state, action, noise, smooth)
        rewards.append(float(outputs["reward"]))
    return sum(rewards), state


def small(**options) -> Model:
    return Model(4, snapo.Box(-1.0, 1.0), 2, 2, **options)


@pytest.mark.prove
def test_an_end_pays_once_and_nothing_comes_after():
    """With a hazard p a path's reward is the sum of (1 - p)^t ((1 - p) a + p b)."""
    odds = np.log(0.25 / 0.75)
    inputs = constant([0, 0, -1.0, 100.0, odds])
    alive = 0.75 ** np.arange(4)
    expected = np.sum(alive * (0.75 * -1 + 0.25 * 100))
    assert total(small(can_end=True), inputs)[0] == pytest.approx(expected, rel=1e-5)
    assert total(small(can_end=False), inputs)[0] == pytest.approx(-4)
    # In training an end is felt from farther away.
    wide = snapo.Smooth(np.float32(0.005))
    felt = 1 / (1 + np.exp(-odds / 2))
    _, state = total(small(can_end=True), inputs, wide, 1)
    assert float(state["alive"]) == pytest.approx(1 - felt, rel=1e-5)


@pytest.mark.prove
def test_known_rewards_and_ends_take_the_place_of_learnt_ones():
    """The state moves by 1 a step and ends above 2.5: at the third."""
    inputs = constant([1.0, 0, -1.0, 100.0, 9.0])

    def reward(seen, action, after):
        return 10 * after[0] + action[0]

    def over(after):
        return after[0] - 2.5

    found, state = total(small(can_end=True, reward=reward, over=over), inputs)
    assert found == pytest.approx(10 * (1.6 + 2.6) + 2) and float(state["alive"]) == 0
    assert total(small(can_end=False, over=over), inputs)[0] == pytest.approx(-1 + 100)


@pytest.mark.prove
def test_a_model_stays_on_its_circle_and_within_its_range():
    _, state = total(small(can_end=False, circles=((0, 1),)), constant([0.3, 0.1, 0, 0, 0], 0.2))
    assert float(np.hypot(*state["seen"])) == pytest.approx(1, abs=1e-6)
    _, state = total(small(can_end=False), constant([90.0, 0, 0, 0, 0], 0.2))
    # A clip to 100 in single precision.
    assert state["seen"].tolist() == pytest.approx([100, 0.8 + 4 * 0.2 * 0.5], rel=1e-5)


@pytest.mark.study
@pytest.mark.parametrize("seed", range(10))
def test_pendulum_as_a_black_box(seed):
    learned = snapo.learn("Pendulum-v1", steps=20_000, seed=seed)
    played = learned.play(2000)
    print(learned, played, sep="\n")
    assert learned.steps <= 20_000 and played.mean >= -158


@pytest.mark.study
@pytest.mark.parametrize("seed", range(10))
def test_mountain_car_as_a_black_box(seed):
    learned = snapo.learn("MountainCarContinuous-v0", steps=20_000, seed=seed)
    played = learned.play(200)
    print(learned, played, sep="\n")
    assert learned.steps <= 20_000 and played.mean >= 90
