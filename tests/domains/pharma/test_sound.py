"""Nothing that is not a number, unstable, impossible or not converged ends with status "ok"."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pharma.filled import filled, folder
from tests.domains.pharma.pharma_cases import CASE, FAST, TEMPLATE, fast
from tests.domains.pharma.process_cases import cake_filter, flagship, number

from snapo.cli.main import main
from snapo.domains.pharma.chapters.attribution import ATTRIBUTION, Attributions
from snapo.domains.pharma.chapters.batch import ONE_BATCH, BatchResult
from snapo.domains.pharma.chapters.capability import CAPABILITY
from snapo.domains.pharma.chapters.estimation import ESTIMATION, Estimates
from snapo.domains.pharma.chapters.headline import status
from snapo.domains.pharma.chapters.optimum import OPTIMUM, BestRecipe
from snapo.domains.pharma.chapters.verification import (
    BALANCES,
    CONVERGENCE,
    DIFFERENCES,
    Balance,
    CheckedPoint,
)
from snapo.domains.pharma.derivatives.convergence import Convergence, ConvergenceRow
from snapo.domains.pharma.flowsheet.possible import smallest
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.quality.batches import AttributeLimits
from snapo.domains.pharma.quality.capability import Capability
from snapo.domains.pharma.read.case import resolve

FIXED = {"method": "mesh", "refine": False}


@pytest.mark.prove
def test_an_unstable_integration_fails_the_command(tmp_path, capsys):
    """A -> B at 0.26 1/s for an hour on 320 steps: 9.6e28 mol/L, or a zero that nothing warrants."""
    numerics = '[numerics]\nmethod = "mesh"\nrefine = false\n'
    (tmp_path / "case.toml").write_text(FAST + numerics, encoding="utf-8")
    out = tmp_path / "run"
    assert main(["solve", str(tmp_path), "--out", str(out), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    words = "integration failed: reactor: the time steps are too long from 0 s on"
    assert found["status"].startswith(words)
    assert words.removeprefix("integration failed: ") in (out / "report.html").read_text("utf-8")


@pytest.mark.prove
@pytest.mark.parametrize(("rate", "good"), [(0.26, False), (0.2476, False), (0.02, True)])
def test_steps_that_are_too_long_are_told_from_good_ones(rate, good):
    run = PharmaProcess(fast(rate, **FIXED)).run()
    assert (run.status == "ok") == good, run.status
    if good:
        assert run.measures["reactor.concentration.A"] == pytest.approx(np.exp(-72), abs=1e-12)


@pytest.mark.prove
def test_what_cannot_be_is_a_status_and_keeps_no_limit():
    """A porosity of 0.99 leaves less filtrate than nothing: its time is below 0 and under 300 s."""
    bad = cake_filter(porosity=number("filter.porosity", 0.99))
    case = flagship()
    units = tuple(bad if each.name == "filter" else each for each in case.units)
    case = replace(case, units=units)
    run = PharmaProcess(case).run()
    assert run.measures["filter.time"] < 0
    assert run.status.startswith("filter.time is -") and "which is impossible" in run.status


def test_a_limit_is_not_kept_by_what_cannot_be():
    limits = AttributeLimits.of(resolve(TEMPLATE, tomllib.loads(TEMPLATE.read_text("utf-8"))))
    good = np.array([27.0, 80.0, 0.1, 500.0, 80.0, 200.0])
    assert limits.hold(good).all()
    assert limits.hold(np.where(np.arange(6) == 5, -20.9, good)).tolist() == [True] * 5 + [False]
    assert smallest("crystalliser.supersaturation") == pytest.approx(-1)
    assert smallest("process.yield.C.A") == -np.inf


def balance(**values) -> tuple[Balance]:
    return (filled(Balance, quantity="mass", **values),)


def gaps(adaptive: float) -> Convergence:
    rows = [filled(ConvergenceRow, attribute="a", parameter="value", adaptive_gap=1e-9)]
    rows.append(filled(ConvergenceRow, attribute="b", parameter="T", adaptive_gap=adaptive))
    return Convergence(tuple(rows), adaptive < 1e-6)


def point(passed: bool) -> tuple[CheckedPoint]:
    return (filled(CheckedPoint, attribute="a", parameter="T", passed=passed),)


GOOD = {
    ONE_BATCH: filled(BatchResult, status="ok", attributes={"a": 1.0}),
    BALANCES: balance(),
    CONVERGENCE: gaps(0.0),
    DIFFERENCES: point(True),
    ATTRIBUTION: filled(Attributions, closure=1e-14),
    CAPABILITY: filled(Capability, batches=1000, failed=1),
}


@pytest.mark.parametrize(
    ("chapter", "record", "said"),
    [
        (ONE_BATCH, filled(BatchResult, status="reactor: no end at 3 s"), "reactor: no end at 3 s"),
        (ONE_BATCH, filled(BatchResult, status="ok", attributes={"a": np.nan}), "a is not a number"),
        (BALANCES, balance(unit="dryer", relative=1e-3), "a check fails: balances (dryer, mass)"),
        (BALANCES, balance(relative=np.nan), "a check fails: balances (mass)"),
        (CONVERGENCE, gaps(1e-2), "a check fails: convergence in time (b, T)"),
        (DIFFERENCES, point(False), "a check fails: adjoint against differences (a, T)"),
        (ATTRIBUTION, filled(Attributions, closure=np.nan), "a check fails: paths add up"),
        (ESTIMATION, filled(Estimates, converged=False, message="cap"), "the fit did not converge: cap"),
        (OPTIMUM, filled(BestRecipe, converged=False, message="cap"), "the best recipe did not converge: cap"),
        (CAPABILITY, filled(Capability, batches=1000, failed=20), "2 % of the batches gave no finite result"),
    ],
)  # fmt: skip
def test_every_failed_check_is_a_status(chapter, record, said):
    assert status(folder(*GOOD.items())) == "ok"
    assert status(folder(*(GOOD | {chapter: record}).items())) == said


def test_the_case_of_other_tests_is_in_order():
    assert resolve(TEMPLATE, tomllib.loads(CASE) | {"estimation": None}).notes == ()
