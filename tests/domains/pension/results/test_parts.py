"""Runs of some parts alone: which are done, what is refused, and what the report then has."""

import json
import math
import re
from dataclasses import replace

import pytest
from tests.domains.pension.pots_cases import fund as fund_of_pots
from tests.domains.pension.results.test_frontier import fund

from snapo.case.settings import TrainingTable
from snapo.domains.pension import DOMAIN
from snapo.domains.pension.records.case import PARTS, missing_parts
from snapo.domains.pension.results import study
from snapo.study.carry_out import carry_out
from snapo.study.domain import Options

TRAINING = TrainingTable(steps=2, warmup=1, paths=64, validation_paths=64, validation_every=1)
DECIDES = {"case": {}, "options": {}, "files": {}}


def names(*parts: str) -> list[str]:
    return [part.name for part in study.requested(replace(fund(), parts=parts))]


def test_every_part_has_a_name_that_a_case_may_ask_for():
    every = {part.name: None for case in (fund(), fund_of_pots()) for part in study.parts(case)}
    assert tuple(every) == PARTS
    assert names() == [name for name in PARTS if name != "pots"]


def test_what_a_wanted_part_needs_is_done_too():
    assert names("today") == ["training", "objective", "paths", "today"]
    assert names("stress") == ["reconciliation", "stress"]
    assert names("outputs", "reconciliation") == [
        "reconciliation", "training", "objective", "outputs"
    ]  # fmt: skip


def test_a_part_that_the_case_cannot_have_is_lacking_with_its_reason():
    promised, personal = fund(), fund_of_pots()
    assert missing_parts(promised, True) == {"pots": "the case has no [pots]"}
    assert missing_parts(promised, False)["stress"] == "the case has no [stress]"
    assert "[frontier]" in missing_parts(replace(promised, frontier=None), True)["frontier"]
    own = {part.name for part in study.parts(personal)}
    assert set(missing_parts(personal, True)) == set(PARTS) - own


def solved(out, resume: bool = False, parts: tuple[str, ...] = ("today",)):
    told: list[str] = []
    case = replace(fund(), parts=parts, training=TRAINING)
    made = study.pension_study(case, Options())
    return carry_out(DOMAIN, made, out, DECIDES, resume, told.append), told


def sections(out) -> set[str]:
    page = (out / "report.html").read_text(encoding="utf-8")
    assert 'class="missing"' not in page and "not requested" in page
    return set(re.findall(r'<section id="([^"]+)"', page))


@pytest.mark.prove
def test_a_run_of_few_parts_is_whole(tmp_path, sketched):
    """Value, decision and report are there; resumed, nothing is done again."""
    result, _ = solved(tmp_path)
    assert (result["status"], result["failures"]) == ("trained", {})
    assert math.isfinite(result["value"]) and result["references"] == {}
    record = json.loads((tmp_path / "run.json").read_text())
    assert list(record["parts"]) == record["about"]["planned"] == names("today")
    assert {"trades", "ladder", "funding", "history"} <= sections(tmp_path)
    assert not {"reconciliation", "policies", "frontier", "stress"} & sections(tmp_path)
    again, told = solved(tmp_path, resume=True)
    assert told == [] and again["value"] == result["value"]


@pytest.mark.prove
def test_a_run_without_training_has_no_value_and_says_so(tmp_path, sketched):
    result, _ = solved(tmp_path, parts=("reconciliation",))
    assert result["status"] == "ok" and "value" not in result
    assert sections(tmp_path) == {"headline", "reconciliation", "assumptions"}
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "This run trained no policy" in page and "Versions" in page
