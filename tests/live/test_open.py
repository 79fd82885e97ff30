"""`snapo open` refuses in a sentence whatever it cannot show."""

import json

import pytest

from snapo.case.error import CaseError
from snapo.live.open import about_run
from snapo.study import run_folder


def run(folder, kind="gas-storage", **result):
    record = {"kind": kind, "layout": run_folder.LAYOUT, "decides": {"options": {}}, "parts": {}}
    (folder / run_folder.RUN).write_text(
        json.dumps(record | {"about": {"title": "T", "step": 0.5}})
    )
    (folder / run_folder.RESULT).write_text(json.dumps(result))
    return folder


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(CaseError, match="not the folder of a run"):
        about_run(tmp_path)


def test_a_run_without_a_policy_is_refused(tmp_path):
    with pytest.raises(CaseError, match="no trained policy"):
        about_run(run(tmp_path, value=1.0))


def test_a_simulator_of_ones_own_must_be_named_again(tmp_path):
    run(tmp_path, "own", value=1.0)
    record = json.loads((tmp_path / run_folder.RUN).read_text())
    record["decides"]["options"]["simulator"] = "mine:Mine"
    (tmp_path / run_folder.RUN).write_text(json.dumps(record))
    with pytest.raises(CaseError, match="name it again: --simulator mine:Mine"):
        about_run(tmp_path)


def test_what_is_known_without_computing(tmp_path):
    run(tmp_path, value=1.5, standard_error=0.1)
    (tmp_path / run_folder.POLICY).touch()
    found = about_run(tmp_path)
    assert found["title"] == "T" and found["step"] == "step"  # a length in years is no word
    assert found["result"]["value"] == 1.5
