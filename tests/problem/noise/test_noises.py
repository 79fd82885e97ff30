"""Noise of one's own: distributions, derivatives, both engines, antithetic and Sobol scenarios."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import snapo
from snapo import noise
from snapo.problem.inputs import Input, named_inputs
from snapo.problem.noise.base import in_mean
from snapo.problem.noise.counter import normal, threefry

N = 20_000


@pytest.fixture(scope="module")
def normals() -> np.ndarray:
    """[N, 3] of the engines' own counter, in float64."""
    with jax.enable_x64(True):
        count = np.arange(3 * N, dtype=np.uint32)
        counted = jax.jit(lambda *words: normal(threefry(*words)[0], np.float64))
        return np.asarray(counted(np.array([7, 11], np.uint32), count, count * 0)).reshape(N, 3)


def drawn(noises, normals):
    """Values at many normals, in float64."""
    with jax.enable_x64(True):
        made = jax.jit(lambda: noise.prepare(noises))()
        size = noise.size(made)
        found = jax.jit(jax.vmap(lambda z: noise.draw(made, z)))(normals[:, :size])
        return jax.tree.map(np.asarray, found)


CONTINUOUS = {
    "uniform": (noise.Uniform(-1.0, 3.0), stats.uniform(-1, 4)),
    "normal": (noise.Normal(2.0, 0.5), stats.norm(2, 0.5)),
    "lognormal": (noise.LogNormal(0.3, 0.4), stats.lognorm(0.4, scale=np.exp(0.3))),
    "exponential": (noise.Exponential(2.5), stats.expon(scale=2.5)),
    "gamma": (noise.Gamma(1.7, 0.6), stats.gamma(1.7, scale=0.6)),
    "student": (noise.Student(4.5, 1.0, 2.0), stats.t(4.5, 1, 2)),
}
COUNTS = {
    "poisson": (noise.Poisson(4.3), stats.poisson(4.3)),
    "binomial": (noise.Binomial(0.3, 9), stats.binom(9, 0.3)),
    "negative binomial": (noise.NegativeBinomial(3.0, 1.5), stats.nbinom(1.5, 1.5 / 4.5)),
}


@pytest.mark.prove
def test_continuous_noise_has_its_distribution(normals):
    """Kolmogorov and Smirnov: with these 20,000 draws no p-value is below a hundredth."""
    values = drawn({name: each for name, (each, _) in CONTINUOUS.items() if name != "student"},
                   np.repeat(normals[:, :1], 5, 1))  # fmt: skip
    values["student"] = drawn(CONTINUOUS["student"][0], normals)
    for name, (_, law) in CONTINUOUS.items():
        assert stats.kstest(values[name], law.cdf).pvalue > 0.01, name
        error = law.std() / np.sqrt(N)
        assert abs(values[name].mean() - law.mean()) < 3 * error, name


@pytest.mark.prove
def test_counts_have_their_distribution(normals):
    """Quantiles to the number, so that moments and all chances follow."""
    values = drawn({n: each for n, (each, _) in COUNTS.items()}, np.repeat(normals[:, :1], 3, 1))
    u = stats.norm.cdf(normals[:, 0])
    for name, (_, law) in COUNTS.items():
        assert np.array_equal(values[name], law.ppf(u)), name
        seen = np.bincount(values[name].astype(int))[:8] / N
        chance = np.diff(law.cdf(np.arange(-1, 8)))
        assert np.all(np.abs(seen - chance) < 3.5 * np.sqrt(chance * (1 - chance) / N)), name


@pytest.mark.prove
def test_correlated_noise(normals):
    """A Gaussian copula: the margins are kept, and so is the rank correlation, 6 / pi asin(rho / 2)."""
    pair = noise.Correlated({"a": noise.Poisson(40.0), "b": noise.Exponential(2.0)}, [0.6])
    found = drawn(pair, normals)
    assert stats.kstest(found["b"], stats.expon(scale=2).cdf).pvalue > 0.01
    assert np.array_equal(found["a"], stats.poisson(40).ppf(stats.norm.cdf(normals[:, 0])))
    rank = np.corrcoef(stats.rankdata(found["a"]), stats.rankdata(found["b"]))[0, 1]
    assert rank == pytest.approx(6 / np.pi * np.arcsin(0.3), abs=0.015)  # two standard errors
    three = drawn(noise.Normal([1.0, 2.0, 3.0], 0.5, [0.5, -0.2, 0.3]), normals)
    assert np.corrcoef(three.T)[[1, 2, 2], [0, 0, 1]] == pytest.approx([0.5, -0.2, 0.3], abs=0.02)
    two = drawn(noise.Student(5.0, correlation=[0.7]), normals)
    assert two.shape == (N, 2)
    # The root that both share makes large values come together.
    assert np.corrcoef(np.abs(two).T)[0, 1] > np.corrcoef(np.abs(three[:, :2]).T)[0, 1]


@pytest.mark.prove
def test_a_history_and_a_chain(normals):
    history = np.array([3.0, 9.0, 4.0, 4.0, 1.0])
    values = drawn(noise.Empirical(history), normals)
    assert set(values) == set(history)
    assert np.mean(values == 4) == pytest.approx(0.4, abs=0.01)
    assert np.all(np.diff(values[np.argsort(normals[:, 0])]) >= 0)  # antithetic paths differ
    rows = np.stack([history, -history], 1)
    assert np.all(drawn(noise.Empirical(rows), normals).sum(1) == 0)
    chain = noise.Markov([[0.9, 0.1, 0.0], [1.0, 2.0, 1.0], [0.0, 0.0, 1.0]])
    step = jax.jit(jax.vmap(lambda z, r: noise.draw({"r": chain}, z, r=r)["r"]))
    for regime, chances in enumerate(([0.9, 0.1, 0.0], [0.25, 0.5, 0.25], [0.0, 0.0, 1.0])):
        after = np.asarray(step(normals[:, :1].astype(np.float32), np.full(N, regime)))
        assert np.bincount(after, minlength=3) / N == pytest.approx(chances, abs=0.01)


@pytest.mark.prove
def test_gamma_quantiles_and_their_derivative_by_the_shape():
    """Against SciPy's quantiles: 1e-8 of themselves, from -6 to 6 deviations; derivatives 2e-6."""
    z = np.linspace(-6, 6, 200)

    def quantile(shape):
        lower = stats.gamma.ppf(stats.norm.cdf(z), shape)
        return np.where(z < 0, lower, stats.gamma.isf(stats.norm.sf(z), shape))

    with jax.enable_x64(True):

        @jax.jit
        def both(shape):
            def values(shape):
                made = noise.Gamma(shape).prepare()
                return jax.vmap(lambda each: made.draw(each[None]))(jnp.asarray(z))

            return jax.jvp(values, (shape,), (1.0,))

        for shape in (0.06, 0.5, 1.0, 2.3, 40.0, 900.0):
            value, slope = map(np.asarray, both(shape))
            assert value == pytest.approx(quantile(shape), rel=1e-8)
            h = 1e-4 * shape
            moved = (quantile(shape + h) - quantile(shape - h)) / (2 * h)
            assert slope == pytest.approx(moved, rel=2e-6)


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: noise.Poisson(-1.0), "mean is -1"),
        (lambda: noise.Gamma(0.01), "shape is 0.01"),
        (lambda: noise.Uniform(2.0, 1.0), "below low"),
        (lambda: noise.Normal(correlation=[0.9, -0.9, 0.9]), "must be positive definite"),
        (lambda: noise.Normal(correlation=[0.9, 0.1]), "strict lower triangle"),
        (lambda: noise.Markov([[0.5, -0.5], [0.5, 0.5]]), "below 0"),
        (lambda: noise.Correlated([noise.Normal()], [0.1]), "1 noises"),
        (lambda: noise.Empirical(np.zeros((2, 2, 2))), "shape"),
        (lambda: noise.Binomial(1.5), "probability is 1.5"),
        (lambda: noise.draw(noise.Normal(), np.zeros(3)), "noise_size = 1"),
    ],
)
def test_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_parameters_of_separate_draws_are_right_in_the_mean_alone():
    """By the names of the inputs; those of draws that move along a path are not among them."""
    inputs = {
        "both": noise.Correlated(
            {"calls": noise.Poisson(Input(4.0)), "price": noise.LogNormal(Input(0.0), 0.2)},
            Input([0.3]),
        ),
        "regimes": [noise.Markov(Input([[0.9, 0.1], [0.5, 0.5]]))],
        "fails": noise.Binomial(0.1),
        "size": noise.Gamma(Input(2.0), 1.0),
        "rate": Input(0.03),
    }
    assert set(in_mean(inputs)) == {"both.noises.calls.mean", "regimes.0.transition"}
    assert set(in_mean(inputs)) < {entry.name for entry in named_inputs(inputs)}


@pytest.mark.prove
def test_the_check_tells_how_to_name_a_mean_of_whole_numbers():
    """A rate that stands alone, and its noise made in the step: no path moves with it."""

    class Shop(snapo.Simulator):
        horizon: int = 3
        noise_size: int = 1
        action: snapo.Box = snapo.Box(0.0, 5.0)

        def prepare(self, inputs):
            return snapo.Schedule(dict(inputs), {"t": jnp.arange(3.0)})

        def initial(self, constants, normals):
            return jnp.asarray(1.0)

        def observe(self, constants, now, state):
            return state[None] / 5

        def step(self, constants, now, state, action, normals, smooth):
            wanted = noise.Poisson(constants["rate"], maximum=20).draw(normals)
            return action[0], {"cash": -((wanted - action[0]) ** 2)}

    class Named(Shop):
        def in_mean(self):
            return ("rate",)

    inputs = {"rate": snapo.Input(2.0)}
    (found,) = snapo.check(Shop(), inputs)
    assert "in_mean(self): return ('rate',)" in found.fix
    assert not list(snapo.check(Named(), inputs))


@jax.jit
def poisson(mean):
    """[41] probabilities of a Poisson number, and the derivatives of its moves and of them."""

    def both(mean):
        law = noise.Poisson(mean, maximum=40).prepare()
        return law.moves, law.probability

    (_, chances), slopes = jax.jvp(both, (mean,), (jnp.ones_like(mean),))
    return chances, *slopes


@pytest.mark.parametrize("mean", [0.5, 2.0])
@pytest.mark.parametrize("corner", [0, 1, 3])
def test_a_corner_is_off_by_what_the_page_says(mean, corner):
    """E max(q - k, 0) falls by P(k < q) with the mean; a bend of 1 at q adds (p(q - 1) - p(q)) / 4.
    `weigh` is right."""
    k = np.arange(41)
    slope = np.where(k < corner, -1.0, np.where(k == corner, -0.5, 0.0))
    with jax.enable_x64(True):
        p, moves, chances = map(np.asarray, poisson(np.float64(mean)))
    right, off = -p[:corner].sum(), ((p[corner - 1] if corner else 0.0) - p[corner]) / 4
    assert (p * moves * slope).sum() == pytest.approx(right + off, abs=1e-12)
    weighed = (chances * np.maximum(corner - k, 0)).sum()
    assert weighed == pytest.approx(right, abs=1e-12)
