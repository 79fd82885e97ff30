"""Charts of contracts by the hour have dates and times, and a first screen names the checks that fail."""

import datetime
import re
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from tests.domains.energy.energy_cases import battery

from snapo.case.error import CaseError
from snapo.domains.gas_storage.explain.runs import ValuedRun
from snapo.live.open import AboutRun
from snapo.report.drawing import local_times_of, times_of
from snapo.report.evidence import check_marks
from snapo.report.folder import RunFiles, RunResult
from snapo.report.page import Chart, Mark
from snapo.study.chapters.profile import BandProfile, BandSeries, bands, show

BERLIN = ZoneInfo("Europe/Berlin")


def hours(first, count):
    """Local labels of hours, as a forward curve has them."""
    start = datetime.datetime.fromisoformat(first).replace(tzinfo=BERLIN)
    instants = (start.astimezone(datetime.UTC) + datetime.timedelta(hours=n) for n in range(count))
    return [f"{x.astimezone(BERLIN):%Y-%m-%dT%H:%M}" for x in instants]


@pytest.mark.parametrize(
    ("first", "pieces"), [("2026-03-28", 2), ("2026-10-24", 2), ("2026-05-04", 1)]
)
def test_local_times_over_a_change_of_the_clocks(first, pieces):
    """A week with 23 or 25 hours in a day: the labels of the curve themselves, from two numbers."""
    labels = hours(first, 168)
    marks = local_times_of(labels, 24)
    assert len(marks) == pieces
    assert [f"{x:%Y-%m-%dT%H:%M}" for x in times_of(marks, 24, 168)] == labels
    assert len(times_of(marks, 24, 169)) == 169 and len(times_of(marks, 24, 5)) == 5


def test_days():
    days = [f"2026-02-{n:02}" for n in range(20, 29)]
    marks = local_times_of(days, 1)
    assert marks == [(0, "2026-02-20")]
    assert [f"{x:%Y-%m-%d}" for x in times_of(marks, 1, 10)] == [*days, "2026-03-01"]
    about = AboutRun(step="hour", local_times=[(0, "2026-05-04T22:00")], horizon=3)
    assert about.times == ["2026-05-04 22:00", "2026-05-04 23:00", "2026-05-05 00:00"]


@pytest.mark.parametrize(
    ("count", "expected"), [(168, ["4May 2026", "10May"]), (30, ["4May 2026", "06:00", "18:00"])]
)
def test_a_chart_by_the_hour_has_dates(count, expected):
    """Its axis counted hours from 0."""
    rng = np.random.default_rng(1)
    series = BandSeries("charge", "outputs", "MWh", **bands(rng.normal(size=(count, 50))))
    details = {
        "local_times": [(0, "2026-05-04T00:00")],
        "step": "hour",
        "names": {"charge": "Charge"},
    }
    run = RunFiles(RunResult(), details, {}, (), {}, {})
    chart, *_ = show(run, BandProfile((series,), 50))
    assert isinstance(chart, Chart)
    texts = re.sub(r"<[^>]*>|\s*\n", "", chart.svg)
    assert all(text in texts for text in expected) and "Hour" not in texts


def test_failed_checks_are_named():
    """ "4 of 5 checks hold" did not say which one does not."""
    assert check_marks([]) == []
    assert check_marks([("stock", True)]) == [Mark(True, "the check holds")]
    assert check_marks([("stock", True), ("price", True)]) == [Mark(True, "all 2 checks hold")]
    one = check_marks([("stock", True), ("price", False)])
    assert one == [Mark(False, "1 of 2 checks fail: price")]
    many = check_marks([(name, False) for name in "abcde"])
    assert many == [Mark(False, "5 of 5 checks fail: a, b, c and 2 more")]


def test_the_times_of_a_battery_are_those_of_its_curve():
    case = battery()
    labels = case.market.forward_curve.labels
    marks = local_times_of(labels, 24)
    assert [f"{x:%Y-%m-%dT%H:%M}" for x in times_of(marks, 24, len(labels))] == list(labels)


def test_an_auction_is_not_of_days():
    """A battery's flows are those of hours: the message spoke of their own day."""
    case = battery(auction={"at": "00:00", "step": "4h"})
    data = {"contract": {"auction": {}}}
    folder = Path("run")
    run = ValuedRun(folder, folder / "case.toml", data, case, "auto", 1.0, 0.1, None)
    with pytest.raises(CaseError, match=r"contract\.auction: .* decided at delivery") as caught:
        run.check()
    assert "day" not in str(caught.value)
