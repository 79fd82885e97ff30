"""Noise is a function of seed, path, step and component, and standard normal."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats

from snapo.problem.actions import Box
from snapo.problem.noise.counter import normal, threefry
from snapo.problem.scenarios import Pseudo, Sobol, Sources, Supplied, bridge
from snapo.problem.simulator import Schedule, Simulator


class Shape(Simulator):
    """A simulator that only says how much noise it needs."""

    horizon: int = 7
    action: Box = Box(-np.inf, np.inf)
    noise_size: int = 3
    initial_noise_size: int = 2

    def prepare(self, inputs):
        return Schedule({}, {})

    def initial(self, constants, noise):
        return noise

    def observe(self, constants, now, state):
        return state

    def step(self, constants, now, state, action, noise, smooth):
        return state, {}


SHAPE = Shape()


def drawn(scenarios, paths, simulator=SHAPE, dtype="float64", first=0, length=None):
    """All noise: initial [N, K0] and steps [T, N, K], drawn as an engine draws it."""
    draws = scenarios.draws(np.asarray(paths), simulator)
    length = simulator.horizon - first if length is None else length
    sizes = simulator.initial_noise_size, simulator.noise_size, length
    with jax.enable_x64(dtype == "float64"):
        placed = jax.tree.map(jnp.asarray, draws)
        initial, steps = placed_noise(placed, jnp.asarray(first), sizes, dtype)
        return np.asarray(initial), np.asarray(steps)


@eqx.filter_jit
def placed_noise(draws, first, sizes, dtype):
    """Initial noise and that of `length` steps from `first` on; `sizes` are K0, K and `length`."""
    size, step_size, length = sizes

    def one(draws):
        steps = draws.steps(first, length)
        noise = jax.vmap(lambda s: draws.noise(s, step_size, jnp.dtype(dtype)))(steps)
        return draws.initial(size, jnp.dtype(dtype)), noise

    return jax.vmap(one, in_axes=(draws.axes(),), out_axes=(0, 1))(draws)


words_of = jax.jit(threefry)
normal_of = jax.jit(normal, static_argnums=1)


def test_words_are_those_of_jax():
    """JAX's own threefry takes counters as one array whose halves are the two words."""
    from jax.extend.random import threefry_2x32

    rng = np.random.default_rng(0)
    key, x, y = (rng.integers(0, 2**32, n, dtype=np.uint32) for n in (2, 50, 50))
    ours = np.concatenate(words_of(key, x, y))
    theirs = threefry_2x32(jnp.asarray(key), jnp.concatenate([x, y]))
    np.testing.assert_array_equal(ours, np.asarray(theirs))


@pytest.mark.parametrize("dtype, tolerance", [("float64", 2e-15), ("float32", 4e-7)])
def test_normals_are_the_inverse_of_the_distribution_function(dtype, tolerance):
    """AS241 states a relative error of 1e-16 (PPND16) and 1e-7 (PPND7); a few roundings more.

    Every region: the centre, both edges of q = 0.425, the far tails and the smallest word.
    """
    edge = int((0.5 - 0.425) * 2.0**32)
    m = np.concatenate(
        [
            [0, 1, 2, edge - 1, edge, edge + 1, 2**31 - 1],
            np.random.default_rng(0).integers(0, 2**31, 20000),
        ]
    ).astype(np.uint64)
    words = np.concatenate([m, m + 2**31]).astype(np.uint32)
    with jax.enable_x64(dtype == "float64"):
        z = np.asarray(normal_of(words, dtype))
    assert z.dtype == dtype
    upper = -special.ndtri((m + 0.5) / 2.0**32)
    expected = np.concatenate([upper, -upper])
    # Near the centre z = q / phi(0) is small while scipy works with 0.5 - q: absolute there.
    np.testing.assert_allclose(z, expected, rtol=tolerance, atol=3e-16)


def test_both_precisions_draw_the_same_words():
    """So the normals agree to float32's accuracy."""
    for a, b in zip(drawn(Pseudo(1), range(9)), drawn(Pseudo(1), range(9), dtype="float32")):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-7)


def test_components_come_from_the_contracted_words():
    """Component 2j and 2j + 1 are the words of counter (path, step * ceil(K / 2) + j)."""
    draws = Pseudo(3, antithetic=False).draws(np.arange(4), SHAPE)
    _, steps = drawn(Pseudo(3, antithetic=False), range(4))
    for path, step in ((0, 0), (3, 5)):
        counter = np.uint32([2 * step, 2 * step + 1])
        words = np.asarray(words_of(draws.keys[0], np.full(2, path, np.uint32), counter))
        with jax.enable_x64(True):
            expected = normal_of(words.T.ravel()[:3], "float64")
        np.testing.assert_allclose(steps[step, path], expected, rtol=1e-15)  # compiled: 4 ulp


@pytest.mark.prove
@pytest.mark.parametrize(
    "scenarios", [Pseudo(4), Pseudo(4, antithetic=False), Sobol(4, scrambles=4)], ids=str
)
def test_a_path_is_the_same_in_any_company(scenarios):
    """Bit for bit: more paths, other chunks, one alone, and (drawn where used) any window."""
    initial, steps = drawn(scenarios, range(64))
    for paths in (range(10), range(40, 64), [17], [3, 8, 40]):
        some_initial, some_steps = drawn(scenarios, paths)
        np.testing.assert_array_equal(some_initial, initial[list(paths)])
        np.testing.assert_array_equal(some_steps, steps[:, list(paths)])
    _, window = drawn(scenarios, range(64), first=2, length=3)
    np.testing.assert_array_equal(window, steps[2:5])


def test_antithetic_paths_have_opposite_signs_and_seeds_differ():
    for noise in drawn(Pseudo(7), range(20)):
        even, odd = np.take(noise, range(0, 20, 2), -2), np.take(noise, range(1, 20, 2), -2)
        np.testing.assert_array_equal(even, -odd)
    _, steps = drawn(Pseudo(7), range(4))
    for other in (Pseudo(8), Pseudo(7, stream=1)):
        assert not np.any(drawn(other, range(4))[1] == steps)


def test_moments_and_distribution():
    """Within 4.5 standard errors: seven statistics and a fixed seed, no luck needed."""
    initial, steps = drawn(Pseudo(11, antithetic=False), range(20000))
    z = np.concatenate([initial.ravel(), steps.ravel()])
    n = z.size
    for power, mean, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs(np.mean(z**power) - mean) < 4.5 * np.sqrt(variance / n)
    assert stats.kstest(z, "norm").pvalue > 1e-4
    columns = np.concatenate([initial, steps.transpose(1, 0, 2).reshape(20000, -1)], axis=1)
    correlation = np.corrcoef(columns.T) - np.eye(columns.shape[1])
    assert np.abs(correlation).max() < 5.0 / np.sqrt(20000)  # 253 pairs


def test_blocks_are_independent_units():
    for scenarios in (Pseudo(0), Sobol(0), Pseudo(0, antithetic=False)):
        blocks = scenarios.blocks(640)
        assert len(blocks) == 32
        np.testing.assert_array_equal(np.sort(np.concatenate(blocks)), np.arange(640))
        members = [set(scenarios.groups(block)) for block in blocks]
        assert sum(map(len, members)) == len(set().union(*members))  # no unit is split


@pytest.mark.parametrize("steps", [1, 2, 3, 7, 12])
def test_the_bridge_is_orthogonal(steps):
    """Normals in, normals out: its matrix has M M' = 1 to rounding."""
    matrix = bridge(np.eye(steps)[:, :, None])[:, :, 0]
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(steps), atol=1e-13)
    np.testing.assert_allclose(matrix[0], 1 / np.sqrt(steps), atol=1e-13)  # first: the displacement


def test_sobol_covariance_and_smaller_error():
    """Covariance: the identity to 0.05 at 4,096 paths (random sampling: 0.016 standard error).

    Integrand exp(sum / sqrt(dimensions)), mean e^(1/2): the error over 8 seeds must be below a
    third of random sampling's standard error sqrt((e^2 - e) / n), and its stated blocks must agree.
    """
    columns, errors, n = None, [], 4096
    for seed in range(8):
        initial, steps = drawn(Sobol(seed), range(n))
        columns = np.concatenate([initial, steps.transpose(1, 0, 2).reshape(n, -1)], axis=1)
        errors.append(np.exp(steps.sum((0, 2)) / np.sqrt(21)).mean() - np.exp(0.5))
    np.testing.assert_allclose(np.cov(columns.T), np.eye(23), atol=0.05)
    assert np.sqrt(np.mean(np.square(errors))) < np.sqrt((np.e**2 - np.e) / n) / 3


@pytest.mark.prove
def test_sobol_past_its_dimensions(monkeypatch):
    """The leading bridge components are Sobol, the rest pseudo-random, and still normal."""
    monkeypatch.setattr("snapo.problem.scenarios.SOBOL_DIMENSIONS", 8)
    initial, steps = drawn(Sobol(2), range(2048))
    columns = np.concatenate([initial, steps.transpose(1, 0, 2).reshape(2048, -1)], axis=1)
    np.testing.assert_allclose(np.cov(columns.T), np.eye(23), atol=0.15)
    np.testing.assert_array_equal(drawn(Sobol(2), [40])[1][:, 0], steps[:, 40])


def test_supplied_paths_are_given_back():
    noise = np.random.default_rng(0).normal(size=(7, 5, 3))
    initial, steps = drawn(Supplied(noise), [4, 1])
    np.testing.assert_array_equal(steps, noise[:, [4, 1]])
    np.testing.assert_array_equal(initial, np.zeros((2, 2)))
    start = np.arange(10.0).reshape(5, 2)
    np.testing.assert_array_equal(drawn(Supplied(noise, start), [3])[0], start[[3]])
    with pytest.raises(ValueError, match="needs"):
        drawn(Supplied(noise[:6]), [0])
    with pytest.raises(ValueError, match="path 5 was requested"):
        drawn(Supplied(noise), [5])


def test_an_odd_number_of_antithetic_paths_is_completed():
    """65 paths were 32 pairs, and the total of the last path not a number."""
    source = Pseudo(1)
    assert (source.available(65), source.available(64)) == (66, 64)
    assert Pseudo(1, antithetic=False).available(65) == 65
    with pytest.raises(ValueError, match="65 antithetic paths; their number must be even"):
        source.blocks(65)
    assert sorted(np.concatenate(source.blocks(66))) == list(range(66))


def test_every_role_says_which_paths_it_has():
    supplied = Supplied(np.zeros((3, 1_000, 1)))
    roles = Sources.of(supplied).roles(64, 4_096, 65_536, 16_384)
    assert roles == {
        "training": "64 drawn from the supplied paths 1 to 600; new ones at every step",
        "validation": "200 of the supplied paths 601 to 800; the same at every validation",
        "evaluation": "200 of the supplied paths 801 to 1,000; used for the results only",
        "sensitivities": "200 of the evaluation paths",
    }
    roles = Sources.of(Sobol(1)).roles(65, 128, 256, 128)
    assert roles["training"].startswith("66 pseudo-random paths, in antithetic pairs; new")
    assert roles["evaluation"] == "256 Sobol points in 32 scrambles; used for the results only"
