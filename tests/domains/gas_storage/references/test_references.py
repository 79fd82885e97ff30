"""Exact and classical answers against published values, closed forms and one another.

"Published" numbers come from the package cmdty-storage and from Boogert and de Jong (2011); the
lattice values were computed by an independent dynamic program.
"""

import datetime

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.domains.gas_storage.references import reference_schedules as cases
from tests.domains.gas_storage.references.linear_program import (
    black_call,
    intrinsic_by_linear_program,
    perfect_foresight,
)
from tests.domains.gas_storage.references.reference_schedules import Factor

from snapo.domains.gas_storage.references.intrinsic import intrinsic
from snapo.domains.gas_storage.references.lattice import lattice, refined, relevant_factors
from snapo.domains.gas_storage.references.marginal import DEGREE, PIECES, marginal_values


def small(factors, days=40, interpolation="linear", seed=3, **terms):
    """A fast storage of 100 units on a random curve; `terms` as for `reference_schedules.build`."""
    random = np.random.default_rng(seed)
    start = cases.date("2024-01-01")
    curve = 20 + np.cumsum(random.normal(0, 1, days + 1))
    ratchets = terms.pop("ratchets", ([0, 50, 100], [6, 10, 12], [9, 8, 4]))
    return cases.build(
        "2024-01-01",
        "2024-01-01",
        (start + datetime.timedelta(days)).isoformat(),
        terms.pop("inventory", 30.0),
        lambda day: ratchets,
        (0.0, 100.0),
        lambda day: curve[(day - start).days],
        factors,
        interpolation=interpolation,
        **terms,
    )


def spot_paths(schedule, count, seed=0):
    """Spot prices [count, T] drawn from the schedule's factors, antithetic."""
    steps, random = schedule.steps, np.random.default_rng(seed)
    of = schedule.factors
    factor = np.zeros((count, of.loading.shape[1]))
    spots = np.empty((count, len(steps.forward)))
    for t in range(len(steps.forward)):
        noise = random.normal(size=(count // 2, factor.shape[1]))
        factor = of.decay[t] * factor + np.concatenate([noise, -noise]) @ of.shock[t].T
        log = factor @ of.loading[t] - of.variance[t] / 2
        spots[:, t] = steps.forward[t] * np.exp(log)
    return spots


def still(day):
    return 0.0


# Intrinsic value.


@pytest.mark.parametrize(
    ("case", "value", "tolerance"),
    [
        (cases.flagship, 40_992, 1e-4),
        (cases.sixteen_days, 10_827.2072, 1e-9),
        (cases.dated_ratchets, 24_781.90, 1e-6),
        (cases.slow_storage, 306.20, 1e-9),
        (cases.forced_flows, -156_115.5176, 1e-9),
    ],
)
def test_intrinsic_value(case, value, tolerance):
    assert_allclose(intrinsic(case(), "linear").value, value, rtol=tolerance)


def test_plan_keeps_the_contract():
    schedule = cases.flagship()
    plan, steps = intrinsic(schedule, "linear"), schedule.steps
    rows = ([0, 2000, 5000, 7000], [150, 200, 260, 275], [250, 175, 155, 132])
    start, end = plan.inventory[:-1], plan.inventory[1:]
    assert np.all(plan.net <= np.interp(start, rows[0], rows[2]) + 1e-9)
    assert np.all(-plan.net <= np.interp(start, rows[0], rows[1]) + 1e-9)
    assert np.all((end >= steps.next_low - 1e-9) & (end <= steps.next_high + 1e-9))
    assert_allclose(end, start + plan.net, atol=1e-9)
    assert plan.inventory[0] == 1500 and plan.inventory[-1] == 0


@pytest.mark.parametrize("seed", range(6))
def test_linear_program_agrees_on_concave_contracts(seed):
    schedule = small(
        [Factor(5.0, still)],
        seed=seed,
        ratchets=([0, 50, 100], [3, 9, 12], [9, 8, 4]),
        costs=(0.1, 0.2),
        inventory_loss=0.002,
        injection_fuel=0.01,
        withdrawal_fuel=0.02,
        inventory_cost=0.01,
        end_values=([0, 40, 100], [0, 900, 1500]),
        end_fraction=0.1,
        min_injection=np.arange(40) == 7,
        min_withdrawal=2.0 * (np.arange(40) == 20),
    )
    program = intrinsic_by_linear_program(schedule, "linear")
    assert program is not None
    plan = intrinsic(schedule, "linear")
    assert_allclose(plan.value, program.value, rtol=1e-9)
    assert plan.net[7] >= 1 - 1e-9 and plan.net[20] <= -2 + 1e-9


def test_linear_program_declines_what_it_would_overstate():
    concave = intrinsic_by_linear_program(cases.sixteen_days(), "linear")
    assert concave is not None
    assert_allclose(concave.value, 10_827.2072, rtol=1e-9)
    assert intrinsic_by_linear_program(cases.flagship(), "linear") is None
    assert intrinsic_by_linear_program(cases.dated_ratchets(), "linear") is None
    assert intrinsic_by_linear_program(cases.dated_ratchets("step"), "step") is None


@pytest.mark.prove
@pytest.mark.parametrize("interpolation", ["linear", "step"])
@pytest.mark.parametrize("seed", range(3))
def test_intrinsic_is_the_limit_of_fine_grids(interpolation, seed):
    """On ratchets that are far from concave, where only a grid is an independent witness."""
    ratchets = ([0, 20, 60, 100], [4, 9, 7, 15], [12, 3, 9, 2])
    schedule = small(
        [Factor(5.0, still)],
        interpolation=interpolation,
        seed=seed,
        ratchets=ratchets,
        costs=(0.1, 0.2),
    )
    exact = intrinsic(schedule, interpolation).value
    spots = schedule.steps.forward[None, :]
    grids = [
        perfect_foresight(schedule, interpolation, spots, inventories=n)[0] for n in (201, 1001)
    ]
    assert abs(grids[1] - exact) < abs(grids[0] - exact) + 1e-9 * exact
    assert_allclose(grids[1], exact, rtol=5e-4 if interpolation == "linear" else 2e-3)


# Lattice.


@pytest.mark.parametrize(
    ("case", "value", "tolerance", "volumes"),
    [
        (cases.slow_storage, 656.15, 2e-5, "free"),
        (cases.dated_ratchets, 24_802.08, 2e-5, "extremes"),
        # Stopping between the extremes earns 6 more; 24,808.2 is the limit of ever finer fractions.
        (cases.dated_ratchets, 24_808.2, 3e-5, "free"),
        (lambda: cases.flagship(seasonal=False), 77_314, 5e-4, "free"),
        (cases.forced_flows, -156_115.5176, 1e-8, "free"),
    ],
)
def test_one_factor_lattice(case, value, tolerance, volumes):
    schedule = case()
    found = lattice(schedule, schedule.factors, "linear", volumes=volumes)
    assert_allclose(found.value, value, rtol=tolerance)


@pytest.mark.prove
def test_two_factor_lattice_and_its_monthly_deltas():
    schedule = cases.flagship()
    assert relevant_factors(schedule, schedule.factors) == (0, 2)
    found = lattice(schedule, schedule.factors, "linear")
    assert found.dropped == (1,)
    assert_allclose(found.value, 78_370, rtol=5e-4)
    months = np.array([(day.year - 2021) * 12 + day.month - 4 for day in schedule.dates])
    by_month = np.bincount(months, found.deltas)
    known = [747, -994, -464, -237, -242, -1524, -168, 1786, 505, 1609, 1801, 1378]
    assert_allclose(by_month, known, atol=0.025 * 1801)
    # Sum of forward price x delta = value + present value of the costs.
    assert_allclose(schedule.steps.forward @ found.deltas, 79_380, rtol=1e-3)


def test_two_factor_lattice_on_a_coarse_grid():
    schedule, coarse = cases.flagship(), {"inventories": 81, "spacing": 0.4, "slow_nodes": 11}
    found = lattice(schedule, schedule.factors, "linear", **coarse)
    assert_allclose(found.value, 78_370, rtol=1e-3)


def test_deltas_explain_the_value_where_nothing_else_costs():
    schedule = cases.slow_storage()
    found = lattice(schedule, schedule.factors, "linear", inventories=101)
    assert_allclose(schedule.steps.forward @ found.deltas, found.value, rtol=1e-9)
    assert_allclose(np.diff(found.inventory), found.net, atol=1e-9)
    assert_allclose(found.inventory[[0, -1]], 0, atol=1e-9)


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_calls_in_disguise(correlation):
    """Gas that leaves on given days only is a strip of calls, whatever the number of factors."""
    matrix = [[1.0, correlation], [correlation, 1.0]]
    schedule = cases.calls(
        [Factor(16.5, cases.sine_volatility), Factor(2.0, lambda d: 0.3)], matrix
    )
    expected = 0.0
    for day, (volume, strike, paid) in cases.CALLS.items():
        t = schedule.dates.index(day)
        deviation, discount = np.sqrt(schedule.factors.variance[t]), cases.nine_percent(paid)
        call = black_call(schedule.steps.forward[t], strike, deviation, discount)
        expected += volume * float(call.value)
    found = lattice(schedule, schedule.factors, "linear", inventories=5)
    assert_allclose(found.value, expected, rtol=1e-3)


def test_black_calls():
    schedule, values, deltas = cases.calls(), [], []
    for day, (volume, strike, paid) in cases.CALLS.items():
        t = schedule.dates.index(day)
        deviation = np.sqrt(schedule.factors.variance[t])
        call = black_call(cases.sine_curve(day), strike, deviation, cases.nine_percent(paid))
        values.append(volume * float(call.value))
        deltas.append(volume * float(call.delta) / cases.nine_percent(paid))
    assert_allclose(values, [6_905.1935, 2_969.1867, 572.9235], atol=2e-3)
    assert_allclose(sum(values), 10_447.3037, atol=2e-3)
    assert_allclose(deltas, [646.4087, 374.7695, 248.2129], atol=1e-3)
    found = lattice(schedule, schedule.factors, "linear", inventories=5)
    assert_allclose(found.value, 10_447.3037, rtol=1e-4)
    assert_allclose(found.deltas.sum(), 1_250, rtol=0.05)


def test_black_call_at_its_edges():
    found = black_call([10.0, 10.0, 10.0], [8.0, 12.0, 0.0], [0.0, 0.0, 0.3], 0.5)
    assert_allclose(found.value, [1.0, 0.0, 5.0])
    assert_allclose(found.delta, [0.5, 0.0, 0.5])


def test_gas_left_is_worth_its_price_at_the_end():
    """Half a unit sold on the last day, or all kept for a fraction of the end's spot price.

    One factor: both are lognormal, so the choice is Margrabe's exchange option.
    """
    reversion, volatility, fraction = 3.0, 0.8, 0.9
    rates = ([0.0], [1.0], [0.0])
    schedule = cases.build(
        "2024-01-01",
        "2024-03-01",
        "2024-03-02",
        1.0,
        lambda day: rates,
        (0.0, 1.0),
        lambda day: 20.0 if day < cases.date("2024-03-02") else 22.0,
        [Factor(reversion, lambda day: volatility)],
        end_fraction=fraction,
    )
    time = 60 / 365
    spread = volatility * np.sqrt(-np.expm1(-2 * reversion * time) / (2 * reversion))
    spread *= 1 - np.exp(-reversion / 365)
    expected = 22 * fraction + float(black_call(20.0, 22 * fraction, spread).value)
    found = lattice(schedule, schedule.factors, "linear", spacing=0.02)
    assert_allclose(found.value, expected, rtol=1e-5)
    assert_allclose(found.deltas @ [20.0] + found.end_delta * 22.0, found.value, rtol=1e-9)


# Identities.


@pytest.mark.prove
def test_a_single_factor_without_reversion_adds_nothing():
    schedule = small([Factor(0.0, lambda day: 0.5)], days=40)
    value = intrinsic(schedule, "linear").value
    found = lattice(schedule, schedule.factors, "linear", inventories=401)
    assert_allclose(found.value, value, rtol=3e-4)


@pytest.mark.prove
def test_a_common_factor_without_reversion_may_be_dropped():
    fast = Factor(60.0, lambda day: 0.9)
    schedule = small([Factor(0.0, lambda day: 0.4), fast], days=30)
    assert relevant_factors(schedule, schedule.factors) == (1,)
    alone = lattice(schedule, schedule.factors, "linear").value
    both = lattice(schedule, schedule.factors, "linear", keep=(1, 0), spacing=0.15).value
    assert_allclose(both, alone, rtol=1e-3)


@pytest.mark.parametrize("interpolation", ["linear", "step"])
def test_intrinsic_exact_perfect_foresight(interpolation):
    schedule = cases.dated_ratchets(interpolation)
    plan = intrinsic(schedule, interpolation).value
    exact = lattice(schedule, schedule.factors, interpolation).value
    known = perfect_foresight(schedule, interpolation, spot_paths(schedule, 500))
    assert plan <= exact
    assert exact <= known.mean() + 3 * known.std() / np.sqrt(len(known))
    low_volatility = small([Factor(30.0, lambda day: 1e-9)], interpolation=interpolation)
    fine = {"inventories": 501, "spacing": 0.5}
    found = lattice(low_volatility, low_volatility.factors, interpolation, **fine)
    assert_allclose(found.value, intrinsic(low_volatility, interpolation).value, rtol=2e-3)


def test_more_than_two_factors_must_be_chosen():
    factors = [Factor(k, lambda day: 0.3) for k in (1.0, 5.0, 30.0)]
    schedule = small(factors, days=5)
    assert relevant_factors(schedule, schedule.factors) == (2, 1, 0)
    with pytest.raises(ValueError, match="name one or two factors in"):
        lattice(schedule, schedule.factors, "linear")
    assert lattice(schedule, schedule.factors, "linear", keep=(2, 1)).dropped == (0,)


# The marginal value of gas.


def follow_marginal_values(schedule, table, spots, factor):
    """The earnings of trading at the table's trigger prices on each path, [paths]."""
    steps = schedule.steps
    stock, earned = np.full(len(spots), schedule.constants.inventory), np.zeros(len(spots))
    for t in range(len(steps.forward)):
        state = np.clip(factor[:, t], -table.reach[t], table.reach[t])
        # Ratchets leave no corners: both sides of the table are one.
        worth = np.vander(state, DEGREE + 1, increasing=True) @ table.above[t].T
        width = max(table.high[t] - table.low[t], 1e-12)

        def marginal(inventory, worth=worth, low=table.low[t], width=width):
            place = np.clip((inventory - low) / width, 0, 1) * (worth.shape[1] - 1)
            weights = np.maximum(1 - np.abs(place[:, None] - np.arange(worth.shape[1])), 0)
            return np.sum(weights * worth, axis=1)

        out = np.interp(stock, steps.levels[t], steps.withdrawal_rate[t])
        into = np.interp(stock, steps.levels[t], steps.injection_rate[t])
        down = np.maximum(stock - out, steps.next_low[t])
        up = np.maximum(np.minimum(stock + into, steps.next_high[t]), down)
        hold = np.clip(stock, down, up)
        gas = spots[:, t] * steps.gas_discount[t]
        buy = gas + steps.injection_cost[t] * steps.injection_cost_discount[t]
        sell = gas - steps.withdrawal_cost[t] * steps.withdrawal_cost_discount[t]
        middle_up, middle_down = (hold + up) / 2, (hold + down) / 2
        end = np.where(marginal(middle_up) > buy, up, hold)
        end = np.where(marginal(middle_down) < sell, down, end)
        net = end - stock
        earned -= np.where(net > 0, net * buy, net * sell)
        stock = end
    return earned


@pytest.mark.prove
def test_marginal_values_are_a_good_policy():
    schedule = cases.flagship(seasonal=False)
    steps = schedule.steps
    # At rest, the long-term factor leaves the spot to the factor that the table knows.
    of, years = schedule.factors, np.append(steps.day, steps.day[-1] + 1) / 365
    of.loading[:, 1] = 0.0
    schedule = schedule._replace(factors=of._replace(variance=of.variance - 0.3**2 * years))
    of = schedule.factors
    table = marginal_values(schedule, schedule.factors, "linear")
    assert table.above.shape == table.below.shape == (341, 2 * PIECES + 1, DEGREE + 1)
    spots = spot_paths(schedule, 2048)
    factor = (np.log(spots / steps.forward) + of.variance[:-1] / 2) / of.loading[:-1, 0]
    earned = follow_marginal_values(schedule, table, spots, factor)
    calm = follow_marginal_values(
        schedule, marginal_values(schedule, None, "linear"), spots, factor
    )
    pairs = earned.reshape(2, -1).mean(axis=0)
    error = pairs.std() / np.sqrt(len(pairs))
    exact = lattice(schedule, schedule.factors, "linear", keep=(0,), spacing=0.3).value
    assert exact * 0.995 - 3 * error <= earned.mean() <= exact + 3 * error
    assert intrinsic(schedule, "linear").value < calm.mean() < earned.mean()


def test_marginal_values_without_noise_are_slopes_of_the_intrinsic_value():
    """On the first day the slope at the inventory held is what one unit more at the start adds."""

    def ten_days(stock=30.0):
        rates = ([0.0], [10.0], [0.0])
        return small([Factor(5.0, still)], days=10, inventory=stock, ratchets=rates)

    table = marginal_values(ten_days(), None, "linear")
    assert np.all(table.above[..., 1:] == 0) and np.all(table.below[..., 1:] == 0)
    values = [intrinsic(ten_days(stock), "linear").value for stock in (20.0, 22.0)]
    # The most, 10, leaves at once: the unit in the middle is the one at 21 - 10.
    row = np.linspace(table.low[0], table.high[0], 2 * PIECES + 1)
    slope = np.interp(11, row, table.above[0, :, 0])
    assert ten_days().steps.forward[0] > slope
    assert_allclose((values[1] - values[0]) / 2, slope, rtol=1e-9)


# Finer and finer grids.


def test_the_refined_value_of_few_days_is_the_exact_one():
    """A rate that no plain grid holds: 100 / 200 is half a unit, and a day delivers 4.7."""
    calm = Factor(30.0, lambda day: 1e-9)
    schedule = small([calm], days=30, inventory=100.0, ratchets=([0.0], [4.7], [0.0]))
    exact, found = (
        intrinsic(schedule, "linear").value,
        refined(schedule, schedule.factors, "linear"),
    )
    assert lattice(schedule, schedule.factors, "linear").value < exact * (1 - 1e-4)
    assert found.error <= 1e-6 * exact
    assert abs(found.value - exact) <= found.error + 1e-9 * exact


def swing(rate: float):
    """Two hundred days of a delivery whose daily volume is no part of the grid's."""
    calm = Factor(30.0, lambda day: 1e-9)
    return small([calm], days=200, inventory=100.0, ratchets=([0.0], [rate], [0.0]))


@pytest.mark.prove
@pytest.mark.parametrize(("rate", "lost"), [(0.83, 0.007), (1.3, 0.005), (4.7, 0.002)])
def test_the_refined_value_is_the_exact_one_to_its_error(rate, lost):
    """Without noise the exact value is the intrinsic one, of which a plain grid gives away."""
    schedule = swing(rate)
    exact = intrinsic(schedule, "linear").value
    found = refined(schedule, schedule.factors, "linear")
    assert lattice(schedule, schedule.factors, "linear").value < exact * (1 - lost)
    assert found.error <= 2e-4 * exact
    assert abs(found.value - exact) <= found.error + 2e-5 * exact


@pytest.mark.prove
def test_a_grid_across_the_daily_volumes_is_told_by_its_refinement():
    """Ratchets have no common volume: the first grid is as good as any, and halved."""
    schedule = small([Factor(20.0, lambda day: 0.8)], days=30)
    plain = lattice(schedule, schedule.factors, "linear", inventories=1601, spacing=0.04).value
    found = refined(schedule, schedule.factors, "linear")
    assert found.error > 0
    assert abs(found.value - plain) <= max(2 * found.error, 2e-4 * plain)
