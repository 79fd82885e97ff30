"""Limited increases valued as options: limits without options, closed forms, simulation."""

from dataclasses import replace
from math import erf, exp, log, sqrt

import equinox as eqx
import jax
import numpy as np
import pytest
from tests.domains.pension.market_cases import (
    CASH,
    assets,
    case,
    cash_flows,
    curve,
    given,
    inflation,
    plan,
    rates,
)

from snapo.case.error import CaseError
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.people.lpi import log_growth
from snapo.domains.pension.read.plan import check_limited
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.market import Correlation
from snapo.domains.pension.records.plan import Liability
from snapo.domains.pension.results.figures.reconcile import figures
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact

INDEX = 0.011


def scheme(kind="capped", cap=0.05, floor=0.0, steps=3, timing="arrears", **changes):
    """Three payments, yearly steps, rates and inflation that depend on each other, measure Q."""
    rules = plan(timing, "capped" if kind == "capped" else "full")
    limits = {"cap": given("indexation_cap", cap), "floor": given("indexation_floor", floor)}
    tenor = [1.0, 5.0, 10.0, 30.0]
    quotes = curve("break_even", tenor, [0.018, 0.02, 0.021, 0.022])
    usual = {
        "step": 1.0,
        "measure": "Q",
        "held_assets": assets(steps, [CASH], weight=[1.0]),
        "flows": cash_flows([100.0, 50.0, 30.0], [2, 9, 25]),
        "curve": curve("zero_rate", tenor, [0.02, 0.022, 0.025, 0.026]),
        "rates": rates(steps, 0.05, 0.009),
        "inflation": inflation(steps, quotes, volatility=0.007, index=INDEX),
        "correlation": Correlation(
            ("rate", "inflation", "price index"), given("correlation", [0.3, -0.2, 0.25])
        ),
        "plan": replace(rules, indexation=replace(rules.indexation, **limits)),
        "liability": Liability("risk-free", given("liability_rate", 0.0), kind),
    }
    return case(steps, **usual | changes)


def valued(one):
    return figures(one, plain(pension_inputs(one)))


@pytest.mark.prove
def test_without_limits_it_is_the_real_curve():
    """Liability, duration and IE01 are those of payments that follow prices, of any year."""
    full = valued(scheme("full", timing="advance"))
    limited = valued(scheme("capped", 9.0, -0.999, timing="advance"))
    assert limited.liability == pytest.approx(full.liability, rel=1e-12)
    assert limited.duration == pytest.approx(full.duration, rel=1e-12)
    assert limited.key_inflation == pytest.approx(full.key_inflation, rel=1e-9)


def black(forward: float, strike: float, deviation: float) -> float:
    """Black's call on a lognormal, undiscounted."""
    far = (log(forward / strike) + deviation**2 / 2) / deviation

    def below(x):
        return (1 + erf(x / sqrt(2))) / 2

    return forward * below(far) - strike * below(far - deviation)


@pytest.mark.prove
def test_a_case_of_years_is_valued_by_months_too():
    """`check` compares the two: volatilities are written for the years' steps."""
    one = scheme()
    by_month = replace(one, step=1 / 12, steps=12)
    yearly, monthly = (
        with_numpy(log_growth)(each, plain(pension_inputs(each))) for each in (one, by_month)
    )
    # A year's first payment is in arrears of it, a month's is not: one increase less.
    assert monthly[12 * 25] == pytest.approx(yearly[25], abs=2e-3)


@pytest.mark.prove
@pytest.mark.parametrize(("floor", "cap"), [(0.0, 0.05), (0.0, 0.025), (-0.02, 0.03)])
def test_independent_years_are_products_of_blacks_caplets_and_floorlets(floor, cap):
    """Expected inflation and rates that stand still: every year has its own forward and option."""
    quotes = curve("break_even", [1.0, 5.0, 30.0], [0.018, 0.02, 0.022])
    one = scheme(
        cap=cap, floor=floor, rates=rates(3, 0.05, 0.0), inflation=inflation(3, quotes, index=INDEX)
    )
    found = with_numpy(log_growth)(one, plain(pension_inputs(one)))
    years = np.arange(26)
    index = np.interp(years, quotes.tenor, quotes.rate.values) * years
    want = [0.0]
    for t in range(1, 26):
        forward = exp(index[t] - index[t - 1])
        options = [black(forward, 1 + strike, INDEX) for strike in (floor, cap)]
        want.append(want[-1] + log(1 + floor + options[0] - options[1]))
    # In arrears a payment at time s + 1 has had the increases up to time s.
    assert found[1:27] == pytest.approx(np.array(want), abs=1e-12)


@pytest.fixture(scope="module")
def ready():
    """LPI(0, 2.5): the fund's schedule, drawn paths and totals of the native engine."""
    one, paths = scheme(cap=0.025), 8192
    simulator = PensionSimulator.of(one)
    with jax.enable_x64(True):
        made = eqx.filter_jit(simulator.prepare)(plain(pension_inputs(one)))
        schedule = jax.tree.map(np.asarray, made)
    draws = Pseudo(3, antithetic=True).draws(np.arange(paths), simulator)
    found = Native("float64").values(
        simulator, None, schedule, draws, Exact(), actions=np.ones((3, paths, 1))
    )
    totals = {name: np.asarray(total) for name, total in found.totals.items()}
    return one, simulator, schedule, totals


@pytest.mark.prove
def test_payments_and_what_is_left_are_worth_the_liability_of_today(ready):
    """E[D_T L_T + sum D benefits] = L_0 under "Q": the options on a path, and their increases."""
    one, _, schedule, totals = ready
    worth = totals["pv_liability"] + totals["pv_benefit"]
    pairs = (worth[::2] + worth[1::2]) / 2
    error = pairs.std(ddof=1) / np.sqrt(pairs.size)
    assert error < 4e-4 * worth.mean()
    assert worth.mean() == pytest.approx(valued(one).liability, abs=4 * error)
    assert float(schedule.constants.liability) == pytest.approx(valued(one).liability, rel=1e-12)
    # Without the options' value today's liability would be another one by far.
    assert abs(valued(scheme("none")).liability - worth.mean()) > 100 * error
    assert np.abs(totals["pv_indexation"]).max() < 1e-12  # nothing is granted beyond them


@pytest.mark.prove
def test_both_engines_agree(ready):
    _, simulator, schedule, _ = ready
    draws, actions = Pseudo(5).draws(np.arange(9), simulator), np.ones((3, 9, 1))
    weights = {"pv_liability": np.ones(9), "funding_ratio": np.linspace(0, 1, 9)}
    given_ = (simulator, None, schedule, draws, Exact(), weights)
    found = [
        engine.adjoint(*given_, actions=actions, wrt=("schedule",))
        for engine in (Xla(precision="float64"), Native("float64"))
    ]
    for a, b in zip(*(jax.tree.leaves((each.totals, each.schedule)) for each in found)):
        np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-9)


@pytest.mark.prove
def test_inflation_exposure_is_that_of_differences():
    """IE01 at every node, and the liability's slope by cap, floor and volatilities."""
    one = scheme()
    inputs = {name: np.asarray(x, float) for name, x in plain(pension_inputs(one)).items()}
    with jax.enable_x64(True):
        value = jax.jit(lambda g: log_growth(one, g)[26])
        slopes = jax.jit(jax.grad(lambda g: log_growth(one, g)[26]))(inputs)
        for name in ("break_even", "indexation_cap", "indexation_floor", "inflation_volatility"):
            for place in np.ndindex(inputs[name].shape):
                step, both = 1e-6, []  # options bend within a per cent of inflation
                for sign in (1, -1):
                    moved = inputs[name].copy()
                    moved[place] += sign * step
                    both.append(float(value(inputs | {name: moved})))
                central = (both[0] - both[1]) / (2 * step)
                assert float(slopes[name][place]) == pytest.approx(central, rel=1e-6, abs=1e-9)


def test_options_without_limits_or_models_are_refused():
    check_limited(scheme())
    with pytest.raises(CaseError, match="not limited"):
        check_limited(replace(scheme(), plan=plan(indexation="full")))
    one, changing = scheme(), given("rate_volatility", [[0.01], [0.02], [0.02]])
    with pytest.raises(CaseError, match="do not change"):
        check_limited(replace(one, rates=replace(one.rates, volatility=changing)))
