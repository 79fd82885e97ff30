"""The report of an inventory run."""

import pytest
from tests.domains.inventory.inventory_cases import case

from snapo.domains.inventory.chapters.about import about
from snapo.domains.inventory.report import of_its_period
from snapo.domains.inventory.setup import make_setup
from snapo.report.folder import RunFiles, RunResult
from snapo.report.page import Text
from snapo.study.chapters.profile import profile


@pytest.mark.parametrize(("cost", "told"), [("EUR/week", "30"), ("EUR", "0.5")])
def test_an_output_over_time_is_that_of_its_period(cost, told):
    """A run holds an output's part of the mean over 60 weeks; a discounted cost is whole."""
    lines = {name: [0.5, 0.5] for name in ("mean", "p01", "p99")}
    series = [{"name": "a", "kind": kind, "unit": unit} | lines
              for kind, unit in (("state", "piece"), ("outputs", "piece"), ("outputs", cost))]  # fmt: skip
    about = {"horizon": 100, "warm_up": 40, "step": "week", "currency": "EUR",
             "profile": {"series": series, "paths": 2}}  # fmt: skip
    blocks = profile(factor=of_its_period)(RunFiles(RunResult(), about, {}, (), {}, {})).blocks
    texts = [each.text.split(" is ")[1] for each in blocks if isinstance(each, Text)]
    assert [each.split("\N{NO-BREAK SPACE}")[0] for each in texts] == ["0.5", "30", told]


@pytest.mark.parametrize(
    ("lead_time", "names"),
    [
        (0, {}),
        (1, {}),
        (2, {"coming": "Order that arrives in 1 week"}),
        (
            3,
            {
                "coming.0": "Order that arrives in 1 week",
                "coming.1": "Order that arrives in 2 weeks",
            },
        ),
    ],
)
def test_outstanding_orders_are_called_by_their_arrival(lead_time, names):
    item = case(lead_time=lead_time, period="week")
    assert about(item)["names"] == names
    start = make_setup(item).problem.schedule.constants["coming"]
    assert len(start) == len(names)
