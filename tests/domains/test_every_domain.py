"""What holds for every domain: no mistake passes, and a miniature runs from the file to the report."""

import json
import shutil
from pathlib import Path

import pytest
from tests.miniatures import MINIATURES

from snapo.cli.main import main
from snapo.study import commands
from snapo.study.domain import Domain, Options, find, installed
from snapo.testing.miniature import quiet
from snapo.testing.mistakes import refusals, spoilt_files, spoilt_keys

# Tables whose keys, and columns whose entries, are names of the owner's choice.
FREE = {"own": ("inputs", "units")}
LABELS = {"own": ("week",), "inventory": ("period",)}


# Kinds whose miniature is not solved in the quick suite: most run the code that the others run, and
# a process takes long.
SLOW = (
    "battery", "control", "park-and-loan", "pension", "pharma", "plant", "stores", "swing"
)  # fmt: skip


@pytest.fixture(
    params=[
        pytest.param(kind, marks=[pytest.mark.prove] if kind in SLOW else [])
        for kind in sorted(MINIATURES)
    ]
)
def kind(request):
    """Every kind of case that the package brings."""
    return request.param


def test_every_installed_domain_has_a_miniature():
    assert set(MINIATURES) == set(installed())


@pytest.mark.prove
@pytest.mark.parametrize("spoilt", ["keys", "files"])
def test_a_mistake_is_refused_in_words(kind, spoilt, tmp_path):
    """Every key and column of the template, spoilt in every common way."""
    asked = MINIATURES[kind]._replace(texts=None).write(tmp_path)
    read = commands.load(asked).domain.read
    mistakes = spoilt_keys(asked.path, FREE.get(kind, ()))
    if spoilt == "files":
        mistakes = spoilt_files(asked.path, LABELS.get(kind, ()))
    complaints = refusals(read, asked.path, mistakes, tmp_path / "scratch")
    assert not complaints, "\n".join(complaints)


@pytest.mark.prove
def test_every_template_is_accepted(kind, tmp_path):
    domain = find(kind, "tests")
    assert isinstance(domain, Domain) and domain.kind == kind and domain.description
    for size in domain.templates:
        small = MINIATURES[kind]._replace(size=size, assignments=(), texts=None)
        lines = commands.check(small.write(tmp_path / size), quiet)
        assert lines and all(isinstance(line, str) for line in lines)


def test_the_miniature_is_solved_and_its_report_can_be_written_again(
    kind, solved, tmp_path, capsys
):
    """One test, so that one process solves it."""
    run = solved(kind) / "run"
    result = json.loads((run / "result.json").read_text())
    assert result["status"] in ("trained", "ok"), result
    assert result["kind"] == kind and result["failures"] == {}
    assert isinstance(result["value"], float) and isinstance(result["standard_error"], float)
    record = json.loads((run / "run.json").read_text())
    asked = MINIATURES[kind].request(solved(kind))
    loaded = commands.load(asked)
    options = Options(about=record["about"])
    parts = loaded.domain.study(loaded.case, options).parts
    assert [each.name for each in parts] == list(record["parts"])
    assert {each["state"] for each in record["parts"].values()} == {"done"}
    assert {each.file for each in parts} == {each.name for each in (run / "parts").iterdir()}
    assert not list(run.rglob("*.partial"))
    out, before = copied(solved, kind, tmp_path), (run / "report.html").read_bytes()
    (out / "report.html").unlink()
    capsys.readouterr()
    assert main(["report", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out / "report.html")
    assert (out / "report.html").read_bytes() == before


def copied(solved, kind: str, tmp_path: Path) -> Path:
    return Path(shutil.copytree(solved(kind) / "run", tmp_path / "run"))


@pytest.mark.parametrize(
    "every",
    [pytest.param(9, marks=pytest.mark.prove), pytest.param(1, marks=pytest.mark.study)],
)
def test_a_report_does_without_any_part(kind, every, solved, sketched, tmp_path):
    """Files of parts removed in turn: the page says so, and has every section still."""
    out = copied(solved, kind, tmp_path)
    page = (out / "report.html").read_text(encoding="utf-8")
    sections = page.count("<section")
    assert sections >= 3
    for part in sorted((out / "parts").iterdir())[::every]:
        kept = part.read_bytes()
        part.unlink()
        commands.report(out)
        assert (out / "report.html").read_text(encoding="utf-8").count("<section") == sections
        part.write_bytes(kept)


@pytest.mark.prove
def test_a_finished_run_is_not_done_again(kind, solved, tmp_path):
    out = copied(solved, kind, tmp_path)
    before, said = json.loads((out / "result.json").read_text()), []
    asked = MINIATURES[kind].request(solved(kind))
    again = commands.solve(asked, said.append, out=out, resume=True)
    assert again["value"] == before["value"] and again["standard_error"] == before["standard_error"]
    assert not [line for line in said if not line.startswith("note:")], said


@pytest.mark.prove
def test_a_run_with_other_numbers_is_not_resumed(kind, solved, tmp_path, capsys):
    out = copied(solved, kind, tmp_path)
    before = (out / "result.json").read_bytes()
    command = ["solve", str(solved(kind) / "case"), "--out", str(out), "--resume"]
    command += ["--set", "evaluation.paths=192"]
    if (simulator := MINIATURES[kind].simulator) is not None:
        command += ["--simulator", ":".join(simulator)]
    assert main(command) == 2
    assert "resume" in capsys.readouterr().err
    assert (out / "result.json").read_bytes() == before
