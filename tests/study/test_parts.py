"""The tables of the parts that every study can have, against their definitions."""

import json
from dataclasses import asdict, dataclass

import numpy as np
import pytest
from tests.study.fake import parts

from snapo.problem.inputs import Input
from snapo.report.evidence import history, making
from snapo.report.folder import RunFiles, RunResult
from snapo.report.missing import not_asked, unless_left_out
from snapo.report.page import Chart, Missing, Page, Text, render
from snapo.study import training
from snapo.study.chapter import Chapter, Floats, Number
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION, distributed
from snapo.study.chapters.headline import headline
from snapo.study.chapters.profile import PROFILE, bands, profile
from snapo.study.chapters.sensitivities import InputMove, direction, sensitivities
from snapo.study.run_folder import plain_json

SECTIONS = (headline, sensitivities, DISTRIBUTION, PROFILE, history, CERTIFICATE, making)


def described(total):
    """Every path is a group of its own."""
    return distributed(total, np.arange(total.size))


def test_a_distribution_is_that_of_its_paths():
    total = np.random.default_rng(0).normal(10, 2, 4000)
    found = described(total)
    assert found.mean == total.mean() and found.paths == 4000
    assert found.quantiles["p05"] == np.quantile(total, 0.05)
    assert found.tail_mean == pytest.approx(np.sort(total)[:200].mean())
    assert found.counts.sum() == 4000, "paths beyond the edges are in the outermost bins"
    assert len(found.edges) == len(found.counts) + 1


def test_totals_that_do_not_vary_or_are_not_finite():
    same = described(np.full(50, 3.0))
    assert (same.counts.tolist(), same.edges.tolist()) == ([50], [2.5, 3.5])
    assert described(np.array([1.0, np.nan, np.inf])).paths == 1
    assert described(np.array([np.nan])).paths == 0


def test_bands_are_quantiles_over_paths():
    values = np.arange(12.0).reshape(3, 4)
    values[1] = np.nan
    values[2, 0] = np.inf
    found = bands(values)
    assert found["mean"][0] == 1.5 and found["p50"][0] == 1.5
    assert np.isnan(found["mean"][1])
    assert found["mean"][2] == 10.0, "the path that is not finite is left out"


def test_what_never_moves_is_a_sentence_and_no_picture(tmp_path):
    series = [
        {"name": "cost", "kind": "outputs", "unit": "EUR", **bands(np.full((4, 9), 0.5))},
        {"name": "sold", "kind": "outputs", "unit": "", **bands(np.arange(36.0).reshape(4, 9))},
    ]
    run = write(tmp_path, {"profile": {"profile": {"series": series, "paths": 9}}}, {}, {})
    doubled = profile(factor=lambda run, series: 2.0 if series.name == "cost" else 1.0)
    picture, sentence = doubled(run).blocks
    assert isinstance(picture, Chart) and picture.caption.startswith("Sold (output of one step)")
    assert isinstance(sentence, Text)
    assert sentence.text == "Cost (output of one step) is 1\N{NO-BREAK SPACE}EUR in every week."


def test_an_input_moves_by_its_own_move_or_by_a_share():
    assert direction(Input([2.0, -4.0])).tolist() == [0.02, -0.04]
    assert direction(Input([2.0, -4.0], move=0.5)).tolist() == [0.5, 0.5]
    assert InputMove("rate", amount=25.0, unit="bp").size == "+25\N{NO-BREAK SPACE}bp"
    assert InputMove("rate", share=0.01).size == "+1\N{NO-BREAK SPACE}%"


def write(folder, parts: dict, result: dict, states: dict) -> RunFiles:
    (folder / "parts").mkdir()
    for name, tables in parts.items():
        (folder / "parts" / f"{name}.json").write_text(json.dumps(plain_json(tables)))
    about = {"title": "A run", "unit": "EUR", "step": "week", "objective_output": "cash"}
    (folder / "run.json").write_text(json.dumps({"about": about, "parts": states}))
    (folder / "result.json").write_text(json.dumps(result))
    return RunFiles.read(folder)


def test_sections_of_a_run_without_anything_say_so(tmp_path):
    states = {"training": {"state": "failed", "note": "ZeroDivisionError: by zero"}}
    states["moves"] = {"state": "skipped", "note": "it needs training"}
    run = write(tmp_path, {}, {"status": "training, moves failed"}, states)
    for section in SECTIONS[:-1]:
        blocks = section(run).blocks
        assert isinstance(blocks[0], Missing), section
    page = render(Page("A run", [], [section(run) for section in SECTIONS]))
    assert "The part “training” failed: ZeroDivisionError: by zero." in page
    assert "This run stopped before its part “profile”." in page


def test_parts_are_chosen_with_all_that_they_need():
    given = parts([1.0])
    assert training.with_needs(given, []) == given
    doubled = training.with_needs(given, ["doubled", "not of this case"])
    assert [part.name for part in doubled] == ["first sum", "doubled"]
    assert training.summary(given, doubled) == {
        "planned": ["first sum", "doubled"], "left_out": ["alone"]
    }  # fmt: skip


def test_a_part_that_was_not_asked_for_is_no_part_that_is_missing(tmp_path):
    run = write(tmp_path, {}, {}, {"moves": {"state": "done", "note": ""}})
    run.details["left_out"] = ["profile", "moves", "bound"]
    assert PROFILE(run).blocks == []
    asked = unless_left_out(sensitivities, "profile")
    assert asked.__name__ == "sensitivities" and asked(run).blocks == []
    # The section has numbers of a part of an earlier run, and of several parts if one is there.
    for names in (("moves",), ("profile", "moves"), ("distribution",)):
        assert unless_left_out(sensitivities, *names)(run).blocks != []
    (sentence,) = not_asked(run)
    assert sentence.text.endswith("(`[report] parts`): profile, bound.")
    assert not_asked(RunFiles(RunResult(), {}, {}, (), {}, {})) == []


@dataclass(frozen=True)
class Level:
    height: Number
    line: Floats


@dataclass(frozen=True)
class Lake:
    levels: tuple[Level, ...]
    deepest: str | None = None


def lake(run) -> Lake:
    return Lake((Level(np.nan, np.array([1.0, np.nan])), Level(2.0, np.zeros(0))))


@pytest.mark.parametrize("key", ["", "lake"])
def test_a_result_comes_back_from_its_file_as_it_was_measured(tmp_path, key):
    chapter = Chapter("the lake", "A lake", Lake, lake, lambda run, x: [Text(str(x.deepest))],
                      key=key)  # fmt: skip
    part = chapter.part
    run = write(tmp_path, {part.file.removesuffix(".json"): part.work(None)}, {}, {})
    first, second = chapter.of(run).levels
    assert np.isnan(first.height) and second.height == 2.0
    assert first.line[0] == 1.0 and np.isnan(first.line[1]) and second.line.size == 0
    assert chapter(run).blocks == [Text("None")] and chapter(run).name == "the-lake"
    assert chapter.of(RunFiles(RunResult(), {}, {}, (), {}, {})) is None


def test_a_file_of_another_form_is_a_missing_result(tmp_path):
    chapter = Chapter("lake", "A lake", Lake, lake, lambda run, x: [], key="lake")
    run = write(tmp_path, {"lake": {"lake": {"levels": "deep"}}}, {}, {"lake": {"state": "done"}})
    assert chapter.of(run) is None and isinstance(chapter(run).blocks[0], Missing)


def test_a_run_without_a_policy_says_why(tmp_path):
    assert "--resume" in str(training.no_policy(tmp_path, {}))
    record = {"about": {"left_out": ["training"]}}
    assert "`[report] parts` do not include the training" in str(
        training.no_policy(tmp_path, record)
    )


def test_sections_of_a_whole_run(tmp_path):
    total = np.random.default_rng(0).normal(1000, 50, 512)
    fan = {"name": "water", "kind": "state", "unit": "hm3", **bands(np.ones((5, 1)) * total[:40])}
    moved = {"input": "rain", "words": "of a week", "amount": 1.0, "share": None, "unit": "hm3",
             "effect": 12.5, "low": 11.4, "high": 13.6, "sampling": 1.0, "policy": 0.1,
             "held": 12.5, "held_error": 0.5, "smooth": 12.0, "smooth_error": 1.0, "bump": 12.4,
             "bump_error": 0.1, "more": 12.0, "less": 12.8, "source": "held"}  # fmt: skip
    parts = {
        "distribution": {
            "distribution": [asdict(described(total)) | {"name": "cash", "unit": "EUR"}]
        },
        "profile": {"profile": {"series": [fan], "paths": 40, "notes": ["a remark"]}},
        "moves": {"moves": [moved, moved | {"input": "snow", "more": None, "less": None}]},
        "certificate": {"certificate": {"bump_check": [], "feasibility": []}},
    }
    states = {name: {"state": "done", "note": "", "seconds": 1.0} for name in parts}
    result = {"value": 1000.0, "standard_error": 2.2, "status": "trained", "smoothing_gap": -0.5}
    (tmp_path / "sensitivities.csv").write_text(
        "input,label,unit,source,value,low,high,held,held_error,smooth,smooth_error,moved\n"
        "rain,,hm3,held,12.5,11.4,13.6,12.5,0.5,12,1,0.1\n"
    )
    run = write(tmp_path, parts, result, states)
    page = render(Page("A run", [], [section(run) for section in SECTIONS]))
    for words in ("1,000.0", "± 4.3".replace(" ", "\N{NO-BREAK SPACE}"), "trained to the end",
                  "a remark", "of a week", "Water (state) on 40 paths", "Cash: the total of a path",
                  "its method <code>slack</code> names none", "12.00 more, 12.80 less",
                  ">12.40<"):  # fmt: skip
        assert words in page, words
