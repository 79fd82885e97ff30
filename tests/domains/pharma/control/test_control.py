"""A closed loop and a best recipe from the case file to the report, on a reactor alone."""

import json

import numpy as np
import pytest
from tests.domains.pharma.filled import filled
from tests.domains.pharma.pharma_cases import template

from snapo.case.error import CaseError
from snapo.domains.pharma.chapters.closed_loop import KeptShares, better, rates
from snapo.domains.pharma.control.staging import decided, staged
from snapo.problem.scenarios import Pseudo
from snapo.report.folder import RunFiles


def control(held=(), **changes):
    """The template with a `[control]` on its crystalliser."""
    table = {
        "steps": {"crystalliser": 4},
        "manipulated": [{"of": "crystalliser.temperature", "low": "273 K", "high": "314 K"}],
        "measurements": [
            {"state": "crystalliser.d43", "error": "1 um", "centre": "60 um", "width": "40 um"}
        ],
    }
    return template(control=table | changes, held=list(held))


def test_stages_are_where_something_is_decided_or_measured():
    """The reactor runs before the first decision; what has no time runs after the last one."""
    case = control()
    assert case.control is not None
    assert [unit.name for unit in staged(case.units, case.control)] == ["crystalliser"]
    reactor = {"of": "reactor.temperature", "low": "303 K", "high": "323 K"}
    wash = {"of": "filter.wash_ratio", "low": 1, "high": 4}
    more = control(manipulated=[reactor, wash])
    parts = more.units, more.control
    assert [unit.name for unit in staged(*parts)] == ["reactor", "crystalliser"]
    assert decided(*parts, "reactor") == (0,) and decided(*parts, "") == (1,)


def test_a_decision_has_the_ramp_of_its_profile_by_default():
    """0.6 K/min in the template are 0.01 K/s; other numbers have no limit."""
    cooling = {"of": "crystalliser.temperature", "low": "273 K", "high": "314 K"}
    heating = {"of": "reactor.temperature", "low": "303 K", "high": "323 K"}
    wash = {"of": "filter.wash_ratio", "low": 1, "high": 4}
    case = control(manipulated=[cooling, heating, wash])
    assert case.control is not None
    ramp, *others = [item.ramp for item in case.control.manipulated]
    assert ramp == pytest.approx(0.01) and others == [None, None]
    other = control(manipulated=[cooling | {"ramp": "1.5 K/min"}]).control
    assert other is not None and other.manipulated[0].ramp == pytest.approx(0.025)


def test_what_is_measured_must_be_known_in_time():
    sensor = {"state": "dryer.solvent", "error": 0, "centre": 0, "width": 1}
    with pytest.raises(CaseError, match="there is no such state"):
        control(measurements=[sensor])


@pytest.mark.parametrize(
    ("of", "low", "high", "words"),
    [
        ("charge.volume", "50 L", "70 L", "does not belong to a unit"),
        ("crystalliser.seed.size", "10 um", "30 um", "fields that change over time"),
    ],
)
def test_what_cannot_be_decided_over_time_is_refused(of, low, high, words):
    with pytest.raises(CaseError, match=words):
        control(manipulated=[{"of": of, "low": low, "high": high}])


def test_what_is_held_cannot_be_decided():
    wash = {"of": "filter.area", "low": "100 cm^2", "high": "300 cm^2"}
    with pytest.raises(CaseError, match=r"control.manipulated\[0\].*in the list `held`"):
        control(held=["filter.area"], manipulated=[wash])


@pytest.mark.parametrize(
    ("gain", "error", "which", "words"),
    [
        (
            -0.016,
            0.002,
            "recipe",
            "The best fixed recipe does better than the policy: 95.9 % under",
        ),
        (0.016, 0.002, "policy", "The policy does better than the best fixed recipe"),
        (0.003, 0.002, "", "The policy and the best fixed recipe do not differ"),
    ],
)
def test_the_headline_says_which_rival_is_better(gain, error, which, words):
    assert better(gain, error) == which
    said = filled(KeptShares, better=which, value=0.959, baseline=0.959 - gain).verdict
    assert said.startswith(words)


LOOPS = [{"of": "crystalliser.temperature", "measure": "crystalliser.d43"}]


def test_a_rule_is_read_in_its_units():
    """K per um is 1e6 K/m, and a dead time has its unit."""
    loop = LOOPS[0] | {"gain": "-0.5 K/um", "integral_time": "10 min", "setpoint": ["60 um"]}
    sensor = {"state": "crystalliser.d43", "error": "1 um", "centre": "60 um", "width": "40 um"}
    found = control(
        rules=[{"name": "PI", "loops": [loop]}], measurements=[sensor | {"delay": "2 min"}]
    )
    assert found.control is not None and found.control.measurements[0].delay == 120
    pi = found.control.rules[0].loops[0].outer
    assert (
        pi.gain == pytest.approx(-5e5)
        and pi.integral == 600
        and pi.setpoint == pytest.approx((6e-5,))
    )


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        ({"loops": [LOOPS[0] | {"of": "filter.wash_ratio"}]}, "there is no such control"),
        ({"loops": [LOOPS[0] | {"measure": "crystalliser.d32"}]}, "there is no such measurement"),
        ({"loops": [LOOPS[0] | {"gain": "0 K/um"}]}, "a gain that is not 0"),
        ({"loops": [LOOPS[0] | {"gain": "2 K"}]}, r"loops\[0\].gain.*2 K"),
        ({"loops": LOOPS * 2}, "a control can have only one loop"),
        ({"loops": [], "tuning": "simc"}, "loops"),
        ({"loops": LOOPS, "tuning": "by hand"}, "ziegler-nichols"),
    ],
)
def test_a_rule_that_cannot_be_is_refused(rule, words):
    with pytest.raises(CaseError, match=words):
        control(rules=[{"name": "PI"} | rule])


@pytest.fixture(scope="module")
def whole(solved):
    """(result, details, run folder) of the reactor with a controller beside the policy."""
    out = solved("closed-loop") / "run"
    return json.loads((out / "result.json").read_text()), RunFiles.read(out).details, out


@pytest.mark.prove
def test_a_closed_loop_runs_from_the_file_to_the_report(whole):
    result, found, out = whole
    assert result["status"] == "trained", result["failures"]
    loop = found["closed_loop"]
    assert result["value"] == loop["value"] and 0 < loop["value"] < 1
    assert result["references"]["best_fixed_recipe"] == loop["baseline"]
    assert abs(loop["gain"] - (loop["value"] - loop["baseline"])) < 1e-12
    row = loop["recipe"][0]
    assert row["input"] == "reactor.temperature" and len(row["values"]) == 3
    assert all(303.15 <= each <= 323.15 for each in row["values"])
    # The policy's course and both recipes over time, and the rivals in the headline.
    for name in ("policy", "policy_low", "policy_high", "given"):
        assert len(row[name]) == 3 and all(303.1 <= each <= 323.2 for each in row[name])
    assert row["given"] == pytest.approx([313.15] * 3) and row["time"][-1] == 3600
    assert result["references"]["recipe_as_given"] == loop["given"]
    assert (
        "optimised_recipe" in result["references"] and "the best fixed recipe" in result["verdict"]
    )
    page = (out / "report.html").read_text(encoding="utf-8")
    head = page.partition("Quality attributes of one batch")[0]
    assert "Best fixed recipe" in page and result["verdict"] in head
    assert "All limits, best fixed recipe" in head
    assert "Out of specification, original recipe" in head
    assert "reactor.temperature, K" in page and "Policy, median" in page
    # The controller on the same batches, as given and trained.
    first, tuned = loop["rules"]
    assert (first["name"], tuned["name"]) == ("PI, first settings", "PI")
    assert first["gains_own"][0] == pytest.approx(-50) and tuned["gains_own"][0] != -50
    for each in (first, tuned):
        assert each["policy_gain"] == pytest.approx(loop["value"] - each["value"], abs=1e-12)
        assert each["policy_gain_error"] >= 0 and each["times"][0] > 0
    assert "Rules on the same batches, paired" in page
    reason = found["engine"]["reason"]
    assert "asked for" not in reason and "larger than the native engine supports" in reason
    assert loop["goal"].startswith("mean of product") and loop["goal"] in page
    assert result["references"]["goal"] == loop["objective"]
    for name in ("policy.npz", "history.csv", "sensitivities.csv"):
        assert (out / name).exists(), sorted(each.name for each in out.iterdir())


@pytest.mark.prove
def test_the_best_recipe_stands_in_the_report(whole):
    _, found, out = whole
    best = found["optimise"]
    assert best["converged"] and best["unit"] == "mol/L/h" and len(best["chance"]) == 2
    assert best["decisions"][0]["value"] == pytest.approx(50)
    assert "First-order conditions" in (out / "report.html").read_text(encoding="utf-8")


def test_a_pair_that_keeps_two_sided_limits_together_counts_once():
    """z and -z both lie within +-1 or both beyond, so there are half as many independent batches."""
    z = np.random.default_rng(1).standard_normal(4096)
    kept = np.repeat(np.abs(z) < 1, 2).astype(float)
    found = rates(kept, 1 - kept, 0 * kept, Pseudo(0).groups(np.arange(kept.size)))
    share = kept.mean()
    expected = np.sqrt(share * (1 - share) / len(z))
    assert found.standard_error == pytest.approx(expected, rel=1e-3)
    assert found.gain_error == pytest.approx(2 * expected, rel=1e-3)
    assert found.given_error == 0
