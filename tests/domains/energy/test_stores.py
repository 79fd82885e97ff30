"""Two stores behind one connection: an integer program, the stores apart, limits, errors."""

import datetime
import tempfile
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, milp
from tests.domains.energy.energy_cases import exact
from tests.domains.gas_storage.storage_cases import bare

from snapo.book.file import contents
from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.case.toml import to_toml
from snapo.domains.energy.contracts.stores import STORES
from snapo.domains.energy.core.feasibility import check_limits
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.read.case import EnergyCase, read_case
from snapo.domains.energy.setup import bare_problem, make_setup
from snapo.domains.energy.summary import known_schedule, lines
from snapo.domains.gas_storage.bounds.relaxation import StoreRelaxation
from snapo.domains.gas_storage.contract.schedule import of_prices
from snapo.domains.gas_storage.read.case import read_case as read_store
from snapo.domains.gas_storage.references.lattice import lattice as store_lattice
from snapo.domains.gas_storage.setup import make_setup as store_setup
from snapo.engine import TRAJECTORY
from snapo.engine.native import Native
from snapo.problem.smooth import Exact
from snapo.solver.bound import bound
from snapo.solver.evaluate import evaluate
from snapo.solver.sensitivity import sensitivities
from snapo.study.positions.files import read_files
from snapo.testing.derivatives import wrong_derivatives

DAY = datetime.date
START = DAY(2027, 1, 1)
# 16 days on which prices fall and rise.
PRICES = [30, 31, 29, 27, 26, 28, 33, 36, 35, 31, 30, 28, 29, 34, 37, 33]
FAST = {
    "start": START, "end": DAY(2027, 1, 17), "inventory": 2.0, "max_inventory": 6.0,
    "max_injection": 2.0, "max_withdrawal": 2.0, "injection_cost": 0.3, "withdrawal_cost": 0.2,
}  # fmt: skip
SLOW = FAST | {
    "inventory": 5.0, "max_inventory": 12.0, "max_injection": 1.0, "max_withdrawal": 1.0,
    "injection_cost": 0.1, "withdrawal_cost": 0.1, "injection_fuel": 0.01,
}  # fmt: skip
WIDE = {"net_injection": 100.0, "net_withdrawal": 100.0}
TIGHT = {"net_injection": 1.0, "net_withdrawal": 2.0}


def tables(folder: Path, fast=None, slow=None, model=None, **changes: Any):
    """The file and the tables of a small case, written into a folder."""
    folder.mkdir(exist_ok=True)
    for name, table in (("fast", FAST | (fast or {})), ("slow", SLOW | (slow or {}))):
        (folder / f"{name}.toml").write_text(to_toml({"contract": table}))
    rows = [f"{START + datetime.timedelta(n)},{price}" for n, price in enumerate(PRICES)]
    (folder / "curve.csv").write_text("\n".join(["date,price", *rows]))
    usual = {"kind": "one-factor", "mean_reversion": 12.0, "volatility": 0.9}
    market = {"valuation_date": START, "forward_curve": "curve.csv", "interest_rate": 0.03}
    data = {
        "kind": "stores",
        "contract": {"stores": ["fast.toml", "slow.toml"]} | changes,
        "market": market,
        "model": usual | (model or {}),
        "evaluation": {"paths": 4096},
    }
    (folder / "case.toml").write_text(to_toml(data))
    return load(folder)


def case(folder: Path, **changes: Any) -> EnergyCase:
    return read_case(*tables(folder, **changes))


def best_plan(case: EnergyCase) -> float:
    """An integer program of what each store takes in and gives out at forward prices."""
    count, contract = len(case.days) // STORES, case.contract
    day = case.day[::STORES]
    price, discount = case.market.forward_curve.used()[::STORES], np.exp(-0.03 * day / 365)
    below, zero, one = np.tri(count), np.zeros((count, count)), np.eye(count)
    gains, rows, lower, upper, highest, constant = [], [], [], [], [], 0.0
    for k, store in enumerate(contract.stores):
        held = np.zeros(count) if store.holding is None else store.holding.used() * discount
        later = np.append(np.cumsum(held[::-1])[::-1][1:], 0.0)
        start = float(store.inventory.used())
        constant -= start * held.sum()
        (cost_in, cost_out), (fuel_in, fuel_out) = (
            [x.used() for x in pair] for pair in (store.costs, store.fuel)
        )
        gains += [discount * (-price * (1 + fuel_in) - cost_in) - later]
        gains += [discount * (price * (1 - fuel_out) - cost_out) + later]
        highest += [x.used() * y for x, y in zip(store.rates, store.factors.T)]
        rows.append(np.hstack([*[zero] * 2 * k, below, -below, *[zero] * (3 - 2 * k)]))
        low, high = (x.used()[1:].copy() for x in store.limits)
        if store.end is not None:
            low[-1] = high[-1] = float(store.end.used())
        lower.append(low - start)
        upper.append(high - start)
    rows.append(np.hstack([one, -one, one, -one, zero]))
    net = [
        np.full(count, 1e3) if x is None else x.used()
        for x in (contract.net_withdrawal, contract.net_injection)
    ]
    lower.append(-net[0])
    upper.append(net[1])
    if not contract.transfers:
        for k in range(4):  # nothing flows out on a day of injections, and nothing in on others
            side = [one if i == k else zero for i in range(4)]
            largest = np.diag(highest[k])
            rows.append(np.hstack([*side, -largest if k % 2 == 0 else largest]))
            lower.append(np.full(count, -np.inf))
            upper.append(np.zeros(count) if k % 2 == 0 else highest[k])
    whole = np.repeat([0, 1], [4 * count, count])
    bounds = np.concatenate([*highest, np.ones(count)])
    result = milp(
        -np.concatenate([*gains, np.zeros(count)]),
        integrality=whole,
        bounds=(np.zeros(5 * count), bounds),
        constraints=LinearConstraint(
            np.concatenate(rows), np.concatenate(lower), np.concatenate(upper)
        ),
        options={"mip_rel_gap": 1e-9},
    )
    assert result.status == 0, result.message
    return constant - result.fun


VARIANTS = [
    TIGHT,
    {},
    WIDE,
    {"net_withdrawal": 1.0},
    {"net_injection": 0.0, "net_withdrawal": 0.5},
    TIGHT | {"fast": {"inventory_cost": 0.02}, "slow": {"inventory_cost": 0.05}},
    TIGHT | {"fast": {"end_inventory": 4.0}, "slow": {"end_inventory": 1.0}},
    TIGHT | {"fast": {"end_inventory": "free"}, "slow": {"min_inventory": 1.0, "end_inventory": 1.0}},
    TIGHT | {"slow": {"outages": ["2027-01-04/2027-01-08"], "withdrawal_fuel": 0.02}},
    {"net_injection": 1.5, "net_withdrawal": 0.75, "inventory": [0.5, 3.0]},
    {"net_injection": 0.0, "net_withdrawal": 2.0, "inventory": [0.0, 12.0]},
]  # fmt: skip


def sets(every: list) -> list:
    """The first one in the quick suite."""
    return [every[0], *(pytest.param(x, marks=pytest.mark.prove) for x in every[1:])]


@pytest.mark.parametrize("changes", sets(VARIANTS))
def test_without_volatility_a_linear_program(changes, tmp_path):
    """With transfers."""
    this = case(tmp_path, **changes)
    assert exact(this, forward=True) == pytest.approx(best_plan(this), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("changes", sets([*VARIANTS[:6], *VARIANTS[8:]]))
def test_without_volatility_an_integer_program(changes, tmp_path):
    """Without transfers: not both directions on one day."""
    this = case(tmp_path, **changes, transfers=False)
    value = exact(this, forward=True)
    assert value == pytest.approx(best_plan(this), rel=1e-6, abs=1e-6)


@pytest.mark.prove
def test_transfers_fill_the_fast_store(tmp_path):
    """Nothing is bought: what the fast store gives out at the highest prices is from the slow one."""
    changes = VARIANTS[-1]
    values = [exact(case(tmp_path, **changes, transfers=x), forward=True) for x in (False, True)]
    assert values[1] > values[0] + 5.0


def alone(folder: Path, name: str) -> float:
    """The value of one of the stores by the lattice of a gas store, which shares no code with
    this one."""
    file, data = load(folder)
    store = load(folder / f"{name}.toml")[1]
    data = {k: v for k, v in data.items() if k in ("market", "model")} | store
    simulator, _, schedule = bare(read_store(file, data | {"kind": "gas-storage"}))
    factors = simulator.process.factors(of_prices(schedule))
    assert simulator.horizon == len(PRICES)
    return store_lattice(schedule, factors, "linear", step=1.0, spacing=0.15).value


@pytest.mark.prove
def test_without_a_joint_limit_the_sum_of_both_stores(tmp_path):
    """With limits that never bind, and with none; exact values, and derivatives on paths."""
    values = [exact(case(tmp_path, **limits)) for limits in (WIDE, {})]
    both = alone(tmp_path, "fast") + alone(tmp_path, "slow")
    np.testing.assert_allclose(values, both, rtol=2e-5)


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param(TIGHT, marks=pytest.mark.prove),
        pytest.param(TIGHT | {"transfers": False}, marks=pytest.mark.study),
    ],
)
def test_policy_and_bound_enclose_the_exact_value(changes, tmp_path):
    """The fitted rule at most 0.5 % below, the bound at most 1 % above; and the derivatives."""
    this = case(tmp_path, **changes)
    setup, value = make_setup(this, Native()), exact(this)
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    result = evaluate(problem, rule, paths=16384, engine=engine)
    assert result.standard_error < 0.5e-2 / 3 * value
    assert value * 0.995 <= result.value + 3 * result.standard_error
    assert result.value <= value + 3 * result.standard_error
    relaxation = EnergyRelaxation(problem)
    upper = bound(problem, rule, relaxation=relaxation, engine=engine, paths=1024).upper
    assert value <= upper.value + 3 * upper.standard_error
    assert upper.value - 3 * upper.standard_error <= value * 1.01
    assert wrong_derivatives(problem, rule, paths=16, engine=engine) == []
    draws = problem.sources.evaluation.draws(np.arange(2048), problem.simulator)
    rollout = engine.bind(problem).values(rule, draws, Exact(), record=TRAJECTORY)
    flows = rollout.record["outputs"]
    net = sum(
        sign * np.asarray(flows[f"{verb} {name}"]).reshape(-1, STORES, 2048).sum(axis=1)
        for name in ("fast", "slow")
        for verb, sign in (("inject", 1.0), ("withdraw", -1.0))
    )
    assert net.max() <= 1.0 + 1e-5 and net.min() >= -2.0 - 1e-5
    np.testing.assert_allclose(np.asarray(rollout.state.levels)[:, :2], 0.0, atol=1e-4)


@pytest.mark.study
def test_without_a_joint_limit_value_deltas_and_bounds_are_sums(tmp_path):
    """Measured on paths, both stores apart by the methods of a gas store: within two errors."""
    measured = []
    this = case(tmp_path, **WIDE)
    setups = [make_setup(this, "native")]
    file, data = load(tmp_path)
    for name in ("fast", "slow"):
        contract = load(tmp_path / f"{name}.toml")[1]
        tables = {k: data[k] for k in ("market", "model", "evaluation")} | contract
        setups.append(store_setup(read_store(file, tables | {"kind": "gas-storage"}), "native"))
    for setup in setups:
        problem, engine = setup.problem, setup.engines.evaluate
        rule = setup.policy.value_rule
        value = evaluate(problem, rule, paths=4096, engine=engine)
        held = sensitivities(problem, rule, paths=4096, engine=engine).held["forward_curve"]
        relaxation = EnergyRelaxation(problem) if setup is setups[0] else StoreRelaxation(problem)
        upper = bound(problem, rule, relaxation=relaxation, engine=engine, paths=512).upper
        weeks = np.asarray(held.value).reshape(2, -1).sum(axis=1)
        errors = np.sqrt(np.sum(np.square(held.standard_error).reshape(2, -1), axis=1))
        numbers = np.array([value.value, upper.value, *weeks])
        measured.append((numbers, np.array([value.standard_error, upper.standard_error, *errors])))
    (joint, error), *apart = measured
    together = np.sqrt(error**2 + sum(x[1] ** 2 for x in apart))
    assert np.all(np.abs(joint - sum(x[0] for x in apart)) < 2 * together)


@pytest.mark.prove
@hypothesis.settings(max_examples=8, deadline=None)
@hypothesis.given(st.integers(0, 6), st.integers(0, 6), st.booleans())
def test_a_wider_joint_limit_is_worth_more(into, out, transfers):
    with tempfile.TemporaryDirectory() as folder:
        values = [
            exact(
                case(
                    Path(folder), net_injection=x / 2, net_withdrawal=y / 2, transfers=transfers,
                    inventory=[0.0, 1.0],
                ),
                forward=True,
            )
            for x, y in ((into, 1 + out), (into + 1, 1 + out), (into, 2 + out))
        ]  # fmt: skip
    assert values[0] <= min(values[1:]) + 1e-9


@pytest.mark.prove
@pytest.mark.parametrize("transfers", [True, False])
def test_the_order_of_the_stores_does_not_matter(transfers, tmp_path):
    values = [
        exact(case(tmp_path, **TIGHT, stores=[f"{x}.toml" for x in names], transfers=transfers))
        for names in (("fast", "slow"), ("slow", "fast"))
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"stores": ["fast.toml"]}, "contract.stores: .*2 stores"),
        ({"stores": ["fast.toml", "fast.toml"]}, "two different files"),
        ({"stores": ["fast.toml", "other.toml"]}, "contract.stores: .*no such file"),
        ({"stores": ["fast.toml", "../slow.toml"]}, "next to the case"),
        ({"slow": {"end": DAY(2027, 1, 16)}}, r"slow.toml, contract.end: .*fast.toml, 2027-01-17"),
        ({"slow": {"ratchets": "r.csv"}}, r"slow.toml, contract.ratchets"),
        ({"fast": {"min_injection": 1.0}}, r"fast.toml, contract.min_injection"),
        ({"fast": {"inventory": 7.0}}, r"fast.toml, contract.inventory: .*0 to 6"),
        ({"fast": {"end_inventory": 7.0}}, r"fast.toml, contract.end_inventory: .*7; .* allow 0 to 6"),
        ({"slow": {"min_inventory": 1.0}}, r"slow.toml, contract.end_inventory: .*0; .* allow 1 to 12"),
        ({"inventory": [1.0]}, "contract.inventory: .*list of 2"),
        ({"net_injection": -1.0}, "contract.net_injection"),
        ({"transfers": False, "fast": {"end_inventory": 1.0}}, r"fast.toml, contract.end_inventory"),
        ({"model": {"kind": "one-factor-jumps"}}, "model.kind"),
    ],
)  # fmt: skip
def test_mistakes_are_named(changes, where, tmp_path):
    with pytest.raises(CaseError, match=where):
        case(tmp_path, **changes)


def test_what_cannot_be_met_or_has_no_nodes_is_refused(tmp_path):
    with pytest.raises(CaseError, match=r"contract: (fast|slow): no decisions can meet"):
        lines(case(tmp_path, net_withdrawal=0.25))
    with pytest.raises(CaseError, match=r"contract: .*common divisor"):
        lines(case(tmp_path, net_withdrawal=1.0001))


@pytest.mark.parametrize("transfers", [True, False])
def test_joint_limits_that_today_cannot_meet_are_refused(transfers, tmp_path):
    """In 16 days at most 8 units flow out of both stores, or into both. Each store can be emptied,
    or filled, without the other one."""
    limits = {"net_withdrawal": 0.5, "net_injection": 0.5, "transfers": transfers}
    lines(case(tmp_path, **limits, inventory=[4.0, 4.0]))
    words = "net_withdrawal: got 0.5; .* at most 8 MWh on 2027-01-01, but they have 9 MWh"
    with pytest.raises(CaseError, match=words):
        lines(case(tmp_path, **limits, inventory=[4.0, 5.0]))
    if not transfers:  # then nothing may be owed
        return
    full = limits | {"inventory": [0.0, 0.0], "fast": {"end_inventory": 4.0}}
    lines(case(tmp_path, **full, slow={"end_inventory": 4.0}))
    words = "net_injection: got 0.5; .* at least 1 MWh on 2027-01-01, but they have 0 MWh"
    with pytest.raises(CaseError, match=words):
        lines(case(tmp_path, **full, slow={"end_inventory": 5.0}))


@pytest.mark.prove
@hypothesis.settings(max_examples=60, deadline=None)
@hypothesis.given(*[st.integers(0, 6)] * 4, *[st.integers(0, 4)] * 2)
def test_what_can_be_met_has_a_plan(fast, slow, end_fast, end_slow, into, out):
    """A contract is refused if and only if the integer program has no plan."""
    with tempfile.TemporaryDirectory() as folder:
        this = case(
            Path(folder), fast={"end_inventory": float(end_fast)}, net_injection=into / 8,
            slow={"end_inventory": float(end_slow)}, net_withdrawal=out / 8,
            inventory=[float(fast), float(slow)],
        )  # fmt: skip
    schedule = known_schedule(this)
    try:
        best_plan(this)
    except AssertionError:
        with pytest.raises(CaseError):
            check_limits(this, schedule)
    else:
        check_limits(this, schedule)


def test_the_files_of_the_stores_go_with_the_case(tmp_path):
    """To a folder of the live page, and to the workers of a book."""
    file, data = tables(tmp_path / "a")
    (tmp_path / "a" / "other.toml").write_text("x = 1")
    copied = read_files(file.parent, data).write(tmp_path / "b")
    assert len(read_case(*load(copied)).days) == STORES * len(PRICES)
    assert not (tmp_path / "b" / "other.toml").exists()
    assert set(contents(file.parent, data)) == {"curve.csv", "fast.toml", "slow.toml"}


def test_a_plan_goes_on_with_the_inventories_of_its_day(tmp_path):
    """The keys of a state are those of a case that begins there."""
    keys = case(tmp_path).contract.keys_at({"fast": 1.0, "slow": 4.0, "joint flow": 0.0}, "", None)
    later = case(tmp_path, **keys)
    schedule = bare_problem(later).schedule
    assert schedule.constants.start.tolist() == [1.0, 4.0]
    assert [x.inventory.positions[0] for x in later.contract.stores] == [
        ("contract", "inventory", 0), ("contract", "inventory", 1)
    ]  # fmt: skip


def test_limits_of_zero_are_tested_by_a_volume_of_the_nodes(tmp_path):
    """Between the nodes of the fitted value its rule is worse: V jumps with any smaller bump."""
    inputs = bare_problem(case(tmp_path, **TIGHT)).inputs_by_name
    for name in ("fast_min_inventory", "slow_min_inventory", "slow_end_inventory"):
        assert not inputs[name].value.any() and inputs[name].judge_bump == 1.0, name
        assert "cannot be raised" not in inputs[name].meaning
    assert inputs["slow_max_inventory"].judge_bump is None
    empty = case(tmp_path, fast={"inventory": 0.0}, **TIGHT)
    words = bare_problem(empty).inputs_by_name["fast_min_inventory"].meaning
    assert words.endswith("which cannot be raised, since the store begins with less gas")
