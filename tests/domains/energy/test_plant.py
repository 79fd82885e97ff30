"""A power plant against the exact numbers of D9 (shared/cases/desk.md) and QuantLib's vpp.cpp."""

import datetime
import itertools
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from tests.domains.energy.energy_cases import HOME, case_at, exact, plant

from snapo.case.error import CaseError
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.methods.lattice import lattice, refined
from snapo.domains.energy.setup import bare_problem, factors_of, make_setup
from snapo.engine.native import Native
from snapo.solver.bound import bound
from snapo.solver.evaluate import evaluate
from snapo.solver.sensitivity import sensitivities
from snapo.testing.derivatives import wrong_derivatives

VPP = Path(__file__).parent / "vpp"
D9 = {"model.power.volatility": 0.12 * 8760**0.5}
# The strip of exchange options of D9: no start costs, no minimum times.
STRIP = {
    "contract.starts": [],
    "contract.min_up": 1,
    "contract.min_down": 1,
    "contract.power": {"min": 0.0, "max": 110.0},
    "contract.fuel": {"per_mwh": 2.0},
    "contract.emission": None,
    "contract.other_cost": 0.0,
}
LATE = [{"off": 1, "money": 2500.0, "fuel": 60.0}, {"off": 12, "money": 5200.0, "fuel": 140.0}]
EXACT, STRIP_VALUE = 84014.0, 363520.474


def d9(**changes):
    """D9, with changed keys."""
    return case_at(HOME / "template_plant", D9 | changes)


@pytest.mark.parametrize(
    ("efficiency", "off", "free"),
    [
        (0.35, 0.0, 0.0),
        (0.40, 2056.04, 2056.04),
        (0.45, 11145.577778, 11145.577778),
        (0.50, 26452.04, 26452.04),
        (0.55, 44409.952727, 44512.461818),
        (0.60, 61695.693333, 62000.626667),
        (0.90, 137017.111111, 137591.911111),
    ],
)
def test_published_values_at_forward_prices(efficiency, off, free):
    """QuantLib, test-suite/vpp.cpp; `free`: the better of off and of on before the first hour."""
    fuel = {"contract.fuel": {"per_mwh": 1.0 / efficiency}}
    before = [{"contract.before": x} for x in ({"off": 2}, {"on": 2})]
    values = [exact(case_at(VPP, fuel | x), forward=True) for x in before]
    assert values[0] == pytest.approx(off, abs=1e-6)
    assert max(values) == pytest.approx(free, abs=1e-6)


def test_forward_prices():
    """D9: it never runs."""
    assert exact(d9(), forward=True) == 0.0


@pytest.mark.prove
def test_a_week():
    """D9, good to 0.6; the lattice has an error of its own."""
    case = d9()
    problem = bare_problem(case)
    result = refined(case.contract.layout, problem.schedule, factors_of(problem))
    assert result.error < 2e-4 * EXACT
    assert result.value == pytest.approx(EXACT, abs=0.6 + result.error)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("changes", "value", "error"),
    [
        ({"contract.starts": [{"off": 3, "money": 2500.0, "fuel": 60.0}]}, 98057.0, 1.0),
        ({"contract.starts": LATE, "contract.min_up": 1, "contract.min_down": 1}, 89977.0, 1.0),
        ({"contract.starts": []}, 121902.0, 1.0),
        (STRIP, STRIP_VALUE, 0.0),
    ],
)
def test_other_plants(changes, value, error):
    """D9, with the errors given there; 33 nodes of gas are within 0.002 %."""
    case = d9(**changes)
    problem = bare_problem(case)
    result = lattice(case.contract.layout, problem.schedule, factors_of(problem), slow=33).value
    assert result == pytest.approx(value, abs=error, rel=2e-5)


def by_hand(power, gas, min_up, min_down, starts, before, most):
    """The best of all sequences of on and off at these prices, one by one."""
    least, volume, idle, rate, price, other = 50.0, 110.0, 45.0, 1.6, 14.0, 1.5
    fuel = gas + price
    best = -np.inf
    for plan in itertools.product((False, True), repeat=len(power)):
        on, hours, money, count = *before, 0.0, 0
        for hour, running in enumerate(plan):
            if running != on:
                if hours < (min_up if on else min_down):
                    break
                if running:
                    (_, cost, burnt) = [x for x in starts if x[0] <= hours][-1]
                    money, count = money - cost - burnt * fuel[hour], count + 1
                on, hours = running, 0
            hours += 1
            if running:
                unit = power[hour] - rate * fuel[hour] - other
                money += (volume if unit > 0 else least) * unit - idle * fuel[hour]
        else:
            best = max(best, money) if count <= most else best
    return best


@pytest.mark.parametrize("most", [None, 1])
@pytest.mark.parametrize(("before", "state"), [({"off": 4}, (False, 4)), ({"on": 1}, (True, 1))])
def test_all_plans_of_twelve_hours(before, state, most, tmp_path):
    """At forward prices that rise and fall, against every plan of on and off."""
    power = np.array([20.0, 95, 95, 20, 20, 100, 70, 130, 20, 10, 120, 120])
    gas = np.full(12, 30.0)
    folder = shutil.copytree(HOME / "template_plant", tmp_path / "case")
    rows = [f"2026-01-05T{h:02d}:00,{x}" for h, x in enumerate(power)]
    (folder / "power.csv").write_text("\n".join(["time,price", *rows]))
    (folder / "gas.csv").write_text("date,price\n2026-01-05,30")
    starts = [(2, 100.0, 1.0), (4, 900.0, 12.0)]
    changes = {
        "contract.end": datetime.datetime(2026, 1, 5, 12),
        "contract.starts": [dict(zip(("off", "money", "fuel"), x)) for x in starts],
        "contract.min_up": 2,
        "contract.min_down": 2,
        "contract.most_starts": most,
        "contract.before": before,
    }
    case = case_at(folder, changes)
    assert len(case.contract.layout.levels) == (most is not None)
    best = by_hand(power, gas, 2, 2, starts, state, most or 99)
    assert best > 0 or state[0]
    assert exact(case, forward=True) == pytest.approx(best, rel=1e-12)


def test_numbers_have_units_and_labels():
    inputs = plant(emission={"per_fuel": 0.2, "price": 70.0}).inputs()
    units = {name: inputs[name].unit for name in ("start_money", "emission_price", "other_cost")}
    assert units == {"start_money": "EUR", "emission_price": "EUR", "other_cost": "EUR/MWh"}
    assert inputs["start_fuel"].labels == ("3 hours off", "12 hours off")
    assert inputs["gas_curve"].value.shape == (7,) and inputs["power_curve"].value.shape == (168,)


def test_more_starts_than_there_can_be_are_no_limit():
    assert plant(most_starts=200).contract.layout == plant().contract.layout


@pytest.mark.prove
def test_policy_and_bound_enclose_the_exact_value():
    """D9: the fitted rule at most 0.5 % below 84,014, the bound at most 1 % above."""
    setup = make_setup(d9(), "native")
    problem, policy, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    rule = evaluate(problem, policy, paths=16384, engine=engine)
    assert rule.standard_error < 0.005 * EXACT / 3
    assert 0.995 * EXACT <= rule.value <= EXACT + 0.6 + 3 * rule.standard_error
    relaxation = EnergyRelaxation(problem)
    result = bound(problem, policy, relaxation=relaxation, engine=engine, paths=1024)
    assert result.upper.value + 3 * result.upper.standard_error >= EXACT
    assert result.upper.value - 3 * result.upper.standard_error <= 1.01 * EXACT
    assert 0 < result.upper.value - result.lower.value < 0.01 * EXACT


@pytest.mark.prove
def test_strip_of_exchange_options():
    """D9, Margrabe: 363,520.474, by power 12,680.109, by gas -21,889.380, by correlation
    -11,945.55, with the rule and its decisions held fixed."""
    setup = make_setup(d9(**STRIP), Native())
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    value = evaluate(problem, rule, paths=16384, engine=engine)
    assert abs(value.value - STRIP_VALUE) < 2 * value.standard_error
    held = sensitivities(problem, rule, paths=16384, engine=engine).held
    for name, slope in (
        ("power_curve", 12680.109),
        ("gas_curve", -21889.380),
        ("correlation", -11945.55),
    ):
        blocks = held[name].blocks
        sums = blocks.reshape(len(blocks), -1).sum(axis=1)
        assert abs(sums.mean() - slope) < 2 * sums.std(ddof=1) / len(sums) ** 0.5


@pytest.mark.prove
def test_strip_valued_earlier_and_with_rates():
    """Margrabe's formula for every hour, three days before the first one."""
    earlier = datetime.date(2026, 1, 2)
    case = d9(**STRIP, **{"market.valuation_date": earlier, "market.interest_rate": 0.5})
    time = np.arange(72, 240) / 8760
    power, gas = case.market.forward_curve.used(), 2.0 * case.model.second_curve.used()
    rates, volatilities = np.array([525.6, 20.0]), np.array([D9["model.power.volatility"], 0.6])
    pair = rates[:, None] + rates
    part = np.outer(volatilities, volatilities) * np.array([[1.0, -0.4], [-0.4, 1.0]])
    deviation = np.sqrt(np.sum(part / pair * (1 - np.exp(-np.multiply.outer(time, pair))), (1, 2)))
    d = np.log(power / gas) / deviation + deviation / 2
    paid = np.exp(-0.5 * np.array([(day - earlier).days for day in case.days]) / 365)
    value = 110.0 * np.sum(paid * (power * norm.cdf(d) - gas * norm.cdf(d - deviation)))
    problem = bare_problem(case)
    exact_value = lattice(case.contract.layout, problem.schedule, factors_of(problem), slow=33)
    assert exact_value.value == pytest.approx(value, rel=2e-6)


def test_no_file_of_core_and_methods_names_a_contract():
    files = [*(HOME / "core").glob("*.py"), *(HOME / "methods").glob("*.py")]
    words = re.compile(r"\b(swing|battery|batteries|plant)s?\b", re.IGNORECASE)
    assert len(files) > 10
    assert [file.name for file in files if words.search(file.read_text())] == []


@pytest.mark.prove
def test_every_derivative_is_that_of_differences():
    """Eight hours with two classes of starts, with decisions held fixed."""
    end = datetime.datetime(2026, 1, 5, 8)
    starts = [{"off": 1, "money": 250.0, "fuel": 6.0}, {"off": 2, "money": 520.0, "fuel": 14.0}]
    case = plant(end=end, min_up=1, min_down=1, before={"off": 2}, most_starts=2, starts=starts)
    setup = make_setup(case, Native())
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    assert wrong_derivatives(problem, rule, paths=16, engine=engine) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"contract.power": {"min": 120.0, "max": 110.0}}, "power.min.*at most power.max, 110"),
        ({"contract.power": {"market": "heat", "max": 110.0}}, "power.market"),
        ({"contract.starts": [{"off": 4}]}, "starts.1.off.*min_down = 3"),
        ({"contract.starts": [{"off": 3}, {"off": 3}]}, "starts.2.off.*more than"),
        ({"contract.starts": [{"money": 3.0}]}, "starts.1.off"),
        ({"contract.before": {"on": 2, "off": 2}}, "before.*not both"),
        ({"contract.min_up": 0}, "min_up"),
        ({"model.correlation": [["power", "coal", 0.4]]}, "model.correlation"),
        ({"model.correlation": [["power", "gas", 1.0]]}, "model.correlation.*between -1 and 1"),
        ({"model.power": {"kind": "regimes"}}, "model.power.kind"),
        ({"market.gas": None}, "market.gas"),
        ({"market.power": {"forward_curve": "none.csv"}}, "none.csv"),
    ],
)
def test_mistakes_are_named(changes, words):
    with pytest.raises(CaseError, match=words):
        case_at(HOME / "template_plant", changes)


def test_prices_of_gas_are_needed_for_every_day(tmp_path):
    folder = shutil.copytree(HOME / "template_plant", tmp_path / "case")
    rows = (folder / "gas.csv").read_text().splitlines()
    (folder / "gas.csv").write_text("\n".join(rows[:-1]))
    with pytest.raises(CaseError, match=r"gas.csv.*2026-01-11"):
        case_at(folder, {})
    (folder / "gas.csv").write_text("\n".join([*rows[:-1], "2026-01-11,-1.0"]))
    with pytest.raises(CaseError, match="above 0"):
        case_at(folder, {})
