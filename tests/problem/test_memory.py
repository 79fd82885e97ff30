"""Policies that remember: both engines alike, right derivatives, and as good as Kalman's filter."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Native, Xla
from snapo.problem.policy import parameters, trainable
from snapo.solver import checkpoint
from snapo.solver.adjoint import value_and_gradient
from snapo.solver.train import initial_progress, train

STEPS, KEEP, SHAKE, BLUR, FORCE = 12, 1.0, 0.6, 0.7, 0.5


class Hidden(snapo.Simulator):
    """x' = keep x + u + shake noise, seen as x + blur noise; costs x^2 + force u^2."""

    horizon: int = STEPS
    action: snapo.Box = snapo.Box(-np.inf, np.inf)
    noise_size: int = 2
    initial_noise_size: int = 2

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.zeros(self.horizon)})

    def initial(self, constants, noise):
        return {"x": noise[0], "seen": noise[0] + constants["blur"] * noise[1]}

    def observe(self, constants, now, state):
        return state["seen"][None]

    def step(self, constants, now, state, action, noise, smooth):
        cost = state["x"] ** 2 + FORCE * action[0] ** 2
        x = constants["keep"] * state["x"] + action[0] + constants["shake"] * noise[0]
        return {"x": x, "seen": x + constants["blur"] * noise[1]}, {"cost": cost}

    def terminal(self, constants, state, smooth):
        return {"cost": state["x"] ** 2}


INPUTS = {name: snapo.Input(x) for name, x in (("keep", KEEP), ("shake", SHAKE), ("blur", BLUR))}
PROBLEM = snapo.Problem(Hidden(), INPUTS, -snapo.Mean("cost"))
POLICIES = {
    "recurrent": snapo.GRU(hidden=5),
    "recent": snapo.LastObservations(3, snapo.MLP(hidden=(6,))),
}


def kalman_cost(steps: int) -> float:
    """Linear-quadratic-Gaussian control in closed form (Åström 1970): Riccati's equations for the
    gains and, forward, for the filter, whose variance each gain turns into a cost."""
    worth, worths = 1.0, [1.0]
    for _ in range(steps):
        worth = 1 + KEEP**2 * worth - (KEEP * worth) ** 2 / (FORCE + worth)
        worths.append(worth)
    worths.reverse()
    cost, prior = worths[0], 1.0
    for t in range(steps):
        known = prior * BLUR**2 / (prior + BLUR**2)
        gain = KEEP * worths[t + 1] / (FORCE + worths[t + 1])
        cost += worths[t + 1] * SHAKE**2 + known * gain**2 * (FORCE + worths[t + 1])
        prior = KEEP**2 * known + SHAKE**2
    return cost


def made(name: str) -> snapo.Policy:
    """A policy with numbers that are not small, so that its memory matters."""
    policy = POLICIES[name].for_problem(PROBLEM.interface, jax.random.key(1))
    moving, fixed = trainable(policy)
    rng = np.random.default_rng(2)
    moved = jax.tree.map(lambda x: np.asarray(x + 0.1 * rng.normal(size=x.shape), x.dtype), moving)
    return eqx.combine(moved, fixed)


def rolled(engine, policy, paths=64, **options):
    draws = snapo.Pseudo(3).draws(np.arange(paths), PROBLEM.simulator)
    return engine.bind(PROBLEM).values(policy, draws, snapo.Exact(), **options), draws


@pytest.mark.prove
@pytest.mark.parametrize("name", POLICIES)
def test_both_engines_agree_and_recorded_actions_replay(name):
    policy, weights = made(name), {"cost": np.full(64, 1 / 64)}
    found = {}
    for engine in (Xla("float64"), Native("float64")):
        one, draws = rolled(engine, policy, record=("action", "state"))
        assert set(one.state) == {"x", "seen"} == set(one.record["state"])
        assert np.shape(one.record["action"]) == (STEPS, 64, 1)
        again, _ = rolled(engine, None, actions=one.record["action"])
        np.testing.assert_array_equal(again.totals["cost"], one.totals["cost"])
        bound = engine.bind(PROBLEM)
        found[engine] = one, bound.adjoint(policy, draws, snapo.Exact(), weights)
    (one, slopes), (other, theirs) = found.values()
    np.testing.assert_allclose(one.totals["cost"], other.totals["cost"], rtol=1e-12)
    np.testing.assert_allclose(parameters(slopes.policy), parameters(theirs.policy), rtol=1e-9)


@pytest.mark.prove
@pytest.mark.parametrize("name", POLICIES)
def test_derivatives_are_those_of_central_differences(name):
    policy = made(name)

    def cost(problem):
        return value_and_gradient(problem, policy, paths=64)[0]

    _, gradient = value_and_gradient(PROBLEM, policy, paths=64)
    for input, value in (("keep", KEEP), ("blur", BLUR)):
        up, down = (cost(PROBLEM.at({input: value + h})) for h in (1e-5, -1e-5))
        assert gradient.inputs[input] == pytest.approx((up - down) / 2e-5, rel=1e-6)


@pytest.mark.prove
def test_the_gradient_of_a_recurrent_policy_is_that_of_central_differences():
    policy = made("recurrent")
    slopes = value_and_gradient(PROBLEM, policy, paths=64)[1].policy
    along = np.random.default_rng(5).normal(size=parameters(policy).size)

    def cost(step):
        moving, fixed = trainable(policy)
        leaves, tree = jax.tree.flatten(moving)
        parts = np.split(step * along, np.cumsum([leaf.size for leaf in leaves])[:-1])
        moved = [np.asarray(x, float) + part.reshape(x.shape) for x, part in zip(leaves, parts)]
        moved = eqx.combine(jax.tree.unflatten(tree, moved), fixed)
        return value_and_gradient(PROBLEM, moved, paths=64)[0]

    found = (cost(1e-5) - cost(-1e-5)) / 2e-5
    assert float(parameters(slopes) @ along) == pytest.approx(found, rel=1e-6)


@pytest.mark.prove
def test_windows_carry_the_memory_and_a_run_resumes_with_the_same_bits(tmp_path):
    plan = snapo.Training(steps=4, paths=64, window=4, validation_paths=64, validation_every=2)
    policy, found = made("recurrent"), []
    for engine in (Xla(), Native()):
        states = []
        done = train(
            PROBLEM, initial_progress(policy, plan, PROBLEM), plan, engine, [states.append]
        )
        found.append(done)
        checkpoint.save(states[0], tmp_path / "checkpoint.npz")
        resumed = checkpoint.load(
            tmp_path / "checkpoint.npz", initial_progress(policy, plan, PROBLEM)
        )
        again = train(PROBLEM, resumed, plan, engine)
        assert resumed.step == 2
        np.testing.assert_array_equal(parameters(again.policy), parameters(done.policy))
    for one, other in zip(*(each.history for each in found)):
        assert one.objective == pytest.approx(other.objective, rel=1e-3)
    # Adam makes steps of one size of the rounding of gradients that are nearly zero.
    one, other = (parameters(each.policy) for each in found)
    assert np.abs(one - other).mean() < 0.1 * np.abs(one - parameters(policy)).mean()


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(seed, marks=pytest.mark.study if seed else pytest.mark.prove)
        for seed in range(10)
    ],
)
def test_a_recurrent_policy_costs_as_much_as_kalmans_filter(seed):
    """Within 1 % of the closed form by default settings."""
    evaluation = snapo.Evaluation(
        32768, sensitivity_paths=0, smooth_paths=0, judge_paths=0, search_paths=0,
        scenarios="sobol",
    )  # fmt: skip
    problem = replace(PROBLEM, simulator=Hidden(horizon=30), sources=evaluation.sources(seed))
    solution = snapo.solve(
        problem,
        policy=snapo.GRU(hidden=16),
        evaluation=evaluation,
        training=snapo.Training(seed=seed),
    )
    best = kalman_cost(30)
    print(f"seed {seed}: {-solution.value / best:.4f} of the optimum")
    assert solution.standard_error < 1e-3 * best
    assert best - 4 * solution.standard_error < -solution.value < 1.01 * best


def test_a_memory_must_be_outermost_and_recipes_say_so():
    with pytest.raises(ValueError, match="Residual: GRU has a memory"):
        snapo.Residual(snapo.GRU())
    with pytest.raises(ValueError, match="Stages: LastObservations has a memory"):
        snapo.Stages([snapo.LastObservations(2)])
    with pytest.raises(ValueError, match="hidden is 0"):
        snapo.GRU(hidden=0)
    with pytest.raises(ValueError, match="steps is 1"):
        snapo.LastObservations(1)
    with pytest.raises(ValueError, match="has a memory already"):
        snapo.LastObservations(2, snapo.GRU())
