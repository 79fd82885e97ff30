"""Policies of every kind play: those that remember, and those of every set of actions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.gym.normals import on_the_noise_of
from tests.problem.test_memory import PROBLEM as HIDDEN
from tests.problem.test_memory import STEPS

import snapo
from snapo.problem.actions import Actions
from snapo.problem.simulator import Interface, Schedule
from snapo.solver.evaluate import path_totals

gymnasium = pytest.importorskip("gymnasium")
import snapo.gym  # noqa: E402

SETS = {
    "box": snapo.Box([-1.0, 0.0], 1.0),
    "simplex": snapo.Simplex(3),
    "whole": snapo.Integers(0, [3, 5]),
    "choice": snapo.Choice(3),
    "stop": snapo.Stop(rights=2),
    "product": snapo.Product(run=snapo.Choice(2), lots=snapo.Integers(0, 4), mix=snapo.Simplex(2)),
    "nested": snapo.Product(
        z=snapo.Choice(3), a=snapo.Product(c=snapo.Stop(), b=snapo.Box(-1.0, 1.0))
    ),
}


class AnySet(snapo.Simulator):
    """A walk that all numbers of a decision push, each in its own way."""

    action: Actions = SETS["box"]
    horizon: int = 6
    noise_size: int = 1
    initial_noise_size: int = 2

    def prepare(self, inputs):
        return Schedule({}, {"t": jnp.arange(self.horizon) / self.horizon})

    def initial(self, constants, noise):
        return noise

    def observe(self, constants, now, state):
        return jnp.append(state, now["t"])

    def step(self, constants, now, state, action, noise, smooth):
        pushes = jnp.arange(1.0, 1 + action.shape[0]) / action.shape[0]
        after = 0.8 * state + jnp.stack([pushes @ action - 0.5, jnp.sum(action**2)]) / 4
        return after + noise / 2, {"cash": after[0] * after[1] - jnp.sum(pushes * action)}

    def terminal(self, constants, state, smooth):
        return {"cash": state[0] ** 2}


def problem_of(name: str) -> snapo.Problem:
    return snapo.Problem(AnySet(action=SETS[name]), None, snapo.Mean("cash"))


def wild(problem: snapo.Problem, policy=None, seed: int = 0):
    """A policy whose numbers are large enough that its decisions differ."""
    made = (policy or snapo.MLP(hidden=(8,))).for_problem(problem.interface, jax.random.key(seed))
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda x: np.float32(x + rng.normal(size=x.shape)), made)


@pytest.mark.prove
@pytest.mark.parametrize("name", SETS)
def test_a_policy_of_every_set_earns_in_the_environment_what_it_earns_in_the_engine(name):
    """Without a map written by hand, on the same normals; single precision."""
    problem = problem_of(name)
    policy = wild(problem)
    played = snapo.gym.play(policy, lambda: snapo.gym.Environment(problem), 16)
    totals = path_totals(on_the_noise_of(problem, 16), policy, 16)["cash"]
    assert np.ptp(totals) > 0.1 and np.all(played.steps == 6)
    np.testing.assert_allclose(played.rewards, totals, rtol=1e-4, atol=1e-4)
    agent = snapo.gym.play(snapo.gym.Agent(policy), lambda: snapo.gym.Environment(problem), 16)
    assert np.array_equal(agent.rewards, played.rewards)


@pytest.mark.prove
@pytest.mark.parametrize("name", SETS)
def test_an_agents_actions_are_elements_of_both_environments_spaces(name):
    problem = problem_of(name)
    one, many = snapo.gym.Environment(problem), snapo.gym.VectorEnvironment(problem, 4)
    agent = snapo.gym.Agent(wild(problem))
    action = agent(one.reset(seed=0)[0])
    assert one.action_space.contains(action), action
    assert one.observation_space.contains(one.step(action)[0])
    actions = agent(many.reset(seed=0)[0])
    assert many.action_space.contains(actions), actions
    assert many.observation_space.contains(many.step(actions)[0])
    # What is written is read again as the decision that it was.
    seen = many.reset(seed=0)[0]
    decided = np.stack([agent.policy(each, snapo.Exact()) for each in seen])
    np.testing.assert_allclose(many._read(agent(seen)), decided, atol=1e-6)
    sampled = many.step(many.action_space.sample())[0]
    assert np.isfinite(sampled).all()


@pytest.mark.prove
def test_a_choice_plays_cart_and_pole():
    """The rule "push to where it falls" as scores of two options; CartPole-v1 counts them 0 and 1."""
    gain = np.zeros((2, 4), np.float32)
    gain[1] = [0.0, 0.2, 1.0, 1.0]
    policy = snapo.Linear(gain, 0.5, snapo.Choice(2))
    fresh = snapo.MLP(snapo.Choice(2), 4, key=jax.random.key(0))
    for each in (policy, snapo.gym.Agent(fresh)):
        played = snapo.gym.play(each, "CartPole-v1", 5)
        assert np.all(played.rewards == played.steps) and np.all(played.steps >= 8)
    assert snapo.gym.play(policy, "CartPole-v1", 5).mean > 150


def test_spaces_of_others_take_what_they_can():
    from snapo.gym.spaces import writer

    spaces = gymnasium.spaces
    best = np.eye(3)[[2, 0]]
    assert writer(spaces.Discrete(3, start=5), snapo.Choice(3))(best).tolist() == [7, 5]
    assert writer(spaces.Discrete(3))(best).tolist() == [2, 0]
    assert writer(spaces.Discrete(4), snapo.Integers(0, 3))(np.array([[3.0]])).tolist() == [3]
    several = writer(spaces.MultiDiscrete([3, 4], start=[1, 0]), snapo.Integers(0, [2, 3]))
    assert several(np.array([[2.0, 3.0]])).tolist() == [[3, 3]]
    binary = spaces.MultiBinary(2)
    written = writer(binary, snapo.Integers(0, 1, 2))(np.array([[1.0, 0.0]]))
    assert binary.contains(written[0])
    square = spaces.Box(-1, 1, (2, 2))
    assert square.contains(writer(square, snapo.Box(-1, 1, 4))(np.zeros((1, 4)))[0])
    for space, action in (
        (spaces.Discrete(2), snapo.Choice(3)),
        (spaces.Discrete(2), snapo.Stop(rights=2)),
        (spaces.Dict(a=spaces.Discrete(2)), snapo.Product(b=snapo.Choice(2))),
        (spaces.Box(-1, 1, (3,)), snapo.Box(-np.inf, np.inf, 2)),
        (spaces.Text(3), snapo.Box(-np.inf, np.inf)),
    ):
        with pytest.raises(ValueError, match="do not fit into the space"):
            writer(space, action)
    with pytest.raises(ValueError, match="the policy decides 3 numbers, but there are 2 options"):
        writer(spaces.Discrete(2))(best)


REMEMBERING = {
    "recurrent": snapo.GRU(hidden=5),
    "recent": snapo.LastObservations(3, snapo.MLP(hidden=(6,))),
}


@pytest.mark.prove
@pytest.mark.parametrize("name", REMEMBERING)
def test_a_policy_with_memory_plays_a_plant_seen_through_noise(name):
    """The same rewards as in the engine; once more with the same agent, which begins anew."""
    policy = wild(HIDDEN, REMEMBERING[name])
    agent = snapo.gym.Agent(policy)
    agent(np.ones((3, 1)))
    assert agent.memory.shape == (3, policy.memory) and np.all(agent.memory.any(1))
    totals = -path_totals(on_the_noise_of(HIDDEN, 8), policy, 8)["cost"]
    for _ in range(2):
        played = snapo.gym.play(agent, lambda: snapo.gym.Environment(HIDDEN), 8)
        np.testing.assert_allclose(played.rewards, totals, rtol=1e-4)


@pytest.mark.prove
def test_memories_begin_anew_where_a_vectorised_environment_does():
    """Paths that end on their own at different times: each decision is that of the observations of
    its own episode alone."""

    class Ending(type(HIDDEN.simulator)):
        def over(self, constants, state):
            return jnp.abs(state["x"]) > 2

    problem = snapo.Problem(Ending(), HIDDEN.inputs, HIDDEN.objective)
    policy = wild(problem, REMEMBERING["recurrent"])
    many, agent = snapo.gym.VectorEnvironment(problem, 5), snapo.gym.Agent(policy)
    seen, done = many.reset(seed=3)[0], np.zeros(5, bool)
    episodes, lengths = [[each] for each in seen], []
    for _ in range(3 * STEPS):
        actions = agent(seen)
        for episode, action in zip(episodes, actions):
            memory = np.zeros(policy.memory, np.float32)
            for each in episode:
                decided, memory = policy.decide(each, memory, snapo.Exact())
            np.testing.assert_allclose(action, decided, rtol=1e-4, atol=1e-5)
        seen, _, ended, late, _ = many.step(actions)
        agent.reset(done)  # those that began anew in this step
        for i in range(5):
            lengths += [len(episodes[i])] * bool(done[i])
            episodes[i] = [seen[i]] if done[i] else [*episodes[i], seen[i]]
        done = ended | late
    assert len(set(lengths)) > 2


@pytest.mark.prove
def test_one_observation_after_another_is_remembered_too():
    policy = wild(HIDDEN, REMEMBERING["recent"])
    agent, rng = snapo.gym.Agent(policy), np.random.default_rng(0)
    rows = rng.normal(size=(4, 1)).astype(np.float32)
    one = [agent(row) for row in rows]
    agent.reset()
    assert agent.memory is None
    np.testing.assert_allclose([agent(row[None])[0] for row in rows], one, rtol=1e-6)
    with pytest.raises(ValueError, match="a memory of 1 episodes, but got 3 observations"):
        agent(np.zeros((3, 1)))


@pytest.mark.prove
def test_a_recurrent_policy_plays_a_pendulum_whose_speed_is_hidden():
    interface = Interface(snapo.Box(-2.0, 2.0), 2)
    policy = snapo.GRU(hidden=4).for_problem(interface, jax.random.key(0))
    seeing = []

    def angle(seen):
        seeing.append(seen.shape)
        return seen[:, :2]

    played = snapo.gym.play(snapo.gym.Agent(policy, angle), "Pendulum-v1", 4)
    assert np.all(played.steps == 200) and np.all(np.isfinite(played.rewards))
    assert set(seeing) == {(4, 3)}
