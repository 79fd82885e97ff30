"""`snapo explain` of contracts: parts of a change against closed forms and the exact lattice."""

import datetime

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm
from tests.domains.energy.energy_cases import HOME, battery, case_at, exact, plant, swing
from tests.domains.energy.explain.valued import valued
from tests.domains.energy.test_stores import PRICES
from tests.domains.energy.test_stores import tables as stores_tables
from tests.domains.gas_storage.explain.valued import run_at

from snapo.case.error import CaseError
from snapo.domains.energy.core.policy import UnitValuePolicy, reordered
from snapo.domains.energy.core.simulator import simulator_of
from snapo.domains.energy.explain.parts import curves_of, explained_change, planned_steps, state_of
from snapo.domains.energy.read.case import read_case
from snapo.domains.energy.setup import bare_problem, make_setup, rebuilt, setup_at
from snapo.domains.gas_storage.explain import CASH, DECISIONS, FIRST, POLICY, REST, SECOND, TIME
from snapo.domains.gas_storage.explain.chain import delivery_periods
from snapo.domains.gas_storage.hedges.gamma import price_rises

FEW = {"evaluation.paths": 8192, "evaluation.scheme": None}
STRIP = FEW | {
    "contract.annual": None,
    "contract.shortfall": "firm",
    "contract.end": datetime.date(2026, 12, 1),
}


def silent(text: str) -> None:
    pass


def by_name(change) -> dict:
    assert_allclose(sum(row.amount for row in change.parts), change.change, atol=1e-9)
    return {(row.part, row.period): row for row in change.parts}


def day_calls(case, up: float, volatility: float = 0.9) -> dict[str, np.ndarray]:
    """{month: Black's delta times a move, half of the change in delta times it, and the change by
    another volatility}."""
    forward, strike, result = case.market.forward_curve.used(), 29.0, {}
    for day, price, time in zip(case.days, forward, case.time):
        deviation = np.sqrt(-np.expm1(-24 * time) / 24)
        discount = np.exp(-0.03 * round(time * 365) / 365)
        if time == 0:
            terms = [0.0, 0.0, 0.0]
            if price > strike:
                terms[0] = up * price
        else:
            d1 = _d1(price, strike, 0.9 * deviation)
            move, moved = up * price, (1 + up) * price
            deltas = norm.cdf(d1), norm.cdf(_d1(moved, strike, 0.9 * deviation))
            calls = [_call(moved, strike, x * deviation) for x in (0.9, volatility)]
            second = (deltas[1] - deltas[0]) * move / 2
            terms = [deltas[0] * move, second, calls[1] - calls[0]]
        month = f"{day:%b}\u00a0{day:%Y}"
        result[month] = result.get(month, 0.0) + discount * np.array(terms)
    return result


def _d1(forward, strike, deviation):
    return np.log(forward / strike) / deviation + deviation / 2


def _call(forward, strike, deviation):
    d1 = _d1(forward, strike, deviation)
    return forward * norm.cdf(d1) - strike * norm.cdf(d1 - deviation)


@pytest.mark.prove
def test_a_strip_of_calls(tmp_path):
    """A swing without annual limits is a call for each day: all terms are those of Black (1976)."""
    first, _, policy = valued(tmp_path / "a", "swing", STRIP)
    changes = STRIP | {"model.volatility": 1.0}
    second, *_ = valued(tmp_path / "b", "swing", changes, None, policy,
                       {"forward_curve": 1.01})  # fmt: skip
    change = explained_change(first, second, silent)
    rows = by_name(change)
    expected = day_calls(first.case, 0.01, 1.0)
    for month, (one, two, _) in expected.items():
        for part, value in ((FIRST, one), (SECOND, two)):
            row = rows[part, month]
            print(month, part, row.amount, row.standard_error, value)
            assert abs(row.amount - value) < 2 * row.standard_error + 0.5 * 10**-change.digits
            assert row.standard_error < 0.05 * value
    vega = rows["volatility", ""]
    value = sum(terms[2] for terms in expected.values())
    print(vega, value)
    assert abs(vega.amount - value) < 2 * vega.standard_error
    assert abs(rows[REST, ""].amount) < 0.02 * sum(terms[0] for terms in expected.values())


TWO_PRODUCTS = {"day_ahead": {}, "balance_of_month": {}}


def stores_to_empty(folder, moved: float, products: dict | None = TWO_PRODUCTS):
    """Two stores that must give out 1 and 0.5 units on each of four days. On the last three of
    these days the prices of the template of tests are higher by `moved`."""
    gas = {"end": datetime.date(2027, 1, 5), "max_injection": 0.0}
    fast, slow = ({"inventory": 4 * x, "max_withdrawal": x} for x in (1.0, 0.5))
    few = {"net_withdrawal": 1.5, "fast": gas | fast, "slow": gas | slow}
    file, data = stores_tables(folder, **few)
    first, *prices = PRICES[:4]
    rows = [first, *(price + moved for price in prices)]
    rows = [f"2027-01-{day:02d},{price}" for day, price in enumerate(rows, 1)]
    (folder / "curve.csv").write_text("\n".join(["date,price", *rows]))
    data = data | {"evaluation": {"paths": 64}, "products": products}
    if products is None:
        del data["products"]
    return file, data, read_case(file, data)


def test_a_period_of_two_stores_has_two_steps_a_day(tmp_path):
    _, _, case = stores_to_empty(tmp_path, 0.0)
    periods = delivery_periods(case.days, case.products)
    assert [(x.first, x.after) for x in periods] == [(0, 2), (2, 8)]
    problem = bare_problem(case)
    curve = simulator_of(problem).curve
    values = problem.inputs_by_name[curve.name].value
    one, other = price_rises(periods, case.days, curve, values)
    assert (one.dates, other.dates) == (("2027-01-01",) * 2, ("2027-01-02", "2027-01-04"))
    assert one.along.tolist() == [1, 0, 0, 0] and other.along.tolist() == [0, 1, 1, 1]
    assert other.price == pytest.approx(np.mean(PRICES[1:4]))


@pytest.mark.prove
@pytest.mark.parametrize("products", [TWO_PRODUCTS, None])
def test_two_stores_with_products(products, tmp_path):
    """The effect of the curve is in its period: the discounted volume times the move."""
    runs, setup, policy = [], None, None
    for name, moved in (("a", 0.0), ("b", 2.0)):
        file, data, case = stores_to_empty(tmp_path / name, moved, products)
        setup = make_setup(case, "native") if setup is None else setup_at(setup, case)
        policy = setup.policy.value_rule if policy is None else policy
        runs.append(run_at(tmp_path / f"run {name}", file, data, case, setup, policy))
    change = explained_change(*runs, silent)
    rows = by_name(change)
    volume = 1.5 * np.sum(np.exp(-0.03 * np.arange(1, 4) / 365))
    periods = [row.period for row in change.moves]
    rounded = 0.5 * 10**-change.digits + 1e-4  # engines count in single precision
    assert rows[FIRST, periods[-1]].amount == pytest.approx(2.0 * volume, abs=rounded)
    assert abs(rows[REST, ""].amount) <= 2 * rounded
    if products is None:
        assert [(x.days, x.move) for x in change.moves] == [(4, 1.5)]
        return
    assert [(x.days, x.move) for x in change.moves] == [(1, 0.0), (3, 2.0)]
    assert rows[FIRST, "day ahead"].amount == 0.0
    assert change.moves[1].delta == pytest.approx(volume, abs=1e-4)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("key", "value", "part"),
    [
        ("model.volatility", 1.0, "volatility"),
        ("market.interest_rate", 0.05, "interest rate"),
        ("contract.strike", 30.0, "contract"),
    ],
)
def test_one_input_alone_explains_its_change(tmp_path, key, value, part):
    few = STRIP | {"evaluation.paths": 512}
    first, _, policy = valued(tmp_path / "a", "swing", few)
    second, *_ = valued(tmp_path / "b", "swing", few | {key: value}, None, policy)
    change = explained_change(first, second, silent)
    by_name(change)
    others = [row for row in change.totals if row.part not in (part, REST)]
    assert {row.part for row in others} == {FIRST, SECOND, POLICY}
    assert not any(row.amount for row in others)
    totals = {row.part: row.amount for row in change.totals}
    assert totals[part] == change.change != 0 == totals[REST]


@pytest.mark.prove
def test_a_linear_contract(tmp_path):
    """A volume that must be taken each day: delta is its discounted volume, gamma is zero."""
    forced = STRIP | {"contract.min_daily": 1.0, "evaluation.paths": 512}
    forced |= {"contract.end": datetime.date(2026, 10, 11)}
    first, setup, policy = valued(tmp_path / "a", "swing", forced)
    second, *_ = valued(tmp_path / "b", "swing", forced, setup, policy,
                       {"forward_curve": 1.02})  # fmt: skip
    change = explained_change(first, second, silent)
    rows = by_name(change)
    days = np.arange(len(first.case.days))
    forward = first.case.market.forward_curve.used()
    value = np.sum(np.exp(-0.03 * days / 365) * 0.02 * forward)
    row = rows[FIRST, "Oct\u00a02026"]
    assert abs(row.amount - value) < 3 * row.standard_error + 1e-3
    assert rows[SECOND, "Oct\u00a02026"].amount == 0
    assert abs(rows[REST, ""].amount) <= 2e-4  # engines count in single precision


FREE_STARTS = {
    "contract.start": datetime.datetime(2026, 1, 5),
    "contract.end": datetime.datetime(2026, 1, 5, 12),
    "contract.starts": None,
    "contract.min_up": 1,
    "contract.min_down": 1,
    "contract.power": {"market": "power", "min": 100.0, "max": 100.0},
    "contract.fuel": {"market": "gas", "idle": 0.0, "per_mwh": 1.9},
    "contract.emission": None,
    "contract.other_cost": 0.0,
    "contract.before": {"off": 1},
    "evaluation.paths": 8192,
}


@pytest.mark.prove
def test_two_markets(tmp_path):
    """Hours with free starts are exchange options: both deltas are those of Margrabe (1978)."""
    first, setup, policy = valued(tmp_path / "a", "plant", FREE_STARTS)
    second, *_ = valued(tmp_path / "b", "plant", FREE_STARTS, setup, policy,
                       {"power_curve": 1.02, "gas_curve": 1.01})  # fmt: skip
    change = explained_change(first, second, silent)
    rows = by_name(change)
    curves = {name: x.used() for name, x in curves_of(first.case).items()}
    expected = np.zeros(2)
    for power, gas, time in zip(curves["power_curve"], 1.9 * curves["gas_curve"], first.case.time):
        if time == 0:
            expected += 100 * (power > gas) * np.array([0.02 * power, -0.01 * gas])
            continue
        speeds, sizes = np.array([525.6, 20.0]), np.array([11.2315, 0.6])
        sums = speeds[:, None] + speeds
        rho = np.array([[1.0, 0.4], [0.4, 1.0]])
        covariance = rho * np.outer(sizes, sizes) * -np.expm1(-sums * time) / sums
        deviation = np.sqrt(np.array([1.0, -1.0]) @ covariance @ np.array([1.0, -1.0]))
        d1 = _d1(power, gas, deviation)
        deltas = norm.cdf(d1), -norm.cdf(d1 - deviation)
        expected += 100 * np.array([0.02 * power, 0.01 * gas]) * deltas
    for market, value in zip(("power", "gas"), expected):
        row = rows[FIRST, f"{market} Jan\u00a02026"]
        print(market, row.amount, row.standard_error, value)
        assert abs(row.amount - value) < 2 * row.standard_error
        assert row.standard_error < 0.02 * abs(value)
    assert [move.period for move in change.moves] == ["power Jan\u00a02026", "gas Jan\u00a02026"]
    assert_allclose([move.move for move in change.moves],
                    [0.02 * curves["power_curve"].mean(), 0.01 * curves["gas_curve"].mean()])  # fmt: skip


LENT = {"evaluation.paths": 8192, "contract.end": datetime.date(2026, 10, 21),
        "contract.annual": {"min": 7.0, "max": 13.0}}  # fmt: skip


@pytest.mark.prove
def test_two_days_later(tmp_path):
    """Time and decisions are differences of exact values on the lattice, and the planned cash."""
    first, _, policy = valued(tmp_path / "a", "swing", LENT)
    planned = planned_steps(rebuilt(bare_problem(first.case)), policy, 2, 2)
    later = LENT | {"market.valuation_date": datetime.date(2026, 10, 3)}
    second, *_ = valued(tmp_path / "b", "swing", later | {"contract.taken": 2.0}, None, policy)
    change = explained_change(first, second, silent, cash=7.0)
    rows = {row.part: row for row in change.totals}
    cases = [later | {"contract.taken": x} for x in (planned.levels["taken"], 2.0)]
    values = [exact(swing_at(x)) for x in (LENT, *cases)]
    time = values[1] - values[0] + planned.cash
    decided = values[2] - values[1] + 7.0 - planned.cash
    for part, value in ((TIME, time), (DECISIONS, decided)):
        row = rows[part]
        assert row.standard_error is not None
        print(part, row.amount, row.standard_error, value)
        assert abs(row.amount - value) < 3 * row.standard_error + 2e-4 * values[0]
    assert rows[CASH].amount == -7.0 and change.profit == pytest.approx(change.change + 7.0)
    by_name(change)


def swing_at(changes):
    return case_at(HOME / "template_swing", changes)


@pytest.mark.prove
def test_a_plant_that_begins_in_another_mode_keeps_its_policy():
    """The modes of the contract are in another order; the actions of the policy are the same."""
    short = {"end": datetime.datetime(2026, 1, 5, 6), "starts": None, "min_up": 3}
    one, other = plant(before={"off": 12}, **short), plant(before={"on": 2}, **short)
    simulators = [simulator_of(bare_problem(case)) for case in (one, other)]
    features = bare_problem(one).features
    layouts = [x.layout for x in simulators]
    policy = UnitValuePolicy(layouts[0], features, key=jax.random.key(3))
    moved = reordered(policy, layouts[1])
    head, count = policy.head, len(layouts[0].modes)
    rng = np.random.default_rng(1)
    for name in layouts[0].modes:
        seen = rng.normal(size=features)
        ahead = [seen.copy() for _ in layouts]
        for x, layout in zip(ahead, layouts):
            x[-count:] = np.array([mode == name for mode in layout.modes])
        actions = [rule(x) for rule, x in zip((policy, moved), ahead)]
        before = np.array([move.before for move in layouts[0].moves])
        from_here = [layouts[0].choices.index(m) for m in layouts[0].choices
                     if layouts[0].modes[before[m]] == name]  # fmt: skip
        place = len(layouts[0].pairs) + np.array(from_here, int)
        assert_allclose(actions[0][place], actions[1][place], rtol=1e-5)
        assert_allclose(actions[0][: len(layouts[0].pairs)], actions[1][: len(layouts[0].pairs)])
    assert head == moved.head
    with pytest.raises(ValueError, match="other levels, flows or moves"):
        reordered(policy, swing().contract.layout)


@pytest.mark.prove
def test_messages(tmp_path):
    few = STRIP | {"evaluation.paths": 64, "contract.end": datetime.date(2026, 10, 4)}
    first, *_ = valued(tmp_path / "a", "swing", few)
    with pytest.raises(CaseError, match="use --cash for the cash flow"):
        explained_change(first, first, silent, flows={})
    with pytest.raises(CaseError, match="there is no decision between"):
        explained_change(first, first, silent, cash=1.0)
    nominated = few | {"contract.nomination": {"days": 1}}
    with pytest.raises(CaseError, match=r"contract.nomination: snapo explain needs flows"):
        valued(tmp_path / "b", "swing", nominated)


@pytest.mark.parametrize(
    ("make", "contract", "levels", "mode"),
    [
        (swing, {}, {"taken": 3.0}, ""),
        (swing, {"shortfall": "strike", "make_up": {}, "carry_forward": {"max": 8.0}},
         {"taken": 1.0, "bank": -2.0}, ""),
        (battery, {}, {"energy": 0.5, "taken today": 0.0}, ""),
        (battery, {"cycles": {"term": 6.0}}, {"energy": 0.5, "taken": 2.0}, ""),
        (plant, {"min_up": 2, "most_starts": 3}, {"starts": 1.0}, "on 2"),
    ],
)  # fmt: skip
def test_a_case_begins_in_the_state_of_its_keys(make, contract, levels, mode):
    """What was taken of a limit of the term has left the limit, and not the level."""
    layout = make(**contract).contract.layout
    keys = make(**contract).contract.keys_at(levels, mode or layout.modes[0], None)
    for name, value in keys.items():
        table, _, key = name.partition(".")
        contract = contract | {table: contract.get(table, {}) | {key: value} if key else value}
    again = make(**contract)
    state = state_of(bare_problem(again))
    kept = {"taken": 0.0, "starts": 0.0} if "energy" in levels or "starts" in levels else {}
    assert state.levels == levels | {name: x for name, x in kept.items() if name in levels}
    assert state.mode == (mode or layout.modes[0])
    left = {x.name: float(x.values[0]) for x in again.numbers()}
    if "cycles_term" in left:
        assert left["cycles_term"] == 5.5
    assert "starts" not in levels or again.contract.start_limit == 2


def test_no_right_is_left_in_a_rest():
    contract = swing(annual=None, shortfall="firm", rights={"most": 3, "rest": 2}).contract
    assert contract.keys_at({"rights": 1.0}, "free", None) == {"rights.most": 2}
    with pytest.raises(ValueError, match='no contract can begin in the mode "rest 2"'):
        contract.keys_at({"rights": 1.0}, "rest 2", None)


@pytest.mark.prove
def test_the_fixing_of_an_index_is_a_part_of_its_own(tmp_path):
    """Units that must be taken cost the index: its part is minus their discounted volume a unit."""
    few = STRIP | {"contract.end": datetime.date(2026, 11, 1), "contract.min_daily": 1.0}
    strike = {"index": "month-ahead", "factor": 1.0, "add": 0.0}
    few |= {"evaluation.paths": 64, "market.valuation_date": datetime.date(2026, 10, 5)}
    changes = [few | {"contract.strike": strike | {"fixing": x}} for x in (27.0, 28.5)]
    first, setup, policy = valued(tmp_path / "a", "swing", changes[0])
    second, *_ = valued(tmp_path / "b", "swing", changes[1], setup, policy)
    change = explained_change(first, second, silent)
    rows = by_name(change)
    discounted = np.sum(np.exp(-0.03 * np.arange(len(first.case.days)) / 365))
    assert rows["strike fixing", ""].amount == pytest.approx(-1.5 * discounted, abs=1e-3)
    assert abs(rows[REST, ""].amount) <= 1e-3
