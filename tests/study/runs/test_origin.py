"""A report says where it comes from: case, settings, machine, inputs, and the run before it."""

import base64
import hashlib
import json

import pytest

from snapo.case.error import CaseError
from snapo.case.report import PNG, ReportTable, logo
from snapo.case.table import parse
from snapo.cli.main import main

DRAWING = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"><rect width="9" height="9"/></svg>'
)


def test_the_page_has_the_origin(fake, case, capsys):
    assert main(["solve", str(case)]) == 0
    page = (case / "run" / "report.html").read_text()
    assert "There is no earlier run" in page
    first = (case / "run").resolve().name
    assert main(["solve", str(case), "--set", "numbers=[1, 2, 6]", "--seed", "3"]) == 0
    page = (case / "run" / "report.html").read_text()
    assert hashlib.sha256((case / "case.toml").read_bytes()).hexdigest() in page
    for text in ("numbers=[1, 2, 6]", "training.seed=3", f"Value of {first}", "Machine", "+2"):
        assert text in page, text
    assert "[1, 2, 4]" in page and "Date" in page
    capsys.readouterr()
    assert main(["report", str(case)]) == 0
    assert (case / "run" / "report.html").read_text() == page
    record = json.loads((case / "run" / "run.json").read_text())["provenance"]
    assert record["previous"]["difference"] == 2 and record["assignments"][1] == "training.seed=3"


def test_texts_of_the_user(fake, case, monkeypatch):
    monkeypatch.setattr("tests.study.fake.Fake.read", reading_report)
    (case / "logo.svg").write_text(DRAWING)
    words = ['report.title="Board"', 'report.author="A & B"', 'report.note="For <all>"']
    sets = [word for text in [*words, 'report.logo="logo.svg"'] for word in ("--set", text)]
    assert main(["solve", str(case), *sets]) == 0
    page = (case / "run" / "report.html").read_text()
    assert "<h1>Board</h1>" in page and "A &amp; B" in page and "For &lt;all&gt;" in page
    assert base64.b64encode(DRAWING.encode()).decode() in page and "img-src data:" in page
    assert (case / "run" / "case" / "logo.svg").read_text() == DRAWING
    sets[1] = 'report.title="Other"'
    assert main(["solve", str(case), *sets, "--resume"]) == 0  # no number depends on it
    assert len(list((case / "runs").iterdir())) == 1
    assert "<h1>Other</h1>" in (case / "run" / "report.html").read_text()


def reading_report(self, file, data):
    from tests.study.fake import FakeCase

    parse(ReportTable, data.get("report", {}), str(file), "report")
    return FakeCase(file, data.get("numbers", [1.0]), "")


BAD = {
    "script": DRAWING.replace("<rect", "<script>alert(1)</script><rect"),
    "handler": DRAWING.replace("<rect", '<rect onload="alert(1)"'),
    "link": DRAWING.replace("<rect", '<image href="https://example.org/x.png"/><rect'),
    "style": DRAWING.replace("<rect", "<style>@import 'x.css';</style><rect"),
    "address": DRAWING.replace("<rect", '<rect fill="url(https://example.org)"'),
    "page": DRAWING.replace("<rect", "<foreignObject/><rect"),
    "entity": '<!DOCTYPE svg [<!ENTITY a "b">]>' + DRAWING,
    "text": "not a picture",
}


@pytest.mark.parametrize("name", BAD)
def test_a_drawing_that_is_more_than_a_picture_is_refused(name, tmp_path):
    (tmp_path / "x.svg").write_text(BAD[name])
    with pytest.raises(CaseError, match=r"report\.logo: got 'x\.svg'"):
        parse(ReportTable, {"logo": "x.svg"}, str(tmp_path / "case.toml"), "report")


@pytest.mark.parametrize("name", ["none.png", "../x.png", "/etc/hostname", "case.toml", ""])
def test_a_file_that_is_no_logo_is_refused(name, tmp_path):
    (tmp_path / "case.toml").write_text("")
    (tmp_path.parent / "x.png").write_bytes(PNG)
    with pytest.raises((ValueError, OSError)):
        logo(tmp_path, name)


def test_a_drawing_and_a_picture_are_taken(tmp_path):
    (tmp_path / "x.svg").write_text(
        '<?xml version="1.0"?>' + DRAWING.replace("<rect", '<use href="#a"/><rect fill="url(#a)"')
    )
    (tmp_path / "x.png").write_bytes(PNG + b"1")
    assert logo(tmp_path, "x.svg").startswith("data:image/svg+xml;base64,")
    assert logo(tmp_path, "x.png").startswith("data:image/png;base64,")


def test_texts_of_the_page_are_no_setting_that_differs(fake, case, monkeypatch, capsys):
    monkeypatch.setattr("tests.study.fake.Fake.read", reading_report)
    for title in ("one", "two"):
        assert main(["solve", str(case), "--set", f'report.title="{title}"']) == 0
    assert (
        "All settings are those of the previous run" in (case / "run" / "report.html").read_text()
    )
    capsys.readouterr()
    assert main(["runs", str(case)]) == 0
    assert "report" not in capsys.readouterr().out
