"""A run from the command to its folder: what is written, and what survives being stopped."""

import csv
import datetime
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES, changed, read

from snapo.case.error import CaseError
from snapo.case.table import load
from snapo.cli import commands
from snapo.cli.main import main
from snapo.domains.gas_storage import run
from snapo.solver import checkpoint, train
from snapo.study import run_folder as runfolder

KEYS = {
    "kind": str,
    "value": float,
    "standard_error": float,
    "smooth_value": float,
    "smoothing_gap": float,
    "policy_gradient_norm": float,
    "references": dict,
    "seconds": dict,
    "engine": str,
    "paths": dict,
    "seed": int,
    "status": str,
    "run": str,
}
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
    for name, keys in (("training", TRAINING), ("evaluation", EVALUATION)):
        text += f"[{name}]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items())
    (folder / "case.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def case(folder):
    """Read once: what is compiled for it is compiled once."""
    return changed(folder)


def solve(case, out, **options):
    given = {"seed": 3, "engine": "native", "progress": lambda text: None}
    return run.solve(case, out=out, **given | options)


@pytest.fixture(scope="module")
def whole(case, tmp_path_factory):
    """A run that nobody stops."""
    out = tmp_path_factory.mktemp("whole") / "run"
    return solve(case, out), out


def same_bits(one: Path, other: Path) -> None:
    results = [json.loads((folder / "result.json").read_text()) for folder in (one, other)]
    for key in ("value", "standard_error", "smooth_value", "policy_gradient_norm", "status"):
        assert results[0][key] == results[1][key]
    policies = [np.load(folder / "policy.npz") for folder in (one, other)]
    assert policies[0].files == policies[1].files
    for name in policies[0].files:
        assert policies[0][name].tobytes() == policies[1][name].tobytes()
    for table in ("sensitivities.csv", "profile.csv"):
        assert (one / table).read_bytes() == (other / table).read_bytes()
    histories = [table_of(folder / "history.csv") for folder in (one, other)]
    for row in (*histories[0], *histories[1]):
        del row["seconds"]
    assert histories[0] == histories[1]


def table_of(file: Path) -> list[dict[str, str]]:
    with file.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


# What a run leaves.


def test_the_result(whole):
    result, out = whole
    assert set(result) == set(KEYS)
    for key, kind in KEYS.items():
        assert isinstance(result[key], kind), key
    assert set(result["references"]) == {"intrinsic", "dynamic_programming"}
    assert result["references"]["dynamic_programming"] is None
    assert set(result["seconds"]) == {"compile", "train", "evaluate", "total"}
    assert result["paths"] == {"train": 64, "evaluate": 512}
    assert (result["kind"], result["engine"]) == ("gas-storage", "native")
    assert (result["seed"], result["status"], result["run"]) == (3, "trained", str(out))
    assert json.loads((out / "result.json").read_text()) == result
    assert result["value"] > result["references"]["intrinsic"] * 0.98
    gap = result["value"] - result["smooth_value"]
    assert gap == pytest.approx(result["smoothing_gap"])


def test_the_folder(whole, case):
    _, out = whole
    names = {file.name for file in out.iterdir()}
    files = {"result.json", "sensitivities.csv", "profile.csv", "history.csv", "policy.npz"}
    assert names >= files | {"report.html", "case", "details.json"}
    assert not [name for name in names if name.endswith(".partial")]
    assert load(out / "case")[1] == load(case.file)[1]
    assert {"case.toml", "curve.csv"} <= {file.name for file in (out / "case").iterdir()}
    rows = table_of(out / "sensitivities.csv")
    assert list(rows[0]) == ["input", "label", "value", "standard_error", "unit"]
    curve = [row for row in rows if row["input"] == "forward_curve"]
    assert [row["label"] for row in curve] == [day.isoformat() for day in case.days]
    assert {row["unit"] for row in curve} == {"EUR/MWh"}
    assert all(float(row["standard_error"]) >= 0 for row in rows)
    profile = table_of(out / "profile.csv")
    assert [row["date"] for row in profile] == [day.isoformat() for day in case.days]
    history = table_of(out / "history.csv")
    assert [int(row["step"]) for row in history] == list(range(1, STEPS + 1))
    assert (out / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_the_certificate_passes(whole):
    details = json.loads((whole[1] / "details.json").read_text())["certificate"]
    wrong = [row for row in details["bump_check"] if not row["passed"]]
    assert not wrong, wrong
    assert all(row["passed"] for row in details["feasibility"])
    left, error = details["homogeneity"]["left"], details["homogeneity"]["error"]
    assert abs(error) <= 1e-9 * abs(left)


def test_the_report_is_written_again(whole, tmp_path, capsys):
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    (out / "report.html").unlink()
    assert main(["report", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out / "report.html")
    assert (out / "report.html").exists()
    assert main(["report", str(tmp_path)]) == 2


def test_json_prints_one_object(whole, case, folder, tmp_path, monkeypatch, capsys):
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    monkeypatch.setattr(commands, "_read", lambda path: case)
    given = ["--out", str(out), "--resume", "--seed", "3", "--engine", "native", "--json"]
    assert main(["solve", str(folder), *given]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed) == set(KEYS)
    assert printed["value"] == whole[0]["value"]


def test_a_case_without_decisions_left(tmp_path):
    late = read("quick", market={"valuation_date": datetime.date(2025, 3, 1)})
    result = solve(late, tmp_path / "run")
    assert set(result) == set(KEYS)
    assert result["value"] == 0 and result["status"] == "ok"
    assert (tmp_path / "run" / "report.html").exists()


# Being stopped, and going on.


def stop(folder: Path, out: Path, how: int) -> int:
    """Starts `snapo solve`, stops it in the middle of training, and returns its exit code."""
    command = [sys.executable, "-c", HEEDING, "solve", str(folder), "--out", str(out)]
    command += ["--seed", "3", "--engine", "native"]
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


@pytest.mark.parametrize(
    "how", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)]
)
def test_a_stopped_run_goes_on_bit_for_bit(whole, case, folder, tmp_path, how):
    out = tmp_path / "run"
    code = stop(folder, out, how)
    assert code == (130 if how == signal.SIGINT else -signal.SIGKILL)
    assert not (out / "result.json").exists()
    done = len(table_of(out / "history.csv"))
    assert EVERY <= done < STEPS
    said = []
    solve(case, out, resume=True, progress=said.append)
    assert any(text.startswith("resuming after step") for text in said)
    same_bits(whole[1], out)


def test_an_interrupt_while_validating_loses_nothing(whole, case, tmp_path, monkeypatch):
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
        solve(case, out)
    monkeypatch.undo()
    solve(case, out, resume=True)
    same_bits(whole[1], out)


def test_another_case_does_not_resume(whole, case, folder, tmp_path):
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    before = (out / "result.json").read_bytes()
    dearer = changed(folder, contract={"injection_cost": 0.06})
    with pytest.raises(CaseError, match="started with other inputs"):
        solve(dearer, out, resume=True)
    longer = replace(case, training=case.training.model_copy(update={"steps": STEPS + 1}))
    with pytest.raises(CaseError, match=f"'steps': {STEPS}.*'steps': {STEPS + 1}"):
        solve(longer, out, resume=True)
    assert (out / "result.json").read_bytes() == before
    (out / "checkpoint.npz").write_bytes(b"not a checkpoint")
    with pytest.raises(CaseError, match="cannot be read"):
        solve(case, out, resume=True)


# Folders that do not serve.


def test_a_file_where_the_folder_should_be(case, tmp_path):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "run"):
        with pytest.raises(CaseError, match="is not a folder"):
            solve(case, out)


def test_a_folder_that_cannot_be_written(case, tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(runfolder.tempfile, "TemporaryFile", refuse)
    with pytest.raises(CaseError, match=r"cannot write there \(Permission denied\)"):
        solve(case, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_too_little_space(case, tmp_path, monkeypatch):
    usage = type(shutil.disk_usage(tmp_path))(100 << 20, 93 << 20, 7 << 20)
    monkeypatch.setattr(runfolder.shutil, "disk_usage", lambda place: usage)
    with pytest.raises(CaseError, match="7 MB are free there; a run needs 64 MB"):
        solve(case, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def full_disk(*given, **named):
    raise OSError(28, "No space left on device", "somewhere")


def test_a_checkpoint_that_cannot_be_written_is_a_status(case, tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "save", full_disk)
    said = []
    result = solve(case, tmp_path / "run", progress=said.append)
    assert result["status"] == "not written"
    assert any("No space left on device" in text for text in said)
    assert np.isfinite(result["value"])
    stored = json.loads((tmp_path / "run" / "result.json").read_text())
    assert stored["status"] == "not written"


def test_results_that_cannot_be_written_are_a_status(
    whole, case, folder, tmp_path, monkeypatch, capsys
):
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    monkeypatch.setattr(runfolder, "write_text", full_disk)
    monkeypatch.setattr(commands, "_read", lambda path: case)
    given = ["--out", str(out), "--resume", "--seed", "3", "--engine", "native", "--json"]
    assert main(["solve", str(folder), *given]) == 1
    printed = json.loads(capsys.readouterr().out)
    assert printed["status"] == "not written" and printed["value"] == whole[0]["value"]
