"""Normal and shifted prices, which may be negative: mean, identities, a store valued on them."""

from functools import cache
from operator import itemgetter

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.domains.gas_storage.storage_cases import CASES, bare, read

from snapo.case.error import CaseError
from snapo.domains.gas_storage.bounds.relaxation import StoreRelaxation
from snapo.domains.gas_storage.chapters.certificate import off_ties
from snapo.domains.gas_storage.policy.network import StoragePolicy
from snapo.domains.gas_storage.policy.triggers import triggers
from snapo.domains.gas_storage.references.intrinsic import intrinsic
from snapo.domains.gas_storage.references.lattice import lattice
from snapo.domains.gas_storage.setup import bare_problem, factors, make_setup
from snapo.engine.native import Native
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact
from snapo.solver import certificate
from snapo.solver.bound import bound
from snapo.solver.evaluate import path_totals

EXACT = 2004.293
CURVE = (12, 6, 4, 3, 5, 9, 14, 20, 26, 28, 25, 18)
DELTAS = (-6.080, -5.585, -2.202, -5.447, -3.238, -1.516, -1.285, -0.103, 5.140, 8.297, 4.381,
          4.628)  # fmt: skip
NORMAL = {"kind": "one-factor-normal", "mean_reversion": 30.0, "volatility": 70.0}
SHIFTED = {"kind": "one-factor-shifted", "mean_reversion": 30.0, "shift": 100.0, "volatility": 0.5}
MODELS = [NORMAL, SHIFTED]


def by_month(case, values):
    months = [day.replace(day=1) for day in case.days]
    return [
        sum(value for value, other in zip(values, months) if other == month)
        for month in sorted(set(months))
    ]


def folder_with(path, curve):
    """A folder with the case D2 on another curve, by month."""
    months = [f"{2026 + m // 12}-{m % 12 + 1:02d}" for m in range(3, 15)]
    rows = [f"{month},{price}" for month, price in zip(months, curve)]
    (path / "curve.csv").write_text("\n".join(["date,price", *rows]))
    (path / "case.toml").write_bytes((CASES / "D2" / "case.toml").read_bytes())
    return path


@cache
def ready(name="D2", **model):
    return make_setup(read(name, model=model or NORMAL), "native")


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model["kind"])
def test_the_mean_of_the_spot_price_is_the_forward_price(model):
    """In closed form: the expectation over the normal factor by Gauss-Hermite quadrature."""
    simulator, _, schedule = bare(read("D2", model=model))
    process, points = simulator.process, np.polynomial.hermite_e.hermegauss(40)
    weights = points[1] / points[1].sum()
    for t in (0, 1, 30, 364):
        row = jax.tree.map(itemgetter(t), schedule.steps.price)
        variance = (1 - np.exp(-2 * 30 * t / 365)) / 60
        states = np.sqrt(variance) * points[0][:, None]
        with jax.enable_x64(True):
            constants = schedule.constants.price
            spots = [float(process.level(constants, row, jnp.asarray(x))) for x in states]
            back = process.state_at(constants, row, jnp.asarray(spots[25]))
        assert_allclose(weights @ spots, row.forward, rtol=1e-12)
        assert min(spots) < 0 or t < 30
        assert_allclose(back, states[25], atol=1e-12)


def test_the_lattice_of_a_cavern_with_negative_prices():
    case = read("D2")
    problem = bare_problem(case)
    found = lattice(problem.schedule, factors(problem), "linear", step=1.0, spacing=0.1)
    assert abs(found.value - EXACT) < 0.02
    assert_allclose(by_month(case, found.deltas), DELTAS, atol=0.02)
    assert_allclose(intrinsic(problem.schedule, "linear").value, 715.605, atol=1e-3)


@pytest.mark.prove
def test_a_large_shift_is_the_normal_price(tmp_path):
    """Shift 10,000 and volatility 70 / (F + 10,000) by delivery month."""
    case = read(folder_with(tmp_path, CURVE))
    rows = [
        f"{day},{70 / (price + 10_000):.12g}"
        for day, price in zip(case.days, case.market.forward_curve.used())
        if day.day == 1
    ]
    (tmp_path / "volatility.csv").write_text("\n".join(["date,value", *rows]))
    model = SHIFTED | {"shift": 10_000.0, "volatility": "volatility.csv"}
    problem = bare_problem(read(tmp_path, model=model))
    value = lattice(problem.schedule, factors(problem), "linear").value
    normal = bare_problem(case)
    assert abs(value - lattice(normal.schedule, factors(normal), "linear").value) < 0.5


@pytest.mark.prove
def test_a_constant_added_to_the_curve_leaves_every_path_as_it_is(tmp_path):
    """Without fuel and interest: the rule of the fitted value earns the same on each path."""
    totals = []
    for add in (0, -10):
        folder_with(tmp_path, np.array(CURVE) + add)
        made = make_setup(read(tmp_path, contract={"injection_fuel": 0.0},
                               market={"interest_rate": 0.0}), "native")  # fmt: skip
        policy, engine = made.policy.value_rule, made.engines.evaluate
        totals.append(path_totals(made.problem, policy, 256, engine=engine))
    same = [np.asarray(x["cash_flow"]) for x in totals]
    assert_allclose(same[0], same[1], rtol=1e-9)
    assert abs(same[0].mean() - 2066.868) < 5 * same[0].std() / 16


@pytest.mark.prove
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model["kind"])
def test_a_curve_of_zeros_is_no_mistake(model, tmp_path):
    """Nothing divides by the curve: no note, finite features, triggers around the price."""
    folder_with(tmp_path, [0, 0.01, 0, 0, -20, 0, 0, 0, 0, 0, 0, 0])
    case = read(tmp_path, model={key: None for key in NORMAL} | model)
    assert case.notes == ()
    made = make_setup(case, "native")
    days = np.arange(100, 110)
    found = triggers(made.problem, made.policy.value_rule, days, np.full(10, 15.0))
    assert np.all(found.injection < found.withdrawal)


def test_one_direction_a_day_where_fuel_earns_money():
    """At a price far below zero both directions at once would pay for the fuel."""
    simulator, _, schedule = bare(read("D2", model={"volatility": 700.0}))
    draws = Pseudo(0).draws(np.arange(64), simulator)
    both = np.ones((simulator.horizon, 64, 2))
    rolled = Native("float64").values(
        simulator, None, schedule, draws, Exact(), actions=both, record=("outputs",)
    )
    outputs = rolled.record["outputs"]
    assert np.min(rolled.record["outputs"]["cash_flow"]) < -100
    assert np.all(np.minimum(outputs["injection"], outputs["withdrawal"]) == 0)


def test_a_shift_below_the_curve_is_refused(tmp_path):
    folder = folder_with(tmp_path, np.array(CURVE) - 5.0)
    with pytest.raises(CaseError, match=r"model.shift.*got 2.*forward price is -2.*above 2"):
        read(folder, model=SHIFTED | {"shift": 2.0})


@pytest.mark.prove
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model["kind"])
def test_every_derivative_agrees_with_differences(model):
    problem = off_ties(bare_problem(read("D2", model=model)))
    policy = StoragePolicy(problem.features, key=jax.random.key(0))
    bumps = certificate.bump_check(problem, policy, paths=64, engine=Native("float64"))
    assert {"volatility", "mean_reversion"} <= {bump.input for bump in bumps}
    wrong = [bump for bump in bumps if not bump.passed]
    assert not wrong, "\n".join(map(str, wrong))


@pytest.mark.prove
def test_rule_and_bound_enclose_the_exact_value():
    made = ready()
    relaxation = StoreRelaxation(made.problem)
    policy, engine = made.policy.value_rule, made.engines.evaluate
    found = bound(made.problem, policy, relaxation=relaxation, paths=2048, engine=engine)
    assert 0.999 * EXACT < found.lower.value < EXACT + 3 * found.lower.standard_error
    error = 3 * found.upper.standard_error
    assert EXACT - error < found.upper.value < 1.004 * EXACT + error
