"""Rosenbrock steps: the order conditions, and problems of the test set with their references."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pharma.process_cases import constant

from snapo.domains.pharma.time import rosenbrock
from snapo.domains.pharma.time.dynamics import Dynamics
from snapo.domains.pharma.time.rosenbrock import WRITTEN_OUT, factorised, solve
from snapo.domains.pharma.time.step_choice import choose, times_of
from snapo.domains.pharma.time.stiff import limit_of, stepped, steps_of

TOLERANCE = 1e-8


def test_order_conditions():
    """Hairer and Wanner II, section IV.7, table 7.1, and what makes it L-stable: the last row of
    beta is b, so that R(infinity) = 0."""
    size = len(rosenbrock.A)
    a, c = np.zeros((size, size)), np.zeros((size, size))
    for i in range(size):
        a[i, :i], c[i, :i] = rosenbrock.A[i], rosenbrock.C[i]
    gamma = np.linalg.inv(np.eye(size) / rosenbrock.GAMMA - c)
    alpha, ends = a @ gamma, np.append(rosenbrock.A[-1], 1.0)
    beta, b = alpha + gamma, ends @ gamma
    nodes = alpha.sum(1)
    np.testing.assert_allclose(nodes, rosenbrock.NODES[list(rosenbrock.AT)], atol=1e-13)
    np.testing.assert_allclose(gamma.sum(1), rosenbrock.BY_TIME, atol=1e-12)
    np.testing.assert_allclose(b, beta[-1], atol=1e-12)
    own = beta.sum(1)

    def conditions(b):
        return [
            b.sum() - 1,
            b @ own - 1 / 2,
            b @ nodes**2 - 1 / 3,
            b @ beta @ own - 1 / 6,
            b @ nodes**3 - 1 / 4,
            b @ (nodes * (alpha @ own)) - 1 / 8,
            b @ beta @ nodes**2 - 1 / 12,
            b @ beta @ beta @ own - 1 / 24,
        ]

    np.testing.assert_allclose(conditions(b), 0, atol=1e-12)
    embedded = (ends - np.eye(size)[-1]) @ gamma
    np.testing.assert_allclose(conditions(embedded), 0, atol=1e-12)
    fifth = [
        b @ nodes**4 - 1 / 5,
        b @ beta @ beta @ beta @ own - 1 / 120,
        b @ beta @ nodes**3 - 1 / 20,
        b @ (nodes**2 * (alpha @ own)) - 1 / 10,
    ]
    np.testing.assert_allclose(fifth, 0, atol=1e-12)


class Known(NamedTuple):
    """y' = rate(y, p) from `start` over `time`, and the published y at its end; `step` in the
    logarithms of p at which central differences are best, None if round-off drowns them."""

    rate: Callable
    parameters: tuple[float, ...]
    start: tuple[float, ...]
    time: float
    end: tuple[float, ...]
    step: float | None


def robertson(y, p):
    slow, back, fast = p[0] * y[0], p[1] * y[1] * y[2], p[2] * y[1] ** 2
    return jnp.stack([back - slow, slow - back - fast, fast])


def van_der_pol(y, p):
    """In the time scaled by mu: p is 1/mu^2, here mu = 1000."""
    return jnp.stack([y[1], ((1 - y[0] ** 2) * y[1] - y[0]) / p[0]])


def hires(y, p):
    k1, k2, k3, k4, k5, k6, plus, minus, k9, feed = p
    made = plus * y[5] * y[7]
    both = minus + k2 + k9
    return jnp.stack(
        [
            -k1 * y[0] + k2 * y[1] + k6 * y[2] + feed,
            k1 * y[0] - (k2 + k3) * y[1],
            -(k6 + k1) * y[2] + k2 * y[3] + k5 * y[4],
            k3 * y[1] + k1 * y[2] - (k4 + k2) * y[3],
            -(k5 + k1) * y[4] + k2 * (y[5] + y[6]),
            -made + minus * y[3] + k1 * y[4] - k2 * y[5] + minus * y[6],
            made - both * y[6],
            -made + both * y[6],
        ]
    )


# Mazzia and Magherini, Test Set for Initial Value Problem Solvers, release 2.4, 2008, parts ROBER,
# VDPOL and HIRES (their references by RADAU5 with tolerance 1.1e-18), from Hairer and Wanner II;
# Robertson's at 1e4 from the driver of MEBDF for the same set (Cash and Abdulla, 2005).
PROBLEMS = {
    "robertson": Known(
        robertson, (0.04, 1e4, 3e7), (1.0, 0.0, 0.0), 1e11,
        (0.2083340149701255e-7, 0.8333360770334713e-13, 0.9999999791665050), None,
    ),  # an epsilon of y3 is 1e-8 of y1
    "robertson, 1e4": Known(
        robertson, (0.04, 1e4, 3e7), (1.0, 0.0, 0.0), 1e4,
        (0.1073004285378040, 0.4800166972571660e-6, 0.8926990914454987), 1e-3,
    ),
    "van der pol": Known(
        van_der_pol, (1e-6,), (2.0, 0.0), 2.0,
        (0.1706167732170483e1, -0.8928097010247975), 2e-5,
    ),
    "hires": Known(
        hires, (1.71, 0.43, 8.32, 0.69, 0.035, 8.32, 280.0, 0.69, 0.69, 0.0007),
        (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0057), 321.8122,
        (0.7371312573325668e-3, 0.1442485726316185e-3, 0.5888729740967575e-4,
         0.1175651343283149e-2, 0.2386356198831331e-2, 0.6238968252742796e-2,
         0.2849998395185769e-2, 0.2850001604814231e-2), 1e-4,
    ),
}  # fmt: skip


def problem(known: Known, parameters) -> Dynamics:
    def nothing(*_):
        raise AssertionError("No unit is behind this problem.")

    return Dynamics(
        start=jnp.asarray(known.start, float),
        rate=lambda y, drive: known.rate(y, parameters),
        drive=lambda value: value[..., None],
        controls=((constant("none", 1.0), jnp.ones(1)),),
        duration=jnp.asarray(known.time, float),
        event=None,
        states=nothing,
        finish=nothing,
        stiff=True,
    )


@pytest.mark.prove
@pytest.mark.parametrize("name", PROBLEMS)
def test_published_problems(name):
    """Values to 1e-6 of the references at tolerance 1e-8; the adjoint on the steps so chosen, by
    all parameters, to 1e-6 of central differences and to 1e-7 of the forward mode."""
    known = PROBLEMS[name]
    with jax.enable_x64(True):
        p = jnp.asarray(known.parameters)
        chosen = jax.jit(lambda p: choose(problem(known, p), TOLERANCE, 20_000))(p)
        times = times_of(jax.tree.map(np.asarray, chosen))
        steps = steps_of(problem(known, p), times)

        @jax.jit
        def end(logarithm):
            found = stepped(
                problem(known, p * jnp.exp(logarithm)), steps, limit_of(TOLERANCE), False
            )
            return found.final / np.array(known.end)

        here = jnp.zeros(len(p))
        np.testing.assert_allclose(end(here), 1.0, rtol=1e-6)
        if known.step is None:
            return
        adjoint, forward = (
            np.asarray(jax.jit(mode(end))(here)) for mode in (jax.jacrev, jax.jacfwd)
        )
        step = known.step
        moved = [[end(k * step * e) for k in (-2, -1, 1, 2)] for e in np.eye(len(p))]
        far_low, low, high, far_high = np.moveaxis(np.array(moved), 1, 0)
        differences = ((8 * (high - low) - (far_high - far_low)) / (12 * step)).T
    largest = np.abs(adjoint).max(1, keepdims=True)
    np.testing.assert_allclose(forward / largest, adjoint / largest, atol=1e-7)
    np.testing.assert_allclose(differences / largest, adjoint / largest, atol=1e-6)


@pytest.mark.prove
@pytest.mark.parametrize("size", [3, WRITTEN_OUT + 1])
def test_small_systems(size):
    """With a pivot of zero, and derivatives by the matrix: -A^-1 dA x, and its transpose."""
    random = np.random.default_rng(size)
    with jax.enable_x64(True):
        matrix = jnp.asarray(random.normal(size=(size, size))).at[0, 0].set(0.0)
        right = jnp.asarray(random.normal(size=size))

        def found(a, b):
            return solve(a, factorised(a), b)

        known = np.linalg.solve(matrix, right)
        np.testing.assert_allclose(jax.jit(found)(matrix, right), known, rtol=1e-12)
        change, weights = random.normal(size=(size, size)), random.normal(size=size)
        expected = -np.linalg.solve(matrix, change @ known)
        ahead = jax.jit(lambda a, by: jax.jvp(lambda a: found(a, right), (a,), (by,))[1])(
            matrix, change
        )
        np.testing.assert_allclose(ahead, expected, rtol=1e-10)
        back = jax.jit(jax.grad(lambda a: weights @ found(a, right)))(matrix)
        assert np.sum(np.asarray(back) * change) == pytest.approx(weights @ expected, rel=1e-10)
