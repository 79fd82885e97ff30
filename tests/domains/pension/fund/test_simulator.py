"""The fund on its paths: curve identity (P2), constant mix (P3), market consistency (P8)."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import (
    CASH,
    EQUITY,
    assets,
    case,
    cash_flows,
    full,
    given,
    inflation,
    no_contribution,
    plan,
    rates,
)

from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.market.assets.priced import Property
from snapo.domains.pension.policies.allocation import new_policy
from snapo.domains.pension.policies.classical import ConstantMix, LiabilityDriven
from snapo.domains.pension.records.assets import Overlay
from snapo.domains.pension.records.case import OUTPUTS
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.market import Correlation, SuppliedScenarios
from snapo.engine import Xla
from snapo.engine.native import Native, unsupported
from snapo.problem.objective import CRRA, ExpectedUtility, Mean
from snapo.problem.policies.rules import Constant
from snapo.problem.problem import Problem, prepare
from snapo.problem.scenarios import Pseudo, Supplied
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import pull_back
from snapo.solver.evaluate import path_totals
from snapo.solver.train import Training, initial_progress, train

NATIVE = Native("float64")


def simulated(one):
    simulator = PensionSimulator.of(one)
    inputs = pension_inputs(one)
    return simulator, inputs, prepare(simulator, inputs)


def totals_of(simulator, inputs, policy, source, paths):
    """Path totals on the native engine."""
    problem = Problem(simulator, inputs, Mean("funding_ratio"))
    return path_totals(problem, policy, paths, engine=NATIVE, source=source)


def shaken(policy, size, seed=1):
    """The policy with its trained numbers moved at random."""
    leaves, tree = jax.tree.flatten(policy)
    rng = np.random.default_rng(seed)
    moved = [
        leaf + size * rng.standard_normal(leaf.shape).astype(leaf.dtype)
        if hasattr(leaf, "dtype") and leaf.dtype == np.float32
        else leaf
        for leaf in leaves
    ]
    return jax.tree.unflatten(tree, moved)


def curve_case(flows, observation, steps=24):
    """Hull-White on a curve whose nodes are all dates; costs and a swap in proportion to assets."""
    held = assets(
        steps,
        [CASH, EQUITY],
        mean=[0.03],
        volatility=[0.18],
        weight=[0.5, 0.5],
        cost=[0.0, 0.001],
        fee=[0.0, 0.002],
    )
    swaps = Overlay(
        maturities=np.array([120]),
        notional=given("overlay_notional", [20.0]),
        low=np.zeros(1),
        high=np.array([0.8]),
        unit="assets",
        leverage=given("overlay_leverage", 0.5),
        cost=given("overlay_cost", [0.0002]),
        collateral_stress=given("overlay_collateral_stress", 0.035),
        zero_coupon=(0,),  # the share of a par swap that each payment has moves with the curve
    )
    return case(
        steps,
        held_assets=held,
        rates=rates(steps),
        flows=flows,
        overlay=swaps,
        observation=observation,
    )


SEEN = ("time", "relative_funding", "rates", "weights", "overlay")


@pytest.mark.prove
@pytest.mark.parametrize("trained", [False, pytest.param(True, marks=pytest.mark.study)])
def test_the_final_ratio_depends_on_the_node_of_the_payment_alone(trained):
    """P2: d ln F_T / d z_i is T_L at the node T_L and 0 elsewhere, path by path."""
    one = curve_case(cash_flows([120.0], [119]), SEEN)
    simulator, inputs, schedule = simulated(one)
    policy = shaken(new_policy(one, simulator, schedule, jax.random.key(0)), 0.3)
    if trained:
        training = Training(steps=20, paths=128, validation_every=20, validation_paths=128)
        goal = ExpectedUtility("funding_ratio", CRRA(5.0))
        start = initial_progress(policy, training)
        problem = Problem(simulator, inputs, goal)
        policy = train(problem, start, training, Native("float32")).best
    for engine in (NATIVE, Xla("float64")) if trained else (NATIVE,):
        slopes = path_slopes(engine, simulator, inputs, policy, schedule, paths=4)
        want = np.where(one.curve.tenor == 10, 10.0, 0.0)
        assert np.abs(slopes - want).max() < 1e-9


def path_slopes(engine, simulator, inputs, policy, schedule, paths, held=False):
    """[paths, nodes] d ln F_T / d z."""
    draws, found = Pseudo(3).draws(np.arange(paths), simulator), []
    rolled = engine.values(simulator, policy, schedule, draws, Exact(), record=("action",))
    ratio = np.asarray(rolled.totals["funding_ratio"])
    actions = rolled.record["action"] if held else None
    for path in range(paths):
        weights = {"funding_ratio": np.eye(paths)[path] / ratio[path]}
        passed = engine.adjoint(
            simulator, None if held else policy, schedule, draws, Exact(), weights, actions=actions
        )
        found.append(passed.schedule)
    return pull_back(simulator, inputs, found)["zero_rate"]


@pytest.mark.study
def test_a_stream_is_met_payment_by_payment_with_decisions_held():
    """P2 for a stream: tau_j CF_j P(T, tau_j) / L_T on each path, for any observation."""
    months, steps, paths = np.array([59, 119, 239]), 24, 3
    amounts = np.array([40.0, 50.0, 60.0])
    one = curve_case(cash_flows(amounts, months), (*SEEN, "funding_ratio", "long_rate"))
    simulator, inputs, schedule = simulated(one)
    policy = shaken(new_policy(one, simulator, schedule, jax.random.key(0)), 0.3)
    slopes = path_slopes(NATIVE, simulator, inputs, policy, schedule, paths, held=True)
    # P(T, tau) at each path's factor, which a longer horizon has on record.
    longer = PensionSimulator.of(curve_case(cash_flows(amounts, months), SEEN, steps + 1))
    draws = Pseudo(3).draws(np.arange(paths), longer)
    given_up = prepare(longer, pension_inputs(longer.case))
    rolled = Xla("float64").values(
        longer, Constant(np.zeros(3)), given_up, draws, Exact(), record=("state",)
    )
    x = np.asarray(rolled.record["state"].market.factors)[-1, :, 0]
    a, s, t = 0.03, 0.01, steps / 12
    tau = (months + 1) / 12
    u = tau - t
    b = (1 - np.exp(-a * u)) / a
    v = s**2 * (1 - np.exp(-2 * a * t)) / (2 * a)
    c = s**2 * ((1 - np.exp(-a * t)) / a) ** 2 / 2
    price = np.exp(-0.02 * u - b * (c + x[:, None]) - b**2 * v / 2)
    value = amounts * price
    want = np.zeros((paths, 6))
    want[:, [2, 3, 4]] = tau * value / value.sum(1, keepdims=True)
    assert np.abs(slopes - want).max() < 1e-7


@pytest.mark.study
def test_both_engines_support_the_full_case():
    one = full()
    simulator, _, schedule = simulated(one)
    policy = new_policy(one, simulator, schedule, jax.random.key(0))
    for smooth in (Exact(), Smooth(jnp.asarray(0.1))):
        assert unsupported(simulator, schedule, policy, smooth) is None
    draws = Pseudo(1).draws(np.arange(8), simulator)
    ours = NATIVE.values(simulator, policy, schedule, draws, Exact()).totals
    want = Xla("float64").values(simulator, policy, schedule, draws, Exact()).totals
    assert set(ours) == set(OUTPUTS)
    for name in OUTPUTS:
        assert ours[name] == pytest.approx(np.asarray(want[name]), rel=1e-11, abs=1e-11)


@pytest.mark.prove
def test_a_constant_mix_with_outflow_has_the_known_moments():
    """P3: mean 81.20917249 and standard deviation 34.63918480 of the exact recursion."""
    steps, mean = 120, np.array([0.06, 0.03])
    s = np.array([[0.0324, -0.0018], [-0.0018, 0.0036]])
    other = Property("Other")
    held = assets(
        steps,
        [CASH, EQUITY, other],
        mean=mean - np.diag(s) / 2,
        volatility=np.sqrt(np.diag(s)),
        weight=[0.0, 0.5, 0.5],
        return_kind="total",
    )
    correlation = s[0, 1] / np.sqrt(s[0, 0] * s[1, 1])
    one = case(
        steps,
        held_assets=held,
        flows=cash_flows(np.full(steps, 0.5), np.arange(steps)),
        correlation=Correlation(("Equity", "Other"), given("correlation", [correlation])),
    )
    simulator, inputs, _ = simulated(one)
    policy = Constant(np.array([0.0, 0.5, 0.5]))
    source, paths = Pseudo(5), 2**15
    total = totals_of(simulator, inputs, policy, source, paths)["assets"]
    pairs = total.reshape(-1, 2).mean(1)
    assert abs(pairs.mean() - 81.20917249) < 3 * pairs.std() / np.sqrt(pairs.size)
    spread = (total - 81.20917249) ** 2
    error = spread.std() / np.sqrt(paths / 2)
    assert abs(spread.mean() - 34.63918480**2) < 3 * error


def consistent(steps=24):
    """Risk-neutral scenarios with credit, bonds, currencies and swaps; nothing costs anything."""
    base = full(steps)
    free = {
        name: replace(getattr(base.assets, name), values=np.zeros(7)) for name in ("cost", "fee")
    }
    currencies = base.currencies
    hedging = replace(currencies.hedge_cost, values=np.zeros(1))
    assert base.overlay is not None
    return replace(
        base,
        measure="Q",
        assets=replace(base.assets, smoothed=np.zeros(0, int), **free),
        currencies=replace(currencies, hedge_cost=hedging),
        overlay=replace(base.overlay, cost=given("overlay_cost", np.zeros(2))),
        plan=plan(indexation="conditional", contribution=no_contribution("spread")),
    )


@pytest.fixture(scope="module")
def fair():
    return simulated(consistent())


@pytest.mark.prove
@pytest.mark.parametrize(
    "kind",
    ["constant", *(pytest.param(kind, marks=pytest.mark.study) for kind in ("driven", "network"))],
)
def test_values_are_consistent_with_the_market(fair, kind):
    """P8: assets, liability and cash are worth what they cost, whatever the policy does."""
    simulator, inputs, schedule = fair
    one = consistent()
    policy = {
        "constant": lambda: ConstantMix(one),
        "driven": lambda: shaken(LiabilityDriven(one, ConstantMix(one)), 0.3),
        "network": lambda: shaken(new_policy(one, simulator, schedule, jax.random.key(0)), 0.5),
    }[kind]()
    source, paths = Pseudo(7), 2**16
    total = totals_of(simulator, inputs, policy, source, paths)
    flows = total["pv_benefit"] - total["pv_contribution"]
    added = total["pv_accrual"] + total["pv_indexation"]
    start = schedule.constants
    curve = one.curve.rate.values[1]
    checks = {
        "assets": (total["pv_assets"] + flows, 100.0),
        "liability": (
            total["pv_liability"] + total["pv_benefit"] - added,
            float(start.liability),
        ),
        "discount": (total["discount"], np.exp(-2 * curve)),
    }
    for values, want in checks.values():
        pairs = values.reshape(-1, 2).mean(1)
        error = pairs.std() / np.sqrt(pairs.size)
        assert abs(pairs.mean() - want) < 3 * error
    assert np.abs(total["pv_indexation"]).max() > 0.1


@pytest.mark.study
def test_derivatives_are_consistent_with_the_market(fair):
    """The assets' worth does not depend on volatilities or spreads, nor cash on anything else."""
    simulator, inputs, schedule = fair
    policy = ConstantMix(consistent())
    rows = []
    for block in range(16):
        draws = Pseudo(9).draws(np.arange(block * 256, (block + 1) * 256), simulator)
        w = np.full(256, 1 / 256)
        weights = {"pv_assets": w, "pv_benefit": w, "pv_contribution": -w}
        passed = NATIVE.adjoint(simulator, policy, schedule, draws, Exact(), weights)
        rows.append(passed.schedule)
    found = pull_back(simulator, inputs, rows)
    for name in ("asset_volatility", "rate_volatility", "credit_volatility", "zero_rate"):
        error = found[name].std(0, ddof=1) / 4
        # Student's t with 15 degrees of freedom, 16 numbers at once: 4.5 in place of 3.
        assert np.all(np.abs(found[name].mean(0)) < 4.5 * error + 1e-12)


@pytest.mark.prove
def test_a_market_that_stands_still_moves_money_as_the_books_say():
    """Advance against arrears, costs, contributions: one step by hand."""
    steps = 3
    held = assets(
        steps, [CASH, EQUITY], mean=[0.0], volatility=[0.0], weight=[1.0, 0.0], cost=[0.0, 0.01]
    )
    flows = cash_flows([2.0, 2.0, 2.0], [0, 1, 2])
    spread = no_contribution("spread")
    for timing in ("advance", "arrears"):
        terms = plan(timing, contribution=spread)
        simulator, _, schedule = simulated(case(steps, held_assets=held, flows=flows, plan=terms))
        draws = Pseudo(0).draws(np.arange(2), simulator)
        policy = Constant(np.array([0.0, 0.5]))
        rolled = NATIVE.values(
            simulator, policy, schedule, draws, Exact(), record=("state", "outputs")
        )
        grow = np.exp(0.02 / 12)
        due = np.arange(3) / 12 + (1 / 12 if timing == "arrears" else 0.0)
        liability = np.sum(2 * np.exp(-0.02 * due))
        paid = 0.1 / 12 * (liability - 100.0)
        flow = paid - 2.0
        if timing == "advance":
            want = (100 + flow) * (1 - 0.01 * 0.5) * grow
        else:
            want = 100 * (1 - 0.01 * 0.5) * grow + flow
        outputs = rolled.record["outputs"]
        assert np.asarray(outputs["contribution"])[0, 0] == pytest.approx(paid, rel=1e-12)
        # States are recorded before their steps.
        after = np.asarray(rolled.record["state"].assets)[1, 0]
        assert after == pytest.approx(want, rel=1e-12)


@pytest.mark.prove
def test_ready_made_scenarios_take_the_generators_place():
    """Two classes, prices, wages and two zero rates from an array; a path by hand."""
    steps, paths = 2, 2
    columns = ("return Cash", "return Equity", "inflation", "wage", "zero 1", "zero 10")
    table = np.zeros((paths, steps, 6))
    table[:, :] = [0.001, 0.02, 0.002, 0.003, 0.03, 0.03]
    supplied = SuppliedScenarios(table, table, columns, np.array([1.0, 10.0]))
    held = assets(steps, [CASH, EQUITY], mean=[0.0], volatility=[0.0], weight=[0.5, 0.5])
    one = case(
        steps,
        held_assets=held,
        flows=cash_flows([50.0], [119]),
        scenarios=supplied,
        inflation=inflation(steps, case(1, held_assets=held).inflation.break_even),
        observation=("time", "rates", "long_rate", "weights"),
    )
    simulator, inputs, schedule = simulated(one)
    source = Supplied(np.ascontiguousarray(np.swapaxes(table, 0, 1)))
    policy = new_policy(one, simulator, schedule, jax.random.key(0))
    constant = Constant(np.array([0.0, 0.5]))
    for each in (policy, constant):
        assert unsupported(simulator, schedule, each, Exact()) is None
    total = totals_of(simulator, inputs, constant, source, paths)
    assert total["assets"] == pytest.approx(100 * 1.0105**2, rel=1e-14)
    left = 10 - 2 / 12
    assert total["liability"] == pytest.approx(50 * np.exp(-0.03 * left), rel=1e-3)
    assert total["discount"] == pytest.approx(1.001**-2, rel=1e-14)


@pytest.mark.prove
def test_swaps_under_ready_made_scenarios_earn_what_their_payments_do():
    """Of yearly steps, from 2 % at every tenor to the file's zero rates: a par swap of three years
    pays exp(0.02) - 1 a year, a zero-coupon swap all at its end."""
    columns = ("return Cash", "inflation", "wage", "zero 1", "zero 10")
    table = np.tile([0.02, 0.0, 0.0, 0.01, 0.04], (2, 1, 1))
    held = assets(1, [CASH], weight=[1.0])
    swaps = Overlay(
        maturities=np.array([3, 4]),
        notional=given("overlay_notional", [0.0, 0.0]),
        low=np.zeros(2),
        high=np.ones(2),
        unit="assets",
        leverage=given("overlay_leverage", 2.0),
        cost=given("overlay_cost", [0.0, 0.0]),
        collateral_stress=given("overlay_collateral_stress", 0.035),
        zero_coupon=(1,),
    )
    one = case(
        1,
        step=1.0,
        held_assets=held,
        scenarios=SuppliedScenarios(table, table, columns, np.array([1.0, 10.0])),
        overlay=swaps,
    )
    simulator, inputs, _ = simulated(one)
    source = Supplied(np.ascontiguousarray(np.swapaxes(table, 0, 1)))
    total = totals_of(simulator, inputs, Constant(np.array([1.0, 0.5, 0.25])), source, 2)
    left = np.arange(3)
    price = np.exp(-left * np.interp(left, [1, 10], [0.01, 0.04]))
    par = (np.expm1(0.02) + (left == 2)) @ price - 1.02
    zero = np.exp(4 * 0.02 - 3 * np.interp(3, [1, 10], [0.01, 0.04])) - 1.02
    paid = 1.0  # at the end of the step
    assert total["assets"] == pytest.approx(102 + 50 * par + 25 * zero - paid, rel=1e-12)
