"""A report names the levels and choices of a contract as a desk does, and hides private states."""

import numpy as np
import pytest
from tests.domains.energy.energy_cases import battery, plant, swing

from snapo.domains.energy.study import _names
from snapo.report.folder import RunFiles, RunResult
from snapo.study.chapters.distribution import OutputTotal, OutputTotals
from snapo.study.chapters.distribution import show as totals
from snapo.study.chapters.profile import BandProfile, BandSeries
from snapo.study.chapters.profile import show as fans


@pytest.mark.parametrize(
    ("case", "expected"),
    [
        (battery(), {"levels.0": "Energy", "levels.1": "Taken today", "mode": ""}),
        (swing(), {"levels": "Taken", "action": ""}),
        (plant(), {"price.1": "", "value_surprise": ""}),
    ],
)
def test_states_and_decisions_have_names(case, expected):
    names = _names(case.contract.layout)
    assert expected.items() <= names.items()
    assert all("_" not in name for name in names.values())


def test_fans_and_totals_have_these_names_and_others_are_hidden():
    run = RunFiles(RunResult(), {"names": {"levels.0": "Energy", "price": ""}}, {}, (), {}, {})
    line = {"mean": np.arange(3.0), "p01": np.arange(3.0) - 1, "p99": np.arange(3.0) + 1}
    line |= {name: np.arange(3.0) for name in ("p05", "p25", "p50", "p75", "p95")}
    series = [BandSeries(name, "state", "MWh", **line) for name in ("levels.0", "price", "own")]
    shown = fans(run, BandProfile(tuple(series), 8))
    assert [x.caption.partition(" (")[0] for x in shown] == ["Energy", "Own"]
    edges, counts = np.array([0.0, 1.0]), np.array([8.0])
    outputs = [
        OutputTotal(name, "", 8, 0.5, deviation, 0.1, 0.0, 0.1, {}, {}, edges, counts)
        for name, deviation in (("price", 1.0), ("sold", 1.0), ("short", 0.0))
    ]
    histogram, table = totals(run, OutputTotals(tuple(outputs)))
    assert histogram.caption.startswith("Sold: the total of a path")  # and none of a constant
    assert [row[0] for row in table.rows] == ["Sold", "Short"]
