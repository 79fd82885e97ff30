"""From a case file to the run folder and its report, on a reactor alone; the template is slow."""

import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import solve, template
from tests.miniatures import MINIATURES

from snapo.cli.main import main
from snapo.domains.pharma import study
from snapo.domains.pharma.chapters.attribution import ATTRIBUTION
from snapo.domains.pharma.chapters.design_space import SPACE
from snapo.domains.pharma.chapters.estimation import ESTIMATION
from snapo.domains.pharma.chapters.headline import MAKING
from snapo.domains.pharma.chapters.model import MODEL
from snapo.domains.pharma.chapters.ranges import RANGES
from snapo.domains.pharma.chapters.verification import CONVERGENCE, DIFFERENCES
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.report import SECTIONS
from snapo.report.folder import RunFiles
from snapo.study import commands
from snapo.study.chapter import Chapter
from snapo.testing.miniature import quiet

pytestmark = pytest.mark.prove


@pytest.fixture(scope="module")
def folder(solved) -> Path:
    """The miniature's case."""
    return solved("pharma") / "case"


@pytest.fixture(scope="module")
def whole(solved):
    """(result, run folder) of the miniature."""
    out = solved("pharma") / "run"
    return json.loads((out / "result.json").read_text()), out


@pytest.fixture(scope="module")
def found(whole):
    return RunFiles.read(whole[1]).details


def test_the_result(whole):
    result, out = whole
    assert result["status"] == "ok", result["failures"]
    assert result["kind"] == "pharma" and result["seed"] == 0
    assert 0 < result["value"] < 1 and 0 < result["standard_error"] < 0.05
    stored = json.loads((out / "result.json").read_text())
    assert stored["value"] == result["value"]
    names = {file.name for file in out.iterdir()}
    assert names >= {"result.json", "run.json", "attribute_sensitivities.csv", "profile.csv",
                     "design_space.csv", "report.html", "case"}  # fmt: skip
    assert not [name for name in names if name.endswith(".partial")]
    assert (out / "case" / "batch.csv").exists()


def test_the_checks_hold(found):
    assert all(abs(each["relative"]) < 1e-10 for each in found["balances"])
    assert found["convergence"]["passed"]
    assert all(each["passed"] for each in found["certificate"])
    assert found["certificate"][0]["point"] == "set point"
    assert found["attribution"]["closure"] < 1e-10


def test_the_tables_are_in_the_owners_units(found):
    first, second = found["parameters"]
    assert first["unit"] == "degC" and first["nominal"] == pytest.approx(40)
    assert first["range"] == pytest.approx([30, 50])
    assert second["unit"] == "min" and second["nominal"] == pytest.approx(60)
    raw, scaled = (np.array(found["matrix"][key]) for key in ("raw", "scaled"))
    assert scaled == pytest.approx(raw * [1, 5])
    hessian = found["second"][0]
    assert hessian["pair"] == ["T", "t"] and len(hessian["values"]) == 2


def test_the_fit_recovers_the_published_constants(found):
    fit = found["estimation"]
    assert fit["converged"] and not fit["unidentified"]
    assert fit["values"] == pytest.approx([2.654e4, 5.3e2], rel=1e-6)
    for value, low, high in zip(fit["values"], fit["low"], fit["high"]):
        assert low < value < high
    assert np.abs(fit["residuals"]).max() < 1e-3


def test_every_number_has_a_sensitivity(whole, found):
    with (whole[1] / "attribute_sensitivities.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    table = {(r["attribute"], r["input"], r["label"]): float(r["value"]) for r in rows}
    assert len(rows) == 2 * len(found["numbers"])
    assert table["product", "reactor.temperature", ""] == pytest.approx(
        found["matrix"]["raw"][0][0], rel=1e-9
    )
    with (whole[1] / "design_space.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == 25


def test_the_report_says_what_is_there_and_what_is_not(whole, tmp_path, capsys):
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    page = (out / "report.html").read_text(encoding="utf-8")
    assert len(re.findall(r"<section ", page)) == len(SECTIONS) + 1  # and its provenance
    assert not re.search(r"https?:|//[a-z]|@import|url\((?!#)", page)
    (out / "report.html").unlink()
    assert main(["report", str(out)]) == 0
    capsys.readouterr()
    assert (out / "report.html").read_text(encoding="utf-8") == page
    for part in (out / "parts").iterdir():
        part.unlink()
    assert main(["report", str(out)]) == 0
    bare = (out / "report.html").read_text(encoding="utf-8")
    assert len(re.findall(r"<section ", bare)) == len(SECTIONS) + 1
    assert bare.count("was changed or damaged since it was written") >= 10


def test_every_result_reads_back_as_its_type(whole):
    """A record that does not fit its type would count as missing, and no check would look at it."""
    files = RunFiles.read(whole[1])
    chapters = [each for each in vars(study).values() if isinstance(each, Chapter)]
    done = [each.name for each in chapters if each.name in files.parts]
    assert len(done) >= 14
    assert [each.name for each in chapters if each.of(files) is not None] == done
    assert MODEL.of(files) is not None and MAKING.of(files) is not None


def test_a_resumed_run_gives_the_same_numbers(folder, whole, tmp_path):
    """Parts whose files are lost are done again, on what the others left."""
    out = Path(shutil.copytree(whole[1], tmp_path / "run"))
    lost = {name: (out / "parts" / f"{name}.json") for name in ("capability", "attribution")}
    before = {name: json.loads(file.read_text()) for name, file in lost.items()}
    for file in lost.values():
        file.unlink()
    asked = commands.CaseRequest(folder, MINIATURES["pharma"].assignments)
    result = commands.solve(asked, quiet, out=out, resume=True)
    assert result["status"] == "ok" and result["value"] == whole[0]["value"]
    assert {name: json.loads(file.read_text()) for name, file in lost.items()} == before


def test_a_part_that_fails_loses_nothing_else(folder, tmp_path, monkeypatch):
    def broken(*_):
        raise FloatingPointError("made to fail")

    for chapter in (CONVERGENCE, DIFFERENCES, ATTRIBUTION, RANGES, SPACE, ESTIMATION):
        monkeypatch.setitem(chapter.__dict__, "measure", broken)
    result, _ = solve(folder, tmp_path / "run", *MINIATURES["pharma"].assignments)
    assert "design space" in result["status"] and result["status"].endswith("failed")
    assert 0 < result["value"] < 1
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "made to fail" in page


@pytest.mark.study
def test_the_template_runs(tmp_path):
    assert main(["new", "pharma", str(tmp_path / "case")]) == 0
    smaller = "design_space.points=3", "design_space.samples=32"
    result, folder = solve(tmp_path / "case", tmp_path / "run", *smaller)
    assert result["status"] == "ok"
    found = folder.details
    assert found["run"]["attributes"]["yield"] == pytest.approx(27.870059, rel=1e-6)
    assert found["matrix"]["raw"][0][0] == pytest.approx(2.312240e-1, rel=1e-6)
    zero = np.array(found["matrix"]["zero"])
    assert zero[0, 4:].all() and zero[2, 1:4].all() and not zero[3, 5]


def test_a_process_is_what_the_template_says():
    """The values of the flagship chain, through the file, at tolerances of the publication."""
    values = PharmaProcess(template(pairs=None)).values()
    assert values == pytest.approx(
        [27.870059, 87.956431, 0.0465257, 504.75205, 81.223311, 194.163947], rel=1e-6
    )
