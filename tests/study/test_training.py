"""What result.json says of a trained study beside its classical rules."""

import threading
from types import SimpleNamespace
from typing import Any

import pytest

from snapo.solver.derivatives.rebuilt import LONG
from snapo.study import training
from snapo.study.training import trained

HEAD = ("value", "standard_error", "smooth_value", "smoothing_gap", "policy_gradient_norm")


class Run(dict):
    """A run whose training is done."""

    def __init__(self, notes=()):
        super().__init__(solution=dict.fromkeys(HEAD, 1.0) | {"notes": list(notes)})


def test_a_rule_that_does_better_is_named_and_the_best_of_several():
    leads = [("none", 5.0, 0.1), ("linear", -2.0, 0.1), ("clipped", -3.0, 0.25)]
    found = trained(Run(["Paths were left out."]), {"linear": 3.0}, leads)
    assert "“clipped” does better" in found["verdict"] and "3 ± 0.49" in found["verdict"]
    assert found["notes"] == ["Paths were left out.", found["verdict"]]
    assert found["references"] == {"linear": 3.0}


@pytest.mark.parametrize(
    "lead",
    [("worse", 1.0, 0.1), ("not told apart", -0.1, 0.1), ("ruined", None, None),
     ("no number", float("nan"), 0.1), ("better without bound", float("inf"), None)],
)  # fmt: skip
def test_nothing_is_said_where_no_rule_is_surely_better(lead):
    found = trained(Run(), None, [lead])
    assert "verdict" not in found and found["notes"] == []


def test_a_rule_without_an_error_is_compared_as_it_is():
    assert "verdict" in trained(Run(), None, [("same bits", -1.0, None)])


def test_nothing_is_said_before_training():
    assert trained({}, None, [("linear", -2.0, 0.1)]) == {}


def test_work_for_later_parts_is_done_during_the_training(monkeypatch):
    """In another thread; and if it fails there, the part that needs it does it."""
    threads = []

    def prepare():
        threads.append(threading.current_thread().name)
        raise ArithmeticError

    setup = SimpleNamespace(
        problem=SimpleNamespace(simulator=SimpleNamespace(horizon=LONG)),
        training=None,
        solve=lambda **options: "solution",
    )
    run: Any = SimpleNamespace(setup=setup, study=SimpleNamespace(meanwhile=prepare))
    monkeypatch.setattr(training, "_resumed", lambda run, setup: None)
    monkeypatch.setattr(training, "saved", lambda run, solution: {"solution": solution})
    assert training.train(run) == {"solution": "solution"}
    assert threads == ["beside"]
    setup.problem.simulator.horizon = LONG + 1
    training.train(run)
    assert len(threads) == 1
