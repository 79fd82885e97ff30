"""The report of an inventory run."""

import numpy as np
import pytest
from tests.domains.inventory.inventory_cases import case

from snapo.domains.inventory.chapters.about import about
from snapo.domains.inventory.chapters.levels import today
from snapo.domains.inventory.report import of_its_period
from snapo.domains.inventory.setup import make_setup
from snapo.engine import Xla
from snapo.problem.smooth import Exact
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


def seasonal(folder, **item):
    """A setup whose demand of about 100 triples after two periods, in the warm-up."""
    factors = "".join(f"{i},{1 if i < 3 else 3}\n" for i in range(1, 13))
    (folder / "s.csv").write_text("period,factor\n" + factors)
    demand = {"kind": "normal", "mean": 100.0, "deviation": 10.0}
    tables = {"season": {"file": "s.csv"}, "horizon": {"periods": 2, "warm_up": 4}}
    return make_setup(case(demand, folder, **item, **tables))


def todays(setup):
    return {name: number for name, number, _ in today(setup, setup.policy).facts}


def test_todays_order_is_for_the_demand_of_the_first_periods(tmp_path):
    """The initial rule orders up to two periods of demand and a safety stock: 4 of 5 periods
    without shortage cost least, so it is 0.84 deviations of 10 √2."""
    facts = todays(seasonal(tmp_path, lead_time=1, unmet="waits"))
    assert facts["order"] + facts["stock"] == pytest.approx(200 + 0.8416 * 14.142, rel=0.01)


@pytest.mark.prove
@pytest.mark.parametrize(("lead", "order"), [(1, 0.0), (3, 0.0), (1, 500.0)])
def test_todays_order_is_the_first_of_the_simulation(lead, order, tmp_path):
    setup = seasonal(tmp_path, lead_time=lead, order=order)
    draws = setup.problem.sources.evaluation.draws(np.arange(8), setup.problem.simulator)
    bound = Xla("float32").bind(setup.problem)
    action = bound.values(setup.policy, draws, Exact(), record=("action",)).record["action"][0]
    first = action[:, 1] * action[:, 2] if order else action[:, 0]
    assert np.asarray(first) == pytest.approx(todays(setup)["order"], rel=1e-5)
