"""A verdict on training speaks first of what can still be gained, where a bound says it."""

import pytest

from snapo.solver.verdict.convergence import AS_BEGUN, CONVERGED, SATURATED, SHORT
from snapo.solver.verdict.further import room
from snapo.study.study import Part, Study, StudyRun
from snapo.study.training import TRAINING, trained


def bound(value, high, upper=78_463.0):
    gap = {"value": value, "standard_error": 1.0, "low": value - 2, "high": high}
    return {
        "gap": gap,
        "upper": {"value": upper, "standard_error": 9.0, "low": 0, "high": upper + 6},
    }


def test_the_room_is_that_of_the_tightest_bound():
    assert room(78_375.0, 2.0) is None
    found = room(78_375.0, 2.0, bound(88.0, 94.2))
    assert found.near and found.description == (
        "At most 0.12 % can be gained over this policy: the optimum is at most 78,469 (95 %)."
    )
    exact = room(78_374.0, 2.0, bound(88.0, 94.2), exact=78_370.0)
    assert exact.share == 0
    assert exact.description == "Nothing can be gained over this policy: the exact value is 78,370."
    low = room(77_000.0, 2.0, bound(1400.0, 1420.0), exact=78_370.0)
    assert not low.near and low.share == pytest.approx(1374 / 78_370)
    # Costs are values below zero; a bound that leaves half of the value tells nothing.
    assert room(-103.0, 0.5, exact=-100.0).share == pytest.approx(0.04)
    assert room(100.0, 1.0, bound(90.0, 95.0, upper=190.0)) is None
    assert room(None, None, None, None) is None


ADVICE = "Too short to tell whether more steps would help: of its 60 steps 20 are the warm-up."


@pytest.mark.parametrize(
    "word, high, now, kept",
    [
        (SHORT, 94.2, CONVERGED, False),
        (AS_BEGUN, 94.2, CONVERGED, False),
        (SATURATED, 94.2, SATURATED, False),
        (SHORT, 1400.0, SHORT, True),
    ],
)
def test_near_a_bound_the_verdict_is_the_room_and_no_advice_to_train_on(
    word, high, now, kept, tmp_path
):
    solution = {"value": 78_375.0, "standard_error": 2.0, "convergence": word}
    solution |= dict.fromkeys(("smooth_value", "smoothing_gap", "policy_gradient_norm"), 0.0)
    solution |= {"notes": ["Another note.", ADVICE]}
    study = Study("kind", {}, (TRAINING, Part("bound", lambda run: {})), lambda run: {})
    run = StudyRun(study, tmp_path, print, results={"solution": solution, "bound": bound(88, high)})
    result = trained(run)
    said = room(78_375.0, 2.0, bound(88, high)).description
    assert result["verdict"] == said and result["notes"][0] == said
    assert result["convergence"] == now
    assert (ADVICE in result["notes"]) == kept and "Another note." in result["notes"]
    # A classical rule that does better is told in its place, on the terminal.
    beaten = trained(run, advantages=[("rule", -500.0, 1.0)])
    assert "rule" in beaten["verdict"] and beaten["notes"][0] == said
