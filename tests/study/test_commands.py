"""The commands on a fake domain: what they read, write, print and refuse."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from tests.study.fake import Fake

from snapo.cli.main import main


def answer(capsys) -> dict:
    """The one JSON object on stdout."""
    return json.loads(capsys.readouterr().out)


def test_solve_check_and_report(fake, case, capsys):
    assert main(["check", str(case)]) == 0
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("3 numbers\n", "note: a remark\n")
    assert main(["solve", str(case)]) == 0
    printed = capsys.readouterr()
    assert "fake: ok" in printed.out and f"report: {case / 'run' / 'report.html'}" in printed.out
    assert "doubled" in printed.err
    assert (case / "run" / "case" / "case.toml").read_text() == (case / "case.toml").read_text()
    report = case / "run" / "report.html"
    before = report.read_bytes()
    report.unlink()
    assert main(["report", str(case / "run")]) == 0
    assert report.read_bytes() == before
    assert capsys.readouterr().out == f"{report}\n"


def test_remarks_of_check_are_notes_of_the_run(fake, case, capsys, monkeypatch):
    """Those on the case and those that its study adds: said once, and kept with the numbers."""

    def studied(self, read, options):
        study = Fake.plain_study(self, read, options)
        return replace(study, about=study.about | {"notes": [*read.notes, "a finding of check"]})

    monkeypatch.setattr(Fake, "plain_study", Fake.study, raising=False)
    monkeypatch.setattr(Fake, "study", studied)
    assert main(["solve", str(case)]) == 0
    printed = capsys.readouterr().err
    assert printed.count("a remark") == printed.count("a finding of check") == 1
    result = json.loads((case / "run" / "result.json").read_text())
    assert result["notes"] == ["a remark", "a finding of check"]


def test_a_study_without_notes_keeps_those_of_its_case(fake, case, capsys, monkeypatch):
    monkeypatch.setattr(Fake, "plain_study", Fake.study, raising=False)

    def studied(self, read, options):
        return replace(Fake.plain_study(self, read, options), about={"title": "Sums"})

    monkeypatch.setattr(Fake, "study", studied)
    assert main(["solve", str(case)]) == 0
    assert json.loads((case / "run" / "result.json").read_text())["notes"] == ["a remark"]


def test_json_is_one_object_for_every_command(fake, case, capsys):
    assert main(["check", str(case), "--json"]) == 0
    assert answer(capsys) == {"status": "ok", "lines": ["3 numbers"]}
    assert main(["solve", str(case), "--json"]) == 0
    assert answer(capsys)["value"] == 7
    assert main(["report", str(case / "run"), "--json"]) == 0
    assert answer(capsys)["report"] == str(case / "run" / "report.html")
    assert main(["bench", "fake", "--json"]) == 0
    assert answer(capsys) == {"status": "ok", "times": {"fake": "auto: at once"}}
    assert main(["new", "--json"]) == 0
    assert answer(capsys)["kinds"] == {"fake": {"words": "sums of numbers", "sizes": []}}
    assert main(["compare", str(case / "run"), str(case / "run"), "--json"]) == 0
    assert answer(capsys)["difference"] == 0
    assert main(["solve", str(case / "none"), "--json"]) == 2
    assert answer(capsys)["status"] == "bad-input"


def test_set_changes_keys_and_the_domain_judges_them(fake, case, capsys):
    assert main(["solve", str(case), "--json", "--set", "numbers=[5, 6]"]) == 0
    assert answer(capsys)["value"] == 11
    assert main(["check", str(case), "--set", "number=3"]) == 2
    message = capsys.readouterr().err
    assert f"{case / 'case.toml'} with --set, number: got 3; there is no such key" in message
    assert main(["check", str(case), "--set", "numbers=3"]) == 2
    assert "with --set, numbers: got 3; it must be a list of numbers" in capsys.readouterr().err


def test_seed_is_a_key(fake, case):
    assert main(["solve", str(case), "--seed", "7"]) == 0
    decides = json.loads((case / "run" / "run.json").read_text())["decides"]
    assert decides["case"]["training"] == {"seed": 7}
    assert main(["solve", str(case), "--set", "training.seed=7", "--resume"]) == 0


def test_resume_refuses_another_case_and_keeps_the_copy(fake, case, capsys):
    assert main(["solve", str(case)]) == 0
    copy = (case / "run" / "case" / "case.toml").read_bytes()
    (case / "case.toml").write_text('kind = "fake"\nnumbers = [1, 2, 5]\n')
    assert main(["solve", str(case), "--resume"]) == 2
    assert "numbers = [1, 2, 4], and now it is [1, 2, 5]" in capsys.readouterr().err
    assert (case / "run" / "case" / "case.toml").read_bytes() == copy
    assert main(["solve", str(case), "--resume", "--engine", "xla"]) == 2


def test_a_failed_part_is_a_failed_command(fake, case, capsys):
    assert main(["solve", str(case), "--set", 'fails="alone"']) == 1
    printed = capsys.readouterr().out
    assert "alone failed" in printed and "was told to fail" in printed


def test_what_is_refused(fake, case, capsys):
    assert main(["solve", str(case), "--reference"]) == 2
    assert "sums have no references" in capsys.readouterr().err
    assert main(["solve", str(case), "--out", str(case)]) == 2
    assert "this is the folder of the case" in capsys.readouterr().err
    assert main(["solve", str(case), "--simulator", "simulator:Mine"]) == 2
    message = capsys.readouterr().err
    assert (
        'a case of kind "fake" has a fixed simulator; for your own simulator write a case of kind "own"'
        in message
    )
    for name in (case, case / "case.toml"):
        assert main(["report", str(name)]) == 2
        assert (
            f"this case has no run yet; `snapo solve {name}` computes one."
            in capsys.readouterr().err
        )
    book = case.parent / "book.toml"
    book.write_text('kind = "book"\n')
    (case.parent / "values").mkdir()
    (case.parent / "values" / "book.json").write_text("{}")
    for name, expected in ((book, "this is a book"), (case.parent / "values", "folder of a book")):
        assert main(["open", str(name)]) == 2
        assert expected in capsys.readouterr().err
    assert main(["bench", "fakes"]) == 2
    assert "KIND: got 'fakes'" in capsys.readouterr().err


def test_an_interrupt_has_its_code(fake, case, capsys, monkeypatch):
    def study(self, case, options):
        raise KeyboardInterrupt

    monkeypatch.setattr(Fake, "study", study)
    assert main(["solve", str(case)]) == 130
    assert "interrupted" in capsys.readouterr().err


@pytest.fixture
def templates(monkeypatch, tmp_path):
    """Two sizes of an example."""
    sizes = {}
    for size in ("small", "large"):
        folder = tmp_path / f"template_{size}"
        folder.mkdir()
        (folder / "case.toml").write_text(f'kind = "fake"  # {size}')
        sizes[size] = folder
    # Frozen, but a test's own.
    monkeypatch.setitem(
        vars(__import__("tests.study.fake", fromlist=["x"]).DOMAIN), "templates", sizes
    )


def test_new_writes_the_size_that_was_asked_for(fake, templates, tmp_path, capsys):
    assert main(["new", "fake", str(tmp_path / "a")]) == 0
    assert "small" in (tmp_path / "a" / "case.toml").read_text()
    assert main(["new", "fake", str(tmp_path / "b"), "--size", "large"]) == 0
    assert "large" in (tmp_path / "b" / "case.toml").read_text()
    assert main(["new", "fake", str(tmp_path / "c"), "--size", "huge"]) == 2
    assert "got 'huge'; it must be one of small, large" in capsys.readouterr().err
    assert main(["new", "fake", str(tmp_path / "a")]) == 2
    assert "this file exists; nothing was written" in capsys.readouterr().err
    assert main(["new", "fake"]) == 2
    assert "snapo new fake DIR" in capsys.readouterr().err
    assert main(["new"]) == 0
    assert "sums of numbers (--size small, large)" in capsys.readouterr().out


def test_compare_says_what_differs(fake, case, tmp_path, capsys):
    first, second = str(tmp_path / "one"), str(tmp_path / "two")
    main(["solve", str(case), "--out", first])
    main(["solve", str(case), "--out", second, "--set", "numbers=[1, 2, 6]", "--engine", "xla"])
    capsys.readouterr()
    assert main(["compare", first, second]) == 0
    printed = capsys.readouterr().out
    assert "numbers: [1, 2, 4], [1, 2, 6]" in printed
    assert 'engine: "auto", "xla"' in printed
    assert main(["compare", first, second, "--json"]) == 0
    found = answer(capsys)
    assert (found["values"], found["difference"], found["paired"]) == ([7, 9], 2, False)
    record = Path(second) / "run.json"
    found = json.loads(record.read_text())
    record.write_text(
        json.dumps({key: found[key] for key in found if key != "checksum"} | {"kind": "other"})
    )
    assert main(["compare", first, second]) == 2
    assert (
        'is a run of kind "fake"; only runs of the same kind can be compared'
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("depth", [30, 300, 900, 5_000])
@pytest.mark.parametrize(("left", "right"), [("x = " + "[", "]"), ("{a = ", "}"), ("a.", "")])
def test_a_case_that_is_nested_too_deeply(fake, case, left, right, depth, capsys):
    """Lists, tables and dotted keys, in the file and in `--set`."""
    opening = left.removeprefix("x = ") * depth + ("b" if left == "a." else "")
    value = "x = " * (left != "a.") + opening + right * depth + " = 1" * (left == "a.")
    if left == "{a = ":
        value = f"x = {opening}1{right * depth}"
    for commands_of in (["check", str(case)], ["check", str(case), "--set", "numbers=[2]"]):
        (case / "case.toml").write_text(f'kind = "fake"\n{value}\n')
        assert main(commands_of) == 2
        assert "nested too deeply" in capsys.readouterr().err
    (case / "case.toml").write_text('kind = "fake"\n')
    assert main(["check", str(case), "--set", value.replace(" = ", "=", 1)]) == 2
    assert len(capsys.readouterr().err) < 400 + len(value)


def test_links_in_a_circle(fake, case, tmp_path, capsys):
    one, other = tmp_path / "one", tmp_path / "other"
    one.symlink_to(other)
    other.symlink_to(one)
    asked = [["check", str(one)], ["report", str(one)], ["compare", str(one), str(case)]]
    asked += [["solve", str(case), "--out", str(each)] for each in (one, one / "run")]
    for command in asked:
        assert main(command) == 2, command
        message = capsys.readouterr().err.replace("note: a remark\n", "")
        assert str(one) in message and len(message.splitlines()) == 1
