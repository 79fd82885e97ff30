"""Fade of a battery: the energy that it can hold falls with the energy taken."""

import datetime
from itertools import groupby

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp
from tests.domains.energy.energy_cases import (
    battery,
    battery_with_prices,
    case_at,
    exact,
    rule_between,
)

from snapo.case.error import CaseError
from snapo.case.quantity import numbers_in
from snapo.domains.energy.core.policy import UnitValuePolicy
from snapo.domains.energy.methods.grid import check_nodes
from snapo.domains.energy.methods.lattice import refined
from snapo.domains.energy.setup import bare_problem, factors_of, make_setup
from snapo.engine import TRAJECTORY
from snapo.problem.smooth import Exact
from snapo.solver.derivatives.by_block import DerivativePass

START = datetime.datetime(2026, 5, 4)


def with_prices(folder, prices, **changes):
    """The template with these prices by the hour, and other keys."""
    return battery_with_prices(folder, START, prices, **changes)


def best_plan(case):
    """The best plan at forward prices, by a mixed-integer program: charge and discharge of every
    hour, whether it charges, whether it is in reserve, and whether more than a multiple of `every`
    may be taken up to the hour; the limit of an hour that charges falls with these multiples."""
    contract, price = case.contract, np.asarray(case.market.forward_curve.used())
    numbers = {x.name: float(x.values[0]) for x in numbers_in(contract)}
    count, energy, stored = len(price), numbers["energy"], numbers["stored"]
    into, out = numbers["charge_efficiency"], numbers["discharge_efficiency"]
    powers = [numbers["charge_power"] * into, numbers["discharge_power"]]
    every, before, by = float(contract.fade.every), float(contract.fade.taken), numbers["fade"]
    falls = int((before + powers[1] * count) / every) + 1
    one, none, below = np.eye(count), np.zeros((count, count)), np.tri(count)
    passed, nothing = np.hstack([one] * falls), np.zeros((count, count * falls))
    level = np.hstack([below, -below, none, none, nothing])
    charges, reserve = (np.hstack([*x, nothing]) for x in (
        (none, none, one, none), (none, none, none, one)
    ))  # fmt: skip
    fallen = np.hstack([np.zeros((count, 4 * count)), passed])
    most_lost = energy + by * falls
    rows = [
        (level, -stored, energy - stored),
        (np.hstack([one, none, -powers[0] * one, none, nothing]), -np.inf, 0.0),
        (np.hstack([none, one, powers[1] * one, powers[1] * one, nothing]), -np.inf, powers[1]),
        (charges + reserve, -np.inf, 1.0),
        (np.hstack([none, below, none, none, -every * passed]), -np.inf, every - before),
        (level + by * fallen + most_lost * charges, -np.inf, energy - stored + most_lost),
    ]
    paid = 0.0
    if contract.reserve is not None:
        low, high = contract.reserve.stock
        rows.append((level - low * reserve, -stored, np.inf))
        rows.append((level + (energy - high) * reserve, -np.inf, energy - stored))
        paid = numbers["reserve_price"] * min(numbers["charge_power"], powers[1] * out)
    for name, spans in (
        ("cycles_day", groupby(range(count), lambda n: case.days[n])),
        ("cycles_term", [(0, range(count))]),
    ):
        for _, hours in spans if name in numbers else []:
            row = np.zeros((1, level.shape[1]))
            row[0, [count + n for n in hours]] = 1.0
            rows.append((row, -np.inf, numbers[name] * energy))
    gain = np.zeros(level.shape[1])
    gain[: 2 * count] = np.concatenate([-price / into, out * price - numbers["wear"]])
    gain[3 * count : 4 * count] = paid
    upper = np.ones(level.shape[1])
    upper[: 2 * count] = np.repeat(powers, count)
    upper[3 * count : 4 * count] = contract.reserve is not None
    result = milp(
        -gain,
        integrality=np.repeat([0, 1], [2 * count, len(gain) - 2 * count]),
        bounds=Bounds(np.zeros(len(upper)), upper),  # pyright: ignore
        constraints=[LinearConstraint(*row) for row in rows],
        options={"mip_rel_gap": 1e-9},
    )
    assert result.success
    return -result.fun


SMALL = [
    {"fade": {"every": 2.0, "by": 0.5}},
    {"fade": {"every": 1.2, "by": 0.3, "taken": 0.7}, "stored": 1.3, "energy": 3.0},
    {"fade": {"every": 1.5, "by": 1.0, "taken": 4.0}, "cycles": {"term": 0.9}, "stored": 4.0},
    {
        "fade": {"every": 1.0, "by": 0.4}, "cycles": {"day": 0.5}, "energy": 2.0, "stored": 1.0,
        "charge": {"power": 1.0, "efficiency": 0.8},
    },
    {
        "fade": {"every": 2.0, "by": 0.9}, "stored": 2.0,
        "reserve": {"price": 9.0, "stock": [1.0, 2.5]},
    },
    {"fade": {"every": 3.0, "by": 1.0}, "stored": 2.0, "wear": 0.0, "auction": {"step": "4h"}},
]  # fmt: skip


@pytest.mark.parametrize("changes", SMALL)
def test_without_volatility_it_is_the_best_plan(changes, tmp_path):
    """A mixed-integer program, for two draws of the prices."""
    for k in range(2):
        prices = 45 * np.exp(0.7 * np.random.default_rng([k, 5]).normal(size=14))
        case = with_prices(tmp_path / str(k), prices, **changes)
        assert exact(case, forward=True) == pytest.approx(best_plan(case), rel=1e-6)


SHORT = {"end": START + datetime.timedelta(hours=10), "cycles": None, "stored": 1.0}


@pytest.mark.parametrize(
    "fade", [{"every": 2.0, "by": 0.0}, {"every": 50.0, "by": 4.0}, {"every": 50.0, "by": 0.7}]
)
def test_no_fade_or_one_that_is_never_reached_changes_nothing(fade):
    """Bit for bit, with volatility."""
    assert exact(battery(**SHORT, fade=fade), finer=1) == exact(battery(**SHORT), finer=1)


def test_more_fade_never_raises_the_value(tmp_path):
    """In `by`, and in the energy taken before."""
    prices = [90.0, 20.0, 20.0, 80.0, 70.0, 10.0, 20.0, 90.0, 60.0, 20.0, 10.0, 90.0, 95.0]

    def values(**changes):
        key, numbers = changes.popitem()
        fades = [{"every": 2.0, "by": 0.5} | {key: x} for x in numbers]
        return [
            exact(with_prices(tmp_path, prices, fade=fade, energy=2.0), forward=True)
            for fade in fades
        ]

    for key, numbers, lost in (
        ("by", (0.0, 0.2, 0.5, 2.0), 50), ("taken", (0.0, 1.0, 4.0, 11.0), 200),
    ):  # fmt: skip
        result = np.array(values(**{key: numbers}))
        assert np.all(np.diff(result) <= 1e-9) and result[0] - result[-1] > lost
    assert result[-1] == 0.0  # nothing is left of 2 MWh after four falls


@pytest.mark.parametrize(("every", "value"), [(6.0, 560.0), (2.0, 515.0), (1.9, 497.0)])
def test_a_multiple_may_be_reached_at_the_earlier_limit(every, value, tmp_path):
    """2 MWh are sold three times at 100, and charged between at 10. The limit falls by 0.5 MWh with
    the first unit beyond a multiple: with 2 MWh before the third charge, 200 + 180 + 135. With 1.9
    it is best to sell no more than that each time, 190 - 19 + 190 - 14 + 150."""
    prices = [100.0, 100.0, 10.0, 10.0, 100.0, 100.0, 10.0, 10.0, 100.0, 100.0]
    plain = {"power": 1.0, "efficiency": 1.0}
    keys = {"energy": 2.0, "stored": 2.0, "wear": 0.0, "charge": plain, "discharge": plain}
    case = with_prices(tmp_path, prices, **keys, fade={"every": every, "by": 0.5})
    assert exact(case, forward=True) == pytest.approx(value, rel=1e-9)
    assert best_plan(case) == pytest.approx(value, rel=1e-9)


SPEED, VOLATILITY, HOUR = 525.6, 10.2956, 1 / 8760  # of the template
PRICES = np.array([66.0, 45.0, 66.0, 52.0, 70.0, 50.0, 72.0])


def test_every_decision_on_a_fine_grid_of_the_factor(tmp_path):
    """2 MWh, moved by quarters of 1 MWh in an hour; the limit falls by 0.75 MWh for each 1.25."""
    into, part, every, by = 0.9, 0.25, 5, 3
    charge = {"power": 1 / into, "efficiency": into}
    keys = {"energy": 2.0, "stored": 1.5, "charge": charge, "fade": {"every": 1.25, "by": 0.75}}
    case = with_prices(tmp_path, PRICES, **keys)
    problem = bare_problem(case)
    result = refined(case.contract.layout, problem.schedule, factors_of(problem))
    count, last, full = 401, 22, 8  # nodes of the factor; quarters taken at the end, and in store
    variance = -np.expm1(-2 * SPEED * HOUR * np.arange(len(PRICES))) / (2 * SPEED)
    f = np.linspace(-1, 1, count) * 7 * np.sqrt(variance[-1])
    left = np.exp(-SPEED * HOUR)
    step = np.exp(-0.5 * (f[None, :] - left * f[:, None]) ** 2 / variance[1])
    step /= step.sum(axis=1, keepdims=True)
    value = np.zeros((full + 1, last + 1, count))
    for t in reversed(range(len(PRICES))):
        if t + 1 < len(PRICES):
            value = value @ step.T
        price = PRICES[t] * np.exp(VOLATILITY * f - VOLATILITY**2 * variance[t] / 2)
        best = value.copy()
        for taken in range(last + 1):
            limit = full - by * max(-(-taken // every) - 1, 0)
            for stored in range(full + 1):
                for moved in range(1, 5):
                    if stored + moved <= limit:
                        bought = value[stored + moved, taken] - moved * part * price / into
                        best[stored, taken] = np.maximum(best[stored, taken], bought)
                    if moved <= min(stored, last - taken):
                        sold = moved * part * (0.95 * price - 3.0)
                        sold = sold + value[stored - moved, taken + moved]
                        best[stored, taken] = np.maximum(best[stored, taken], sold)
        value = best
    assert result.value == pytest.approx(float(np.interp(0.0, f, value[6, 0])), rel=3e-5)


DAY = {"end": START + datetime.timedelta(days=1), "cycles": None}
VOLATILE = [
    {"fade": {"every": 3.0, "by": 0.5}},
    {"fade": {"every": 2.0, "by": 0.6, "taken": 1.0}, "cycles": {"term": 1.5}, "stored": 1.0},
    {"fade": {"every": 2.0, "by": 1.0}, "auction": {"step": "4h"}, "energy": 3.0},
    {
        "fade": {"every": 2.0, "by": 1.0}, "stored": 2.0,
        "reserve": {"price": 8.0, "stock": [1.0, 2.5]},
    },
]  # fmt: skip


@pytest.mark.prove
@pytest.mark.parametrize("changes", VOLATILE)
def test_the_policy_is_near_the_lattice_and_below_the_bound(changes):
    """And never charges beyond the limit, on any path."""
    case = battery(**DAY | changes)
    problem, rule, engine = rule_between(case, 0.999, 1.001)

    draws = problem.sources.evaluation.draws(np.arange(512), problem.simulator)
    rollout = engine.bind(problem).values(rule, draws, Exact(), record=TRAJECTORY)
    levels = np.concatenate([rollout.record["state"].levels, rollout.state.levels[None]])
    fade, charge = changes["fade"], rollout.record["outputs"]["charge"]
    falls = np.maximum(np.ceil((levels[1:, :, 1] - 2e-3) / fade["every"]) - 1, 0)
    above = levels[1:, :, 0] - (changes.get("energy", 4.0) - fade["by"] * falls)
    assert np.all(above[charge > 1e-5] < 1e-4)
    assert falls.max() > 0 and np.any(np.abs(above[charge > 1e-5]) < 1e-4)


@pytest.mark.prove
def test_derivatives_where_decisions_stop_at_a_multiple(tmp_path):
    """1.9 MWh are sold twice, so that the limit falls only once, then all 1.5 MWh. More `energy` is
    bought at 11 and sold at 80; less that fades, at 13 and at 80; more `stored` saves 11. A decision that is
    held stops at the multiple: with more power 101 replaces 100, and so on. By central differences
    of the lattice too."""
    prices = [101.0, 100.0, 10.0, 11.0, 91.0, 90.0, 12.0, 13.0, 81.0, 80.0]
    plain = {"power": 1.0, "efficiency": 1.0}
    keys = {
        "energy": 2.0, "stored": 1.95, "wear": 0.0, "charge": plain, "discharge": plain,
        "fade": {"every": 1.9, "by": 0.5},
    }  # fmt: skip
    with_prices(tmp_path, prices, **keys)
    keys |= {"start": START, "end": START + datetime.timedelta(hours=10), "cycles": None}

    def case(**changes):
        every = {f"contract.{name}": value for name, value in (keys | changes).items()}
        return case_at(tmp_path, every | {"model.volatility": 1e-3})

    setup = make_setup(case(), "native")
    assert isinstance(setup.policy, UnitValuePolicy)
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    path = DerivativePass(problem, engine.bind(problem), rule, Exact(), held=True)
    slopes = path.derivatives([np.arange(64)]).inputs
    expected = {"fade": -67.0, "energy": 69.0, "stored": 11.0, "discharge_power": 3.0}
    assert {name: slopes[name].value.item() for name in expected} == pytest.approx(
        expected, abs=0.05
    )
    for name in ("fade", "energy", "stored"):
        sides = [
            exact(case(fade={"every": 1.9, "by": 0.5 + x}) if name == "fade" else
                  case(**{name: keys[name] + x}), forward=True)
            for x in (-0.05, 0.05)
        ]  # fmt: skip
        assert (sides[1] - sides[0]) / 0.1 == pytest.approx(expected[name], abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fade": {"by": 0.5}}, r"contract.fade.every"),
        ({"fade": {"every": 30.0}}, r"contract.fade.by"),
        ({"fade": {"every": 0.0, "by": 0.5}}, r"fade.every: got 0; it must be a number above 0: MWh taken"),
        ({"fade": {"every": 30.0, "by": -0.5}}, r"fade.by: got -0.5; it must be"),
        ({"fade": {"every": 30.0, "by": 4.5}}, r"fade.by: got 4.5; it must be at most energy, 4"),
        ({"fade": {"every": 30.0, "by": 0.5, "taken": -1.0}}, r"fade.taken: got -1; it must be a number"),
        ({"fade": 0.5}, r"contract.fade: got 0.5"),
        ({"fade": {"every": 30.0, "by": 0.5}, "auction": {"step": "4h"},
          "intraday": {"half_spread": 1.0}}, r"contract.fade: .*cannot be combined with `intraday`"),
    ],
)  # fmt: skip
def test_mistakes_are_named(changes, message):
    with pytest.raises(CaseError, match=message):
        battery(**changes)


@pytest.mark.parametrize(
    "changes", [{"fade": {"every": 3.03, "by": 0.5}}, {"cycles": {"day": 1.0}, "energy": 4.1}]
)
def test_coarse_nodes_are_refused(changes):
    """Where `every` has no common divisor with the powers, and where a third level has too many."""
    case = battery(**DAY | {"fade": {"every": 3.0, "by": 0.5}} | changes)
    with pytest.raises(CaseError, match="limits of moves and flows need a larger common divisor"):
        check_nodes(case, bare_problem(case).schedule)


def test_energy_taken_goes_on_to_a_later_case():
    case = battery(cycles={"term": 6.0}, fade={"every": 8.0, "by": 0.5, "taken": 3.0})
    keys = case.contract.keys_at({"energy": 2.5, "taken": 9.0}, "", None)
    assert keys == {"stored": 2.5, "fade.taken": 9.0, "cycles.term": 4.5}
    assert case.inputs()["fade"].value == 0.5
