"""Make-up and carry-forward of a swing contract, against an integer program of all its days."""

import datetime
import shutil

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp
from tests.domains.energy.energy_cases import HOME, case_at, exact

from snapo.case.error import CaseError
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.setup import make_setup
from snapo.solver.bound import bound
from snapo.solver.evaluate import evaluate, path_totals
from snapo.testing.derivatives import wrong_derivatives

START, SECOND, END = (datetime.date(2026, *x) for x in ((9, 20), (10, 1), (10, 13)))
STRIKE, MOST, SOFT = 29.0, 8.0, 4.0
MAKE_UP = {"make_up": {"years": 1, "price": 3.0}, "shortfall": "strike"}
CARRY = {"carry_forward": {"years": 1, "max": 2.0}}
CHEAP, DEAR = (22.0, 34.0), (34.0, 27.0)  # prices of the two contract years, about


def two_years(folder, levels, low=5.0, volatility=0.0, **changes):
    """11 days and 12 days around the first of October, at most one unit a day and 8 a year."""
    shutil.copytree(HOME / "template_swing", folder, dirs_exist_ok=True)
    days = [START + datetime.timedelta(n) for n in range((END - START).days)]
    noise = np.random.default_rng(3).normal(size=len(days)) * 3
    prices = [levels[day >= SECOND] + x for day, x in zip(days, noise)]
    rows = [f"{day},{price!r}" for day, price in zip(days, map(float, prices))]
    (folder / "curve.csv").write_text("\n".join(["date,price", *rows]))
    keys = {
        "start": START,
        "end": END,
        "year_begins": "10-01",
        "annual": {"min": low, "max": MOST},
        "shortfall": SOFT,
    }
    settings = {f"contract.{name}": x for name, x in (keys | changes).items()}
    settings |= {"market.valuation_date": START, "model.volatility": volatility}
    return case_at(folder, settings)


def best_plan(case, low: float) -> float:
    """By integer programming, with the clauses as they are written.

    Columns: paid and free units of each day, whether the minimum was taken before the day, and of
    each year units short, units carried out of it, and whether there is an excess.
    """
    contract, price = case.contract, case.market.forward_curve.used()
    count = len(price)
    paid_on = np.exp(-0.03 * np.arange(count + 1) / 365)
    second = (SECOND - START).days
    years = [range(second), range(second, count)]

    def number(item):
        return 0.0 if item is None else float(item.values[0])

    make, carry, big = contract.made_up is not None, number(contract.carry_max), 100.0
    free_price = number(contract.make_up_price)
    brought = [number(contract.made_up), number(contract.carried)]
    size = 3 * count + 6
    paid, free, done = (slice(k * count, (k + 1) * count) for k in range(3))
    short, out, excess = (3 * count + 2 * k for k in range(3))
    gain, rows, lows, highs = np.zeros(size), [], [], []
    gain[paid] = paid_on[:-1] * (price - STRIKE)
    gain[free] = paid_on[:-1] * (price - free_price)

    def row(entries, least=-np.inf, most=np.inf):
        line = np.zeros(size)
        for place, value in entries:
            line[place] += value
        rows.append(line)
        lows.append(least)
        highs.append(most)

    for y, days in enumerate(years):
        every = [(t, 1.0) for t in days] + [(count + t, 1.0) for t in days]
        own = [(short + y, 1.0), *every]
        before = [] if y == 0 else [(out, 1.0)]
        # Short of the minimum, less the units carried into the year.
        row(own + before, least=low - (brought[1] if y == 0 else 0.0))
        row(every, most=MOST)
        free_units = [(count + t, 1.0) for t in days]
        if y == 0:
            row(free_units, most=brought[0])
        else:
            row([*free_units, (short, -float(make))], most=0.0)
        # Carried out: paid units above the minimum, only where there are some.
        row([(out + y, 1.0), *((t, -1.0) for t in days), (excess + y, big)], most=big - low)
        row([(out + y, 1.0), (excess + y, -carry)], most=0.0)
        for t in days:
            row([(t, 1.0), (count + t, 1.0)], most=1.0)
            row([(count + t, 1.0), (2 * count + t, -1.0)], most=0.0)
            taken = [(s, 1.0) for s in days if s < t] + [(count + s, 1.0) for s in days if s < t]
            row([*taken, *[(p, v) for p, v in before], (2 * count + t, -low)], least=0.0)
        last = days[-1]
        rate = STRIKE if contract.at_strike else SOFT
        gain[short + y] = -1e4 if contract.firm else -paid_on[last + 1] * rate
    whole = np.zeros(size)
    whole[done], whole[excess : excess + 2] = 1, 1
    whole[paid], whole[free] = 1, 1
    top = np.full(size, np.inf)
    top[: 3 * count], top[excess : excess + 2] = 1.0, 1.0
    found = milp(
        -gain,
        integrality=whole,
        bounds=Bounds(0.0, top),
        constraints=LinearConstraint(np.array(rows), lows, highs),
        options={"mip_rel_gap": 0.0},
    )
    assert found.success
    return float(-found.fun)


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


@pytest.mark.parametrize("changes", [MAKE_UP, CARRY, MAKE_UP | CARRY])
def test_without_a_minimum_no_clause_has_a_value(changes, tmp_path):
    values = [
        exact(two_years(tmp_path / "case", DEAR, 0.0, 0.9, **x))
        for x in (changes, {"shortfall": changes.get("shortfall", SOFT)})
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (MAKE_UP | {"shortfall": "firm"}, "shortfall: .*are paid, and made up"),
        (MAKE_UP | {"annual": None}, "make_up: .*needs a minimum"),
        (MAKE_UP | {"rights": {"most": 3}}, "make_up: .*rights"),
        (MAKE_UP | {"side": "put"}, "side: .*call"),
        (MAKE_UP | {"make_up": {"price": 30.0}}, "make_up.price: .*at most the strike, 29"),
        (MAKE_UP | {"make_up": {"years": 2}}, "make_up.years: .*allowed is 1"),
        (MAKE_UP | {"make_up": {"units": 6.0}}, "make_up.units: .*at most annual.min, 5"),
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
    [(CHEAP, MAKE_UP | CARRY), (DEAR, CARRY | {"shortfall": "firm"})],
)
def test_policy_and_bound_enclose_the_exact_value(levels, changes, tmp_path):
    """The fitted rule within 0.3 % of the lattice's value, the bound within 0.5 %."""
    case = two_years(tmp_path / "case", levels, 5.0, 0.9, **changes)
    value, setup = exact(case), make_setup(case, "native")
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    result = evaluate(problem, rule, paths=16384, engine=engine)
    size = max(abs(value), 20.0)
    assert value - 0.003 * size <= result.value + 3 * result.standard_error
    assert result.value <= value + 3 * result.standard_error
    upper = bound(
        problem, rule, relaxation=EnergyRelaxation(problem), engine=engine, paths=1024
    ).upper
    assert value <= upper.value + 3 * upper.standard_error
    assert upper.value - 3 * upper.standard_error <= value + 0.005 * size
    if not case.contract.firm:
        assert wrong_derivatives(problem, rule, paths=16) == []
    else:
        taken = path_totals(problem, rule, 2048, engine=engine)["take"]
        assert taken.min() >= 2 * 5 - 2 - 1e-9 and taken.max() <= 2 * MOST + 1e-9
