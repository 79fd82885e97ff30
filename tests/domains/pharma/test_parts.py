"""Which parts a run has, their progress, and the words where one is not there."""

import math
import tomllib

import numpy as np
import pytest
from tests.domains.pharma.filled import filled, folder, plain
from tests.domains.pharma.pharma_cases import CASE, LOOP, SMALLER, TEMPLATE, data

from snapo.case.error import CaseError
from snapo.domains.pharma import progress
from snapo.domains.pharma.chapters.batch import ONE_BATCH, BatchResult
from snapo.domains.pharma.chapters.design_space import SPACE, SpaceMap, boundary_rows, map_rows
from snapo.domains.pharma.chapters.headline import marks
from snapo.domains.pharma.chapters.model import AttributeStatement
from snapo.domains.pharma.chapters.optimum import OPTIMUM, BestRecipe, KeptChance
from snapo.domains.pharma.chapters.ranges import RANGES
from snapo.domains.pharma.chapters.verification import BALANCES, CONVERGENCE, Balance
from snapo.domains.pharma.derivatives.convergence import Convergence
from snapo.domains.pharma.quality.boundary import Boundary
from snapo.domains.pharma.quality.ranges import AcceptableRange, ProvenRange
from snapo.domains.pharma.read.case import PARTS, resolve
from snapo.domains.pharma.study import study
from snapo.report.folder import RunFiles, RunResult
from snapo.report.page import Missing
from snapo.report.record import PartState
from snapo.study.domain import Options


def case(folder, text=CASE, **tables):
    (folder / "batch.csv").write_text(data())
    return resolve(folder / "case.toml", tomllib.loads(text) | tables)


def names(folder, *parts, text=CASE):
    found = study(case(folder, text, report={"parts": list(parts)}), Options())
    return [part.name for part in found.parts], found.about


def test_every_part_has_a_known_name(tmp_path):
    loop = {k: v for k, v in tomllib.loads(LOOP).items() if k not in SMALLER}
    every = study(case(tmp_path, **loop), Options())
    assert [part.name for part in every.parts] == list(PARTS)


def test_parts_are_chosen_with_what_they_need(tmp_path):
    found, about = names(tmp_path, "capability")
    assert found == ["one batch", "integration", "mesh of statistics", "capability"]
    assert about["planned"] == found and "design space" in about["left_out"]
    assert len(names(tmp_path)[0]) > 12


def test_a_part_that_is_not_known_is_refused(tmp_path):
    with pytest.raises(CaseError, match=r"report.parts\[0\].*the nearest known part is capability"):
        names(tmp_path, "capabilty")


def test_progress_is_told_some_seconds_apart(monkeypatch):
    clock, lines = [0.0], []
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock[0])
    progress.say("nobody listens")
    with progress.reporting(lines.append):
        for clock[0] in (1.0, 11.0, 12.0, 25.0):
            progress.say(f"{clock[0]:.0f} of 30")
    assert lines == ["  11 of 30, 11 s", "  25 of 30, 25 s"]


@pytest.mark.parametrize(
    ("details", "parts", "words"),
    [
        ({"planned": []}, {}, "The case has no `[design_space]`."),
        ({"planned": ["design space"]}, {}, "stopped before its part “design space”"),
        ({}, {"design space": PartState("failed", "a stone")}, "failed: a stone"),
        ({}, {"design space": PartState("done")}, "has nothing to show"),
    ],
)
def test_a_section_says_why_it_is_empty(details, parts, words):
    block = SPACE(RunFiles(RunResult(), details, parts, (), {}, {})).blocks[0]
    assert isinstance(block, Missing) and words in block.text


def test_the_map_names_the_attribute_that_binds():
    found = filled(
        SpaceMap, grid=(np.array([1.0, 2.0]), np.array([3.0])), axes=("a", "b"), units=("K", "1"),
        probability=[[0.5], [1.0]], error=[[0.1], [0.1]], low=[[0.4], [0.9]], high=[[0.6], [1.0]],
        binding=[[1], [-1]],
    )  # fmt: skip
    header, rows = map_rows(found, ["yield", "size"])
    assert header[-1] == "binding" and [row[-1] for row in rows] == ["size", ""]


def test_the_places_of_the_boundary_are_without_round_off():
    end = Boundary(1, (1, -1), 1, 0.1 + 0.2, math.nan, 308.34000000000003, 0)
    grid = (np.array([1.0, 0.7 + 0.1]), np.array([3.0]))
    found = filled(SpaceMap, grid=grid, axes=("a", "b"), units=("K", "1"), ends=(end,))
    _, rows = boundary_rows(found, ["yield"])
    ((*at, along, side, place, inner, outer, which),) = rows
    assert at == [0.8, 0.3] and (place, outer) == (0.3, 308.34) and math.isnan(inner)
    assert (along, side, which) == ("b [1]", "above", "yield")


def test_a_whole_number_of_samples_is_asked_for_with_both_ends(tmp_path):
    space = tomllib.loads(CASE)["design_space"] | {"samples": 10_000_000}
    with pytest.raises(CaseError, match="a whole number from 16 to 1,000,000"):
        case(tmp_path, design_space=space)


def test_the_template_reads_with_its_parts():
    read = tomllib.loads(TEMPLATE.read_text("utf-8")) | {"report": {"parts": ["one batch"]}}
    assert resolve(TEMPLATE, read).parts == ("one batch",)


def balance(relative: float) -> tuple:
    return BALANCES, (filled(Balance, quantity="A", relative=relative),)


def proven(inside: bool) -> tuple:
    probable = filled(AcceptableRange, holds_normal=inside)
    return RANGES, (filled(ProvenRange, parameter="T", probable=probable),)


WORSE = filled(BestRecipe, chance=(KeptChance(0.85, 0.01), KeptChance(0.09, 0.01)))
HOLD = "✓ all 2 numerical checks hold"


@pytest.mark.parametrize(
    ("entry", "status", "expected"),
    [
        (balance(0.0), "ok", [HOLD]),
        (balance(1.0), "a check fails: balances (A)",
         ["✗ 1 of 2 numerical checks fail: balances"]),
        (balance(0.0), "the fit did not converge: cap", ["✗ the fit did not converge: cap"]),
        (proven(False), "ok", [HOLD, "✗ normal ranges not inside the proven ranges: T"]),
        (proven(True), "ok",
         [HOLD, "✗ normal ranges inside the proven ranges, but not with 95 % confidence: T"]),
        ((ONE_BATCH, filled(BatchResult, status="ok", holds=(False,))), "ok",
         [HOLD, "✗ at the set point a limit is broken: size"]),
        ((OPTIMUM, WORSE), "ok",
         [HOLD,
          "✗ the optimised recipe meets all limits less often, 9.0 % instead of 85.0 %: "
          "use a reserve"]),
    ],
)  # fmt: skip
def test_nothing_good_stands_alone_above_what_fails(entry, status, expected):
    known = (balance(0.0), (CONVERGENCE, filled(Convergence)))
    size = plain(AttributeStatement("size"))
    run = folder(*known, entry, result={"status": status}, attributes=[size])
    texts = [f"{'✓' if mark.good else '✗'} {mark.text}" for mark in marks(run)]
    assert [text.replace("\N{NO-BREAK SPACE}", " ") for text in texts] == expected
