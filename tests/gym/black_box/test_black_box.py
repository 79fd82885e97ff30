"""Black boxes: counting, exploring, units, and the figures of a result. No training runs."""

from types import SimpleNamespace

import equinox as eqx
import jax
import numpy as np
import pytest

import snapo

gymnasium = pytest.importorskip("gymnasium")
from snapo.gym.black_box import rounds as rounds_  # noqa: E402
from snapo.gym.black_box.learned import Compared, Learned, LearningRound  # noqa: E402
from snapo.gym.black_box.real import HeldAction, Known, Real, Units, circles, scale_of  # noqa: E402
from snapo.gym.black_box.rounds import noisy, random_actions  # noqa: E402


class Counter(gymnasium.Env):
    """Counts its steps; it ends by itself at `last`. Every step is paid its number."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 3.0, (2,), np.float32)

    def __init__(self, last: int = 1000):
        self.last, self.t, self.taken = last, 0, []

    def reset(self, *, seed=None, options=None):
        self.t = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.t += 1
        self.taken.append(np.array(action))
        return np.full(1, self.t, np.float32), float(self.t), self.t == self.last, False, {}


def nothing(seen, number):
    return np.zeros(2)


def test_decisions_are_held_and_every_step_is_counted():
    real = Real(Counter(), hold=3, limit=8)
    assert real.decisions == 3
    played = real.episode(nothing, 0)
    assert played.steps == real.steps == 8
    assert played.rows.before[:, 0].tolist() == [0, 3, 6]
    assert played.rows.after[:, 0].tolist() == [3, 6, 8]
    assert played.rows.reward.tolist() == [1 + 2 + 3, 4 + 5 + 6, 7 + 8]
    assert played.total == 36 and played.rows.action.shape == (3, 2)
    real.episode(nothing, 0)
    assert real.steps == 16


def test_the_limit_of_time_is_no_end():
    """The state after the last step in time says nothing of an end; that of an end does."""
    late, ended = (Real(Counter(last), 1, 5).episode(nothing, 0).rows for last in (1000, 4))
    assert not late.ended.any() and late.ended.size == 5
    assert ended.ended.tolist() == [False, False, False, True]
    at_once = Real(Counter(5), 1, 5).episode(nothing, 0).rows
    assert at_once.ended.tolist() == [False] * 4 + [True]  # both: the end is one


def test_decisions_are_held_by_default_where_episodes_are_long():
    assert [Real(Counter(), None, limit).hold for limit in (200, 250, 251, 999)] == [1, 1, 2, 4]


def test_a_limit_of_time_around_an_environment_without_a_spec_is_found():
    limited = gymnasium.wrappers.TimeLimit(Counter(), 50)
    assert Real(limited, hold=None, limit=None).limit == 50
    assert (
        Real(gymnasium.wrappers.RecordEpisodeStatistics(limited), hold=None, limit=20).limit == 20
    )


def test_what_cannot_be_learnt_is_refused_with_a_remedy():
    discrete, unbounded = gymnasium.spaces.Discrete(2), gymnasium.spaces.Box(-np.inf, 1.0, (2,))
    for name, space, told in (
        ("action_space", discrete, r"action space is Discrete\(2\).*ActionWrapper"),
        ("observation_space", discrete, r"observation space is Discrete.*FlattenObservation"),
        ("action_space", unbounded, "finite bounds low and high"),
    ):
        environment = Counter()
        setattr(environment, name, space)
        with pytest.raises(ValueError, match=told):
            snapo.learn(environment, limit=10)
    with pytest.raises(ValueError, match="limit=200"):
        snapo.learn(Counter)
    with pytest.raises(ValueError, match=r"up to 200 steps; got steps=100 .* 2000 steps"):
        snapo.learn(Counter, steps=100, limit=200)


def test_random_actions_are_held_and_keep_within_bounds():
    real, rng = Real(Counter(), 1, 200), np.random.default_rng(0)
    lengths = []
    for _ in range(25):
        act = random_actions(real, rng)
        actions = np.stack([act(None, t) for t in range(200)])
        assert actions.min() >= -1 and actions.max() <= 3
        changes = np.flatnonzero(np.any(np.diff(actions, axis=0), axis=1)) + 1
        lengths.append(changes[0])
        ends = actions[np.unique(np.append(0, changes))]
        assert len(ends) >= 10
    # From a hundredth to a tenth of the episode. An end drawn twice hides a change.
    assert min(lengths) == 2 and 12 <= max(lengths) <= 60
    centre = noisy(lambda seen: np.full(2, 2.9), real, rng)
    actions = np.stack([centre(None, t) for t in range(200)])
    assert actions.max() == 3 and actions.min() >= 2.9 - 2 * 0.3 * 2
    assert np.ptp(actions) > 0.3


def test_a_cosine_and_its_sine_are_found():
    angle, other = np.random.default_rng(0).uniform(-np.pi, np.pi, (2, 100))
    speed = np.linspace(-1, 1, 100)
    seen = np.stack([speed, np.cos(angle), np.sin(other), np.sin(angle), np.cos(other)], 1)
    assert circles(seen) == ((1, 3), (2, 4))
    assert circles(np.stack([np.ones(100), np.zeros(100)], 1)) == ()  # nothing turns
    seen[7] *= 1.01
    assert circles(seen) == ()


def test_scales_of_what_never_moves_are_one():
    rows = np.stack([np.full(50, 1e6), np.linspace(0, 1e-3, 50)], 1)
    mean, scale = scale_of(rows)
    assert mean[0] == 1e6 and scale[0] == 1 and scale[1] == pytest.approx(rows[:, 1].std())
    assert scale_of(np.zeros((0, 2)))[1].tolist() == [1, 1]


def test_a_policy_keeps_its_decisions_in_other_units():
    """The first layer takes the scales in, and gives them back."""
    rng = np.random.default_rng(0)
    network = eqx.tree_at(
        lambda made: made.network,
        snapo.MLP(hidden=(4,)),
        _Bare([rng.normal(size=(4, 2)), rng.normal(size=(1, 4))], [np.ones(4), np.zeros(1)]),
        is_leaf=lambda leaf: leaf is None,
    )
    units = Units(np.array([5.0, -100.0]), np.array([0.01, 40.0]))
    seen = units.shift + units.scale * rng.normal(size=(6, 2))
    before = ((seen - units.shift) / units.scale) @ network.network.weights[0].T + 1
    undone = units.undone(network)
    after = seen @ np.asarray(undone.network.weights[0]).T + undone.network.biases[0]
    assert np.allclose(before, after, rtol=1e-4, atol=1e-3)  # 5 / 0.01 in single precision
    assert np.allclose(units.done(undone).network.weights[0], network.network.weights[0])


class _Bare(eqx.Module):
    """A network's numbers alone: nothing is drawn by JAX."""

    weights: list
    biases: list


def test_the_gap_has_the_error_of_the_difference():
    starts = np.array([-100.0, -300.0, -10.0, -150.0])
    found = Compared.of(starts + np.array([1.0, 0.9, 1.1, 1.0]), starts)
    assert found.gap == pytest.approx(1.0) and found.gap_error < 0.05 < found.real_error
    assert found.episodes == 4 and found.model == pytest.approx(-140)


def test_a_result_prints_itself():
    """Rounds are compared on the starts that all of them played."""
    errors = np.array([0.01, 0.2, 0.0])
    rounds = [
        LearningRound(
            500, 300, errors, Compared.of(np.array([-10.0, -20.0, -90.0]), np.zeros(3)), 1.0
        ),
        LearningRound(800, 500, errors, Compared.of(np.array([-10.0, -18.0]), np.zeros(2)), 1.0),
    ]
    learned = Learned(
        policy=snapo.MLP(), comparison=rounds[1].comparison, steps=1000, hold=1, limit=100,
        rounds=tuple(rounds), selected=2, seconds=3.2, seed=0, model=None, inputs=None,
        environment=Counter(),
    )  # fmt: skip
    told = str(learned).splitlines()
    assert told[0] == "real environment -14 ± 51, model 0 ± 0, gap -14 ± 51 (95 %) over 2 episodes"
    assert told[1] == "1,000 real steps, 3 s of processor time, policy of round 2 of 2"
    assert (
        told[3].split()[:4] == ["1", "500", "300", "20.00%"] and "-15 ± 64" in told[3]
    )  # 12.7 standard errors of two
    with pytest.raises(ValueError, match="there is only one environment"):
        learned.play(3)


def test_an_episode_begins_only_where_all_of_it_has_room():
    known = Known.of(Real(Counter(), 1, 10), 0)
    known.play(nothing)
    assert known.real.steps == 10 and known.room(20) and not known.room(19)
    known.play(nothing)
    assert known.transitions.count == 20 and known.settled().units.scale[0] == pytest.approx(
        np.append(np.arange(10), np.arange(1, 11)).std()
    )


class Chancy(Counter):
    """Ends by chance."""

    def step(self, action):
        seen, reward, *_ = super().step(action)
        return seen, reward, self.np_random.uniform() < 0.05, False, {}


@pytest.mark.parametrize("rounds", [1, 6, 15])
@pytest.mark.parametrize("more", [0, 7, 300])
@pytest.mark.parametrize("made", [Counter, Chancy])
def test_the_steps_allowed_are_never_exceeded(rounds, more, made, monkeypatch):
    """However long episodes take; every round and the last policy play. Nothing is fitted."""
    policy = SimpleNamespace(network=SimpleNamespace(weights=[np.ones((1, 1))], biases=[0.0]))
    inside = SimpleNamespace(model=None, inputs=None, rows=1, fit=SimpleNamespace(raw=0, error=1))
    for name in ("fitted_model", "initial_policy", "improved"):
        found = inside if name == "fitted_model" else policy
        monkeypatch.setattr(rounds_, name, lambda *given, found=found: found)
    monkeypatch.setattr(Units, "undone", lambda units, policy: policy)
    monkeypatch.setattr(rounds_, "Agent", lambda policy: lambda seen: np.zeros(2))
    monkeypatch.setattr(rounds_, "replace", lambda model, horizon: model)
    monkeypatch.setattr(rounds_, "value", lambda model, inputs, policy, firsts, *_: firsts[:, 0])
    steps = 10 * rounds_.fewest(rounds) + more
    learned = snapo.learn(made, steps, rounds=rounds, limit=10)
    assert steps - 10 < learned.steps <= steps
    assert len(learned.rounds) == rounds and min(r.comparison.episodes for r in learned.rounds) >= 1
    assert learned.comparison.episodes >= 1


class Still(snapo.Simulator):
    """In the place of a learned model: two decisions that move nothing."""

    horizon: int = 100
    action: snapo.Box = snapo.Box(-1.0, 1.0, 2)
    noise_size: int = 1
    may_end: bool = False

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": np.zeros(100)})

    def initial(self, constants, noise):
        return constants["one"]

    def observe(self, constants, now, state):
        return state[None]

    def step(self, constants, now, state, action, noise, smooth):
        return state, {"reward": action.sum() + noise[0]}


def test_middle_rounds_train_half_of_the_steps(monkeypatch):
    """Half of those that are given, or that follow the problem (see the test below)."""
    shares = []
    monkeypatch.setattr(rounds_, "trained", lambda *given: shares.append(given[5]))
    inside = SimpleNamespace(model=Still(), inputs={"one": snapo.Input(1.0)})
    policy = rounds_.initial_policy(inside, None, None, 0)
    plan = SimpleNamespace(training=snapo.Training(paths=64), rounds=3, engine="xla")
    for number in range(3):
        rounds_.improved(plan, inside, policy, number)
    assert shares == [1.0, 0.5, 1.0]


def test_a_held_environment_is_one_of_gymnasium():
    held = HeldAction(Counter(last=5), 2, 100)
    held.reset(seed=0)
    steps = [held.step(np.zeros(2))[1:4] for _ in range(3)]
    assert steps == [(3.0, False, False), (7.0, False, False), (5.0, True, False)]
    assert held.taken == 5


def test_play_stays_a_function():
    """No module of that name takes its place when the black box is loaded."""
    import snapo.gym

    assert rounds_.run and snapo.gym.play.__name__ == "play"


class Line(snapo.Simulator):
    """A step towards zero."""

    horizon: int = 20
    action: snapo.Box = snapo.Box(-1.0, 1.0)
    noise_size: int = 1

    def prepare(self, inputs):
        return snapo.Schedule(np.ones(1), np.zeros(self.horizon))

    def initial(self, constants, noise):
        return constants[0]

    def observe(self, constants, now, state):
        return state[None]

    def step(self, constants, now, state, action, noise, smooth):
        after = state + action[0] + noise[0]
        return after, {"reward": -(after**2)}


def test_half_the_steps_are_half_of_those_that_follow_the_problem(monkeypatch):
    """Middle rounds trained one step where the caller had named no steps."""
    steps = []

    def noted(problem, progress, plan, engine):
        steps.append(plan.steps)
        return progress

    monkeypatch.setattr(rounds_, "train", noted)
    problem = snapo.Problem(Line(), None, snapo.Mean("reward"))
    policy = snapo.MLP(hidden=(4,)).for_problem(problem.interface, jax.random.key(0))
    for training, share in (
        (snapo.Training(), 1.0),
        (snapo.Training(), 0.5),
        (snapo.Training(steps=1), 0.5),
        (snapo.Training(steps=0), 0.5),
    ):
        rounds_.trained(Line(), None, policy, training, "xla", share)
    assert steps == [3840, 1920, 1, 0]
