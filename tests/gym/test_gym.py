"""Both ways between snapo and Gymnasium, on real environments."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtri

import snapo
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.pendulum import Pendulum
from snapo.domains.control.rules import rivals
from snapo.domains.control.twin import agent
from snapo.problem.simulator import Schedule
from snapo.solver.evaluate import path_totals

gymnasium = pytest.importorskip("gymnasium")
import snapo.gym  # noqa: E402

STEPS, STARTS = 60, 16


class Walk(snapo.Simulator):
    """A walk that a decision pushes; it ends at 3, and the last place is paid."""

    horizon: int = 12
    noise_size: int = 1
    initial_noise_size: int = 1
    action: snapo.Box = snapo.Box(1, -1.0, 1.0)

    def prepare(self, inputs):
        return Schedule({}, {"left": 1 - jnp.arange(self.horizon) / self.horizon})

    def initial(self, constants, noise):
        return {"place": 0.1 * noise[0]}

    def observe(self, constants, now, state):
        return jnp.stack([state["place"], now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        place = state["place"] + action[0] + 0.1 * noise[0]
        return {"place": place}, {"cash": -(action[0] ** 2), "other": place}

    def terminal(self, constants, state, smooth):
        return {"cash": 2 * state["place"]}

    def over(self, constants, state):
        return state["place"] > 3


@pytest.fixture(scope="module")
def walk():
    return snapo.Problem(Walk(), None, 3 * snapo.Mean("cash"))


def test_sets_of_actions_have_spaces():
    """No simulator runs."""
    from snapo.gym.spaces import space_of

    box, read = space_of(snapo.Box(2, -1.0, [2.0, 3.0]))
    assert box.shape == (2,) and np.array_equal(box.high, [2.0, 3.0])
    assert np.array_equal(read(np.array([[5.0, -5.0]])), [[2.0, -1.0]])
    discrete, read = space_of(snapo.Choice(3))
    assert discrete.n == 3 and np.array_equal(read(np.array([1, 2])), [[0, 1, 0], [0, 0, 1]])
    _, read = space_of(snapo.Simplex(2))
    assert np.allclose(read(np.array([[0.2, 0.6], [0.0, 0.0]])), [[0.25, 0.75], [0.5, 0.5]])
    _, read = space_of(snapo.Whole(1, 0, 9))
    assert read(np.array([[3.6]])) == 4
    with pytest.raises(ValueError, match="a Product has no space"):
        space_of(snapo.Product(a=snapo.Box(1), b=snapo.Choice(2)))


@pytest.mark.prove
def test_an_objective_without_rewards_is_refused():
    problem = snapo.Problem(Walk(), None, snapo.CVaR("cash", 0.9))
    with pytest.raises(ValueError, match="CVaR of cash has no reward"):
        snapo.gym.Environment(problem)


@pytest.mark.prove
def test_gymnasiums_own_checker_passes(walk):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unbounded observations, and no registered name
        check_env(snapo.gym.Environment(walk), skip_render_check=True)


@pytest.mark.prove
def test_rewards_add_up_to_the_objective(walk):
    """With the last state's output; an episode that ends early is paid where it ends."""
    environment = snapo.gym.Environment(walk)
    for push, steps in ((0.1, 12), (1.0, None)):
        seen, _ = environment.reset(seed=1)
        place, total, done, count = [float(seen[0])], 0.0, False, 0
        while not done:
            seen, reward, done, late, _ = environment.step(np.array([push], np.float32))
            place.append(float(seen[0]))
            total, count = total + reward, count + 1
            assert not late
        assert count == steps or (place[-1] > 3 >= place[-2] and count < 12)
        assert total == pytest.approx(3 * (2 * place[-1] - count * push**2), rel=1e-5)
    endless = snapo.gym.Environment(walk, endless=True)
    endless.reset(seed=1)
    ends = [endless.step(np.zeros(1, np.float32))[2:4] for _ in range(12)]
    assert ends == [(False, False)] * 11 + [(False, True)]


@pytest.mark.prove
def test_many_paths_move_as_one_does(walk):
    """The same dynamics; a path that ended starts anew at its next step, without a reward."""
    many = snapo.gym.VectorEnvironment(walk, 3)
    seen, _ = many.reset(seed=2)
    assert seen.shape == (3, 2) and many.single_action_space.shape == (1,)
    pushes = np.array([[1.0], [0.5], [0.0]], np.float32)
    ended = np.zeros(3, bool)
    for _ in range(14):
        before, again = seen, ended
        seen, reward, ended, late, _ = many.step(pushes)
        assert not late.any() and np.all(reward[again] == 0)
        assert np.all(np.abs(seen[again, 0]) < 1) and np.all(seen[again, 1] == 1)
        going = ~again
        moved = seen[going, 0] - before[going, 0] - pushes[going, 0]
        assert np.all(np.abs(moved) < 0.6)  # 0.1 standard normals
        last = 2 * seen[going, 0] * ended[going]
        assert np.allclose(reward[going], 3 * (last - pushes[going, 0] ** 2), atol=1e-5)
        assert np.all(ended[seen[:, 0] > 3] | again[seen[:, 0] > 3])
    assert not ended[2]  # it ended at its horizon, at the twelfth step, and began anew
    again, _ = many.reset(seed=2)
    other = snapo.gym.VectorEnvironment(walk, 3).reset(seed=2)[0]
    assert np.array_equal(again, other)


@pytest.mark.prove
def test_the_same_policy_earns_the_same_in_both_pendulums():
    """Snapo's simulator and Gymnasium's, from the starts of 16 seeds, over 60 steps."""

    def made():
        return gymnasium.make("Pendulum-v1", max_episode_steps=STEPS, disable_env_checker=True)

    inputs = make_inputs(Pendulum)
    plant = Pendulum(inputs, horizon=STEPS)
    starts = []
    for seed in range(STARTS):
        environment = made()
        environment.reset(seed=seed)
        starts.append(environment.unwrapped.state)
    shares = (np.array(starts) / [np.pi, 1.0] + 1) / 2
    given = snapo.Supplied(np.zeros((STEPS, STARTS, 0)), ndtri(shares))
    problem = snapo.Problem(plant, inputs, snapo.Mean("reward"), snapo.Sources(given, given, given))
    network = snapo.MLP().for_problem(problem.interface, jax.random.key(0))
    for policy in (rivals(plant, inputs)["linear regulator"], network):
        totals = path_totals(problem, policy, STARTS)["reward"]
        played = snapo.gym.play(agent(plant, policy, inputs), made, STARTS)
        assert np.all(played.steps == STEPS)
        # Single precision of the agent, and 60 steps of a system that doubles errors in ten.
        assert np.allclose(played.rewards, totals, rtol=1e-4, atol=1e-2)
        assert played.mean == pytest.approx(played.rewards.mean())
