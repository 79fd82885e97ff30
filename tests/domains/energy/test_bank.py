"""Make-up and carry-forward of a swing contract, against an integer program of all its days."""

import copy
import datetime
import shutil

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp
from tests.domains.energy.energy_cases import HOME, case_at, exact

from snapo.case.error import CaseError
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.setup import bare_problem, make_setup
from snapo.engine.native import Native
from snapo.solver.bound import bound
from snapo.solver.evaluate import evaluate, path_totals
from snapo.testing.derivatives import wrong_derivatives

START, LATE, SECOND, END = (datetime.date(2026, *x) for x in ((9, 20), (9, 23), (10, 1), (10, 13)))
STRIKE, MOST, SOFT = 29.0, 8.0, 4.0
MAKE_UP = {"make_up": {"years": 1, "price": 3.0}, "shortfall": "strike"}
CARRY = {"carry_forward": {"years": 1, "max": 2.0}}
TWO = {"make_up": {"years": 2, "price": 3.0}}
CHEAP, DEAR = (22.0, 34.0), (34.0, 27.0)  # prices of the two contract years, about


def two_years(folder, levels, low=5.0, volatility=0.0, **changes):
    """11 days and 12 days around the first of October, at most one unit a day and 8 a year."""
    days = [START + datetime.timedelta(n) for n in range((END - START).days)]
    noise = np.random.default_rng(3).normal(size=len(days)) * 3
    prices = [levels[day >= SECOND] + x for day, x in zip(days, noise)]
    keys = {"year_begins": "10-01"} | changes
    return in_days(folder, days, prices, low, volatility, keys)


def three_years(folder, levels, low=4.0, volatility=0.0, nested=(), **changes):
    """Contract years of which the last 8 days of the first, all of the second and the first 8 days
    of the third have volumes: at most one a day."""
    days = [LATE + datetime.timedelta(n) for n in range(365 + 16)]
    noise = np.random.default_rng(5).normal(size=len(days)) * 3
    prices = [levels[(n >= 8) + (n >= 373)] + x for n, x in enumerate(noise)]
    rows = ["date,value", f"{days[0]},1.0", f"{days[14]},0.0", f"{days[373]},1.0"]
    folder.mkdir(exist_ok=True)
    (folder / "most.csv").write_text("\n".join(rows))
    keys = {"year_begins": "10-01", "max_daily": "most.csv", "shortfall": "strike"} | changes
    return in_days(folder, days, prices, low, volatility, keys, nested)


def in_days(folder, days, prices, low, volatility, changes, nested=()):
    """The template on these days, with a curve by the day."""
    shutil.copytree(HOME / "template_swing", folder, dirs_exist_ok=True)
    rows = [f"{day},{price!r}" for day, price in zip(days, map(float, prices))]
    (folder / "curve.csv").write_text("\n".join(["date,price", *rows]))
    keys = {
        "start": days[0],
        "end": days[-1] + datetime.timedelta(1),
        "annual": {"min": low, "max": MOST},
        "shortfall": SOFT,
    }
    settings = {f"contract.{name}": x for name, x in copy.deepcopy(keys | changes).items()}
    settings |= {"market.valuation_date": days[0], "model.volatility": volatility}
    settings |= {f"contract.{name}": x for name, x in dict(nested).items()}
    return case_at(folder, settings)


def best_plan(case, low: float, years: int = 1) -> float:
    """By integer programming, with the clauses as they are written; make-up in so many years.

    Columns: paid units of each day, whether the minimum was taken before the day, and free units
    by their age; of each year units short, units carried out of it, and whether there is an excess.
    """
    contract, price = case.contract, case.market.forward_curve.used()
    paid_on = np.exp(-0.03 * np.arange(len(price) + 1) / 365)
    active = np.flatnonzero(contract.max_daily.used())
    of_year = np.append(0, np.cumsum(contract.year_ends)[:-1])[active]
    count, last_days = len(active), np.flatnonzero(contract.year_ends)

    def number(item):
        return 0.0 if item is None else float(item.values[0])

    make, carry, big = contract.made_up is not None, number(contract.carry_max), 100.0
    size, numbers = (2 + years) * count + 3 * len(last_days), {}
    short, out, excess = ((2 + years) * count + k * len(last_days) for k in range(3))
    gain, rows, lows, highs = np.zeros(size), [], [], []
    gain[:count] = paid_on[active] * (price[active] - STRIKE)
    ages = range(1, years + 1)
    for age in ages:
        free = slice((1 + age) * count, (2 + age) * count)
        gain[free] = paid_on[active] * (price[active] - number(contract.make_up_price))

    def row(entries, least=-np.inf, most=np.inf):
        line = np.zeros(size)
        for place, value in entries:
            line[place] += value
        rows.append(line)
        lows.append(least)
        highs.append(most)

    def units(days, *kinds):
        """All units of these days, paid ones (0) or free ones by their age."""
        return [((k + 1) * count * (k > 0) + t, 1.0) for t in days for k in kinds]

    for y, last in enumerate(last_days):
        days = np.flatnonzero(of_year == y)
        before = [] if y == 0 else [(out + y - 1, 1.0)]
        brought = number(contract.carried) if y == 0 else 0.0
        # Short of the minimum, less the units carried into the year.
        row([(short + y, 1.0), *units(days, 0, *ages), *before], least=low - brought)
        row(units(days, 0, *ages), most=float(contract.annual_max.values[0]))
        # Carried out: paid units above the minimum, only where there are some.
        row([(out + y, 1.0), *((t, -1.0) for t in days), (excess + y, big)], most=big - low)
        row([(out + y, 1.0), (excess + y, -carry)], most=0.0)
        for t in days:
            row(units([t], 0, *ages), most=1.0)
            for age in ages:
                row([*units([t], age), (count + t, -1.0)], most=0.0)
            taken = units([s for s in days if s < t], 0, *ages)
            row([*taken, *before, (count + t, -low)], least=0.0 if y else -brought)
        rate = STRIKE if contract.at_strike else SOFT
        gain[short + y] = -1e4 if contract.firm else -paid_on[last + 1] * rate
    # Units short are free in the years after; -1 and -2 are those before the first.
    numbers = {-1: number(contract.made_up), -2: number(contract.older)}
    for y in range(-years, len(last_days)):
        free = [x for age in ages for x in units(np.flatnonzero(of_year == y + age), age)]
        row([*free, *([(short + y, -float(make))] if y >= 0 else [])], most=numbers.get(y, 0.0))
    whole, top = np.ones(size), np.full(size, np.inf)
    whole[short:excess] = 0
    top[: (2 + years) * count] = 1.0
    top[excess:] = 1.0
    result = milp(
        -gain,
        integrality=whole,
        bounds=Bounds(0.0, top),
        constraints=LinearConstraint(np.array(rows), lows, highs),
        options={"mip_rel_gap": 0.0},
    )
    assert result.success
    return float(-result.fun)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("levels", "changes"),
    [
        (CHEAP, MAKE_UP),
        (CHEAP, MAKE_UP | {"make_up": {"price": 0.0}}),
        (DEAR, MAKE_UP | {"make_up": {"units": 3.0}}),
        (DEAR, CARRY),
        (DEAR, CARRY | {"shortfall": "firm"}),
        (CHEAP, CARRY | {"carry_forward": {"max": 3.0, "units": 2.0}, "shortfall": "firm"}),
        (CHEAP, MAKE_UP | CARRY),
        (DEAR, MAKE_UP | CARRY),
    ],
)
def test_without_volatility_it_is_the_best_plan(levels, changes, tmp_path):
    case = two_years(tmp_path / "case", levels, **changes)
    assert exact(case) == pytest.approx(best_plan(case, 5.0), abs=1e-6)
    without = {"make_up": None, "carry_forward": None}
    assert exact(case) > exact(two_years(tmp_path / "case", levels, **changes | without)) + 0.1


@pytest.mark.prove
@pytest.mark.parametrize(
    ("levels", "changes"),
    [
        ((20.0, 27.0, 36.0), {}),
        ((20.0, 22.0, 36.0), {"make_up.price": 0.0, "annual.max": 7.0}),
        ((20.0, 30.0, 34.0), {"make_up.units": 3.0, "make_up.older_units": 2.0}),
        ((34.0, 20.0, 31.0), {"make_up.older_units": 4.0, "carry_forward.max": 2.0}),
        ((24.0, 31.0, 36.0), {"make_up.units": 2.0, "carry_forward.max": 2.0}),
    ],
)
def test_units_of_two_years_without_volatility(levels, changes, tmp_path):
    """A cheap first year, and units that are made up in the third: more than with one year."""
    case = three_years(tmp_path / "case", levels, **TWO, nested=changes)
    assert exact(case) == pytest.approx(best_plan(case, 4.0, 2), abs=1e-6)
    one = {k: v for k, v in changes.items() if "older" not in k} | {"make_up.years": 1}
    other = three_years(tmp_path / "case", levels, **TWO, nested=one)
    assert exact(other) == pytest.approx(best_plan(other, 4.0), abs=1e-6)
    assert exact(case) > exact(other) + 1.0


@pytest.mark.parametrize("changes", [MAKE_UP, CARRY, MAKE_UP | CARRY, MAKE_UP | TWO])
def test_without_a_minimum_no_clause_has_a_value(changes, tmp_path):
    make = three_years if changes.keys() == MAKE_UP.keys() and changes != MAKE_UP else two_years
    levels = DEAR if make is two_years else (34.0, 27.0, 30.0)
    values = [
        exact(make(tmp_path / "case", levels, 0.0, 0.9, **x))
        for x in (changes, {"shortfall": changes.get("shortfall", SOFT)})
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


def test_a_case_begins_with_the_balances_of_another(tmp_path):
    """The keys of a state are those of a case that begins in it."""
    case = three_years(tmp_path / "case", (20.0, 27.0, 36.0), **TWO)
    keys = case.contract.keys_at({"taken": 1.5, "bank": 3.0, "older bank": 2.0}, "", None)
    assert keys == {"taken": 1.5, "make_up.units": 3.0, "make_up.older_units": 2.0}
    other = three_years(tmp_path / "case", (20.0, 27.0, 36.0), **TWO, nested=keys)
    start = bare_problem(other).schedule.constants.start
    assert start == pytest.approx([1.5, 3.0, 2.0], abs=0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (MAKE_UP | {"shortfall": "firm"}, "shortfall: .*are paid, and made up"),
        (MAKE_UP | {"annual": None}, "make_up: .*needs an annual minimum"),
        (MAKE_UP | {"rights": {"most": 3}}, "make_up: .*rights"),
        (MAKE_UP | {"side": "put"}, "side: .*call"),
        (MAKE_UP | {"make_up": {"price": 30.0}}, "make_up.price: .*at most the strike, 29"),
        (MAKE_UP | {"make_up": {"years": 3}}, "make_up.years: .*must be 1 or 2"),
        (MAKE_UP | {"make_up": {"units": 6.0}}, "make_up.units: .*at most annual.min, 5"),
        (MAKE_UP | {"make_up": {"older_units": 1.0}}, "older_units: .*needs make_up.years = 2"),
        (
            MAKE_UP | {"make_up": {"years": 2, "older_units": 6.0}},
            "older_units: .*at most annual.min, 5",
        ),
        (CARRY | {"carry_forward": {"units": 1.0}}, "carry_forward.max"),
        (CARRY | {"carry_forward": {"max": 1.0, "units": 2.0}}, "carry_forward.units: .*at most"),
        (CARRY | {"shortfall": "firm", "max_daily": 0.4}, "annual.min: .*at most 4.4"),
        (
            MAKE_UP | {"make_up": {"units": 1.0}, "carry_forward": {"max": 1.0, "units": 1.0}},
            "make_up.units: .*either short",
        ),
    ],
)
def test_mistakes_are_named(changes, words, tmp_path):
    with pytest.raises(CaseError, match=words):
        two_years(tmp_path / "case", DEAR, **changes)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("levels", "changes"),
    [
        (CHEAP, MAKE_UP | CARRY),
        (DEAR, CARRY | {"shortfall": "firm"}),
        ((20.0, 27.0, 36.0), MAKE_UP | TWO),
    ],
)
def test_policy_and_bound_enclose_the_exact_value(levels, changes, tmp_path):
    """The fitted rule within 0.3 % of the lattice's value, the bound within 0.5 %."""
    make = two_years if len(levels) == 2 else three_years
    case = make(tmp_path / "case", levels, 5.0, 0.9, **changes)
    value, setup = exact(case), make_setup(case, Native())
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    paths = 16384 if make is two_years else 4096
    result = evaluate(problem, rule, paths=paths, engine=engine)
    size = max(abs(value), 20.0)
    assert value - 0.003 * size <= result.value + 3 * result.standard_error
    assert result.value <= value + 3 * result.standard_error
    upper = bound(
        problem, rule, relaxation=EnergyRelaxation(problem), engine=engine, paths=paths // 16
    ).upper
    assert value <= upper.value + 3 * upper.standard_error
    assert upper.value - 3 * upper.standard_error <= value + 0.005 * size
    if not case.contract.firm:
        assert wrong_derivatives(problem, rule, paths=16, engine=engine) == []
    else:
        taken = path_totals(problem, rule, 2048, engine=engine)["take"]
        assert taken.min() >= 2 * 5 - 2 - 1e-9 and taken.max() <= 2 * MOST + 1e-9
