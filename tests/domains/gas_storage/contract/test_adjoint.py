"""Every input's derivative, entry by entry, against central differences on the same paths.

In float64, to 1e-6 of the largest derivative of the input's family plus the round-off that
`certificate.bump_check` states. Decisions held fixed, exact; and through the policy, smooth. Round
numbers are moved off their ties first; a kink that stays is compared with one side.
"""

import datetime
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.domains.gas_storage.storage_cases import changed, read

from snapo.domains.gas_storage.chapters.certificate import off_ties
from snapo.domains.gas_storage.contract.simulator import StorageSimulator
from snapo.domains.gas_storage.policy.network import StoragePolicy
from snapo.domains.gas_storage.policy.value_table import Knots, ValueTable, readings
from snapo.domains.gas_storage.references.marginal import marginal_values
from snapo.domains.gas_storage.setup import bare_problem, factors
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.objective import CVaR, Mean
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import EXACT, Smooth
from snapo.solver import certificate
from snapo.solver.adjoint import pull_back

EVERYTHING = {
    "contract": """
start = 2025-01-10
end = 2025-01-24
inventory = 23.7
max_inventory = 61.3
min_inventory = 1.2
ratchets = "ratchets.csv"
ratchet_interpolation = "step"
injection_cost = 0.053
injection_cost_settlement = { days = 10 }
withdrawal_cost = 0.071
withdrawal_cost_settlement = "gas"
injection_fuel = 0.013
withdrawal_fuel = 0.007
inventory_loss = 0.0017
inventory_cost = 0.011
fixed_costs = "fees.csv"
min_withdrawal = "forced.csv"
outages = ["2025-01-15/2025-01-16"]
end_inventory = "free"
end_value = 0.83
""",
    "market": """
valuation_date = 2024-12-20
forward_curve = "curve.csv"
interest_rate = "rates.csv"
settlement = { months = 1, day = 20 }
""",
    "model": """
kind = "multi-factor"
factors = [
    { mean_reversion = 41.0, volatility = 0.93 },
    { mean_reversion = 1.3, volatility = 0.42 },
    { mean_reversion = 0.0, volatility = 0.21 },
]
correlation = [[1.0, 0.31, -0.22], [0.31, 1.0, 0.17], [-0.22, 0.17, 1.0]]
""",
}
TABLES = {
    "ratchets.csv": "date,inventory,max_withdrawal,max_injection\n"
    "2025-01-10,0,7.3,9.1\n,17.9,8.2,8.7\n,41.1,9.4,6.6\n,61.3,11.2,3.9\n",
    "fees.csv": "date,amount\n2025-01-12,3.5\n2025-02-01,4.5\n",
    "forced.csv": "date,value\n2025-01-10,0\n2025-01-18,2.1\n2025-01-19,0\n",
    "rates.csv": "date,zero_rate\n2024-12-20,0.021\n2025-01-10,0.0\n2025-01-20,0.027\n2025-03-01,0.031\n",
}


def everything(folder):
    """A short contract that uses every term there is, with step ratchets and three factors."""
    text = 'kind = "gas-storage"\ntitle = "everything"\n'
    text += "".join(f"[{name}]{keys}" for name, keys in EVERYTHING.items())
    (folder / "case.toml").write_text(text)
    random = np.random.default_rng(5)
    days = [datetime.date(2025, 1, 10) + datetime.timedelta(n) for n in range(15)]
    prices = [f"{day},{price:.3f}" for day, price in zip(days, random.uniform(18, 26, 15))]
    (folder / "curve.csv").write_text("date,price\n" + "\n".join(prices) + "\n")
    for name, table in TABLES.items():
        (folder / name).write_text(table)
    return changed(folder)


SLOW = [pytest.param(name, marks=pytest.mark.prove) for name in ("G3", "everything")]


@pytest.fixture(scope="module", params=["quick", *SLOW])
def contract(request, tmp_path_factory):
    """A problem with its value table, off its ties, and a policy that is not trained."""
    if request.param == "everything":
        return prepared(everything(tmp_path_factory.mktemp("everything")))
    return prepared(read(request.param))


def prepared(case, nudge=off_ties):
    problem = bare_problem(case)
    found = marginal_values(
        problem.schedule, factors(problem), case.contract.ratchets.interpolation
    )
    problem = replace(problem, simulator=StorageSimulator.of(case, ValueTable.of(found)))
    problem = replace(problem, sources=replace(problem.sources, evaluation=Pseudo(7)))
    return nudge(problem), StoragePolicy(problem.features, key=jax.random.key(0))


def check(contract, objective=None, smooth=EXACT, paths=128, engine=None, every=True):
    problem, policy = contract
    return certificate.bump_check(
        replace(problem, objective=objective or Mean("cash_flow")),
        policy,
        paths=paths,
        smooth=smooth,
        every=every,
        engine=engine or Native("float64"),
    )


def all_pass(bumps):
    wrong = [bump for bump in bumps if not bump.passed]
    assert not wrong, "\n".join(map(str, wrong[:5]))


@pytest.mark.prove
def test_every_input_with_decisions_held(contract):
    bumps = check(contract)
    numbers = sum(entry.value.size for entry in contract[0].inputs_by_name.values())
    assert len(bumps) == numbers
    all_pass(bumps)
    # Forced flows start at zero: a kink by the contract's own terms. There are few others.
    kinks = {bump.input for bump in bumps if bump.kink}
    assert kinks <= {"min_injection", "min_withdrawal", "min_inventory", "max_injection"}
    assert max(bump.crossing for bump in bumps) < 0.1


@pytest.mark.prove
def test_every_input_through_the_policy(contract):
    bumps = check(contract, smooth=Smooth(np.float64(0.02)))
    all_pass(bumps)
    assert max(bump.crossing for bump in bumps) < 0.6


@pytest.mark.prove
def test_a_risk_measure_holds_its_weights(contract):
    all_pass(check(contract, CVaR("cash_flow", 0.9), every=False))


@pytest.mark.prove
def test_xla_agrees():
    contract = prepared(read("quick"))
    given = {"smooth": Smooth(np.float64(0.02)), "paths": 64, "every": False}
    native = check(contract, **given)
    xla = check(contract, engine=Xla("float64"), **given)
    all_pass(xla)
    for one, other in zip(native, xla):
        assert_allclose(one.adjoint, other.adjoint, rtol=1e-9, atol=1e-9)


@pytest.mark.prove
def test_on_a_tie_the_adjoint_is_one_side():
    """Full after exactly one day at the full rate: a higher rate is worth nothing, a lower costs."""
    case = read(
        "quick",
        contract={
            "inventory": 45.0,
            "max_injection": 5.0,
            "end": datetime.date(2025, 1, 2),
            "end_inventory": "free",
            "end_value": 1.5,
        },
    )
    bumps = check(prepared(case, nudge=lambda problem: problem), paths=8)
    rate = {bump.input: bump for bump in bumps}["max_injection"]
    assert rate.kink and rate.passed and rate.crossing == 0
    assert rate.up == pytest.approx(0.0, abs=1e-6)
    assert rate.down > 5


def test_the_value_table_keeps_a_slope_at_its_knots():
    """An empty and a full store stand on the end rows; the line goes on beyond them."""
    levels = np.array([3.0, 2.0, 1.0, 0.5])
    coefficients = np.stack([levels, 0.1 * levels, 0.0 * levels], axis=1)
    with jax.enable_x64(True):
        knots = Knots(*map(jnp.asarray, (10.0, 40.0, coefficients, coefficients, 2.0)))

        def marginal(inventory):
            (found,) = readings(
                knots, (inventory,), (), lambda row: row @ jnp.asarray([1.0, 0.5, 0.25])
            )
            return found

        slope = jax.grad(marginal)
        found = [float(slope(inventory)) for inventory in (9.0, 10.0, 15.0, 20.0, 30.0, 41.0)]
        middle = float(marginal(15.0))
    assert_allclose(found, np.array([-1, -1, -1, -1, -0.5, -0.5]) * 1.05 / 10, atol=1e-12)
    assert_allclose(middle, 2.5 * 1.05)


def test_moved_inputs_are_near_and_forced_flows_stay_zero():
    problem = bare_problem(read("quick"))
    given, moved = problem.inputs_by_name, off_ties(problem).inputs_by_name
    for name, entry in given.items():
        zero = entry.value == 0
        assert_allclose(moved[name].value[~zero], entry.value[~zero], rtol=certificate.NUDGE)
        assert np.all(moved[name].value[zero] <= (entry.move or 0.0))
    # The end stays above the least inventory, and a forced flow of zero stays zero.
    assert 0 < moved["min_inventory"].value.item() < moved["end_inventory"].value.item() <= 0.02
    assert moved["min_injection"].value.item() == 0


@pytest.mark.prove
def test_a_wrong_adjoint_is_found(monkeypatch):
    """The check itself is checked: a derivative that is off by 1e-4 must not pass."""
    contract = prepared(read("quick"))

    def wrong(*given):
        return {name: found * (1 + 1e-4) for name, found in pull_back(*given).items()}

    monkeypatch.setattr(certificate, "pull_back", wrong)
    failed = {bump.input for bump in check(contract, every=False) if not bump.passed}
    assert {"forward_curve", "volatility", "inventory", "injection_cost"} <= failed
