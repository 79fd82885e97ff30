"""A third party's domain, solved small: its case made from a template, its study, its report."""

import json
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import pytest

from snapo.case.error import CaseError
from snapo.report.folder import RunFiles
from snapo.report.page import Section, Text
from snapo.study import commands, domain
from snapo.study.domain import Report
from snapo.study.study import Part, Study
from snapo.testing.miniature import Miniature, once

CASE = 'kind = "doubling"\ntitle = "Two of it"\n[numbers]\nfirst = 21.0\n'


class Doubling:
    """A kind of case that doubles a number; nothing is trained."""

    kind, description, templates = "doubling", "numbers, doubled", {}

    def read(self, file, data):
        first = data.get("numbers", {}).get("first")
        if not isinstance(first, float):
            raise CaseError(str(file), "numbers.first", first, "it must be a number")
        return SimpleNamespace(file=file, notes=(), title=data["title"], first=first)

    def check(self, case):
        return [f"{case.first:g} is doubled"]

    def study(self, case, options):
        def double(run):
            return {"twice": 2 * case.first, "engine": options.engine}

        parts = [Part("doubling", double), Part("halving", self.halve, ("doubling",))]
        about = {"title": case.title}
        return Study(self.kind, about, parts, lambda run: {"value": run.get("twice")})

    def halve(self, run):
        return {"once": run.get("twice") / 2}

    def report(self):
        def section(run):
            return Section("outcome", "Outcome", "Outcome", [Text(f"It is {run.get('twice')}.")])

        return Report("Doubling", RunFiles, lambda run: [("kind", self.kind)], [section])

    def bench(self, engine, tell):
        return "at once"


DOMAIN = Doubling()


@pytest.fixture(autouse=True)
def template(monkeypatch, tmp_path):
    """The domain is installed, with one template."""
    folder = tmp_path / "template"
    folder.mkdir()
    (folder / "case.toml").write_text(CASE)
    (folder / "curve.csv").write_text("date,price\n")
    monkeypatch.setattr(DOMAIN, "templates", {"small": folder})
    here = EntryPoint("doubling", f"{__name__}:DOMAIN", domain.GROUP)
    monkeypatch.setattr(domain, "installed", lambda: {"doubling": here})
    monkeypatch.setattr(commands, "installed", lambda: {"doubling": here})
    monkeypatch.setitem(sys.modules, __name__, sys.modules[__name__])
    return folder


def test_a_case_is_written_as_the_template_says(template, tmp_path):
    asked = Miniature("doubling", "small").write(tmp_path / "a")
    assert asked.path == tmp_path / "a" / "case"
    for each in template.iterdir():
        assert (asked.path / each.name).read_bytes() == each.read_bytes()


def test_a_run_is_carried_out_from_the_file_to_the_report(tmp_path):
    assert isinstance(DOMAIN, domain.Domain)
    small = Miniature("doubling", None, ("numbers.first=4.0",))
    result, out = small.solve(tmp_path, engine="xla"), tmp_path / "run"
    assert (result["value"], result["status"]) == (8.0, "ok")
    assert json.loads((out / "result.json").read_text())["value"] == 8.0
    assert json.loads((out / "parts" / "doubling.json").read_text()) == {
        "twice": 8,
        "engine": "xla",
    }
    assert json.loads((out / "parts" / "halving.json").read_text()) == {"once": 4.0}
    assert "It is 8.0." in (out / "report.html").read_text()
    said = []
    asked = small.request(tmp_path)
    again = commands.solve(asked, said.append, out=out, engine="xla", resume=True)
    assert again["value"] == 8.0 and not said


def test_a_mistake_in_the_case_is_told(tmp_path):
    with pytest.raises(CaseError, match=r"numbers\.first"):
        Miniature("doubling", None, ('numbers.first="much"',)).solve(tmp_path)
    assert not (tmp_path / "run").exists()


def _fill(folder):
    time.sleep(0.2)
    folder.mkdir()
    (folder / "made").touch()


def test_many_that_ask_make_a_folder_once(tmp_path):
    """A second call of `_fill` would fail, as the folder is there."""
    shared = tmp_path / "shared"
    with ThreadPoolExecutor(4) as many:
        found = list(many.map(lambda _: once(shared, _fill), range(4)))
    assert found == [shared] * 4 and (shared / "made").exists()


def test_what_fails_is_tried_again(tmp_path):
    def fail(folder):
        raise RuntimeError("no")

    with pytest.raises(RuntimeError):
        once(tmp_path / "shared", fail)
    assert once(tmp_path / "shared", _fill) == tmp_path / "shared"
