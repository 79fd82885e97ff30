"""A third party's domain, solved small: its case made from a template, its study, its report."""

import json
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest

from snapo.case.error import CaseError
from snapo.report.folder import Folder
from snapo.report.page import Section, Text
from snapo.study.domain import Domain, Options, Report
from snapo.study.study import Part, Study
from snapo.testing.miniature import case_folder, once, run

CASE = 'kind = "doubling"\ntitle = "Two of it"\n[numbers]\nfirst = 21.0\n'


class Doubling:
    """A kind of case that doubles a number; nothing is trained."""

    kind, words, templates = "doubling", "numbers, doubled", {}

    def read(self, file, data):
        first = data.get("numbers", {}).get("first")
        if not isinstance(first, float):
            raise CaseError(str(file), "numbers.first", first, "allowed is a number")
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

        return Report("Doubling", Folder, lambda run: [("kind", self.kind)], [section])

    def bench(self, engine, tell):
        return "at once"


@pytest.fixture
def template(tmp_path):
    folder = tmp_path / "template"
    folder.mkdir()
    (folder / "case.toml").write_text(CASE)
    (folder / "curve.csv").write_text("date,price\n")
    return folder


def test_a_case_made_from_a_template(template, tmp_path):
    folder = case_folder(template, tmp_path / "a" / "case", {"21.0": "4.0", "Two": "Twice"})
    assert (folder / "case.toml").read_text() == CASE.replace("21.0", "4.0").replace("Two", "Twice")
    assert (folder / "curve.csv").exists() and (template / "case.toml").read_text() == CASE


def test_a_template_that_has_changed_is_named(template, tmp_path):
    with pytest.raises(ValueError, match=r"template/case\.toml has no 'years = 10'"):
        case_folder(template, tmp_path / "case", {"years = 10": "years = 1"})


def test_a_run_is_carried_out_from_the_file_to_the_report(template, tmp_path):
    assert isinstance(Doubling(), Domain)
    out, said = tmp_path / "run", []
    result = run(template, out, Options("xla"), domain=Doubling(), tell=said.append)
    assert (result["value"], result["status"]) == (42.0, "ok")
    assert said == ["doubling", "halving"]
    assert json.loads((out / "result.json").read_text())["value"] == 42.0
    assert json.loads((out / "parts" / "halving.json").read_text()) == {"once": 21.0}
    assert "It is 42.0." in (out / "report.html").read_text()
    assert (out / "case" / "case.toml").read_text() == CASE
    said.clear()
    again = run(template, out, Options("xla"), domain=Doubling(), resume=True, tell=said.append)
    assert again["value"] == 42.0 and not said


def test_a_mistake_in_the_case_is_told(template, tmp_path):
    folder = case_folder(template, tmp_path / "case", {"21.0": '"much"'})
    with pytest.raises(CaseError, match=r"numbers\.first"):
        run(folder, tmp_path / "run", domain=Doubling())
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
