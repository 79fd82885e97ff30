"""Funds that borrow or sell short: closed forms, ruin, and the adjoint on both engines."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import CASH, EQUITY, assets, case, cash_flows, full, given

from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.policies.allocation import new_policy
from snapo.domains.pension.policies.classical import ConstantMix, PresentMix
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.engine import Xla
from snapo.engine.native import Native, unsupported
from snapo.problem.inputs import named_inputs, values
from snapo.problem.inputs import replace as with_values
from snapo.problem.objective import CRRA, ExpectedUtility, Mean
from snapo.problem.problem import Problem, prepare
from snapo.problem.scenarios import Pseudo, Sobol
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import float64, pull_back, value_and_gradient
from snapo.solver.train import Training, initial_progress, train

STEPS, RATE, DRIFT = 24, 0.02, 0.05
ENGINES = {"xla": Xla("float64"), "native": Native("float64")}


def borrowing(weight, *, volatility=0.0, drift=DRIFT, flows=None, **held):
    """Cash at 2 % and shares that grow by 5 % a year, `weight` of them and the rest in cash."""
    changed = {
        "mean": [np.expm1(drift)], "volatility": [volatility], "weight": [1 - weight, weight],
        "return_kind": "total", "mean_kind": "arithmetic", "amount": 1.0,
    } | held  # fmt: skip
    found = assets(STEPS, [CASH, EQUITY], high=[1.0, 5.0], **changed)
    found = replace(found, low=np.array([-4.0, -1.0]))
    flows = cash_flows([0.0], [0]) if flows is None else flows
    return case(STEPS, held_assets=found, flows=flows)


def totals(one, engine, paths=8, policy=None):
    simulator = PensionSimulator.of(one)
    schedule = prepare(simulator, pension_inputs(one))
    draws = Pseudo(3).draws(np.arange(paths), simulator)
    policy = PresentMix(one, 1) if policy is None else policy
    found = engine.values(simulator, policy, schedule, draws, Exact())
    return {name: np.asarray(each) for name, each in found.totals.items()}


@pytest.mark.prove
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("weight", [1.4, 3.0, -0.5])
def test_a_levered_constant_mix_grows_as_known(engine, weight):
    """(w exp(mu / 12) + (1 - w) exp(r / 12)) ^ months, without volatility."""
    grown = weight * np.exp(DRIFT / 12) + (1 - weight) * np.exp(RATE / 12)
    found = totals(borrowing(weight), ENGINES[engine])["assets"]
    np.testing.assert_allclose(found, grown**STEPS, rtol=1e-12)


@pytest.mark.prove
def test_fees_are_paid_on_both_sides_of_zero_and_trades_once():
    """Shares at 140 %, and cash borrowed at 30 bp more: fees on 1.4 and on 0.4 of the assets."""
    one = borrowing(1.4, fee=[0.003, 0.001], cost=[0.0, 0.0])
    grown = 1.4 * np.exp(DRIFT / 12) - 0.4 * np.exp(RATE / 12)
    paid = (0.4 * 0.003 + 1.4 * 0.001) / 12
    found = totals(one, ENGINES["xla"])["assets"]
    np.testing.assert_allclose(found, (grown * (1 - paid)) ** STEPS, rtol=1e-10)


@pytest.mark.prove
def test_mean_log_growth_and_its_derivatives_of_a_levered_mix():
    """E ln A by Gauss-Hermite, at the growth-optimal mix of 1.23 and beyond it; derivatives held."""
    volatility, paths = 0.18, 2**12
    nodes, mass = np.polynomial.hermite_e.hermegauss(60)
    mass = mass / mass.sum()

    def log_growth(weight, drift=DRIFT, rate=RATE):
        stock = (drift - volatility**2 / 2) / 12 + volatility / np.sqrt(12) * nodes
        gross = weight * np.exp(stock) + (1 - weight) * np.exp(rate / 12)
        return STEPS * np.log(gross) @ mass

    for weight in ((DRIFT - RATE) / volatility**2, 1.8):
        one = borrowing(weight, volatility=volatility)
        simulator, inputs = PensionSimulator.of(one), pension_inputs(one)
        problem = Problem(simulator, inputs, Mean("log_relative"))
        problem = replace(problem, sources=replace(problem.sources, evaluation=Sobol(5)))
        value, gradient = value_and_gradient(
            problem, PresentMix(one, 1), paths=paths, decisions="held", engine=ENGINES["native"]
        )
        h = 1e-5
        by_drift = (log_growth(weight, DRIFT + h) - log_growth(weight, DRIFT - h)) / (2 * h)
        by_rate = (log_growth(weight, rate=RATE + h) - log_growth(weight, rate=RATE - h)) / (2 * h)
        assert value == pytest.approx(log_growth(weight), abs=2e-3)
        found = gradient.inputs["asset_mean"][0] * np.exp(DRIFT)
        assert found == pytest.approx(by_drift, rel=2e-3)
        assert gradient.inputs["zero_rate"].sum() == pytest.approx(by_rate, rel=4e-3)


@pytest.mark.study
def test_training_finds_the_levered_weight_of_a_logarithm():
    """Merton's 0.03 / 0.156^2, 123 % in shares, from a start at 50 % and from one at 190 %.

    300 steps of 2,048 paths tell a mean return to 0.156 / (2 years x 600,000)^.5, a weight to 0.005.
    """
    logarithm, best = ExpectedUtility("assets", CRRA(1.0)), (DRIFT - RATE) / 0.156**2
    for start in (0.5, 1.9):
        one = borrowing(start, volatility=0.156)
        simulator, inputs = PensionSimulator.of(one), pension_inputs(one)
        problem = Problem(simulator, inputs, logarithm)
        training = Training(steps=300, paths=2048, learning_rate=0.05, validation_every=100)
        policy = ConstantMix(one, np.array([1 - start, start]))
        engine = Native("float32")
        found = train(problem, initial_progress(policy, training), training, engine).best
        weight = np.asarray(found(jnp.zeros(1), Exact()))
        assert weight[1] == pytest.approx(best, abs=0.03)
        assert weight.sum() == pytest.approx(1, abs=1e-6)


@pytest.mark.prove
@pytest.mark.parametrize("engine", ENGINES)
def test_a_fund_that_lost_everything_owes_its_debt_in_cash(engine):
    """Shares at 500 % fall by a third in the first month: 1, then -0.67, a debt at 2 %."""
    fall = np.log(1 - 1 / 3)
    one = borrowing(5.0, drift=12 * fall)
    first = 5 * np.exp(fall) - 4 * np.exp(RATE / 12)
    found = totals(one, ENGINES[engine])["assets"]
    np.testing.assert_allclose(found, first * np.exp(RATE * (STEPS - 1) / 12), rtol=1e-12)
    # Derivatives pass through the ruin: all money scales with the assets at the start.
    simulator, inputs = PensionSimulator.of(one), pension_inputs(one)
    problem = Problem(simulator, inputs, Mean("assets"))
    _, gradient = value_and_gradient(
        problem, PresentMix(one, 1), paths=8, decisions="held", engine=ENGINES[engine]
    )
    assert gradient.inputs["assets"] == pytest.approx(found[0], rel=1e-12)
    assert all(np.isfinite(each).all() for each in gradient.inputs.values())


def short_of_everything():
    """The full case with borrowed cash, a levered bond, shares sold short and swaps."""
    base = full(5)
    held = base.assets
    low, high = held.low.copy(), held.high.copy()
    low[0], low[2], high[4], low[5] = -0.5, -0.2, 1.4, -0.1
    weight = given("asset_weight", [-0.3, 0.25, -0.1, 0.1, 0.85, 0.15, 0.05])
    group = replace(held.groups[0], low=-0.1, high=0.6)
    held = replace(held, low=low, high=high, weight=weight, groups=(group,))
    return replace(base, assets=held)


@pytest.mark.prove
def test_engines_agree_and_every_derivative_is_that_of_central_differences():
    one = short_of_everything()
    simulator, inputs = PensionSimulator.of(one), pension_inputs(one)
    schedule = prepare(simulator, inputs)
    policy = new_policy(one, simulator, schedule, jax.random.key(0))
    assert unsupported(simulator, schedule, policy, Exact()) is None
    draws, smooth = Pseudo(1).draws(np.arange(8), simulator), Smooth(jnp.asarray(0.5))
    weight = {"funding_ratio": 1.0, "pv_cost": 0.05, "collateral_shortfall": 0.1}
    each = {name: np.full(8, w / 8) for name, w in weight.items()}

    def swept(engine, schedule):
        return ENGINES[engine].adjoint(simulator, policy, schedule, draws, smooth, each)

    passed = [swept(engine, schedule) for engine in ENGINES]
    for a, b in zip(*(jax.tree.leaves(found.policy) for found in passed), strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-7, atol=1e-11)
    ours, native = (pull_back(simulator, inputs, [found.schedule]) for found in passed)
    start = values(inputs)

    def value(i, place, bump):
        moved = [numbers.copy() for numbers in start]
        moved[i].ravel()[place] += bump
        made = prepare(simulator, with_values(inputs, moved))  # compiled already
        found = float64(swept("xla", made).totals)
        return sum(w * found[name].mean() for name, w in weight.items())

    rng = np.random.default_rng(0)
    for i, entry in enumerate(named_inputs(inputs)):
        found, size = ours[entry.name][0].ravel(), entry.input.value.size
        assert native[entry.name][0].ravel() == pytest.approx(found, rel=1e-8, abs=1e-12)
        for place in rng.choice(size, min(size, 2), replace=False):
            h = 1e-4 * max(abs(float(entry.input.value.ravel()[place])), 0.01)
            central = (value(i, place, h) - value(i, place, -h)) / (2 * h)
            assert found[place] == pytest.approx(central, rel=1e-6, abs=3e-14 / h), entry.name
    # The exact fund too, on both engines.
    exact = [
        engine.values(simulator, policy, schedule, draws, Exact()).totals
        for engine in ENGINES.values()
    ]
    for name in exact[0]:
        np.testing.assert_allclose(exact[1][name], exact[0][name], rtol=1e-9, atol=1e-12)
