"""Swing contracts against the exact numbers of D3 and D4 (shared/cases/desk.md)."""

import datetime
import functools
import math
import shutil

import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.energy.energy_cases import HOME, case_at, exact, swing

from snapo.case.error import CaseError
from snapo.domains.energy.methods.grid import grid_of
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.setup import bare_problem, make_setup
from snapo.domains.energy.summary import lines
from snapo.problem.policy import Policy
from snapo.solver.bound import bound
from snapo.solver.derivatives.interval import one_percent
from snapo.solver.evaluate import evaluate, path_totals

FIRM = {"shortfall": "firm"}


def limits(low, high):
    return {"annual": {"min": float(low), "max": float(high)}}


@pytest.mark.prove
@pytest.mark.parametrize(
    ("changes", "value", "error"),
    [
        (FIRM, 806.14, 0.03),
        ({}, 818.17, 0.04),
        (FIRM | limits(199, 300), 808.58, 0.03),
        (FIRM | limits(201, 300), 803.66, 0.03),
        (FIRM | limits(200, 299), 806.11, 0.03),
        (FIRM | limits(200, 301), 806.16, 0.03),
        (FIRM | limits(250, 250), 617.53, 0.03),
    ],
)
def test_take_or_pay(changes, value, error):
    """D3: "exact" with the errors given there."""
    assert exact(swing(**changes)) == pytest.approx(value, abs=error)


@pytest.mark.prove
@pytest.mark.parametrize(("changes", "slope"), [(FIRM, -213.94), ({}, -206.86)])
def test_the_derivative_by_strike(changes, slope):
    """D3, central differences good to 0.2 %."""
    up, down = (exact(swing(strike=29 + x, **changes)) for x in (0.1, -0.1))
    assert (up - down) / 0.2 == pytest.approx(slope, rel=4e-3)


def test_no_annual_limits():
    """D3: one option a day, 929.04."""
    assert exact(swing(annual=None)) == pytest.approx(929.04, abs=0.03)


def test_volumes_off_a_grid_are_breakpoints():
    """A start of 1/3 and a limit of 7 1/7 at forward prices: the first days, then the rest."""
    changes = {"taken": 1 / 3, "annual": {"min": 0.0, "max": 7 + 1 / 7}}
    changes |= {"end": datetime.date(2026, 11, 1)}
    case = swing(**changes, max_daily=1.0, strike=27.0)
    problem = bare_problem(case)
    assert grid_of(case.contract.layout, problem.schedule).exact
    discount = np.exp(-0.03 * np.arange(31) / 365)
    best = np.sort(discount * (28 - 27.0))[::-1]
    room = 7 + 1 / 7 - 1 / 3
    plan = best[: int(room)].sum() + (room - int(room)) * best[int(room)]
    assert exact(case, forward=True) == pytest.approx(plan, abs=1e-9)


def test_a_minimum_that_cannot_be_met_is_refused():
    with pytest.raises(CaseError, match="no decisions can meet"):
        lines(swing(**FIRM, annual={"min": 366.0, "max": 400.0}))


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"shortfall": "soft"}, "shortfall"),
        ({"annual": {"min": 30.0, "max": 20.0}}, "annual.min"),
        ({"min_daily": 2.0}, "min_daily"),
        ({"year_begins": "13-45"}, "year_begins"),
        ({"year_begins": "W05"}, "year_begins"),
        ({"rights": {"most": 0}}, "rights.most"),
        ({"rights": {"most": 3}, "shortfall": "firm"}, "annual.min: .*at most 3"),
        (FIRM | {"rights": {"most": 300}, "year_begins": "04-01"}, "shortfall: .*several"),
    ],
)
def test_mistakes_are_named(changes, where):
    with pytest.raises(CaseError, match=where):
        swing(**changes)


def short(**changes):
    """The first 24 days, between 6 and 12 units."""
    settings = {
        "contract.end": datetime.date(2026, 10, 25),
        "contract.annual": {"min": 6.0, "max": 12.0},
        "training.steps": 0,
        "evaluation.paths": 4096,
    }
    return case_at(HOME / "template_swing", settings | changes)


@pytest.mark.prove
def test_policy_and_bound_enclose_the_exact_value():
    """The fitted rule is below the exact value by 0.3 % at most, the bound above by 0.5 %."""
    case = short()
    setup, value = make_setup(case), exact(case)
    engine = setup.engines.evaluate
    rule = evaluate(setup.problem, setup.policy.value_rule, paths=4096, engine=engine)
    assert value * 0.997 <= rule.value + 3 * rule.standard_error
    assert rule.value <= value + 3 * rule.standard_error
    result = bound(
        setup.problem,
        setup.policy.value_rule,
        relaxation=EnergyRelaxation(setup.problem),
        engine=engine,
        paths=1024,
    )
    error = 3 * result.upper.standard_error
    assert value - error <= result.upper.value <= 1.005 * value + error


@pytest.mark.prove
def test_rights_with_rest_by_brute_force():
    """Two rights with two days of rest at forward prices: the best pair of days."""
    case = case_at(
        HOME / "template_swing",
        {
            "contract.end": datetime.date(2026, 11, 8),
            "contract.annual": None,
            "contract.shortfall": None,
            "contract.strike": 27.0,
            "contract.rights": {"most": 2, "rest": 2},
        },
    )
    count = len(case.days)
    gain = case.market.forward_curve.used() - 27.0
    gain = gain * np.exp(-0.03 * np.arange(count) / 365)
    best = max(gain[i] + gain[j] for i in range(count) for j in range(i + 3, count))
    assert exact(case, forward=True) == pytest.approx(best, abs=1e-9)
    setup = make_setup(case)
    rule = evaluate(
        setup.problem, setup.policy.value_rule, paths=16384, engine=setup.engines.evaluate
    )
    value = exact(case)
    assert 0.99 * value <= rule.value + 3 * rule.standard_error
    assert rule.value <= value + 3 * rule.standard_error


def firm_with_rights(low, high, most, rest, **changes):
    """33 days of at most 2 units, between two numbers of units, both firm."""
    more = {"annual": {"min": float(low), "max": float(high)}}
    more |= {"rights": {"most": most, "rest": rest}} if most else {}
    end = datetime.date(2026, 11, 3)
    return swing(**FIRM, end=end, max_daily=2.0, **more | changes)


def best_uses(case, low, high, most, rest) -> float:
    """Every plan of whole units at forward prices."""
    forward = case.market.forward_curve.used()
    gain = np.exp(-0.03 * np.arange(len(forward)) / 365) * (forward - 33.0)

    @functools.cache
    def best(t, wait, taken, used):
        if t == len(gain):
            return 0.0 if low <= taken <= high else -np.inf
        plans = [best(t + 1, max(wait - 1, 0), taken, used)]
        if wait == 0 and used < most:
            plans += [q * gain[t] + best(t + 1, rest, taken + q, used + 1) for q in range(3)]
        return max(plans)

    return best(0, 0, 0, 0)


@pytest.mark.parametrize("limits", [(9, 11, 6, 0), (9, 11, 6, 2), (17, 18, 9, 3), (20, 20, 11, 2)])
def test_a_firm_minimum_with_rights(limits):
    """At forward prices, where every unit loses: the best of all plans."""
    case = firm_with_rights(*limits, strike=33.0)
    assert exact(case, forward=True) == pytest.approx(best_uses(case, *limits), rel=1e-9)


@pytest.mark.prove
def test_as_many_rights_as_days_are_no_limit():
    values = [exact(firm_with_rights(20, 30, most, 0), finer=1) for most in (0, 33)]
    assert values[1] == pytest.approx(values[0], rel=1e-9)


class Waits(Policy):
    """Never uses a right by itself: shares, then weights of wait, use, and two days of rest."""

    def __call__(self, observation, smooth=None):
        return jnp.array([0.0, 1.0, 0.0, 1.0, 1.0])


class Uses(Policy):
    """Always uses one, and takes all that it may."""

    def __call__(self, observation, smooth=None):
        return jnp.array([1.0, 0.0, 1.0, 1.0, 1.0])


@pytest.mark.prove
def test_a_firm_minimum_with_rights_is_met_on_every_path():
    """By the fitted rule, and by others that never and always use a right; the first is within 0.3 % of the exact value."""
    case = firm_with_rights(10, 14, 7, 2)
    setup, value = make_setup(case, "native"), exact(case)
    engine, rule = setup.engines.evaluate, setup.policy.value_rule
    result = evaluate(setup.problem, rule, paths=16384, engine=engine)
    assert value * 0.997 <= result.value + 3 * result.standard_error
    assert result.value <= value + 3 * result.standard_error
    for policy in (rule, Waits(), Uses()):
        taken = path_totals(setup.problem, policy, 2048, engine=engine)["take"]
        assert taken.min() > 10 - 1e-9 and taken.max() < 14 + 1e-9


@pytest.mark.prove
def test_contract_years_add_up():
    """Two halves of a year, each with its limits; 10 units were taken before the first."""
    halves = {"annual": {"min": 80.0, "max": 120.0}}
    both = exact(swing(year_begins="04-01", taken=10.0, **FIRM, **halves), finer=1)
    first = {"annual": {"min": 70.0, "max": 110.0}, "end": datetime.date(2027, 4, 1)}
    parts = [first, halves | {"start": datetime.date(2027, 4, 1)}]
    assert both == pytest.approx(sum(exact(swing(**FIRM, **x), finer=1) for x in parts), rel=1e-8)


def bermudan(folder, rights):
    """D4: puts struck at 40 on 50 dates of a year, here days with rates and volatility to match."""
    shutil.copytree(HOME / "template_swing", folder)
    days = [datetime.date(2026, 10, 1) + datetime.timedelta(n) for n in range(1, 51)]
    rows = [f"{day},{40 * math.exp(0.06 * n / 50)!r}" for n, day in enumerate(days, 1)]
    (folder / "curve.csv").write_text("\n".join(["date,price", *rows]))
    settings = {
        "contract.start": days[0],
        "contract.end": days[-1] + datetime.timedelta(1),
        "contract.side": "put",
        "contract.strike": 40.0,
        "contract.annual": None,
        "contract.shortfall": None,
        "contract.rights": rights,
        "market.interest_rate": 0.06 * 365 / 50,
        "model.mean_reversion": 0.0,
        "model.volatility": 0.2 * math.sqrt(365 / 50),
    }
    return case_at(folder, settings)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("rights", "value"),
    [
        ({"most": 1}, 2.31407),
        ({"most": 2}, 4.60443),
        ({"most": 5}, 11.33102),
        ({"most": 50}, 78.72618),
        ({"most": 2, "rest": 4}, 4.50935),
        ({"most": 5, "rest": 4}, 10.31617),
    ],
)
def test_rights_of_a_bermudan_put(rights, value, tmp_path):
    """D4, exact."""
    result = exact(bermudan(tmp_path / "case", rights), finer=4)
    assert result == pytest.approx(value, rel=2e-4)


@pytest.mark.prove
def test_policy_and_bound_of_three_rights_with_rest(tmp_path):
    """D4: the fitted rule within 0.4 % of the exact value, the bound within 1 %."""
    setup, value = make_setup(bermudan(tmp_path / "case", {"most": 3, "rest": 4})), 6.57977
    problem, policy, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    rule = evaluate(problem, policy, paths=65536, engine=engine)
    assert 0.996 * value <= rule.value + 3 * rule.standard_error
    assert rule.value <= value + 3 * rule.standard_error
    relaxation = EnergyRelaxation(problem)
    upper = bound(problem, policy, relaxation=relaxation, engine=engine, paths=1024).upper
    assert value - 3 * upper.standard_error <= upper.value <= 1.01 * value


def test_no_file_of_the_core_names_a_contract():
    """Core, methods and chapters read levels, modes, moves and cash alone."""
    for folder in ("core", "methods", "chapters", "explain"):
        for file in (HOME / folder).glob("*.py"):
            text = file.read_text().lower()
            for name in ("swing", "battery", "plant", "strike", "discharge", "park", "loan"):
                assert name not in text, f"{file.name} names {name}"


def test_years_end_on_their_day():
    case = swing(year_begins="04-01")
    ends = np.flatnonzero(case.contract.year_ends)
    assert [case.days[t].isoformat() for t in ends] == ["2027-03-31", "2027-09-30"]


@pytest.mark.prove
def test_a_large_shift_is_the_normal_price():
    """Negative prices in the contract core: the lattice, the rule of the fitted value, the bound."""
    reversion = {"model.mean_reversion": 12.0}
    normal = {"model.kind": "one-factor-normal", "model.volatility": 30.0}
    shifted = {"model.kind": "one-factor-shifted", "model.volatility": 3e-4, "model.shift": 1e5}
    cases = [case_at(HOME / "template_swing", reversion | x) for x in (normal, shifted)]
    values = [exact(case, finer=1) for case in cases]
    assert abs(values[1] - values[0]) < 1e-3 * values[0]
    made = make_setup(cases[0], "native")
    found = bound(
        made.problem,
        made.policy.value_rule,
        relaxation=EnergyRelaxation(made.problem),
        paths=1024,
        engine=made.engines.evaluate,
    )
    assert 0.995 * values[0] < found.lower.value < values[0] + 3 * found.lower.standard_error
    assert values[0] - 3 * found.upper.standard_error < found.upper.value < 1.005 * values[0]


@pytest.mark.prove
def test_spikes_in_rule_and_bound():
    """The methods of the core in factor and spike, around the lattice."""
    model = {
        "kind": "one-factor-poisson-jumps",
        "jump_intensity": 20.0,
        "jump_size": 0.35,
        "jump_mean_reversion": 120.0,
    }
    changes = {f"model.{name}": value for name, value in model.items()} | {
        "contract.end": datetime.date(2026, 10, 31),
        "contract.annual": {"min": 5.0, "max": 10.0},
    }
    case = case_at(HOME / "template_swing", changes)
    made, value = make_setup(case, "native"), exact(case, finer=1)
    assert made.problem.simulator.control_variates() == ("value_surprise",)
    found = bound(
        made.problem,
        made.policy.value_rule,
        relaxation=EnergyRelaxation(made.problem),
        paths=1024,
        engine=made.engines.evaluate,
    )
    errors = [3 * x.standard_error for x in (found.lower, found.upper)]
    assert 0.99 * value < found.lower.value < value + errors[0]
    assert value - errors[1] < found.upper.value < 1.008 * value + errors[1]


@pytest.mark.parametrize("begins", [None, "02-29"])
def test_a_year_that_begins_on_29_february_begins_every_year(begins, tmp_path):
    """On 1 March where there is no such day: annual limits would else be those of the whole term."""
    shutil.copytree(HOME / "template_swing", tmp_path, dirs_exist_ok=True)
    months = [f"{year}-{month:02d},30" for year in range(2028, 2034) for month in range(1, 13)]
    (tmp_path / "curve.csv").write_text("\n".join(["date,price", *months]))
    first, end = datetime.date(2028, 2, 29), datetime.date(2033, 3, 1)
    case = case_at(tmp_path, {"contract.start": first, "contract.end": end,
                              "contract.year_begins": begins, "market.valuation_date": first})  # fmt: skip
    ends = [case.days[t] for t in np.flatnonzero(case.contract.year_ends)]
    assert ends == [
        *(datetime.date(year, 2, 28) for year in (2029, 2030, 2031, 2032)), case.days[-1]
    ]  # fmt: skip


def test_the_derivative_with_respect_to_a_minimum_of_zero_is_tested():
    """Its bump was zero, and the held derivative had the wrong sign: 5.7 ± 4.7, exact -24.3 for more and 0
    for less."""
    values = swing().inputs()["min_daily"]
    assert not values.value.any() and one_percent(values).all()
