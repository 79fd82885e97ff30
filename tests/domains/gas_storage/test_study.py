"""A run of a storage case from its tables to its folder, and a run that was stopped and goes on."""

import csv
import datetime
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES, changed, tables_of

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.chapters import value
from snapo.solver import checkpoint, train
from snapo.study import commands, run_folder
from snapo.study.carry_out import carry_out
from snapo.study.domain import Options
from snapo.study.run_folder import decisive

HEAD = {"kind", "value", "standard_error", "references", "status", "seconds", "failures", "run"}
PARTS = [
    "intrinsic value", "training", "profile", "deltas", "vega", "shadow prices", "certificate",
]  # fmt: skip
PARTS += ["bound", "dynamic programming", "value ladder"]
STEPS, EVERY = 300, 10

# Whoever starts the tests in the background passes on that interrupts are ignored.
HEEDING = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from snapo.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
TRAINING = {"steps": STEPS, "paths": 64, "validation_paths": 128, "validation_every": EVERY}
EVALUATION = {"paths": 512}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A case on disk, small, with enough steps to be stopped in the middle."""
    folder = Path(shutil.copytree(CASES / "quick", tmp_path_factory.mktemp("run") / "case"))
    text = (folder / "case.toml").read_text().partition("[training]")[0]
    given = {"training": TRAINING | {"seed": 3}, "evaluation": EVALUATION}
    for name, keys in given.items():
        text += f"[{name}]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items())
    (folder / "case.toml").write_text(text)
    return folder


def solve(folder, out, progress=lambda text: None, **options):
    """`snapo solve` of a case in a folder."""
    asked = commands.CaseRequest(folder, options.pop("assignments", ()))
    return commands.solve(asked, progress, out=out, **{"engine": "native"} | options)


@pytest.fixture(scope="module")
def whole(folder, tmp_path_factory):
    """A run that nobody stops."""
    out = tmp_path_factory.mktemp("whole") / "run"
    return solve(folder, out, reference=True), out


def same_bits(one: Path, other: Path) -> None:
    results = [json.loads((folder / "result.json").read_text()) for folder in (one, other)]
    for key in ("value", "standard_error", "smooth_value", "policy_gradient_norm", "status"):
        assert results[0][key] == results[1][key]
    policies = [np.load(folder / "policy.npz") for folder in (one, other)]
    assert policies[0].files == policies[1].files
    for name in policies[0].files:
        assert policies[0][name].tobytes() == policies[1][name].tobytes()
    for table in ("sensitivities.csv", "profile.csv", "parts/profile.json", "parts/deltas.json"):
        assert (one / table).read_bytes() == (other / table).read_bytes()
    histories = [table_of(folder / "history.csv") for folder in (one, other)]
    for row in (*histories[0], *histories[1]):
        del row["seconds"]
    assert histories[0] == histories[1]


def table_of(file: Path) -> list[dict[str, str]]:
    with file.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def details_of(out: Path) -> dict:
    found = json.loads((out / "run.json").read_text())["about"]
    for file in (out / "parts").iterdir():
        found |= json.loads(file.read_text())
    return found


@pytest.fixture(autouse=True)
def charts(sketched):
    """Only the run that nobody stops lays its charts out."""


# The folder that a run leaves.


@pytest.mark.prove
def test_the_result(whole):
    result, out = whole
    assert set(result) >= HEAD
    references = result["references"]
    assert set(references) == {"intrinsic", "dynamic_programming", "upper_bound"}
    assert references["intrinsic"] < references["dynamic_programming"]
    error = result["standard_error"]
    assert result["value"] <= references["dynamic_programming"] + 3 * error
    assert result["value"] > references["intrinsic"] * 0.98
    assert set(result["seconds"]) >= {"compile", "train", "evaluate", "total", *PARTS}
    assert result["paths"] == {"train": 64, "evaluate": 512}
    assert (result["kind"], result["engine"]) == ("gas-storage", "native")
    assert (result["seed"], result["status"], result["run"]) == (3, "trained", str(out))
    assert json.loads((out / "result.json").read_text()) == result
    gap = result["value"] - result["smooth_value"]
    assert gap == pytest.approx(result["smoothing_gap"])


@pytest.mark.prove
def test_the_folder(whole, folder):
    _, out = whole
    names = {file.name for file in out.iterdir()}
    files = {"result.json", "sensitivities.csv", "profile.csv", "history.csv", "policy.npz"}
    assert names >= files | {"report.html", "case", "run.json", "parts"}
    assert not list(out.rglob("*.partial"))
    assert load(out / "case")[1] == load(folder)[1]
    assert {"case.toml", "curve.csv"} <= {file.name for file in (out / "case").iterdir()}
    days = details_of(out)["days"]
    rows = table_of(out / "sensitivities.csv")
    curve = [row for row in rows if row["input"] == "forward_curve"]
    assert [row["label"] for row in curve] == days and len(days) == 30
    assert {row["unit"] for row in curve} == {"EUR/MWh"}
    assert all(float(row["held_error"]) >= 0 for row in rows)
    profile = table_of(out / "profile.csv")
    assert [row["date"] for row in profile] == days
    history = table_of(out / "history.csv")
    assert [int(row["step"]) for row in history] == list(range(1, STEPS + 1))
    assert (out / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


@pytest.mark.prove
def test_every_part_is_done_and_inputs_say_their_meaning(whole):
    record = json.loads((whole[1] / "run.json").read_text())
    assert list(record["parts"]) == PARTS
    assert {each["state"] for each in record["parts"].values()} == {"done"}
    inputs = record["about"]["inputs"]
    assert {row["input"] for row in table_of(whole[1] / "sensitivities.csv")} == set(inputs)
    for name, each in inputs.items():
        assert each["words"] and each["group"], name
    ladder = details_of(whole[1])["value_ladder"]
    assert [each["name"] for each in ladder][:2] == ["Intrinsic", "One-factor rule"]
    assert ladder[3]["name"] == "Dynamic programming"


@pytest.mark.prove
def test_the_certificate_passes(whole):
    details = details_of(whole[1])["certificate"]
    wrong = [row for row in details["bump_check"] if row["passed"] is False]
    assert not wrong, wrong
    assert all(row["passed"] for row in details["feasibility"])
    left, error = details["homogeneity"]["left"], details["homogeneity"]["error"]
    assert abs(error) <= 1e-9 * abs(left)


@pytest.mark.prove
def test_the_exact_value_lies_between_the_bounds(whole):
    found = details_of(whole[1])["bound"]
    exact = whole[0]["references"]["dynamic_programming"]
    assert found["lower"]["low"] <= exact <= found["upper"]["high"]
    assert 0 <= found["gap"]["value"] <= 0.02 * exact
    assert whole[0]["references"]["upper_bound"] == found["upper"]["value"]
    page = (whole[1] / "report.html").read_text(encoding="utf-8")
    assert "No policy earns more than" in page


@pytest.mark.prove
def test_a_run_is_certified_again_with_another_penalty(whole, tmp_path):
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    result = commands.certify(out, lambda text: None, paths=64, penalty="none", engine="native")
    wide, narrow = result["bound"], whole[0]["bound"]
    assert (wide["paths"], wide["penalty"], narrow["penalty"]) == (64, "none", "value")
    assert wide["gap"]["value"] > 10 * narrow["gap"]["value"]
    assert result["value"] == whole[0]["value"] and result["status"] == "trained"
    assert json.loads((out / "result.json").read_text())["bound"] == wide


@pytest.mark.prove
def test_a_run_that_nothing_bounds_says_why(whole, folder, tmp_path):
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    record = json.loads((out / "run.json").read_text())
    record["decides"]["case"]["objective"] = {"kind": "cvar", "level": 0.9}
    run_folder.save(out, record)
    with pytest.raises(CaseError, match=r'only a mean has an upper bound, .* "cvar"'):
        commands.certify(out, lambda text: None)
    with pytest.raises(CaseError, match="this case has no run yet; `snapo solve"):
        commands.certify(folder, lambda text: None)


@pytest.mark.prove
@pytest.mark.parametrize("date", [datetime.date(2025, 3, 1), datetime.date(2025, 1, 31)])
def test_a_case_without_decisions_left(tmp_path, date):
    """After the end it is worth nothing; on the end date half the price of the gas left."""
    market, contract = {"valuation_date": date}, {"end_inventory": "free", "end_value": 0.5}
    file, data = tables_of(CASES / "quick", market=market, contract=contract)
    case = DOMAIN.read(file, data)
    assert "no decision day is left" in DOMAIN.check(case)[0]
    study = DOMAIN.study(case, Options("auto", True))
    out, decides = tmp_path / "run", decisive(file, data, {})
    result = carry_out(DOMAIN, study, out, decides, False, lambda text: None)
    expected = 0.0
    if date == datetime.date(2025, 1, 31):
        expected = 10 * 0.5 * float(case.market.forward_curve.values[-1])
    assert result["value"] == pytest.approx(expected) and result["status"] == "ok"
    assert set(result) >= HEAD and result["failures"] == {}
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "No decision day is left." in page


@pytest.mark.prove
def test_supplied_paths_are_solved_whole(tmp_path):
    """Paths of one's own: no vegas, no lattice, no homogeneity where they ignore the curve."""
    folder = Path(shutil.copytree(CASES / "quick", tmp_path / "case"))
    random, files = np.random.default_rng(0), {}
    for key in ("training_paths", "evaluation_paths"):
        files[key] = f"{key}.npy"
        np.save(folder / files[key], random.uniform(15, 30, (200, 30)))
    model = {"kind": "supplied", "mean_reversion": None, "volatility": None, **files}
    training = {"steps": 4, "paths": 32, "validation_paths": 64}
    file, data = tables_of(folder, model=model, training=training)
    case = DOMAIN.read(file, data)
    study = DOMAIN.study(case, Options("native", True))
    decides = decisive(file, data, {})
    found = carry_out(DOMAIN, study, tmp_path / "run", decides, False, lambda text: None)
    assert found["status"] == "trained", found
    assert found["paths"] == {"train": 32, "evaluate": 200}
    assert found["references"]["dynamic_programming"] is None
    assert details_of(tmp_path / "run")["certificate"]["homogeneity"] is None
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "Supplied price paths" in page and "This run has no vegas" in page


@pytest.mark.prove
def test_a_part_that_fails_loses_no_other(folder, whole, tmp_path, monkeypatch):
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    record = json.loads((out / "run.json").read_text())
    del record["parts"]["value ladder"]
    run_folder.save(out, record)

    def broken(*given):
        raise ZeroDivisionError("nothing to divide by")

    monkeypatch.setattr(value, "_ladder", broken)
    result = solve(folder, out, resume=True, reference=True)
    assert result["status"] == "value ladder failed"
    assert result["failures"] == {"value ladder": "ZeroDivisionError: nothing to divide by"}
    assert result["value"] == whole[0]["value"]
    assert "nothing to divide by" in (out / "report.html").read_text(encoding="utf-8")


# Being stopped, and going on.


def stop(folder: Path, out: Path, how: int) -> int:
    """Starts `snapo solve`, stops it in the middle of training, and returns its exit code."""
    command = [sys.executable, "-c", HEEDING, "solve", str(folder), "--out", str(out)]
    command += ["--engine", "native"]
    with open(out.parent / "log", "wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ)
        try:
            ends = time.monotonic() + 240
            while not (out / "history.csv").exists():
                assert process.poll() is None and time.monotonic() < ends, "it never trained"
                time.sleep(0.002)
            process.send_signal(how)
            return process.wait(60)
        finally:
            process.kill()
            process.wait()


@pytest.mark.prove
@pytest.mark.parametrize(
    "how", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.study)]
)
def test_a_stopped_run_goes_on_bit_for_bit(whole, folder, tmp_path, how):
    out = tmp_path / "run"
    code = stop(folder, out, how)
    assert code == (130 if how == signal.SIGINT else -signal.SIGKILL)
    done = len(table_of(out / "history.csv"))
    assert EVERY <= done < STEPS
    said = []
    solve(folder, out, resume=True, progress=said.append)
    assert any(text.startswith("resuming after step") for text in said)
    same_bits(whole[1], out)


@pytest.mark.study
def test_an_interrupt_while_validating_loses_nothing(whole, folder, tmp_path, monkeypatch):
    """Ctrl-C falls into the validation of a step: that validation is made up for."""
    calls, validate = [], train._validate

    def interrupted(*given):
        calls.append(given)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return validate(*given)

    monkeypatch.setattr(train, "_validate", interrupted)
    out = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        solve(folder, out)
    monkeypatch.undo()
    solve(folder, out, resume=True, reference=True)
    same_bits(whole[1], out)


@pytest.mark.prove
def test_another_case_does_not_resume(whole, folder, tmp_path):
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    before = (out / "result.json").read_bytes()
    with pytest.raises(CaseError, match=r"contract\.injection_cost = 0\.05, and now it is 0\.06"):
        solve(folder, out, resume=True, assignments=("contract.injection_cost=0.06",))
    with pytest.raises(CaseError, match=f"training.steps = {STEPS}, and now it is {STEPS + 1}"):
        solve(folder, out, resume=True, assignments=(f"training.steps={STEPS + 1}",))
    assert (out / "result.json").read_bytes() == before


@pytest.mark.prove
def test_a_checkpoint_that_cannot_be_written_is_a_status(folder, tmp_path, monkeypatch):
    def full_disk(*given, **named):
        raise OSError(28, "No space left on device", "somewhere")

    monkeypatch.setattr(checkpoint, "save", full_disk)
    said, short = [], ("training.steps=20", "evaluation.judge_paths=0")
    result = solve(folder, tmp_path / "run", said.append, assignments=short)
    assert result["status"] == "not written"
    assert any("No space left on device" in text for text in said)
    assert np.isfinite(result["value"])


@pytest.mark.prove
def test_an_engine_that_cannot_run_is_refused_by_name(folder, tmp_path):
    case = changed(folder)
    with pytest.raises(CaseError, match="--engine"):
        DOMAIN.study(case, Options("steam")).setup()
