"""A battery by the hour against the exact numbers of D5 (shared/cases/desk.md)."""

import datetime
import shutil

import numpy as np
import pytest
from tests.domains.energy.energy_cases import HOME, battery, best_plan, case_at, exact

from snapo.case.error import CaseError
from snapo.domains.energy.methods.grid import grid_of
from snapo.domains.energy.methods.intrinsic import intrinsic_value
from snapo.domains.energy.methods.lattice import refined
from snapo.domains.energy.read.hours import hours_of
from snapo.domains.energy.setup import bare_problem, factors_of
from snapo.solver.derivatives.interval import one_percent

HOURS = [f"2026-05-04T{hour:02d}:00" for hour in range(6)]


def test_forward_prices():
    """D5, deterministic: 1,084.480."""
    assert exact(battery(), forward=True) == pytest.approx(1084.480, abs=5e-4)


@pytest.mark.parametrize(
    ("changes", "value", "error"),
    [
        pytest.param({}, 1151.74, 0.03, marks=pytest.mark.prove),
        pytest.param({"cycles": {"day": 0.5}}, 717.58, 0.05, marks=pytest.mark.study),
        pytest.param({"cycles": {"day": 1.5}}, 1317.03, 0.05, marks=pytest.mark.study),
        pytest.param({"cycles": {"day": 2.0}}, 1348.81, 0.05, marks=pytest.mark.prove),
        pytest.param({"wear": 0.0}, 1235.76, 0.05, marks=pytest.mark.study),
    ],
)
def test_a_week(changes, value, error):
    """D5, exact with the errors given there; the lattice has one of its own."""
    case = battery(**changes)
    problem = bare_problem(case)
    result = refined(case.contract.layout, problem.schedule, factors_of(problem))
    assert result.error < 0.01
    assert result.value == pytest.approx(value, abs=error + result.error)


@pytest.mark.parametrize(
    "changes",
    [{"cycles": {"day": 0.99}}, {"cycles": {"day": 1.013}}, {"cycles": {"term": 1.73}},
     {"energy": 4.04}, {"charge": {"power": 1.013, "efficiency": 0.9}}],
)  # fmt: skip
def test_limits_between_nodes_are_reached(changes):
    """Two days at forward prices: a linear program, less what is lost between nodes."""
    case = battery(end=datetime.datetime(2026, 5, 6), **changes)
    plan, value = best_plan(case), exact(case, forward=True)
    assert 0.997 * plan <= value <= plan * (1 + 1e-12)


@pytest.mark.prove
def test_cycles_of_each_day_and_of_the_term():
    """Three days at forward prices, a cycle a day and 2.5 in all: a linear program within 0.5 %."""
    end, both = datetime.datetime(2026, 5, 7), {"day": 1.0, "term": 2.5}
    case = battery(end=end, cycles=both)
    plan, value = best_plan(case), exact(case, forward=True)
    assert 0.995 * plan <= value <= plan * (1 + 1e-12)
    assert plan <= min(best_plan(battery(end=end, cycles={name: x})) for name, x in both.items())
    problem = bare_problem(case)
    with pytest.raises(ValueError, match="three levels"):
        refined(case.contract.layout, problem.schedule, factors_of(problem))


@pytest.mark.prove
@pytest.mark.parametrize(
    "cycles", [{"day": 1.0, "term": 2.0}, {"day": 1.0, "term": 90.0}, {"day": 5.0, "term": 1.0}]
)
def test_a_limit_that_another_one_implies_needs_no_nodes(cycles):
    """30 hours in two days: the other limit alone, on the nodes of two levels. With those of three
    the value was up to 9 % too low."""
    end, implied = datetime.datetime(2026, 5, 5, 6), "day" if cycles["term"] < 2 else "term"
    case = battery(end=end, cycles=cycles)
    problem = bare_problem(case)
    grid = grid_of(case.contract.layout, problem.schedule)
    place = [level.name for level in case.contract.layout.levels].index(
        "taken today" if implied == "day" else "taken"
    )
    assert grid.exact and {len(x[place]) for x in grid.nodes} == {1}
    alone = battery(end=end, cycles={x: y for x, y in cycles.items() if x != implied})
    assert exact(case, finer=1) == pytest.approx(exact(alone, finer=1), rel=1e-12)


UNEVEN = {
    "energy": 3.987, "stored": 1.23,
    "charge": {"power": 1.234, "efficiency": 0.8765},
    "discharge": {"power": 1.111, "efficiency": 0.9432},
}  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        UNEVEN,
        pytest.param(UNEVEN | {"cycles": {"term": 1.7}}, marks=pytest.mark.prove),
        pytest.param({"cycles": {"day": 1.0, "term": 1.5}}, marks=pytest.mark.prove),
    ],
)
def test_the_intrinsic_value_has_no_nodes(changes):
    """A linear program of the schedule equals that of `best_plan`; coarse nodes were 0.1 to 1 % lower."""
    case = battery(end=datetime.datetime(2026, 5, 6), **changes)
    schedule = bare_problem(case).schedule
    value = intrinsic_value(case.contract.layout, schedule)
    assert not grid_of(case.contract.layout, schedule).exact
    assert value == pytest.approx(best_plan(case), rel=1e-9)


@pytest.mark.prove
def test_energy_is_not_stored_and_taken_in_one_hour(tmp_path):
    """At negative prices a linear program would burn energy so; the nodes do not."""
    changes = UNEVEN | {
        "end": datetime.datetime(2026, 5, 4, 6),
        "cycles": {"day": 9.0, "term": 9.0},
    }
    shutil.copytree(HOME / "template_battery", tmp_path, dirs_exist_ok=True)
    rows = [f"{time},{-100.0 - number}" for number, time in enumerate(HOURS)]
    (tmp_path / "curve.csv").write_text("\n".join(["time,price", *rows]))
    keys = {f"contract.{name}": value for name, value in changes.items()}
    case = case_at(tmp_path, keys | {"model.kind": "one-factor-normal"})
    value = intrinsic_value(case.contract.layout, bare_problem(case).schedule)
    assert value < 0.98 * best_plan(case)


@pytest.mark.prove
def test_cycles_of_the_term_are_worth_more_than_those_by_day():
    by_day, by_term = (
        exact(battery(end=datetime.datetime(2026, 5, 7), cycles=cycles), forward=True)
        for cycles in ({"day": 0.5}, {"term": 1.5})
    )
    assert by_term >= by_day > 0


def test_the_day_of_summer_time_has_23_hours():
    class Table:
        time_zone = "Europe/Berlin"
        start = datetime.date(2026, 3, 29)
        end = datetime.date(2026, 3, 30)

    hours = hours_of(None, Table, datetime.date(2026, 3, 29))  # pyright: ignore
    assert len(hours.instants) == 23 and len(set(hours.local)) == 23
    assert "2026-03-29T02:00" not in hours.local
    Table.start, Table.end = datetime.date(2026, 10, 25), datetime.date(2026, 10, 26)
    hours = hours_of(None, Table, datetime.date(2026, 10, 25))  # pyright: ignore
    assert len(hours.instants) == 25 and hours.local.count("2026-10-25T02:00") == 2


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"stored": 5.0}, "stored"),
        ({"time_zone": "Atlantis"}, "time_zone"),
        ({"end": datetime.datetime(2026, 5, 12)}, "2026-05-11T00:00"),
        ({"charge": {"power": 1.0, "efficiency": 1.2}}, "charge.efficiency"),
    ],
)
def test_mistakes_are_named(changes, where):
    with pytest.raises(CaseError, match=where):
        battery(**changes)


def with_times(folder, times, **changes):
    """Six hours in Berlin, with these times in the file of the curve; the price of a row is its number."""
    shutil.copytree(HOME / "template_battery", folder, dirs_exist_ok=True)
    rows = [f"{time},{number}" for number, time in enumerate(times, start=1)]
    (folder / "curve.csv").write_text("\n".join(["time,price", *rows]))
    keys = {"end": datetime.datetime(2026, 5, 4, 6), "time_zone": "Europe/Berlin"} | changes
    return case_at(folder, {f"contract.{name}": value for name, value in keys.items()})


@pytest.mark.parametrize(
    ("times", "where"),
    [
        (
            [*HOURS[:3], HOURS[2], *HOURS[3:]],
            r"line 5, column time: .*already has a price, on line 4",
        ),
        ([time + "Z" for time in HOURS], r"line 2, .*hour of local time"),
        ([*HOURS[:3], HOURS[3] + ":00+02:00", *HOURS[4:]], r"line 5, .*hour of local time"),
        ([*HOURS[:2], "2026-05-04T01:15", *HOURS[2:]], r"line 4, .*no such hour from"),
        ([*HOURS[:3], "2026-05-04T03:00:07", *HOURS[4:]], r"line 5, .*hour of local time"),
    ],
)
def test_every_row_of_a_curve_within_the_hours_is_read(times, where, tmp_path):
    """A second price of an hour, one of a quarter of it, and a time of another time zone were passed over."""
    with pytest.raises(CaseError, match=where):
        with_times(tmp_path, times)


def test_an_hour_that_the_clock_skips_has_no_price(tmp_path):
    first = datetime.date(2026, 3, 29)
    with pytest.raises(CaseError, match=r"line 4, .*2026-03-29T02:00.*no such hour"):
        shutil.copytree(HOME / "template_battery", tmp_path, dirs_exist_ok=True)
        rows = [f"2026-03-29T{hour:02d}:00,{hour + 1}" for hour in range(24)]
        (tmp_path / "curve.csv").write_text("\n".join(["time,price", *rows]))
        case_at(tmp_path, {"contract.start": first, "contract.end": datetime.date(2026, 3, 30),
                           "contract.time_zone": "Europe/Berlin", "market.valuation_date": first})  # fmt: skip


def test_other_ways_to_write_an_hour(tmp_path):
    """Seconds that are zero, a blank for the T, in any order; files of dates write no midnight."""
    times = ["2026-05-04 01:00:00", "2026-05-04", *HOURS[2:], "2026-05-04T06:15"]
    curve = with_times(tmp_path, times).market.forward_curve
    assert curve.values.tolist() == [2.0, 1.0, 3.0, 4.0, 5.0, 6.0]


def test_a_day_ends_with_its_last_hour():
    ends = battery().contract.day_ends
    assert ends.sum() == 7 and ends[23] and ends[-1]
    assert bare_problem(battery()).simulator.horizon == 168


A_DAY = {"end": datetime.datetime(2026, 5, 5)}


@pytest.mark.parametrize(
    "cycles",
    [
        {"day": 1.5},
        *(pytest.param(x, marks=pytest.mark.prove) for x in ({"day": 1.0}, {"term": 0.5})),
    ],
)
def test_bumps_of_energy_and_cycles_stay_on_the_nodes(cycles):
    """Values at such a bump, and at half of it, are as exact as those of the case: 0.2 % is lost
    between nodes."""
    case = battery(**A_DAY, cycles=cycles)
    problem, width = bare_problem(case), np.full(2, 0.1)
    for name in ("energy", f"cycles_{next(iter(cycles))}"):
        values = problem.inputs_by_name[name]
        for share in (-1.0, -0.5, 0.5, 1.0):
            moved = problem.at({name: values.value + share * one_percent(values)})
            assert grid_of(case.contract.layout, moved.schedule, apart=width).exact


def bumps_of(**changes):
    contract = battery(**changes).contract
    limits = [contract.energy, contract.cycles_day, contract.cycles_term]
    return [x and x.judge_bump for x in limits]


def test_bumps_are_at_least_one_percent_and_at_most_ten():
    assert bumps_of() == pytest.approx([0.2, 0.05, None])
    assert bumps_of(energy=40.0, cycles={"term": 2.0}) == pytest.approx([0.4, None, 0.01])
    assert bumps_of(energy=4.001, cycles={"day": 1.0}) == pytest.approx(
        [0.042, 0.042 / 4.001, None]
    )
    assert bumps_of(energy=1.5) == [None, None, None]
