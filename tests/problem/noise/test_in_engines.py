"""All kinds of noise inside a simulator: both engines draw and differentiate alike, and right."""

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo import noise
from snapo.engine import Native, Xla
from snapo.problem.scenarios import Pseudo

T = 2
INPUTS = {
    "noises": {
        "binomial": noise.Binomial(snapo.Input(0.3), 5),
        "count": noise.Poisson(snapo.Input(2.5)),
        "exponential": noise.Exponential(snapo.Input(0.8)),
        "gamma": noise.Gamma(snapo.Input(1.7), snapo.Input(0.6)),
        "history": noise.Empirical(snapo.Input([1.0, 0.5, 2.0])),
        "jumps": noise.Poisson(snapo.Input(2.0)),
        "negative": noise.NegativeBinomial(snapo.Input(1.5), snapo.Input(2.0)),
        "pair": noise.Normal(snapo.Input(0.2), 0.9, snapo.Input([0.4])),
        "student": noise.Student(snapo.Input(9.0), scale=snapo.Input(0.5)),
        "uniform": noise.Uniform(snapo.Input(0.1), snapo.Input(0.7)),
    },
    "chain": noise.Markov(snapo.Input([[0.8, 0.2], [0.4, 0.6]])),
    "rates": snapo.Input([1.0, 3.0]),
}
SIZE = noise.size(INPUTS)


class Everything(snapo.Simulator):
    """Outputs of all noises, whose expectations have closed forms. No decision matters."""

    horizon: int = T
    action: snapo.Box = snapo.Box(-np.inf, np.inf)
    noise_size: int = SIZE + 1

    def prepare(self, inputs):
        made = noise.prepare(inputs)
        return snapo.Schedule(made, {"rate": inputs["rates"]})

    def initial(self, constants, normals):
        return {"regime": jnp.zeros((), jnp.int32), "weight": jnp.ones(())}

    def observe(self, constants, now, state):
        return state["weight"][None]

    def step(self, constants, now, state, action, normals, smooth):
        noises = constants["noises"]
        jumps, likely = noises["jumps"].weigh(normals[:1])
        rest = {name: each for name, each in noises.items() if name != "jumps"}
        drawn = noise.draw(rest, normals[1:-2])
        regime, likelihood = constants["chain"].weigh(normals[-2:-1], state["regime"])
        weight = state["weight"] * likelihood
        squares = {name: drawn[name] ** 2 for name in rest if name != "pair"}
        # A rate of this step's own: the distribution is worked out here.
        own = noise.Poisson(now["rate"], maximum=20).draw(normals[-1:])
        outputs = {
            **squares,
            "pair": drawn["pair"][0] * drawn["pair"][1],
            "jumps": likely * jnp.where(jumps >= 3, 1.0, 0.0),
            "chain": weight * regime,
            "own": own**2,
        }
        outputs["all"] = sum(outputs.values())
        return {"regime": regime, "weight": weight}, outputs


RULE = snapo.Constant(np.array([0.5]))
PROBLEM = snapo.Problem(Everything(), INPUTS, snapo.Mean("all"))


def chain(p) -> float:
    """The expected number of steps in regime 1."""
    p = np.asarray(p) / np.sum(p, 1, keepdims=True)
    return sum(np.linalg.matrix_power(p, t)[0, 1] for t in range(1, T + 1))


def chain_slopes() -> np.ndarray:
    p, found = INPUTS["chain"].transition.value, np.zeros((2, 2))
    for at in np.ndindex(2, 2):
        step = np.zeros((2, 2))
        step[at] = 1e-6
        found[at] = (chain(p + step) - chain(p - step)) / 2e-6
    return found


low, high, a, s, m, r, p, df = 0.1, 0.7, 1.7, 0.6, 1.5, 2.0, 0.3, 9.0
SLOPES = {  # of the expected squares, a step
    "noises.binomial.probability": 5 * (1 - 2 * p) + 50 * p,
    "noises.count.mean": 2 * 2.5 + 1,
    "noises.exponential.mean": 4 * 0.8,
    "noises.gamma.shape": s**2 * (2 * a + 1),
    "noises.gamma.scale": 2 * s * a * (a + 1),
    "noises.history.values": 2 * np.array([1.0, 0.5, 2.0]) / 3,
    "noises.jumps.mean": 2 * np.exp(-2.0),
    "noises.negative.mean": 1 + 2 * m / r + 2 * m,
    "noises.negative.dispersion": -(m**2) / r**2,
    "noises.pair.mean": 2 * 0.2,
    "noises.pair.correlation": 0.9**2,
    "noises.student.df": -2 / (df - 2) ** 2 * 0.5**2,
    "noises.student.scale": 2 * 0.5 * df / (df - 2),
    "noises.uniform.low": (2 * low + high) / 3,
    "noises.uniform.high": (low + 2 * high) / 3,
}
PATHS = 16_384


@pytest.fixture(scope="module")
def tables():
    engines = Xla("float64"), Native("float64")
    return [
        snapo.sensitivities(PROBLEM, RULE, paths=PATHS, smooth_paths=0, engine=e).held
        for e in engines
    ]


@pytest.mark.prove
def test_derivatives_by_all_parameters(tables):
    """Closed forms within three and a half standard errors, which are a few percent or less."""
    for name, slope in SLOPES.items():
        error = np.asarray(tables[0][name].standard_error)
        found = np.asarray(tables[0][name].value)
        assert np.all(np.abs(found - T * np.asarray(slope)) < 3.5 * error + 1e-12), (name, found)
        assert np.all(error < 0.1 * np.abs(T * np.asarray(slope)).max()), (name, error)
    for name, slope in {
        "chain.transition": chain_slopes(),
        "rates": 2 * np.array([1.0, 3.0]) + 1,
    }.items():
        error = np.asarray(tables[0][name].standard_error)
        assert np.all(np.abs(tables[0][name].value - slope) < 3.5 * error + 1e-12), name


@pytest.mark.prove
def test_both_engines_differentiate_alike(tables):
    xla, native = tables
    for name in PROBLEM.inputs_by_name:
        assert np.asarray(native[name].value) == pytest.approx(
            np.asarray(xla[name].value), rel=1e-9, abs=1e-11
        ), name


@pytest.mark.prove
def test_both_engines_draw_alike():
    """Whole numbers to the bit, all others to rounding; means are right."""
    draws = Pseudo(3).draws(np.arange(1024), PROBLEM.simulator)
    xla, native = (
        e.bind(PROBLEM).values(RULE, draws, snapo.Exact(), record=("outputs",)).record["outputs"]
        for e in (Xla("float64"), Native("float64"))
    )
    for name in xla:
        ours, theirs = np.asarray(native[name]), np.asarray(xla[name])
        if name in WHOLE:
            assert np.array_equal(ours, theirs) and np.array_equal(ours, np.round(ours)), name
        assert ours == pytest.approx(theirs, rel=1e-12), name
    for name, mean in KNOWN.items():
        spread = np.std(xla[name]) / np.sqrt(xla[name].size)
        assert abs(np.mean(xla[name]) - mean) < 3.5 * spread, name


@pytest.mark.prove
def test_both_engines_draw_alike_in_single_precision():
    """Squares and products of the draws: to 1e-5 of themselves, or 1e-6 of their usual size where
    a product of correlated normals is nearly 0. Whole numbers: at most one of these 32,768 is
    another."""
    draws = Pseudo(5).draws(np.arange(16_384), PROBLEM.simulator)
    xla, native = (
        e.bind(PROBLEM).values(RULE, draws, snapo.Exact(), record=("outputs",)).record["outputs"]
        for e in (Xla("float32"), Native("float32"))
    )
    for name in xla:
        ours, theirs = np.asarray(native[name], float), np.asarray(xla[name], float)
        if name in WHOLE:
            assert np.sum(ours != theirs) <= 1, name
        else:
            usual = np.sqrt(np.mean(theirs**2))
            np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6 * usual, err_msg=name)


WHOLE = ("count", "binomial", "negative", "own", "chain", "jumps")
KNOWN = {"count": 2.5 + 2.5**2, "gamma": s**2 * a * (a + 1), "uniform": 0.19}


@pytest.mark.prove
def test_points_of_sobol_serve_every_distribution():
    """Over 4,096 paths means are within a quarter of what 4,096 independent ones would err."""
    draws = snapo.Sobol(3).draws(np.arange(4096), PROBLEM.simulator)
    totals = Native("float64").bind(PROBLEM).values(RULE, draws, snapo.Exact()).totals
    for name, mean in KNOWN.items():
        spread = np.std(totals[name]) / np.sqrt(4096)
        assert abs(np.mean(totals[name]) - T * mean) < spread / 4, name
