"""Finite-horizon linear-quadratic regulator: cost and every input's sensitivity in closed form.

P_T = Q_T, K = (R + B'PB)^-1 B'PA, P = Q + A'P(A - BK); cost x0' P0 x0 + sum tr(P_(t+1) W_t).
The expectation over the noise is taken without sampling error: with D normals a path, the 2 D
equally weighted points ±sqrt(D) e_i have mean zero and covariance one, and a quadratic cost under
a linear rule asks for no more. So tolerances are those of float64.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Xla
from snapo.problem.actions import Box
from snapo.problem.inputs import Input
from snapo.problem.objective import Mean
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem, prepare
from snapo.problem.scenarios import Sources, Supplied
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import pull_back, value_and_gradient

T = 6
A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]])
Q, R = np.array([[1.0, 0.2], [0.2, 0.8]]), np.array([[1.0]])
FINAL = np.array([[2.0, 0.3], [0.3, 1.5]])
START = np.array([1.0, -0.5])
SIGMA = np.linspace(0.1, 0.3, 2 * T).reshape(T, 2)
COST = -Mean("cost")


class Inputs(eqx.Module):
    A: Input
    B: Input
    Q: Input
    R: Input
    final: Input
    start: Input
    sigma: Input


class Regulator(Simulator):
    """x' = A x + B u + sigma_t n, cost x'Qx + u'Ru a step and x'Q_T x at the end."""

    horizon: int = T
    action: Box = Box(-np.inf, np.inf)
    noise_size: int = 2

    def prepare(self, inputs):
        steps = {"sigma": inputs.sigma, "t": jnp.arange(self.horizon)}
        names = ("A", "B", "Q", "R", "final", "start")
        return Schedule({name: getattr(inputs, name) for name in names}, steps)

    def initial(self, constants, noise):
        return constants["start"]

    def observe(self, constants, now, state):
        return jnp.append(state, now["t"])

    def step(self, constants, now, state, action, noise, smooth):
        c = constants
        cost = state @ c["Q"] @ state + action @ c["R"] @ action
        after = c["A"] @ state + c["B"] @ action + now["sigma"] * noise
        return after, {"cost": cost}

    def terminal(self, constants, state, smooth):
        return {"cost": state @ constants["final"] @ state}


class Feedback(Policy):
    """u = -K_t x."""

    gains: np.ndarray

    def __call__(self, observation, smooth):
        return -self.gains[observation[2].astype(int)] @ observation[:2]


def riccati():
    """P [T + 1, 2, 2], K [T, 1, 2], the second moments M [T + 1, 2, 2] under K, and the cost."""
    P, K = [FINAL], []
    for _ in range(T):
        K.insert(0, np.linalg.solve(R + B.T @ P[0] @ B, B.T @ P[0] @ A))
        P.insert(0, Q + A.T @ P[0] @ (A - B @ K[0]))
    M = [np.outer(START, START)]
    for t in range(T):
        M.append((A - B @ K[t]) @ M[t] @ (A - B @ K[t]).T + np.diag(SIGMA[t] ** 2))
    cost = START @ P[0] @ START + sum(np.sum(np.diag(P[t + 1]) * SIGMA[t] ** 2) for t in range(T))
    return np.array(P), np.array(K), np.array(M), cost


def closed_form():
    """d cost / d each input: the envelope theorem on the recursion."""
    P, K, M, _ = riccati()
    future = [2 * P[t + 1] @ (A - B @ K[t]) @ M[t] for t in range(T)]
    return {
        "A": sum(future),
        "B": -sum(f @ k.T for f, k in zip(future, K)),
        "Q": M[:T].sum(0),
        "R": sum(k @ m @ k.T for k, m in zip(K, M)),
        "final": M[T],
        "start": 2 * P[0] @ START,
        "sigma": 2 * SIGMA * np.array([np.diag(P[t + 1]) for t in range(T)]),
    }


INPUTS = Inputs(*map(Input, (A, B, Q, R, FINAL, START, SIGMA)))
POINTS = np.sqrt(2 * T) * np.concatenate([np.eye(2 * T), -np.eye(2 * T)])
CUBATURE = Supplied(POINTS.reshape(4 * T, T, 2).transpose(1, 0, 2))


def solved(policy, decisions):
    problem = Problem(Regulator(), INPUTS, COST, Sources(*3 * (CUBATURE,)))
    return value_and_gradient(problem, policy, paths=4 * T, decisions=decisions)


def test_stationary_riccati_is_the_published_one():
    """Double integrator with Q = 1, R = 1: P and K to the digits given."""
    P = np.eye(2)
    for _ in range(200):
        K = np.linalg.solve(1.0 + B.T @ P @ B, B.T @ P @ A)
        P = np.eye(2) + A.T @ P @ (A - B @ K)
    np.testing.assert_allclose(P, [[2.94712, 2.36921], [2.36921, 4.61313]], atol=5e-6)
    np.testing.assert_allclose(K, [[0.42208, 1.24393]], atol=5e-6)


@pytest.mark.parametrize("decisions", ["reacting", "held"])
def test_cost_and_all_sensitivities_with_the_optimal_rule(decisions):
    """1e-11 relative to the largest of an input: some hundred roundings of float64.

    Both derivatives must be that of the optimal cost: through the rule because its gradient
    vanishes, held because the held decisions are optimal ones.
    """
    _, K, _, cost = riccati()
    value, gradient = solved(Feedback(K), decisions)
    assert -value == pytest.approx(cost, rel=1e-12)
    for name, expected in closed_form().items():
        np.testing.assert_allclose(
            -gradient.inputs[name],
            expected,
            atol=1e-11 * np.abs(expected).max(),
            rtol=0,
            err_msg=name,
        )
    np.testing.assert_allclose(gradient.policy.gains, 0.0, atol=1e-11 * cost)


def test_a_wrong_rule_costs_more_and_has_a_gradient():
    _, K, _, cost = riccati()
    value, gradient = solved(Feedback(K * 1.1), decisions="reacting")
    assert -value > cost * (1 + 1e-4)
    assert np.abs(gradient.policy.gains).max() > 1e-3


def test_sensitivities_of_weighted_paths_add_up():
    """K cotangents, one per half of the paths: their sum is the whole gradient."""
    _, K, _, _ = riccati()
    simulator = Regulator()
    schedule, draws = prepare(simulator, INPUTS), CUBATURE.draws(np.arange(4 * T), simulator)
    halves = np.zeros((2, 4 * T))
    halves[0, : 2 * T], halves[1, 2 * T :] = 1 / (4 * T), 1 / (4 * T)
    out = Xla(precision="float64").adjoint(
        simulator, Feedback(K), schedule, draws, Exact(), {"cost": halves}
    )
    parts = [jax.tree.map(lambda leaf, k=k: leaf[k], out.schedule) for k in range(2)]
    moved = pull_back(simulator, INPUTS, parts)
    for name, expected in closed_form().items():
        np.testing.assert_allclose(
            moved[name].sum(0), expected, atol=1e-11 * np.abs(expected).max()
        )


@pytest.mark.study
def test_a_network_reaches_the_optimum():
    """400 steps of 256 paths, measured by the exact cubature's law on fresh paths.

    Within 1 % of the optimal cost plus three standard errors: the network is small, its rule is
    smooth in time where the optimal gains change quickly near the end.
    """
    cost = riccati()[3]
    solution = snapo.solve(
        Regulator(),
        INPUTS,
        objective=COST,
        training=snapo.Training(steps=400, paths=256),
        evaluation=snapo.Evaluation(paths=16384, sensitivity_paths=4096, smooth_paths=0),
        engine="xla",
    )
    assert -solution.value >= cost - 3 * solution.standard_error
    assert -solution.value <= cost * 1.01 + 3 * solution.standard_error
