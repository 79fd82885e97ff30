"""From a case file to the run folder and its report, on a reactor alone; the template is slow."""

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import FirstOrder, template

from snapo.cli.main import main
from snapo.domains.pharma import run
from snapo.domains.pharma.case import read_case
from snapo.domains.pharma.flowsheet.process import Process
from snapo.domains.pharma.quality import estimation
from snapo.domains.pharma.quality.records import Estimation, Experiment
from snapo.domains.pharma.report import SECTIONS
from snapo.domains.pharma.results import derivatives, quality

# Concentrations of an isothermal batch at 313.15 K with the kinetics published with PharmaPy, from
# a multistep solution at a relative tolerance of 1e-11: at 600, 1800 and 3600 s, kmol/m3.
TIMES = (600, 1800, 3600)
BATCH = {
    "A": (0.118582315, 0.022330171, 0.002312084),
    "B": (0.165839680, 0.113279266, 0.103639153),
    "C": (0.116902954, 0.125771639, 0.125033777),
    "D": (0.047257366, 0.090949095, 0.101327069),
}
CASE = """kind = "pharma"
title = "Batch reactor"
pairs = [["T", "t"]]
[species]
A = { molar_mass = "100 g/mol" }
B = { molar_mass = "50 g/mol" }
C = { molar_mass = "150 g/mol" }
D = { molar_mass = "250 g/mol" }
[[reactions]]
name = "product"
equation = "A + B -> C"
prefactor = "2.2e4 L/mol/s"
activation = "40 kJ/mol"
[[reactions]]
name = "impurity"
equation = "C + A -> D"
prefactor = "6e2 L/mol/s"
activation = "30 kJ/mol"
[feeds.charge]
volume = "60 L"
temperature = "313.15 K"
concentration = { A = "0.33 mol/L", B = "0.33 mol/L" }
solvent = "887.6 kg/m^3"
[units.reactor]
type = "reactor"
duration = "3600 s"
temperature = "40 degC"
[[connections]]
from = "charge"
to = "reactor.feed"
[[parameters]]
name = "T"
of = "reactor.temperature"
range = ["30 degC", "50 degC"]
normal = ["39 degC", "41 degC"]
distribution = { kind = "normal", spread = "0.5 degC" }
source = "made up"
[[parameters]]
name = "t"
of = "reactor.duration"
range = ["30 min", "90 min"]
normal = ["55 min", "65 min"]
source = "made up"
[[attributes]]
name = "product"
measure = "reactor.concentration.C"
unit = "mol/L"
low = "0.11 mol/L"
citation = "made up"
[[attributes]]
name = "impurity"
measure = "reactor.concentration.D"
unit = "mol/L"
high = "0.12 mol/L"
citation = "made up"
[[uncertainty]]
of = "kinetics.prefactor"
distribution = { kind = "lognormal", spread = 0.1 }
[design_space]
axes = ["T", "t"]
points = 5
samples = 32
[estimation]
[[estimation.fit]]
of = "kinetics.prefactor[product]"
low = "1e3 L/mol/s"
high = "1e6 L/mol/s"
logarithm = true
[[estimation.fit]]
of = "kinetics.prefactor[impurity]"
low = "1e1 L/mol/s"
high = "1e4 L/mol/s"
logarithm = true
[[estimation.experiments]]
name = "batch"
data = "batch.csv"
[evaluation]
paths = 256
"""


def data() -> str:
    rows = ["time,state,value,error"]
    for name, values in BATCH.items():
        for time, value in zip(TIMES, values):
            rows.append(f"{time} s,reactor.concentration.{name},{value} mol/L,1e-4 mol/L")
    return "\n".join(rows) + "\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("pharma") / "case"
    folder.mkdir()
    (folder / "case.toml").write_text(CASE)
    (folder / "batch.csv").write_text(data())
    return folder


@pytest.fixture(scope="module")
def whole(folder, tmp_path_factory):
    """(result, run folder) of one study."""
    out = tmp_path_factory.mktemp("run") / "run"
    return run.solve(read_case(folder), out=out, seed=3, progress=lambda text: None), out


@pytest.fixture(scope="module")
def found(whole):
    return json.loads((whole[1] / "details.json").read_text())


def test_the_result(whole):
    result, out = whole
    assert result["status"] == "ok", (out / "details.json").read_text()[-600:]
    assert result["kind"] == "pharma" and result["seed"] == 3
    assert 0 < result["value"] < 1 and 0 < result["standard_error"] < 0.05
    stored = json.loads((out / "result.json").read_text())
    assert stored["value"] == result["value"]
    names = {file.name for file in out.iterdir()}
    assert names >= {"result.json", "details.json", "attribute_sensitivities.csv", "profile.csv",
                     "design_space.csv", "report.html", "case"}  # fmt: skip
    assert not [name for name in names if name.endswith(".partial")]
    assert (out / "case" / "batch.csv").exists()


def test_the_checks_hold(found):
    assert all(abs(each["relative"]) < 1e-10 for each in found["balances"])
    assert found["convergence"]["passed"]
    assert all(each["passed"] for each in found["certificate"])
    assert found["certificate"][0]["point"] == "set point"
    assert found["attribution"]["closure"] < 1e-10
    assert found["failures"] == {}


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
    assert len(re.findall(r"<section ", page)) == len(SECTIONS)
    assert not re.search(r"https?:|//[a-z]|@import|url\((?!#)", page)
    (out / "report.html").unlink()
    assert main(["report", str(out)]) == 0
    capsys.readouterr()
    assert (out / "report.html").read_text(encoding="utf-8") == page
    (out / "details.json").write_text("{}")
    assert main(["report", str(out)]) == 0
    bare = (out / "report.html").read_text(encoding="utf-8")
    assert len(re.findall(r"<section ", bare)) == len(SECTIONS)
    for words in ("No design space was mapped", "This run has no matrix", "was not computed"):
        assert words in bare


def test_a_part_that_fails_loses_nothing_else(folder, tmp_path, monkeypatch):
    def broken(*_):
        raise FloatingPointError("made to fail")

    for name in ("convergence_rows", "certificate_rows", "second_rows", "attribution_rows"):
        monkeypatch.setattr(derivatives, name, broken)
    for name in ("range_rows", "map_tables", "estimation_rows"):
        monkeypatch.setattr(quality, name, broken)
    result = run.solve(read_case(folder), out=tmp_path / "run", seed=3, progress=lambda t: None)
    assert "design space" in result["status"] and result["status"].endswith("failed")
    assert 0 < result["value"] < 1
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "made to fail" in page


# Estimation against closed forms.


def closed_form(which, low, high, logarithm, noise=0.0, seed=0, temperatures=(313.15, 303.15)):
    """c = 0.33 exp(-0.33 k exp(-E/RT) t): rows at two temperatures, with errors of 1e-3."""
    case = template(pairs=None)
    process = FirstOrder(case)
    times = np.linspace(200, 3600, 9)
    rng = np.random.default_rng(seed)
    experiments = []
    for temperature in temperatures:
        rate = 2.654e4 * np.exp(-4e4 / 8.314 / temperature)
        value = 0.33 * np.exp(-rate * 0.33 * times) + noise * rng.standard_normal(9)
        settings = (("reactor.temperature", 0, temperature),)
        states = ("reactor.concentration.A",) * 9
        experiments.append(Experiment("made up", settings, times, states, value, np.full(9, 1e-3)))
    names, entries = zip(*which)
    asked = Estimation(names, entries, logarithm, low, high, tuple(experiments), 0.95)
    return process, asked


PREFACTOR, ACTIVATION = ("kinetics.prefactor", 0), ("kinetics.activation", 0)


def test_both_kinetic_numbers_from_two_temperatures():
    process, asked = closed_form((PREFACTOR, ACTIVATION), (1e2, 2e4), (1e8, 8e4), (True, False))
    process.inputs["kinetics.prefactor"] = np.array([1e4, 530.0])
    process.inputs["kinetics.activation"] = np.array([3.8e4, 3e4])
    found = estimation.fit(process, asked)
    assert found.converged
    assert found.values == pytest.approx([2.654e4, 4e4], rel=1e-6)
    assert found.correlation[0, 1] > 0.99  # as prefactor and activation always are


def test_one_temperature_does_not_identify_both():
    process, asked = closed_form(
        (PREFACTOR, ACTIVATION), (1e2, 2e4), (1e8, 8e4), (True, False), temperatures=(313.15,)
    )
    found = estimation.fit(process, asked)
    assert len(found.unidentified) == 1 and "activation" in found.unidentified[0]
    assert np.isnan(found.low).any()


@pytest.mark.slow
def test_intervals_cover():
    """200 noisy repeats: a 95 % interval holds the truth in 95 % of them, give or take 3 errors."""
    held = 0
    for seed in range(200):
        process, asked = closed_form((PREFACTOR,), (1e3,), (1e6,), (True,), 1e-3, seed)
        found = estimation.fit(process, asked)
        held += bool(found.low[0] <= 2.654e4 <= found.high[0])
    assert abs(held / 200 - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 200)


@pytest.mark.slow
def test_the_template_runs(tmp_path):
    assert main(["new", "pharma", str(tmp_path / "case")]) == 0
    case = read_case(tmp_path / "case")
    assert case.design_space is not None
    small = replace(case, design_space=replace(case.design_space, points=(3, 3), samples=32))
    result = run.solve(small, out=tmp_path / "run", seed=1, progress=lambda text: None)
    assert result["status"] == "ok"
    found = json.loads((tmp_path / "run" / "details.json").read_text())
    assert found["run"]["attributes"]["yield"] == pytest.approx(27.870059, rel=1e-6)
    assert found["matrix"]["raw"][0][0] == pytest.approx(2.312240e-1, rel=1e-6)
    zero = np.array(found["matrix"]["zero"])
    assert zero[0, 4:].all() and zero[2, 1:4].all() and not zero[3, 5]


@pytest.mark.slow
def test_a_process_is_what_the_template_says():
    """The values of the flagship chain, through the file, at tolerances of the publication."""
    values = Process(template(pairs=None)).values()
    assert values == pytest.approx(
        [27.870059, 87.956431, 0.0465257, 504.75205, 81.223311, 194.163947], rel=1e-6
    )
