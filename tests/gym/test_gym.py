"""Both ways between snapo and Gymnasium, on real environments."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtri
from tests.domains.inventory.inventory_cases import case
from tests.gym.normals import on_the_noise_of

import snapo
from snapo.domains.control.chapters.baselines import agent
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.pendulum import Pendulum
from snapo.domains.control.rules import classical_rules
from snapo.domains.inventory.item.simulator import InventorySimulator
from snapo.domains.inventory.setup import first_policy
from snapo.problem.actions import Actions
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
    action: snapo.Box = snapo.Box(-1.0, 1.0)

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


class Odd(Actions):
    """A set of one's own."""

    size: int = 1

    def squash(self, raw, smooth):
        return raw

    def near(self, base, correction, smooth):
        return base + correction

    def fault(self, action):
        return None


@pytest.fixture(scope="module")
def walk():
    return snapo.Problem(Walk(), None, 3 * snapo.Mean("cash"))


def test_sets_of_actions_have_spaces():
    """No simulator runs."""
    from snapo.gym.spaces import space_of

    box, read = space_of(snapo.Box(-1.0, [2.0, 3.0]))
    assert box.shape == (2,) and np.array_equal(box.high, [2.0, 3.0])
    assert np.array_equal(read(np.array([[5.0, -5.0]])), [[2.0, -1.0]])
    discrete, read = space_of(snapo.Choice(3))
    assert discrete.n == 3 and np.array_equal(read(np.array([1, 2])), [[0, 1, 0], [0, 0, 1]])
    _, read = space_of(snapo.Simplex(2))
    assert np.allclose(read(np.array([[0.2, 0.6], [0.0, 0.0]])), [[0.25, 0.75], [0.5, 0.5]])
    _, read = space_of(snapo.Integers(0, 9))
    assert read(np.array([[3.6]])) == 4
    several, read = space_of(snapo.Product(b=snapo.Box(0.0, 1.0), a=snapo.Choice(2)))
    assert set(several) == {"a", "b"} and several["a"].n == 2
    given = {"a": np.array([1, 0]), "b": np.array([[0.5], [7.0]])}
    assert np.array_equal(read(given), [[0.5, 0, 1], [1, 1, 0]])

    with pytest.raises(ValueError, match="a Odd has no corresponding Gymnasium space"):
        space_of(Odd())


@pytest.mark.prove
def test_an_objective_without_rewards_is_refused():
    problem = snapo.Problem(Walk(), None, snapo.CVaR("cash", 0.9))
    with pytest.raises(ValueError, match="CVaR of cash is not a sum of rewards"):
        snapo.gym.Environment(problem)


@pytest.mark.prove
def test_gymnasiums_own_checker_passes(walk, item):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unbounded observations, and no registered name
        check_env(snapo.gym.Environment(walk), skip_render_check=True)
        check_env(snapo.gym.Environment(item[0]), skip_render_check=True)


@pytest.fixture(scope="module")
def item():
    """Demand that waits, with a cost of an order: whether to order, and how much."""
    given = case(order=10.0, unmet="waits", horizon={"periods": 6, "warm_up": 1})
    problem = snapo.Problem(InventorySimulator.of(given), given.inputs(), snapo.Mean("result"))
    return problem, first_policy(problem, given, 0)


@pytest.mark.prove
def test_an_item_with_a_cost_of_an_order_is_an_environment(item):
    """Its decision is a dictionary; the (s, S) rule earns in it what it earns in the engine, and
    so does a rule that does not say its set."""

    class Untold(snapo.Policy):
        rule: snapo.Policy

        def __call__(self, observation, smooth):
            return self.rule(observation, smooth)

    problem, policy = item
    assert set(snapo.gym.Environment(problem).action_space) == {"order", "size"}
    totals = path_totals(on_the_noise_of(problem, 16), policy, 16)["result"]
    for each in (policy, Untold(policy)):
        played = snapo.gym.play(each, lambda: snapo.gym.Environment(problem), 16)
        np.testing.assert_allclose(played.rewards, totals, rtol=1e-4)
    assert np.ptp(totals) > 1


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


@pytest.mark.prove
def test_an_endless_problem_pays_its_last_state_at_an_end_of_its_own_alone(walk):
    """At the horizon time is up and nothing more is paid; where the walk passes 3 with its last
    step, it is at its end: terminated, and paid."""

    def pushes(seen, t, at_end):
        """Up to 2.3 and, with the last step, beyond 3; or nothing."""
        wanted = np.where(t < 11, np.clip(2.3 - seen[:, :1], -1, 1), 1.0)
        return np.where(np.asarray(at_end)[:, None], wanted, 0.0).astype(np.float32)

    one, many = (
        snapo.gym.Environment(walk, endless=True),
        snapo.gym.VectorEnvironment(walk, 4, endless=True),
    )
    for at_end in (False, True):
        seen, _ = one.reset(seed=1)
        for t in range(12):
            push = pushes(seen[None], t, [at_end])[0]
            seen, reward, ended, late, told = one.step(push)
            assert (ended, late) == (at_end and t == 11, not at_end and t == 11), t
            last = 2 * seen[0] if ended else 0.0
            assert reward == pytest.approx(3 * (last - push[0] ** 2), abs=1e-5)
            assert told["cash"] == pytest.approx(reward / 3, abs=1e-5)
        assert (seen[0] > 3) == at_end
    seen, _ = many.reset(seed=1)
    at_ends = [False, True, True, False]
    for t in range(12):
        push = pushes(seen, t, at_ends)
        seen, rewards, ended, late, _ = many.step(push)
        assert t == 11 or not np.any(ended | late)
    assert ended.tolist() == at_ends and np.all(late == ~ended)
    assert np.allclose(rewards, 3 * (2 * seen[:, 0] * ended - push[:, 0] ** 2), atol=1e-5)


@pytest.mark.prove
def test_information_holds_the_outputs_and_they_add_up_to_their_totals():
    """By each one's kind of total, names of the last state alone among them; after it ended at its
    horizon."""

    class Told(Walk):
        def step(self, constants, now, state, action, noise, smooth):
            after, outputs = super().step(constants, now, state, action, noise, smooth)
            place = after["place"]
            return after, outputs | {"most": place, "final": place, "best": place}

        def terminal(self, constants, state, smooth):
            found = super().terminal(constants, state, smooth)
            return found | {"rest": state["place"] ** 2, "final": jnp.float32(7.0), "best": 9.0}

        def totals(self):
            return {"most": "max", "final": "last", "best": "max"}

    problem = snapo.Problem(Told(), None, snapo.Mean("cash"))
    environment = snapo.gym.Environment(problem)
    environment.reset(seed=4)
    rows = [environment.step(np.array([0.05], np.float32))[4] for _ in range(12)]
    assert all("rest" not in row for row in rows[:-1]) and set(rows[-1]) - set(rows[0]) == {"rest"}
    assert rows[-1]["final"] == 7 and rows[-1]["best"] == 9 and rows[-2]["best"] < 3
    place = [row["other"] for row in rows]
    assert sum(row["cash"] for row in rows) == pytest.approx(2 * place[-1] - 12 * 0.05**2, rel=1e-5)
    assert rows[-1]["rest"] == pytest.approx(place[-1] ** 2) and rows[-1]["most"] == place[-1]
    many = snapo.gym.VectorEnvironment(problem, 2)
    many.reset(seed=4)
    steps = [many.step(np.full((2, 1), 0.05, np.float32)) for _ in range(13)]
    assert not steps[10][4]["_rest"].any() and steps[11][4]["_rest"].all()
    assert steps[11][4]["_cash"].all() and not steps[12][4]["_cash"].any()
    assert np.all(steps[12][4]["cash"] == 0)


@pytest.mark.prove
def test_environments_of_one_problem_are_compiled_once(walk):
    one, other = (snapo.gym.Environment(walk) for _ in range(2))
    assert one._step is other._step
    assert snapo.gym.Environment(walk, endless=True)._step is not one._step


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
    recurrent = snapo.GRU(hidden=6).for_problem(problem.interface, jax.random.key(1))
    recent = snapo.LastObservations(3).for_problem(problem.interface, jax.random.key(2))
    for policy in (classical_rules(plant, inputs)["linear regulator"], network, recurrent, recent):
        totals = path_totals(problem, policy, STARTS)["reward"]
        played = snapo.gym.play(agent(plant, policy, inputs), made, STARTS)
        assert np.all(played.steps == STEPS)
        # Single precision of the agent, and 60 steps of a system that doubles errors in ten.
        assert np.allclose(played.rewards, totals, rtol=1e-4, atol=1e-2)
        assert played.mean == pytest.approx(played.rewards.mean())
