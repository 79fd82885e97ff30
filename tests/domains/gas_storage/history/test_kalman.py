"""The filter against one joint normal density, a published data set, and histories of its model."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from snapo.domains.gas_storage.history.kalman import History, filtered, log_likelihood
from snapo.domains.gas_storage.history.maximum import Maximum, estimate_of, maximise
from snapo.domains.gas_storage.history.model import HistoryModel

from .drawn import drawn, empty_history

CRUDE = Path(__file__).parents[5] / "shared" / "data" / "schwartz_smith_crude.csv"

TWO = HistoryModel(
    "multi-factor", 2, harmonics=1, quoted=True, columns=("spot", "f3", "f9"), exact=("spot",)
)
TABLE = {
    "mean_reversion": 2.0, "volatility": 0.4, "drift": 0.05, "long_volatility": 0.2,
    "correlation": 0.3, "premium": 0.1, "priced_drift": 0.02, "season_cosine_1": 0.1,
    "season_sine_1": -0.05, "deviation_f3": 0.02, "deviation_f9": 0.03,
}  # fmt: skip


def numbers(model: HistoryModel, table: dict[str, float]) -> np.ndarray:
    return np.array([table[name] for name in model.names])


def test_the_filter_is_the_joint_density_of_all_prices():
    """Missing prices, dates of unequal distance, and one series without any error."""
    history = drawn(TWO, TABLE, empty_history(6, [0.0, 0.25, 0.75], 0.1), seed=1)
    gap = np.array([0.0, 0.1, 0.02, 0.3, 0.1, 0.1])
    present = np.ones((6, 3), bool)
    present[1, 0] = present[2, 1] = present[4, :2] = present[0, 2] = False
    history = history._replace(gap=gap, present=present)
    with jax.enable_x64(True):
        result = float(log_likelihood(TWO, jnp.asarray(numbers(TWO, TABLE)), history))
    # Means and covariances of all prices, written down at once: X = loading state + constant.
    p, time = TABLE, np.cumsum(gap)
    a, s, l, rho = p["mean_reversion"], p["volatility"], p["long_volatility"], p["correlation"]
    mean, rows = [], []
    for i, j in np.argwhere(present):
        t, angle = history.years[i, j], 2 * np.pi * history.phase[i, j]
        decay = np.exp(-a * t)
        both = 2 * rho * s * l * (1 - decay) / a
        variance = s * s * (1 - decay**2) / (2 * a) + l * l * t + both
        constant = p["priced_drift"] * t - (1 - decay) * p["premium"] / a + variance / 2
        constant += p["season_cosine_1"] * np.cos(angle) + p["season_sine_1"] * np.sin(angle)
        mean.append(float(history.first) + p["drift"] * time[i] + constant)
        rows.append((time[i], decay, p.get(f"deviation_{TWO.columns[j]}", 0.0)))
    count = len(rows)
    covariance = np.zeros((count, count))
    for m, (t, load, error) in enumerate(rows):
        for n, (u, other, _) in enumerate(rows):
            early, late = min(t, u), max(t, u)
            short = s * s / (2 * a) * np.exp(-a * (late - early))  # stationary
            cross = rho * s * l / a
            # Cov(chi(t), xi(u)): the shocks until the earlier date, as far as chi still has them.
            chi_xi = cross * (np.exp(-a * (t - min(t, u))) - np.exp(-a * t))
            xi_chi = cross * (np.exp(-a * (u - min(t, u))) - np.exp(-a * u))
            long = 1.0 + l * l * early
            covariance[m, n] = load * other * short + load * chi_xi + other * xi_chi + long
        covariance[m, m] += error**2
    exact = multivariate_normal(mean, covariance).logpdf(history.value[present])
    assert result == pytest.approx(exact, abs=1e-8)


def test_a_shifted_price_is_one_factor_of_the_price_plus_its_shift():
    spot, table = np.array([20.0, 24.0, -3.0]), {"mean_reversion": 9.0, "volatility": 0.5}
    one = HistoryModel("one-factor", 1)
    shifted = HistoryModel("one-factor-shifted", 1, shift=30.0)
    np.testing.assert_array_equal(shifted.state_of(spot), one.state_of(spot + 30.0))
    assert shifted.names == one.names == (*table, "level")


# D7: Schwartz and Smith (2000) on crude oil. The published parameters; the exact log-likelihood,
# derivatives and states of ../shared/cases/desk.md, computed by a filter and by a joint density.
PUBLISHED = {
    "mean_reversion": 1.49, "volatility": 0.286, "premium": 0.157, "drift": -0.0125,
    "long_volatility": 0.145, "priced_drift": 0.0115, "correlation": 0.300, "deviation_f1": 0.042,
    "deviation_f5": 0.006, "deviation_f9": 0.003, "deviation_f17": 0.004,
}  # fmt: skip
DERIVATIVES = {
    "mean_reversion": -27.516, "volatility": 157.944, "premium": -0.01056, "drift": 0.19661,
    "long_volatility": 328.134, "priced_drift": -277.778, "correlation": 33.424,
    "deviation_f1": 580.81, "deviation_f5": 20.46, "deviation_f9": 7591.4, "deviation_f17": -4645.0,
}  # fmt: skip
CRUDE_MODEL = HistoryModel(
    "multi-factor", 2, quoted=True, columns=("f1", "f5", "f9", "f13", "f17"), exact=("f13",)
)


@pytest.fixture(scope="module")
def crude() -> History:
    if not CRUDE.is_file():
        pytest.skip("../shared/data/schwartz_smith_crude.csv is not there")
    prices = np.loadtxt(CRUDE, delimiter=",", skiprows=1, usecols=range(1, 6))
    history = empty_history(len(prices), np.array([1, 5, 9, 13, 17]) / 12, 5 / 262)
    return history._replace(value=np.log(prices), first=np.log(prices[0, 0]))


@pytest.mark.prove
def test_published_parameters_on_crude_oil(crude):
    """One error of measurement is exactly zero. The derivatives hold the initial covariance."""
    with jax.enable_x64(True):
        point = jnp.asarray(numbers(CRUDE_MODEL, PUBLISHED))
        initial = CRUDE_MODEL.initial(point, jnp.asarray(crude.first))

        def held(x):
            result = filtered(CRUDE_MODEL, x, crude, initial)
            return result.log_likelihood, result.mean[-1]

        (value, state), slope = jax.jit(jax.value_and_grad(held, has_aux=True))(point)
    assert float(value) == pytest.approx(4025.29759, abs=1e-4)
    np.testing.assert_allclose(state, [-0.014828, 2.920580], atol=1e-6)
    exact = numbers(CRUDE_MODEL, DERIVATIVES)
    # To 1e-3, and to half of the last digit of the printed numbers.
    digits = np.where(np.abs(exact) > 500, 0.05, np.where(exact == 20.46, 0.005, 5e-4))
    np.testing.assert_array_less(np.abs(np.asarray(slope) - exact), np.maximum(digits, 1e-3))


@pytest.mark.prove
def test_estimates_on_crude_oil_name_the_unknown(crude):
    """The maximum is above the published parameters; the data do not determine two of eleven."""
    with jax.enable_x64(True):
        start = jnp.asarray(CRUDE_MODEL.variables(numbers(CRUDE_MODEL, PUBLISHED)))
        maximum = jax.jit(lambda x: maximise(_likelihood(CRUDE_MODEL, crude), x))(start)
        estimate = estimate_of(CRUDE_MODEL, maximum)
        slope = jax.grad(_likelihood(CRUDE_MODEL, crude))(maximum.variables)
    assert estimate.converged and estimate.log_likelihood > 4025.29759
    assert float(np.max(np.abs(slope))) < 1e-2
    unknown = {name for name, x in zip(estimate.names, estimate.unknown) if x}
    assert unknown == {"drift", "premium"}
    # A drift is a mean of independent increments: its error is the deviation over sqrt(years).
    errors, values = (dict(zip(estimate.names, x)) for x in (estimate.errors, estimate.numbers))
    years = float(np.sum(crude.gap))
    assert errors["drift"] == pytest.approx(values["long_volatility"] / np.sqrt(years), rel=0.05)


def _likelihood(model: HistoryModel, history: History):
    return lambda variables: log_likelihood(model, model.numbers(variables), history)


QUOTED = HistoryModel(
    "one-factor", 1, harmonics=1, quoted=True, columns=("spot", "f1", "f3"), exact=("spot",)
)
COVERED = {
    "spot": (
        HistoryModel("one-factor", 1),
        {"mean_reversion": 60.0, "volatility": 0.8, "level": 3.2},
        empty_history(200, [0.0], 1 / 365),
    ),
    "normal": (
        HistoryModel("one-factor-normal", 1, normal=True, unit=10.0),
        {"mean_reversion": 60.0, "volatility": 70.0, "level": 14.0},
        empty_history(200, [0.0], 1 / 365),
    ),
    "quoted": (
        QUOTED,
        {
            "mean_reversion": 6.0, "volatility": 0.5, "level": 3.2, "premium": 0.4,
            "season_cosine_1": 0.2, "season_sine_1": -0.1, "deviation_f1": 0.03,
            "deviation_f3": 0.02,
        },
        empty_history(110, [0.0, 1 / 12, 0.25], 1 / 52),
    ),
    "two": (
        HistoryModel("multi-factor", 2, quoted=True, columns=("f1", "f6", "f15"), exact=()),
        {
            "mean_reversion": 2.5, "volatility": 0.35, "drift": 0.02, "long_volatility": 0.18,
            "correlation": 0.3, "premium": 0.1, "priced_drift": 0.01, "deviation_f1": 0.02,
            "deviation_f6": 0.01, "deviation_f15": 0.012,
        },
        empty_history(100, [1 / 12, 0.5, 1.25], 1 / 52),
    ),
}  # fmt: skip


@pytest.mark.prove
@pytest.mark.parametrize("case", list(COVERED))
def test_intervals_contain_the_truth(case):
    """Of 50 simulated histories the 95 % interval contains the truth 42 to 50 times."""
    model, table, empty = COVERED[case]
    truth = numbers(model, table)
    histories = [drawn(model, table, empty, seed) for seed in range(50)]
    with jax.enable_x64(True):
        together = jax.tree.map(lambda *x: jnp.stack(x), *histories)
        offset = 0.2 * np.random.default_rng(0).standard_normal(len(truth))
        start = jnp.asarray(model.variables(truth) + offset)
        search = jax.jit(jax.vmap(lambda history: maximise(_likelihood(model, history), start)))
        maxima = jax.tree.map(np.asarray, search(together))
        estimates = [estimate_of(model, Maximum(*(x[i] for x in maxima))) for i in range(50)]
    assert all(estimate.converged for estimate in estimates)
    inside = np.sum([(x.low <= truth) & (truth <= x.high) for x in estimates], axis=0)
    assert (inside >= 42).all(), dict(zip(model.names, inside.tolist()))
