"""Gamma by pair of products: Black's of three calls, and identities of stores and swings."""

import datetime
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm
from tests.domains.energy.energy_cases import plant, swing
from tests.domains.gas_storage.storage_cases import read

from snapo.case.error import CaseError
from snapo.domains.energy.methods.lattice import lattice
from snapo.domains.energy.setup import bare_problem as energy_problem
from snapo.domains.energy.setup import factors_of, price_schedule
from snapo.domains.energy.setup import make_setup as energy_setup
from snapo.domains.energy.study import study
from snapo.domains.gas_storage.contract.schedule import of_prices
from snapo.domains.gas_storage.explain.chain import delivery_periods
from snapo.domains.gas_storage.explain.curve import DeliveryPeriod
from snapo.domains.gas_storage.hedges.gamma import (
    GammaMatrix,
    centred_spots,
    gamma_matrix,
    price_rises,
    random_rises,
)
from snapo.domains.gas_storage.setup import bare_problem, fitted_value, make_setup
from snapo.study.domain import Options

VALUATION = datetime.date(2019, 8, 29)
# Volume, day of payment and markup of the cost over the forward price, by day of exercise.
CALLS = {"2019-12-15": (1200.0, "2020-01-20", 0.0), "2020-01-20": (800.0, "2020-02-18", 2.0),
         "2020-03-31": (900.0, "2020-04-22", 2.8)}  # fmt: skip


def curve_of(problem) -> Any:
    """Where the forward prices are used."""
    return problem.simulator.curve


def values(problem) -> np.ndarray:
    """The forward prices."""
    return problem.inputs_by_name[curve_of(problem).name].value


def measured(name: str, paths: int, **tables) -> tuple[GammaMatrix, list]:
    """The matrix by month of a reference case, by the rule that training begins with."""
    case = read(name, **tables)
    setup = make_setup(case, "native", fitted_value(bare_problem(case)))
    problem = setup.problem
    curve = curve_of(problem)
    rises = price_rises(
        delivery_periods(case.days, case.products), case.days, curve, values(problem)
    )
    prices, engine = of_prices(problem.schedule), setup.engines.evaluate
    found = gamma_matrix(problem, setup.policy, curve.name, rises, prices, engine, paths)
    return found, rises


def black(day: str) -> float:
    """Black's gamma of one of the calls of G4, discounted."""
    volume, paid, more = CALLS[day]
    i, later = ((datetime.date.fromisoformat(x) - VALUATION).days for x in (day, paid))
    season = np.sin(2 * np.pi * i / 365)
    forward, sigma = 53.5 + 24.6 * season, 0.78 + 0.35 * season
    deviation = sigma * np.sqrt(-np.expm1(-2 * 16.5 * i / 365) / (2 * 16.5))
    d1 = np.log(forward / (forward + more)) / deviation + deviation / 2
    size = volume * np.exp(-0.09 * later / 365)
    return size * norm.pdf(d1) / (forward * deviation)


@pytest.mark.prove
def test_three_calls():
    """G4: on the diagonal Black's within 2 %; other pairs, and February without an exercise, are
    zero."""
    of, rises = measured("G4", 65536)
    value, error = of.symmetric.value, of.standard_error
    exact = np.zeros((4, 4))
    months = [rise.name[:3] for rise in rises]
    for day in CALLS:
        i = months.index(datetime.date.fromisoformat(day).strftime("%b"))
        exact[i, i] = black(day)
    print(of.bumps, value, error, of.policy, exact, sep="\n")
    assert_allclose(np.diag(value), np.diag(exact), rtol=0.02)
    assert np.all(np.abs(value - exact) <= 3 * error + of.policy)
    assert np.all(np.diag(error) <= 0.014 * np.diag(exact))


@pytest.mark.prove
def test_homogeneous():
    """Half a year of G6, without costs: gamma times the forward prices is zero."""
    half = {"end": datetime.date(2009, 10, 1), "max_inventory": 60.0}
    of, rises = measured("G6", 2048, contract=half)
    product, error = of.along(np.array([rise.price for rise in rises]))
    print(product, error, np.diag(of.symmetric.value))
    assert np.all(np.abs(product) <= 3 * error)
    diagonal = np.diag(of.symmetric.value) * [rise.price for rise in rises]
    assert np.all(diagonal > 20 * error)  # what cancels is far larger


@pytest.mark.prove
def test_a_swing_against_a_lattice():
    """Four months with a soft minimum: the sum of a row, and of all, is the second difference of
    the value by dynamic programming, for a move of one month with all, and of all."""
    case = swing(end=datetime.date(2027, 2, 1), annual={"min": 60.0, "max": 90.0}, shortfall=6.0)
    setup = energy_setup(case, "native")
    problem = setup.problem
    curve = curve_of(problem)
    rises = price_rises(delivery_periods(case.days, None), case.days, curve, values(problem))
    prices = price_schedule(problem)
    of = gamma_matrix(
        problem, setup.policy, curve.name, rises, prices, setup.engines.evaluate, 8192
    )
    bare, base, step = energy_problem(case), problem.inputs_by_name[curve.name].value, 0.5
    layout, every = case.contract.layout, sum(rise.along for rise in rises)

    def exact(one: float, all_of_them: float) -> float:
        moved = bare.at({curve.name: base + one * rises[1].along + all_of_them * every})
        return lattice(layout, moved.schedule, factors_of(moved), finer=2).value

    corners = [sign * other * exact(sign * step, other * step)
               for sign in (1, -1) for other in (1, -1)]  # fmt: skip
    of_row = sum(corners) / (4 * step**2)
    of_all = (exact(0, step) - 2 * exact(0, 0) + exact(0, -step)) / step**2
    for found, expected in ((np.eye(4)[1], of_row), (np.ones(4), of_all)):
        blocks = np.einsum("i,bij,j->b", found, of.symmetric.blocks, np.ones(4))
        value, error = blocks.mean(), blocks.std(ddof=1) / np.sqrt(len(blocks))
        print(value, error, expected)
        assert abs(value - expected) < 3 * error + 0.01 * abs(expected)
        assert error < 0.02 * abs(expected)


def test_both_estimates_of_a_pair():
    """Their mean is symmetric; what they differ by beyond noise is an error of the policy."""
    rng = np.random.default_rng(0)
    noise = 0.1 * rng.standard_normal((32, 3, 3))
    exact = np.array([[3.0, -1.0, 0.0], [-1.0, 2.0, -0.5], [0.0, -0.5, 1.0]])
    off = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    of = GammaMatrix(exact + off + noise, np.ones(3))
    value = of.symmetric.value
    assert_allclose(value, value.T, rtol=0, atol=0)
    assert np.all(np.abs(value - exact) <= 4 * of.standard_error + of.policy)
    assert_allclose(of.policy[0, 2], 0.5, atol=0.1)
    assert np.all(of.policy[[0, 1], [1, 2]] < 0.05) and not np.diag(of.policy).any()
    product, error = of.along(np.array([1.0, 2.0, 3.0]))
    assert_allclose(product, value @ [1.0, 2.0, 3.0])
    assert np.all(error > 0)


def test_a_move_is_of_the_numbers_of_the_days():
    case = read("G4")
    problem = bare_problem(case)
    curve = curve_of(problem)
    periods = [DeliveryPeriod("a", 0, 3), DeliveryPeriod("b", 3, 7)]
    one, other = price_rises(periods, case.days, curve, values(problem))
    assert one.along.sum() == 3 and other.along.sum() == 4 and not np.any(one.along * other.along)
    assert other.price == pytest.approx(case.market.forward_curve.used()[3:7].mean())
    assert other.steps == slice(3, 7)


def test_a_known_price_does_not_rise():
    """A swing of one week: on the valuation date every path has the same price. A rise of it would
    change the decision of that day on all paths at once, and a secant over the kink is no gamma."""
    case = swing(end=datetime.date(2026, 10, 8), annual=None)
    setup = energy_setup(case, "native")
    problem = setup.problem
    curve = curve_of(problem)
    rises = price_rises(delivery_periods(case.days, None), case.days, curve, values(problem))
    prices, engine = price_schedule(problem), setup.engines.evaluate
    (along,) = random_rises(centred_spots(problem, setup.policy, prices, engine), rises)
    assert_array_equal(along, [0, 1, 1, 1, 1, 1, 1])
    # At the money on the first day, where a bump of its price would turn the decision.
    value = problem.inputs_by_name[curve.name].value.copy()
    value[0] = case.contract.strike.values[0]
    on = problem.at({curve.name: value})
    of = gamma_matrix(on, setup.policy, curve.name, rises, prices, engine, 512)
    deviation = np.sqrt(np.asarray(factors_of(on).variance)[1:7])
    d1 = np.log(28.0 / 29.0) / deviation + deviation / 2
    exact = np.sum(norm.pdf(d1) / (28.0 * deviation))  # a call on every other day; discounts: 1e-3
    gamma, error = of.symmetric.value[0, 0], of.standard_error[0, 0]
    print(gamma, error, exact, 1 / (2 * of.bumps[0]))
    assert abs(gamma - exact) < 3 * error < 0.3 / of.bumps[0]


@pytest.mark.prove
def test_prices_that_are_not_random_have_no_gamma():
    case = swing(end=datetime.date(2026, 10, 8), annual=None)
    setup = energy_setup(case, "xla")
    problem = setup.problem.at({"volatility": np.zeros(1)})
    curve = curve_of(problem)
    rises = price_rises(delivery_periods(case.days, None), case.days, curve, values(problem))
    with pytest.raises(ValueError, match="is not random"):
        gamma_matrix(
            problem, setup.policy, curve.name, rises, price_schedule(problem),
            setup.engines.evaluate, 64,
        )  # fmt: skip


def test_a_plant_has_none_and_says_why():
    with pytest.raises(CaseError, match=r"one commodity; case\.toml has 2 curves, gas_curve"):
        study(plant(), Options(gamma=True))
