"""A study carried out: what fails, what is skipped, what a resumed run does again."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.study.fake import DOMAIN, parts, result

from snapo.case.error import CaseError
from snapo.study import run_folder
from snapo.study.carry_out import carry_out
from snapo.study.study import Part, Study

DECIDES = {"case": {"numbers": [1, 2, 4], "training": {"steps": 240}}, "options": {}, "files": {}}


def study(given: list[Part]) -> Study:
    return Study("fake", {"title": "Sums"}, given, result)


def carried(out: Path, given: list[Part], resume: bool = False, decides=DECIDES):
    told: list[str] = []
    return carry_out(DOMAIN, study(given), out, decides, resume, told.append), told


def whole(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def test_a_whole_run(fake, tmp_path):
    found, told = carried(tmp_path, parts([1, 2, 4]))
    assert (found["status"], found["value"], found["failures"]) == ("ok", 7, {})
    seconds = dict(found["seconds"])
    whole_time = seconds.pop("total")
    assert seconds.pop("report") > 0  # which no page can know of itself
    assert set(seconds) == {"preparing", "first sum", "doubled", "alone"}
    assert whole_time == pytest.approx(sum(seconds.values()))
    assert told == ["first sum", "doubled", "alone"]
    assert json.loads((tmp_path / "result.json").read_text()) == found
    assert json.loads((tmp_path / "parts" / "first-sum.json").read_text()) == {"sums": {"total": 7}}
    assert "total 7, doubled 14, alone 3" in whole(tmp_path)


def test_a_failing_part_loses_nothing_else(fake, tmp_path):
    found, told = carried(tmp_path, parts([1, 2, 4], "alone"))
    assert found["status"] == "alone failed"
    assert found["failures"] == {"alone": "ZeroDivisionError: alone was told to fail"}
    assert found["value"] == 7
    assert "alone failed: ZeroDivisionError: alone was told to fail" in told
    assert "doubled 14, alone None" in whole(tmp_path)


def test_a_part_is_skipped_where_another_that_it_needs_failed(fake, tmp_path):
    found, _ = carried(tmp_path, parts([1, 2, 4], "first sum"))
    assert found["failures"]["doubled"] == "it needs first sum"
    assert run_folder.read(tmp_path)["parts"]["doubled"]["state"] == "skipped"
    assert fake == ["first sum", "alone"]
    assert "doubled None, alone 3" in whole(tmp_path)


def test_a_resumed_run_does_again_only_what_is_not_done(fake, tmp_path):
    carried(tmp_path, parts([1, 2, 4], "alone"))
    fake.clear()
    found, _ = carried(tmp_path, parts([1, 2, 4]), resume=True)
    assert fake == ["alone"]
    assert (found["status"], found["value"]) == ("ok", 7)
    assert "total 7, doubled 14, alone 3" in whole(tmp_path)
    other, _ = carried(tmp_path.with_name("other"), parts([1, 2, 4]))
    same = ("value", "status", "failures", "standard_error")
    assert [found[key] for key in same] == [other[key] for key in same]
    for name in ("first-sum.json", "doubled.json", "alone.json"):
        ours, theirs = (folder / "parts" / name for folder in (tmp_path, Path(other["run"])))
        assert ours.read_bytes() == theirs.read_bytes()


def test_a_damaged_part_is_done_again(fake, tmp_path):
    carried(tmp_path, parts([1, 2, 4]))
    (tmp_path / "parts" / "alone.json").write_text('{"alone": ')
    fake.clear()
    carried(tmp_path, parts([1, 2, 4]), resume=True)
    assert fake == ["alone"]


def test_a_new_run_forgets_the_one_before(fake, tmp_path):
    carried(tmp_path, parts([1, 2, 4]))
    (tmp_path / "sensitivities.csv").write_text("input,label\n")
    (tmp_path / "mine.csv").write_text("kept")
    found, _ = carried(tmp_path, parts([1, 2, 4], "alone"))
    assert not (tmp_path / "parts" / "alone.json").exists()
    assert not (tmp_path / "sensitivities.csv").exists()
    assert (tmp_path / "mine.csv").read_text() == "kept"
    assert found["status"] == "alone failed"


def test_an_interrupt_reports_the_parts_that_are_done(fake, tmp_path):
    first, _, alone = parts([1, 2, 4])

    def interrupted(run):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        carried(tmp_path, [first, Part("slow", interrupted), alone])
    found = json.loads((tmp_path / "result.json").read_text())
    assert (found["status"], found["value"]) == ("stopped before slow", 7)
    assert "total 7" in whole(tmp_path)


def test_the_report_of_what_is_done_is_there_while_the_rest_runs(fake, tmp_path, monkeypatch):
    """After parts that took more than a minute, not only at the end."""
    clock, seen = [0.0], []
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])

    def later(run):
        clock[0] += 61.0
        seen.append(
            "total 7" in whole(run.folder) if (run.folder / "report.html").exists() else None
        )
        return {}

    first = parts([1, 2, 4])[0]
    carried(tmp_path, [first, Part("long", later), Part("longer", later)])
    assert seen == [None, True]


def test_the_status_names_what_failed_and_what_the_study_knows(fake, tmp_path):
    """Not the parts that were skipped for it; the study's own words, where they are not good ones."""
    first, doubled, _ = parts([1, 2, 4], "first sum")
    found, _ = carried(tmp_path, [first, doubled])
    assert found["status"] == "first sum failed" and set(found["failures"]) == {
        "first sum",
        "doubled",
    }
    whole = Study("fake", {}, [first], lambda run: {"status": "reactor: did not converge at 3 s"})
    told = carry_out(DOMAIN, whole, tmp_path / "other", DECIDES, False, lambda text: None)
    assert told["status"] == "first sum failed: reactor: did not converge at 3 s"


KILLED = """
import os, sys
from pathlib import Path
from tests.study.test_carry_out import DECIDES, study
from tests.study.fake import DOMAIN, parts
from snapo.study.carry_out import carry_out
from snapo.study.study import Part
first, doubled, alone = parts([1, 2, 4])
killed = Part("doubled", lambda run: os._exit(9), ("first sum",))
carry_out(DOMAIN, study([first, killed, alone]), Path(sys.argv[1]), DECIDES, False, print)
"""


@pytest.mark.prove
def test_a_killed_run_goes_on(fake, tmp_path):
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], timeout=120)
    assert done.returncode == 9
    assert not (tmp_path / "result.json").exists()
    found, _ = carried(tmp_path, parts([1, 2, 4]), resume=True)
    assert fake == ["doubled", "alone"]
    assert (found["status"], found["value"]) == ("ok", 7)


@pytest.mark.parametrize(
    ("now", "clause"),
    [
        ({"case": {"training": {"steps": 300}, "numbers": [1, 2, 4]}},
         "training.steps = 240, and now it is 300"),
        ({"case": {"training": {"steps": 240}}}, "numbers = [1, 2, 4], and now it is not given"),
        ({"options": {"engine": "xla"}}, "engine = not given, and now it is \"xla\""),
        ({"files": {"curve.csv": "ab12"}}, "another curve.csv"),
    ],
)  # fmt: skip
def test_a_changed_case_is_refused_with_its_key(fake, tmp_path, now, clause):
    carried(tmp_path, parts([1, 2, 4]))
    before = {f: f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()}
    with pytest.raises(CaseError) as caught:
        carried(tmp_path, parts([1, 2, 4]), resume=True, decides=DECIDES | now)
    assert clause in str(caught.value)
    assert "resume it with the same settings, or solve into another folder" in str(caught.value)
    assert {f: f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()} == before


def test_a_run_of_few_parts_goes_on_with_more(fake, tmp_path):
    """Which parts are wanted decides no number: what is done stays."""
    report = {"parts": ["doubled"], "digits": 3}
    few = DECIDES | {"case": DECIDES["case"] | {"report": report}}
    carried(tmp_path, parts([1, 2, 4])[:1], decides=few)
    other = DECIDES | {"case": DECIDES["case"] | {"report": report | {"digits": 4}}}
    with pytest.raises(CaseError, match=r"report\.digits = 3"):
        carried(tmp_path, parts([1, 2, 4]), resume=True, decides=other)
    more = DECIDES | {"case": DECIDES["case"] | {"report": {"digits": 3}}}
    done = list(fake)
    found, _ = carried(tmp_path, parts([1, 2, 4]), resume=True, decides=more)
    assert found["status"] == "ok" and not set(done) & set(fake[len(done) :])
    assert run_folder.read(tmp_path)["decides"]["case"]["report"] == {"digits": 3}


def test_nothing_to_resume_is_a_new_run(fake, tmp_path):
    found, _ = carried(tmp_path / "new", parts([1]), resume=True)
    assert found["status"] == "ok"


@pytest.mark.parametrize("left", ["result.json", "checkpoint.npz"])
def test_a_run_of_an_earlier_version_is_not_resumed(fake, tmp_path, left):
    (tmp_path / left).write_text("{}")
    with pytest.raises(CaseError) as caught:
        carried(tmp_path, parts([1]), resume=True)
    assert "an earlier version of snapo wrote this run" in str(caught.value)


def test_the_folder_of_a_saved_solution_is_named(tmp_path):
    for name in ("result.json", "solution.npz"):
        (tmp_path / name).write_text("")
    with pytest.raises(CaseError, match=r"solution\.save wrote this folder"):
        run_folder.read(tmp_path)


@pytest.mark.parametrize(
    ("text", "clause"),
    [
        ('{"layout": 1, "kind": "fake"}', "layout: got 1; it must be 4; another version"),
        ("{", "this file cannot be read"),
        ("[]", "this file cannot be read"),
        (None, "this is not the folder of a run"),
    ],
)
def test_what_is_no_run_is_refused(tmp_path, text, clause):
    if text is not None:
        (tmp_path / "run.json").write_text(text)
    with pytest.raises(CaseError) as caught:
        run_folder.read(tmp_path)
    assert clause in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_a_place_that_cannot_be_written_is_found_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CaseError, match="is not a folder"):
        run_folder.check_writable(tmp_path / "file" / "run")
    with pytest.raises(CaseError, match="this folder cannot be written"):
        run_folder.check_writable(Path("/proc/nowhere"))


def test_a_disk_that_refuses_is_a_status(fake, tmp_path, monkeypatch):
    from snapo.study import carry_out as module

    def full(file, text):
        raise OSError(28, "No space left on device", str(file))

    monkeypatch.setattr(module, "write_text", full)
    found, told = carried(tmp_path, parts([1, 2, 4]))
    assert (found["status"], found["value"]) == ("not written", 7)
    assert any("No space left on device" in line for line in told)


def test_two_parts_give_different_tables(fake, tmp_path):
    first, _, alone = parts([1])
    again = Part("again", lambda run: {"alone": 1})
    found, _ = carried(tmp_path, [first, alone, again])
    assert "another part has already written ['alone']" in found["failures"]["again"]


def test_a_study_names_its_parts_once_and_in_order():
    first, doubled, _ = parts([1])
    with pytest.raises(ValueError, match="two parts are named 'first sum'"):
        study([first, first])
    with pytest.raises(
        ValueError, match="'doubled' needs \\['first sum'\\], which are not before it"
    ):
        study([doubled, first])


def test_what_decides_a_run_has_the_bytes_of_the_files_beside(case):
    before = run_folder.decisive(case / "case.toml", {"kind": "fake"}, {"engine": "auto"})
    (case / "simulator.py").write_text("one")
    with_code = run_folder.decisive(case / "case.toml", {"kind": "fake"}, {"engine": "auto"})
    assert run_folder.changed(before, with_code) == "another simulator.py"
    (case / "simulator.py").write_text("two")
    other = run_folder.decisive(case / "case.toml", {"kind": "fake"}, {"engine": "auto"})
    assert run_folder.changed(with_code, other) == "another simulator.py"
    assert {"jax", "python", "machine"} <= set(other["versions"])
