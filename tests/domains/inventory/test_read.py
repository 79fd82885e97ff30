"""What a case may say, and the refusals of what it may not."""

import numpy as np
import pytest
from tests.domains.inventory.inventory_cases import case

from snapo.case.error import CaseError
from snapo.domains.inventory.read.case import read_case


def written(folder, demand: dict, files: dict[str, str], **other):
    for name, text in files.items():
        (folder / name).write_text(text)
    item = {"unmet": "waits", "lead_time": 1, "holding": 1.0, "shortage": 4.0}
    return read_case(
        folder / "case.toml", {"kind": "inventory", "item": item, "demand": demand, **other}
    )


HISTORY = "period,demand,factor\n" + "".join(f"{i},{d * f},{f}\n" for i, (d, f) in enumerate(
    zip([3, 4, 5, 6, 7, 8, 9, 2], [1, 2] * 4)))  # fmt: skip


def test_a_history_is_divided_by_its_factors(tmp_path):
    found = written(tmp_path, {"kind": "empirical", "history": "h.csv"}, {"h.csv": HISTORY})
    assert found.demand.values() == pytest.approx({
        "demand_mean": 5.5, "demand_deviation": np.std(np.arange(2, 10)),
    })  # fmt: skip
    assert found.item.integer and not found.item.lost


def test_a_season_is_an_input_and_its_orders_are_not_whole(tmp_path):
    files = {"h.csv": HISTORY, "s.csv": "period,factor\nsummer,0.5\nwinter,1.5\n"}
    demand = {"kind": "empirical", "history": "h.csv"}
    found = written(tmp_path, demand, files, season={"file": "s.csv"})
    assert found.seasonal and found.season.labels == ("summer", "winter")
    assert not found.item.integer


def test_weights_add_up_or_are_discount_factors():
    found = case(horizon={"periods": 20, "warm_up": 5})
    assert found.weights.sum() == pytest.approx(1) and found.horizon == 25
    found = case(horizon={"periods": 3, "discount": 0.9})
    assert found.weights == pytest.approx([1, 0.9, 0.81]) and found.warm_up == 0
    assert found.value_unit == "EUR"


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"lead_time": 3, "coming": [5.0]}, "needs 2 numbers"),
        ({"lead_time": -1}, "0 to 12"),
        ({"shortage": 0.0}, "above 0"),
        ({"unmet": "backlogged"}, '"lost" or "waits"'),
    ],
)
def test_mistakes_are_refused_in_words(changes, words):
    with pytest.raises(CaseError, match=words):
        case(**changes)


@pytest.mark.parametrize(
    "demand, words",
    [
        ({"kind": "poison", "mean": 5.0}, "it must be one of"),
        ({"kind": "poisson", "mean": 5000.0}, "use a larger unit"),
        ({"kind": "negative-binomial", "mean": 5.0, "deviation": 2.0}, "above 2.247"),
        ({"kind": "normal", "mean": 1.0, "deviation": 2.0}, "at most the mean"),
    ],
)
def test_impossible_demand_is_refused(demand, words):
    with pytest.raises(CaseError, match=words):
        case(demand)
