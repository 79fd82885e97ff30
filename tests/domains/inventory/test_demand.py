"""Demand: its distribution, and its derivative by every parameter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from tests.domains.inventory.inventory_cases import case

from snapo.domains.inventory.demand.counts import TAIL, most_of, negative_binomial, poisson
from snapo.domains.inventory.demand.registry import kinds

LAWS = {
    "poisson": ({"kind": "poisson", "mean": 5.0}, stats.poisson(5)),
    "geometric": ({"kind": "geometric", "mean": 5.0}, stats.nbinom(1, 1 / 6)),
    "negative-binomial": (
        {"kind": "negative-binomial", "mean": 5.0, "deviation": 3.0},
        stats.nbinom(25 / 4, 5 / 9),
    ),
}
POINTS = 20_000  # of the uniform number, evenly spread: an integral without noise


def drawn(demand, values: dict[str, float], spread: bool = False):
    """[POINTS] demands at evenly spread quantiles, of parameters that are differentiated."""
    u = (np.arange(POINTS) + 0.5) / POINTS
    normals = jnp.asarray(stats.norm.ppf(u))
    now = jax.tree.map(lambda x: x[0], demand.prepare(values, jnp.ones(1)))
    return jax.vmap(lambda z: demand.draw(now, z, spread))(normals)


@pytest.mark.prove
@pytest.mark.parametrize("kind", LAWS)
def test_chances_are_those_of_the_distribution(kind):
    table, law = LAWS[kind]
    demand = case(table).demand
    found = demand.probabilities(demand.values())
    assert found == pytest.approx(law.pmf(np.arange(len(found))), rel=1e-9)
    assert found.sum() == pytest.approx(1, abs=1e-7)
    assert demand.deviation(demand.values(), 1.0) == pytest.approx(law.std())


@pytest.mark.prove
@pytest.mark.parametrize("kind", LAWS)
def test_whole_demand_and_its_derivative(kind):
    """The mean of a straight cost between whole numbers, and its derivative by each parameter,
    against the sum over all demands; corners at whole stocks are met exactly."""
    table, law = LAWS[kind]
    demand = case(table).demand
    stocks = jnp.asarray([2.0, 5.0, 8.0])
    with jax.enable_x64(True):

        def mean(values):
            d = drawn(demand, values)[:, None]
            # Differentiated upwards in stock where the two are equal.
            left = jnp.where(stocks - d < 0, 0.0, stocks - d)
            return jnp.mean(left + 4.0 * (left - stocks + d), 0)

        values = demand.values()
        found, slopes = mean(values), jax.jacobian(mean)(values)
        k = np.arange(400)
        left = np.maximum(np.subtract.outer(np.asarray(stocks), k), 0)
        paid = left + 4.0 * np.maximum(-np.subtract.outer(np.asarray(stocks), k), 0)
        assert found == pytest.approx(paid @ law.pmf(k), rel=2e-3)  # the integral's own error
        for name, slope in slopes.items():
            step = 1e-4
            more, less = (
                np.exp(
                    np.asarray(
                        demand.logarithms(values | {name: values[name] + d}, 1.0, jnp.asarray(k))
                    )
                )
                for d in (step, -step)
            )
            expected = paid @ (more - less) / (2 * step)
            assert slope == pytest.approx(expected, rel=5e-3, abs=5e-3), name


@pytest.mark.prove
def test_spread_demand_is_continuous_and_keeps_the_mean():
    with jax.enable_x64(True):
        demand = case(LAWS["poisson"][0]).demand
        found = np.asarray(drawn(demand, demand.values(), spread=True))
    assert found.mean() == pytest.approx(5.0, abs=2e-3)
    assert found.var() == pytest.approx(5.0 + 1 / 12, rel=2e-3)
    inner = found[POINTS // 100 : -POINTS // 100]
    assert np.all(np.diff(inner) >= 0) and np.max(np.diff(inner)) < 0.01


def test_every_kind_is_complete():
    assert set(kinds()) == {"poisson", "geometric", "negative-binomial", "normal", "empirical"}


@pytest.mark.prove
def test_normal_and_empirical_demand_have_the_derivatives_of_their_moments(tmp_path):
    """Of a cost's mean, against differences; demand from a history is stretched and moved."""
    history = "period,demand\n" + "\n".join(
        f"{i},{d}" for i, d in enumerate([3, 8, 5, 6, 2, 7, 9, 4])
    )
    (tmp_path / "history.csv").write_text(history)
    tables = (
        {"kind": "normal", "mean": 5.0, "deviation": 1.6},
        {"kind": "empirical", "history": "history.csv", "mean": 5.2, "deviation": 2.1},
    )
    for table in tables:
        demand = case(table, folder=tmp_path).demand
        with jax.enable_x64(True):

            def mean(values, demand=demand):
                left = jnp.maximum(6.3 - drawn(demand, values), 0.0)
                return jnp.mean(5 * left - 4 * (6.3 - drawn(demand, values)))

            values = demand.values()
            slopes = jax.grad(mean)(values)
            assert set(slopes) == {"demand_mean", "demand_deviation"}
            for name, slope in slopes.items():
                ends = [mean(values | {name: values[name] + way * 1e-6}) for way in (1, -1)]
                assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / 2e-6, rel=1e-5)


@pytest.mark.parametrize("mean", [0.01, 0.7, 5.0, 90.0, 1100.0])
def test_the_largest_demand_is_the_quantile_of_scipy(mean):
    for size in (0.3, 1.0, 40.0):
        quantile = stats.nbinom(size, size / (size + mean)).ppf(1 - TAIL)
        assert most_of(negative_binomial(size, mean)) == quantile + 1
    assert most_of(poisson(mean)) == stats.poisson(mean).ppf(1 - TAIL) + 1


@pytest.mark.parametrize("mean", [0.01, 0.7, 5.0, 63.2, 1100.0])
def test_probabilities_in_numpy_are_those_of_the_distributions(mean):
    k = np.arange(400.0)
    for size in (0.05, 1.0, 30.5):
        law = stats.nbinom(size, size / (size + mean))
        assert negative_binomial(size, mean)(k) == pytest.approx(law.pmf(k), rel=1e-9, abs=1e-300)
    assert poisson(mean)(k) == pytest.approx(stats.poisson(mean).pmf(k), rel=1e-9, abs=1e-300)
