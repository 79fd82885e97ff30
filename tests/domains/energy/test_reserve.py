"""Capacity of a battery that is sold as reserve, by the hour or by the block of an auction."""

import datetime
import shutil
from itertools import groupby

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp
from tests.domains.energy.energy_cases import HOME, battery, case_at, exact, rule_between

from snapo.case.error import CaseError
from snapo.case.quantity import numbers_in
from snapo.domains.energy.contracts.battery import BatteryContract
from snapo.domains.energy.core.gains import FlowRows
from snapo.domains.energy.core.tables import LevelRows, UnitValues
from snapo.domains.energy.methods.grid import check_nodes
from snapo.domains.energy.methods.lattice import refined
from snapo.domains.energy.setup import bare_problem, factors_of
from snapo.engine import TRAJECTORY
from snapo.engine.native import Native
from snapo.problem.smooth import Exact
from snapo.solver.derivatives.by_block import DerivativePass

START = datetime.datetime(2026, 5, 4)


def with_prices(folder, prices, reserve_prices, stock, **changes):
    """The template with these prices by the hour, of energy and of reserve; other keys changed."""
    shutil.copytree(HOME / "template_battery", folder, dirs_exist_ok=True)
    times = [START + datetime.timedelta(hours=n) for n in range(len(prices) + 1)]
    for name, numbers in (("curve", prices), ("reserve", reserve_prices)):
        rows = [f"{time:%Y-%m-%dT%H:%M},{float(x)!r}" for time, x in zip(times, numbers)]
        (folder / f"{name}.csv").write_text("\n".join(["time,price", *rows]))
    keys = {"start": START, "end": times[-1], "cycles": None} | changes
    keys |= {"reserve": {"price": "reserve.csv", "stock": stock}}
    return case_at(folder, {f"contract.{name}": value for name, value in keys.items()})


def best_plan(case, hours_of_block):
    """The best plan at forward prices, by a mixed-integer program: charge, discharge and reserve of
    each hour, the same reserve in all hours of a block; both are at most zero in reserve."""
    contract, price = case.contract, np.asarray(case.market.forward_curve.used())
    numbers = {x.name: float(x.values[0]) for x in numbers_in(contract)}
    paid = np.broadcast_to(contract.reserve.price.used(), price.shape)
    count, energy, stored = len(price), numbers["energy"], numbers["stored"]
    into, out = numbers["charge_efficiency"], numbers["discharge_efficiency"]
    power = min(numbers["charge_power"], numbers["discharge_power"] * out)
    most = np.array([numbers["charge_power"] * into, numbers["discharge_power"]])
    low, high = contract.reserve.stock
    below, one, none = np.tri(count), np.eye(count), np.zeros((count, count))
    level = np.hstack([below, -below, none])
    rows = [
        (level, -stored, energy - stored),
        (np.hstack([one, none, most[0] * one]), -np.inf, most[0]),
        (np.hstack([none, one, most[1] * one]), -np.inf, most[1]),
        (level - low * np.hstack([none, none, one]), -stored, np.inf),
        (level + (energy - high) * np.hstack([none, none, one]), -np.inf, energy - stored),
    ]
    same = np.flatnonzero(np.arange(1, count) % hours_of_block)
    rows.append((np.hstack([none, none, one - np.eye(count, k=1)])[same], 0.0, 0.0))
    for name, spans in (
        ("cycles_day", groupby(range(count), lambda n: case.days[n])),
        ("cycles_term", [(0, range(count))]),
    ):
        for _, hours in spans if name in numbers else []:
            row = np.zeros((1, 3 * count))
            row[0, [count + n for n in hours]] = 1.0
            rows.append((row, -np.inf, numbers[name] * energy))
    gain = np.concatenate([-price / into, out * price - numbers["wear"], paid * power])
    upper = np.concatenate([np.repeat(most, count), np.ones(count)])
    result = milp(
        -gain,
        integrality=np.repeat([0, 0, 1], count),
        bounds=Bounds(np.zeros(len(upper)), upper),  # pyright: ignore
        constraints=[LinearConstraint(*row) for row in rows],
        options={"mip_rel_gap": 1e-9},
    )
    assert result.success
    return -result.fun


SMALL = [
    ({}, 1, [1.0, 3.0]),
    ({"auction": {"step": "4h"}}, 4, [1.0, 3.0]),
    ({"auction": {"step": "2h"}, "stored": 2.0, "cycles": {"day": 0.5}}, 2, [0.5, 2.5]),
    ({"cycles": {"term": 0.6}, "stored": 1.3}, 1, [2.0, 2.2]),
    ({"charge": {"power": 2.0, "efficiency": 0.8}, "stored": 4.0}, 1, [0.0, 1.5]),
    ({"auction": {"step": "3h"}, "wear": 0.0}, 3, [3.5, 4.0]),
]


@pytest.mark.parametrize("changes, block, stock", SMALL)
def test_without_volatility_it_is_the_best_plan(changes, block, stock, tmp_path):
    """A mixed-integer program, for two draws of the prices of energy and of reserve."""
    for k in range(2):
        draws = np.random.default_rng([k, len(stock), block])
        prices, paid = 60 + 20 * draws.normal(size=12), 12 * draws.uniform(size=12)
        case = with_prices(tmp_path / str(k), prices, paid, stock, **changes)
        value = best_plan(case, block)
        assert exact(case, forward=True) == pytest.approx(value, rel=1e-6)


DAY = {"end": START + datetime.timedelta(days=1)}
BLOCKS = {"step": "4h"}


@pytest.mark.parametrize("auction", [None, BLOCKS])
def test_reserve_without_a_price_or_a_reachable_stock_changes_nothing(auction):
    """Bit for bit with volatility; nothing is charged, and 1 MWh is less than the least stock."""
    short = {"end": START + datetime.timedelta(hours=8), "auction": auction}
    reserve = {"price": 0.0, "stock": [1.0, 3.0]}
    assert exact(battery(**short, reserve=reserve), finer=1) == exact(battery(**short), finer=1)
    never = {"charge": {"power": 1e-9, "efficiency": 1.0}, "stored": 1.0} | short
    value = exact(battery(**never, reserve={"price": 50.0, "stock": [2.0, 3.0]}), forward=True)
    assert value == exact(battery(**never), forward=True)


@pytest.mark.parametrize("stored, hours", [(1.0, 24), (0.0, 21)])
def test_at_a_high_price_reserve_is_sold_in_every_step_it_can(stored, hours):
    """At once from a stock within the limits; else after two hours of charge, 0.9 MWh each, in
    blocks of an hour, and of all later blocks of four hours but the first."""
    price = 1e5
    reserve = {"price": price, "stock": [1.0, 3.0]}
    by_hour = exact(battery(**DAY, stored=stored, reserve=reserve), forward=True)
    assert by_hour == pytest.approx(0.95 * price * (24 if stored else 22), rel=1e-3)
    case = battery(**DAY, stored=stored, reserve=reserve, auction=BLOCKS)
    blocks = 24 if stored else 20
    assert exact(case, forward=True) == pytest.approx(0.95 * price * blocks, rel=1e-3)


SPEED, VOLATILITY, HOUR = 525.6, 10.2956, 1 / 8760  # of the template
PRICES = np.array([60.0, 45.0, 66.0, 52.0, 70.0, 61.0])


@pytest.mark.parametrize("block", [1, 3])
def test_every_decision_on_a_fine_grid_of_the_factor(block, tmp_path):
    """2 MWh, of which one is stored or taken in an hour; reserve needs one of them. Blocks of three
    hours at the forward prices of their auctions."""
    paid, into = np.array([3.0, 4.0, 2.0, 9.0, 5.0, 4.0]), 0.9
    keys = {
        "energy": 2.0, "auction": {"step": f"{block}h"}, "stored": 1.0,
        "charge": {"power": 1 / into, "efficiency": into},
    }  # fmt: skip
    case = with_prices(tmp_path, PRICES, paid, [1.0, 1.5], **keys)
    problem = bare_problem(case)
    result = refined(case.contract.layout, problem.schedule, factors_of(problem))
    hours, count = np.arange(len(PRICES)), 1601
    variance = -np.expm1(-2 * SPEED * HOUR * hours) / (2 * SPEED)
    f = np.linspace(-1, 1, count) * 7 * np.sqrt(variance[-block])
    value = np.zeros((3, count))
    for first in reversed(range(0, len(PRICES), block)):
        if first + block < len(PRICES):
            left = np.exp(-SPEED * HOUR * block)
            step = np.exp(-0.5 * (f[None, :] - left * f[:, None]) ** 2 / variance[block])
            value = value @ (step / step.sum(axis=1, keepdims=True)).T
        reserve = value + 0.95 * paid[first : first + block].sum()
        for t in reversed(range(first, first + block)):
            loading = VOLATILITY * np.exp(-SPEED * HOUR * (t - first))
            price = PRICES[t] * np.exp(loading * f - loading**2 * variance[first] / 2)
            value = np.stack([
                np.max([value[at + q] + (-price / into if q > 0 else -q * (0.95 * price - 3.0))
                        for q in (-1, 0, 1) if 0 <= at + q <= 2], axis=0)
                for at in range(3)
            ])  # fmt: skip
        value[1] = np.maximum(value[1], reserve[1])
    assert result.value == pytest.approx(float(np.interp(0.0, f, value[1])), rel=3e-5)


VOLATILE = [
    {"reserve": {"price": 8.0, "stock": [1.0, 3.0]}},
    {"reserve": {"price": 14.0, "stock": [1.0, 3.0]}, "auction": BLOCKS},
    {"reserve": {"price": 10.0, "stock": [1.5, 2.0]}, "cycles": {"term": 0.7}, "stored": 0.3},
]


@pytest.mark.prove
@pytest.mark.parametrize("changes", VOLATILE)
def test_the_policy_is_near_the_lattice_and_below_the_bound(changes):
    """And keeps stock and flows in reserve on every path; the derivative with respect to the price
    of reserve is that of the lattice, by central differences."""
    case = battery(**DAY, **changes)
    problem, rule, engine = rule_between(case, 0.997, 1.008, Native())

    draws = problem.sources.evaluation.draws(np.arange(512), problem.simulator)
    rollout = engine.bind(problem).values(rule, draws, Exact(), record=TRAJECTORY)
    outputs = rollout.record["outputs"]
    sold, stored = outputs["reserve"] > 0.5, rollout.record["state"].levels[..., 0]
    low, high = changes["reserve"]["stock"]
    assert sold.any() and not sold.all()
    assert np.all((stored[sold] > low - 1e-5) & (stored[sold] < high + 1e-5))
    assert np.all(outputs["charge"][sold] == 0) and np.all(outputs["discharge"][sold] == 0)
    if "auction" in changes:
        assert np.all(sold.reshape(-1, 4, sold.shape[1]).all(axis=1) == sold[::4])

    path = DerivativePass(problem, engine.bind(problem), rule, Exact(), held=True)
    slope = path.derivatives([np.arange(2048)]).inputs["reserve_price"].value.item()
    price, width = changes["reserve"]["price"], 0.02
    moved = [
        exact(battery(**DAY, **changes | {"reserve": changes["reserve"] | {"price": price + x}}))
        for x in (-width, width)
    ]
    assert slope == pytest.approx((moved[1] - moved[0]) / (2 * width), rel=0.02)


@jax.jit
def units_of(slopes, begin, free, unit):
    """The positions and the gains of units by `FlowRows`, of slopes of rows 0.1 apart."""
    rows = LevelRows(np.zeros(1), np.full(1, 0.1))  # pyright: ignore
    table = UnitValues(rows, slopes[None, :, None], None, None, every=jnp.full((1, 12), 0.1))  # pyright: ignore
    flow = FlowRows(table, 0, (1.0,), begin[None], 0, (1,))
    result = flow.gains(jnp.zeros(()), free, jnp.ones(1), unit)
    return list(result.positions), list(result.units)


def gains_of(values, begin, free, unit):
    """The volume and its gain by `FlowRows`, of values of one level on rows 0.1 apart."""
    slopes = np.append(np.diff(values) / 0.1, 0.0)
    positions, units = units_of(*map(jnp.asarray, (slopes, begin, free, unit)))
    widths = free * np.diff(np.array([0.0, *positions, 1.0]))
    gains = np.array([np.mean(x) for x in units])
    return widths @ (gains > 0), widths @ np.maximum(gains, 0.0)


@pytest.mark.parametrize("begin, free", [(0.0, 1.0), (0.23, 0.7), (0.5, 0.08), (0.9, 0.1)])
def test_a_volume_that_gains_most_is_among_all_rows(begin, free):
    """Of values that jump and are neither convex nor concave, against all volumes to rows."""
    for values in 0.2 * np.random.default_rng(3).normal(size=(20, 11)).cumsum(axis=1):
        nodes = np.arange(11) * 0.1
        points = np.unique(np.clip([begin, *nodes, begin + free], begin, begin + free))
        totals = np.interp(points, nodes, values) - np.interp(begin, nodes, values)
        totals = totals + 0.3 * (points - begin)
        volume, gain = gains_of(values, begin, free, 0.3)
        assert gain == pytest.approx(totals.max(), abs=1e-5)
        assert volume == pytest.approx(points[np.argmax(totals)] - begin, abs=1e-5)


def test_prices_of_reserve_are_inputs_by_the_hour(tmp_path):
    case = with_prices(tmp_path, PRICES, PRICES / 10, [1.0, 3.0])
    assert case.inputs()["reserve_price"].value.tolist() == (PRICES / 10).tolist()
    assert isinstance(case.contract, BatteryContract) and case.contract.reserve is not None
    assert case.contract.reserve.price.labels[1] == "2026-05-04T01:00"
    assert case.contract.reserve.price.unit == "EUR/MW/h"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"reserve": {"price": -1.0, "stock": [1.0, 3.0]}}, r"reserve.price: got -1; it must be"),
        ({"reserve": {"price": 5.0}}, r"contract.reserve.stock"),
        ({"reserve": {"price": 5.0, "stock": [3.0, 1.0]}}, r"reserve.stock: got \[3, 1\]; it must be two"),
        ({"reserve": {"price": 5.0, "stock": 2.0}}, r"reserve.stock: got 2; it must be two"),
        ({"reserve": {"price": 5.0, "stock": [1.0, 5.0]}}, r"reserve.stock: .*at most energy, 4"),
        ({"reserve": {"price": "none.csv", "stock": [1.0, 3.0]}}, r"reserve.price.*none.csv"),
        ({"reserve": {"price": 5.0, "stock": [1.0, 3.0]}, "auction": BLOCKS,
          "intraday": {"half_spread": 1.0}}, r"contract.reserve: .*cannot be combined with `intraday`"),
    ],
)  # fmt: skip
def test_mistakes_are_named(changes, message):
    with pytest.raises(CaseError, match=message):
        battery(**changes)


def test_every_hour_needs_a_price_of_reserve(tmp_path):
    with_prices(tmp_path, PRICES, PRICES, [1.0, 3.0])
    lines = (tmp_path / "reserve.csv").read_text().splitlines()
    keys = {
        "contract.reserve": {"price": "reserve.csv", "stock": [1.0, 3.0]},
        "contract.end": datetime.datetime(2026, 5, 4, 6),
    }
    for rows, message in (
        (lines[:4] + lines[5:], "reserve.csv, 2026-05-04T03:00: there is no price for this hour"),
        (
            [*lines[:3], "2026-05-04T02:00,-4", *lines[4:]],
            "reserve.csv, line 4, column price: got '-4'",
        ),
    ):
        (tmp_path / "reserve.csv").write_text("\n".join(rows))
        with pytest.raises(CaseError, match=message):
            case_at(tmp_path, keys)


@pytest.mark.parametrize("changes", [
    {"energy": 4.013},
    {"cycles": None, "charge": {"power": 1.0, "efficiency": 0.9012345}},
])  # fmt: skip
def test_coarse_nodes_are_refused(changes):
    """Nodes at the breakpoints of one level would be exact, but a policy of even rows between them
    was 27 % below the lattice."""
    case = battery(**DAY, reserve={"price": 5.0, "stock": [1.0, 3.0]}, **changes)
    with pytest.raises(CaseError, match="limits of moves and flows need a larger common divisor"):
        check_nodes(case, bare_problem(case).schedule)
