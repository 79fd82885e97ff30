"""Spikes on a mean-reverting spot: forward, distribution, derivatives, and a store valued on it."""

import datetime

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.domains.gas_storage.storage_cases import bare, read

from snapo.domains.gas_storage.bounds.regression import basis_of
from snapo.domains.gas_storage.bounds.relaxation import StoreRelaxation
from snapo.domains.gas_storage.chapters.certificate import off_ties
from snapo.domains.gas_storage.contract.schedule import of_prices
from snapo.domains.gas_storage.policy.network import StoragePolicy
from snapo.domains.gas_storage.prices.spikes import Spikes, spike_nodes, spike_weights
from snapo.domains.gas_storage.references.lattice import lattice
from snapo.domains.gas_storage.setup import bare_problem, factors, fitted_value, make_setup
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact
from snapo.solver import certificate
from snapo.solver.bound import bound
from snapo.solver.evaluate import evaluate

SPIKES = {
    "kind": "one-factor-jumps",
    "mean_reversion": 12.0,
    "volatility": 0.6,
    "jump_intensity": 20.0,
    "jump_size": 0.3,
    "jump_mean_reversion": 150.0,
}
KINDS = ("one-factor-jumps", "one-factor-poisson-jumps")
# D1 of the desk: values, and derivatives with the numbers between which a difference is taken.
DESK = [
    (KINDS[0], 965.238, {"jump_intensity": ((7.5, 8.5), 36.456), "jump_size": ((0.34, 0.36), 1445.0),
                         "jump_mean_reversion": ((118.0, 122.0), -1.058)}),
    (KINDS[1], 901.245, {"jump_intensity": ((7.5, 8.5), 28.849), "jump_size": ((0.34, 0.36), 1093.5),
                         "jump_mean_reversion": ((118.0, 122.0), -1.275)}),
]  # fmt: skip
EARLIER = {"valuation_date": datetime.date(2024, 12, 22)}  # ten days before the first decision


def case(**model):
    return read("quick", model=SPIKES | model, market=EARLIER)


def paths_of(case, paths, seed=3):
    """Spot prices [T, paths] and states [T, paths, 2] of simulated paths."""
    simulator, _, schedule = bare(case)
    draws = Pseudo(seed).draws(np.arange(paths), simulator)
    nothing = np.zeros((simulator.horizon, paths, 2))
    rolled = Native("float64").values(
        simulator, None, schedule, draws, Exact(), actions=nothing, record=("state",)
    )
    state, row = np.asarray(rolled.record["state"].price), schedule.steps.price
    log = row.loading[:, None] * state[..., 0] - row.variance[:, None] / 2
    log = log + state[..., 1] - row.compensator[:, None]
    return schedule, row.forward[:, None] * np.exp(log), state


def test_the_spot_price_is_the_forward_price_on_average():
    count = 65536
    schedule, spots, _ = paths_of(case(), count)
    error = spots.std(1) / np.sqrt(count)
    assert np.all(np.abs(spots.mean(1) - schedule.steps.forward) < 4.5 * error)


def test_spikes_come_as_often_and_as_large_as_they_say():
    """Where they do not die out, y after d days is a sum of d draws: mean d p eta, variance
    d p eta^2 (2 - p)."""
    count, days = 65536, 10
    chance = -np.expm1(-20 / 365)
    _, _, state = paths_of(case(jump_mean_reversion=0.0), count)
    sums = state[0, :, 1]
    deviation = 0.3 * np.sqrt(days * chance * (2 - chance))
    assert abs(sums.mean() - days * chance * 0.3) < 4.5 * deviation / np.sqrt(count)
    assert_allclose(sums.std(), deviation, rtol=0.03)
    none = (1 - chance) ** days
    assert abs(np.mean(sums == 0) - none) < 4.5 * np.sqrt(none * (1 - none) / count)


def test_the_compensator_is_the_logarithm_of_the_expectation():
    """Day by day from the closed form: ln E exp(y) with spikes that shrink."""
    _, _, schedule = bare(case())
    chance, age = -np.expm1(-20 / 365), np.arange(11)
    left = 0.3 * np.exp(-150 * age / 365)
    each = np.log(1 - chance + chance / (1 - left))
    assert_allclose(schedule.steps.price.compensator[:2], [each[:10].sum(), each.sum()], rtol=1e-12)


def test_without_a_gap_the_first_price_is_known():
    schedule, spots, _ = paths_of(read("quick", model=SPIKES), 16)
    assert_allclose(spots[0], schedule.steps.forward[0], rtol=1e-12)


def test_poisson_spikes_have_the_moments_of_their_process():
    """Several a day, partly died out: mean intensity eta (1 - exp(-b T)) / b, variance intensity
    eta^2 (1 - exp(-2 b T)) / b, and the compensator in closed form."""
    count, time = 65536, 10 / 365
    schedule, spots, state = paths_of(case(kind="one-factor-poisson-jumps"), count)
    error = spots.std(1) / np.sqrt(count)
    assert np.all(np.abs(spots.mean(1) - schedule.steps.forward) < 4.5 * error)
    sums = state[0, :, 1]
    deviation = np.sqrt(20 * 0.3**2 * -np.expm1(-2 * 150 * time) / 150)
    mean = 20 * 0.3 * -np.expm1(-150 * time) / 150
    assert abs(sums.mean() - mean) < 4.5 * deviation / np.sqrt(count)
    assert_allclose(sums.std(), deviation, rtol=0.03)
    left = np.exp(-150 * np.array([10, 11]) / 365)
    expected = 20 / 150 * np.log((1 - 0.3 * left) / (1 - 0.3))
    assert_allclose(schedule.steps.price.compensator[:2], expected, rtol=1e-12)
    none = case(kind="one-factor-poisson-jumps", jump_mean_reversion=0.0)
    expected = 20 * np.array([10, 11]) / 365 * 0.3 / 0.7
    assert_allclose(bare(none)[2].steps.price.compensator[:2], expected, rtol=1e-9)


@pytest.mark.parametrize("poisson", [False, True])
@pytest.mark.parametrize("speed", [0.0, 5.0, 120.0, 1000.0])
def test_the_nodes_of_the_lattice_have_the_moments_of_the_law(speed, poisson):
    """Also of spikes that do not die out, or are gone in a day."""
    spikes = Spikes(np.exp(-speed / 365), 0.35, 8 / 365, poisson, 0, np.zeros(1))
    nodes = spike_nodes(spikes, 34)
    expected = spike_weights(spikes, nodes, nodes) @ np.exp(0.5 * nodes)
    right = spikes.moment(0.5) * np.exp(0.5 * spikes.decay * nodes)
    assert_allclose(expected[:-4], right[:-4], rtol=1e-4)
    if speed == 0:
        p = -np.expm1(-8 / 365)
        exact = np.exp(8 / 365 * 0.175 / 0.825) if poisson else 1 - p + p / 0.825
        assert_allclose(spikes.moment(0.5), exact, rtol=1e-7)


@pytest.mark.prove
@pytest.mark.parametrize("kind", KINDS)
def test_functions_of_factor_and_spikes_have_the_expectations_that_they_say(kind):
    """By quadrature over the law of a day: increments of the basis have mean 0 given the day
    before, and so have the coefficients of the control variate."""
    days = {"end": datetime.date(2025, 1, 9)}
    short = read("quick", model=SPIKES | {"kind": kind}, market=EARLIER, contract=days)
    simulator, _, schedule = bare(short)
    factors = simulator.process.factors(of_prices(schedule))
    assert factors.exact
    basis, spikes = basis_of(factors, priced=True), factors.spikes
    jump, chance = spikes.quadrature()
    assert_allclose([np.sum(chance), chance @ np.exp(jump)], [1.0, spikes.moment(1.0)], rtol=1e-9)
    assert_allclose(chance[1:] @ jump[1:], chance @ jump, rtol=1e-12)
    shock, weight = np.polynomial.hermite_e.hermegauss(200)
    before = np.array([0.02, 0.4])  # the factor, and the spikes, on day 5
    after = factors.decay[6, 0] * before[0] + factors.shock[6, 0, 0] * shock
    states = np.zeros((len(factors.decay), 2, len(jump) * len(shock)))
    states[5] = before[:, None]
    states[6, 0] = np.tile(after, len(jump))
    states[6, 1] = np.repeat(spikes.decay * before[1] + jump, len(shock))
    weights = np.kron(chance, weight / weight.sum())
    moved = basis.increments(states)[6]
    size = np.abs(moved) @ weights
    assert np.max(np.abs(moved @ weights) / (size + 1e-3)) < 2e-2  # hinges have corners
    assert np.median(np.abs(moved @ weights) / (size + 1e-3)) < 1e-6


@pytest.mark.prove
@pytest.mark.parametrize(("kind", "exact", "slopes"), DESK)
def test_the_lattice_in_factor_and_spike(kind, exact, slopes):
    """Both columns of D1; derivatives by differences of the lattice."""

    def value(**changes):
        problem = bare_problem(read("D1", model={"kind": kind} | changes))
        return lattice(problem.schedule, factors(problem), "linear", step=1.0).value

    assert abs(value() - exact) < 0.05
    for name, (numbers, slope) in slopes.items():
        ends = [value(**{name: number}) for number in numbers]
        assert_allclose(np.diff(ends)[0] / np.diff(numbers)[0], slope, rtol=0.01)


@pytest.mark.prove
@pytest.mark.parametrize(("kind", "exact", "slopes"), DESK)
def test_rule_and_bound_in_factor_and_spike(kind, exact, slopes):
    """Penalised for the calm factor alone, the bound of D1 was 1,056 with at most one spike a
    day."""
    read_case = read("D1", model={"kind": kind})
    made = make_setup(read_case, "native", fitted_value(bare_problem(read_case)))
    assert made.problem.simulator.control_variates() == ("value_surprise",)
    found = bound(
        made.problem,
        made.policy.value_rule,
        relaxation=StoreRelaxation(made.problem),
        paths=1024,
        engine=made.engines.evaluate,
    )
    assert 0.998 * exact < found.lower.value + 3 * found.lower.standard_error
    assert found.lower.value < exact + 3 * found.lower.standard_error
    error = 3 * found.upper.standard_error
    assert exact - error < found.upper.value < 1.008 * exact + error


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "make",
    [pytest.param(Native, marks=pytest.mark.prove), pytest.param(Xla, marks=pytest.mark.study)],
)
def test_every_derivative_agrees_with_differences(make, kind):
    """Also that by the intensity: a spike is continuous in its probability."""
    problem = off_ties(bare_problem(case(kind=kind)))
    policy = StoragePolicy(problem.features, key=jax.random.key(0))
    bumps = certificate.bump_check(problem, policy, paths=64, engine=make("float64"))
    assert {"jump_intensity", "jump_size", "jump_mean_reversion"} <= {b.input for b in bumps}
    wrong = [bump for bump in bumps if not bump.passed]
    assert not wrong, "\n".join(map(str, wrong))


@pytest.mark.prove
def test_rare_and_tiny_spikes_are_the_one_factor_price():
    calm = {key: SPIKES[key] for key in ("mean_reversion", "volatility")} | {"kind": "one-factor"}
    _, spots, _ = paths_of(case(jump_intensity=1e-9, jump_size=1e-6), 8)
    other = read("quick", model=calm, market=EARLIER)
    calm_factors = bare(other)[0].process.factors(of_prices(bare(other)[2]))
    ours = bare(case())[0].process.factors(of_prices(bare(case())[2]))
    assert ours.exact and ours.spikes is not None and calm_factors.exact
    for one, two in zip(ours[:4], calm_factors[:4], strict=True):
        # The decay into the first day multiplies zeros.
        assert_allclose(one[1:], two[1:], rtol=1e-12)
    assert np.isfinite(spots).all()


@pytest.mark.prove
def test_a_store_earns_the_spikes():
    """The same rule earns more with spikes than without, many standard errors."""
    values = {}
    for intensity in (1e-6, 20.0):
        made = make_setup(case(jump_intensity=intensity), "native")
        assert made.problem.simulator.control_variates() == ("forward_hedge",)
        engine = made.engines.evaluate
        values[intensity] = evaluate(
            made.problem, made.policy.value_rule, paths=4096, engine=engine
        )
    calm, wild = values.values()
    assert wild.value - calm.value > 5 * np.hypot(calm.standard_error, wild.standard_error)
