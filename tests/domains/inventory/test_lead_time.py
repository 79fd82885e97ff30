"""Other lead times, trained anew: against the closed form of normal demand that waits."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.domains.inventory.inventory_cases import case
from tests.domains.inventory.references.backlog import best_base_stock

from snapo.domains.inventory.chapters.lead_time import measure
from snapo.domains.inventory.read.network import read_network
from snapo.domains.inventory.setup import make_setup
from snapo.solver.solve import Evaluation, solve

NORMAL = {"kind": "normal", "mean": 5.0, "deviation": 1.6}
HORIZON = {"periods": 40, "warm_up": 15}
TRAINING = {"steps": 40, "paths": 256}
EVALUATION = Evaluation(16384, sensitivity_paths=0, smooth_paths=0, judge_paths=0)


def run_of(setup):
    """What the parts ask of a run."""
    solution = solve(setup.problem, policy=setup.policy, training=setup.training,
                     evaluation=EVALUATION, engine=setup.engines)  # fmt: skip
    return SimpleNamespace(setup=setup, solution=solution, progress=lambda line: None)


def cost(lead: int) -> float:
    return best_base_stock(5.0, 1.6, lead, 1.0, 9.0).cost


@pytest.mark.prove
def test_an_item():
    of = case(NORMAL, unmet="waits", lead_time=1, shortage=9.0, horizon=HORIZON, training=TRAINING)
    rows = measure(run_of(make_setup(of))).lead_time_change  # pyright: ignore
    assert [row.lead for row in rows] == [0, 2]
    for row in rows:
        expected = cost(1) - cost(row.lead)  # the result is minus the cost
        assert row.change == pytest.approx(expected, abs=0.03)
        assert 0 < row.standard_error < 0.03


@pytest.mark.study
def test_every_place_of_a_network():
    """Two stores that do not share: each costs as one item does."""
    place = {"lead_time": 1, "holding": 1.0, "shortage": 9.0, "demand": NORMAL}
    places = [{"name": "a", **place}, {"name": "b", **place, "lead_time": 0}]
    data = {"kind": "inventory", "place": places, "horizon": HORIZON, "training": TRAINING,
            "report": {"lead_time": True}}  # fmt: skip
    given = read_network(Path(__file__).parent / "case.toml", data)
    assert given.other_leads
    rows = measure(run_of(make_setup(given))).lead_time_change  # pyright: ignore
    assert [(row.place, row.lead) for row in rows] == [("a", 0), ("a", 2), ("b", 1)]
    for row, lead in zip(rows, (1, 1, 0)):
        assert row.change == pytest.approx(cost(lead) - cost(row.lead), abs=0.05)
