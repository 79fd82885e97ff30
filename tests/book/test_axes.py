"""Axes of a book, and sweeps: values over a grid or over Sobol points, with or without a policy."""

import csv
import json

import numpy as np
import pytest
from tests.book.books import HERE, SHORT, results_of, write_book
from tests.book.conftest import ROWS
from tests.domains.pharma.pharma_cases import CASE
from tests.miniatures import thirty_days

from snapo.book import commands
from snapo.book.axes import read_design
from snapo.book.commands import sweep_book
from snapo.book.executors import worker_pools
from snapo.book.file import read_book
from snapo.book.run import run_book
from snapo.case.csv import write_table
from snapo.case.error import CaseError
from snapo.domains.pharma import moved
from snapo.study.domain import CaseRequest, Options, load

COST, LEVEL = "contract.injection_cost", "contract.max_inventory"
LITTLE = [f"{key}={value}" for key, value in SHORT.items()]


@pytest.fixture
def store(tmp_path):
    folder = tmp_path / "store"
    folder.mkdir()
    for name, text in thirty_days().items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def process(tmp_path):
    """A reactor without measured batches."""
    folder = tmp_path / "process"
    folder.mkdir()
    text = CASE[: CASE.index("[estimation]")] + "[evaluation]\npaths = 128\n"
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder


def run(book, out):
    result = run_book(book, lambda _: None, HERE, out=out)
    assert result["status"] == "ok", result["failures"]
    return result


def sobol(seed=0, count=5, **more):
    axes = [
        {"key": "a.x", "range": "5:35", "sobol": count},
        {"key": "b.y", "range": "-1:1 degC", "sobol": count, **more},
    ]
    return read_design("book.toml", axes, seed)


def test_sobol_points_are_those_of_the_seed_and_fill_the_ranges():
    design = sobol(3)
    assert design == sobol(3) != sobol(4)
    x = np.array([point[0].value for point in design.points])
    assert len(x) == 5 and x.min() >= 5 and x.max() <= 35
    assert len({int((value - 5) / 30 * 4) for value in x[:4]}) == 4  # one in each quarter
    assert all(point[1].text.endswith(" degC") for point in design.points)
    assert design.points[:4] == sobol(3, 4).points


def test_axes_with_equal_names_have_longer_labels():
    axes = [{"key": f"units.{name}.duration", "values": [1.0, 2.0]} for name in ("mill", "dryer")]
    axes += [{"key": "units.mill.nodes.3", "values": ["a", True]}]
    design = read_design("book.toml", axes, 0, ("duration",))
    assert [axis.label for axis in design.axes] == ["mill.duration", "dryer.duration", "nodes.3"]
    assert design.labels(design.points[1])["nodes.3"] == "true" and len(design.points) == 8


def test_a_number_has_the_unit_of_the_case():
    design = read_design("book.toml", [{"key": "unit.t", "values": [5, 7.5]}], 0)
    tables = {"unit": {"t": "40 degC"}}
    assert design.settings(tables, design.points[1]) == [("unit.t", '"7.5 degC"')]
    assert design.settings({"unit": {"t": 40}}, design.points[0]) == [("unit.t", "5")]


@pytest.mark.parametrize(
    ("axis", "message"),
    [
        ({"values": "1:10:1"}, "in steps of 1 it is 1:10:10"),
        ({"values": "0.1:0.5:0.1"}, "in steps of 0.1 it is 0.1:0.5:5"),
        ({"values": "5:35"}, "how many values"),
        ({"values": "a:b:3"}, "how many values"),
        ({"values": []}, "at least one value"),
        ({}, "how many values"),
        ({"sobol": 4}, "first and last number"),
        ({"sobol": 4, "range": "35:5"}, "first and last number"),
        ({"sobol": 4, "range": "5:35:7"}, "first and last number"),
        ({"range": "5:35"}, "also write sobol = 64"),
        ({"sobol": 4, "values": [1.0], "range": "5:35"}, "either values or Sobol points"),
        ({"sobol": 0, "range": "5:35"}, "1 or more"),
    ],
)
def test_a_wrong_axis_says_how_it_is_written(axis, message):
    with pytest.raises(CaseError, match=message):
        read_design("book.toml", [{"key": "a.x"} | axis], 0)


def test_axes_of_sobol_points_have_one_number_of_them():
    with pytest.raises(CaseError, match="it must be 5"):
        sobol(sobol=6)
    with pytest.raises(CaseError, match="two axes have this key"):
        sobol(key="a.x")


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        (f"{COST}=1:10:1", "injection_cost: got '1:10:1'.*in steps of 1 it is 1:10:10"),
        (f"{COST}=5", "at least one key needs several values"),
        ("contract.injektion_cost=0:1:3", "nearest known key is injection_cost"),
        (f"{LEVEL}=-40:20:3", "of at least 0"),
    ],
)
def test_a_wrong_sweep_is_refused_before_it_is_valued(setting, message, store):
    with pytest.raises(CaseError, match=message):
        sweep_book(store, [setting])


@pytest.mark.prove
def test_a_sweep_values_the_policy_of_the_case_at_every_point(store, tmp_path):
    """As stresses of a book do; table, CSV and picture have every point."""
    settings = [*LITTLE, "evaluation.paths=512", f"{COST}=0.02,0.07", f"{LEVEL}=60:80:2"]
    book = sweep_book(store, settings)
    assert [stress.name for stress in book.stresses][1] == "injection_cost 0.02, max_inventory 80"
    result = run(book, tmp_path / "sweep")
    rows = {tuple(row["at"].values()): row for row in result["points"]}
    assert list(rows) == [("0.02", "60"), ("0.02", "80"), ("0.07", "60"), ("0.07", "80")]
    assert rows["0.02", "80"]["value"] > rows["0.07", "80"]["value"] > rows["0.07", "60"]["value"]
    with (tmp_path / "sweep" / "points.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [float(row["value"]) for row in table] == [row["value"] for row in rows.values()]
    page = (tmp_path / "sweep" / "report.html").read_text()
    assert "Value over injection_cost (across) and max_inventory (up)." in page
    text = commands.summary(result)
    assert "0.07" in text and "points.csv" in text

    stress = f'[[stress]]\nname = "set"\nset = {{ "{COST}" = 0.07, "{LEVEL}" = 60 }}\n'
    text = (store / "case.toml").read_text()
    file = write_book(tmp_path / "book", [{"name": "as it is"}], stresses=stress)
    same = run(read_book(file), tmp_path / "run")
    values = {row["stress"]: row["value"] for row in same["sums"]}
    assert values["set"] == rows["0.07", "60"]["value"]


@pytest.mark.prove
def test_a_sweep_with_training_is_the_contract_at_every_point(store, tmp_path):
    settings = [*LITTLE, "evaluation.paths=512"]
    trained = sweep_book(store, [*settings, f"{COST}=0.02:0.07:2"], train=True)
    assert len(trained.contracts) == 2 and not trained.stresses
    result = run(trained, tmp_path / "sweep")
    assert [row["at"] for row in result["points"]] == [{"injection_cost": "0.02"}, {
        "injection_cost": "0.07"}]  # fmt: skip
    assert json.loads((tmp_path / "sweep" / "book.json").read_text())["axes"] == [
        {"key": COST, "label": "injection_cost"}
    ]
    assert "with its 95 % interval" in (tmp_path / "sweep" / "report.html").read_text()
    results = results_of(trained, tmp_path / "sweep")
    assert len({result.policy for result in results.values()}) == 2
    assert all(result.points[0].outputs for result in results.values())


@pytest.mark.prove
def test_a_process_without_a_policy_is_a_book(process, tmp_path):
    """Beyond the normal range of its parameter; the bits are those of a fresh process, whatever was
    calculated before."""
    book = sweep_book(process, ["units.reactor.temperature=32:46:2"])
    result = run(book, tmp_path / "one")
    assert [row["at"]["temperature"] for row in result["points"]] == ["32", "46"]
    backwards = sweep_book(process, ["units.reactor.temperature=46:32:2"])
    moved._compiled.clear()
    other = run(backwards, tmp_path / "two")
    assert other["points"] == result["points"][::-1]
    first, last = ({x["name"]: x for x in row["outputs"]} for row in result["points"])
    assert last["product"]["value"] > first["product"]["value"]
    assert last["product"]["within"] > first["product"]["within"]
    assert last["product"]["nominal"] == pytest.approx(last["product"]["value"], rel=0.05)
    page = (tmp_path / "one" / "report.html").read_text()
    assert "product, mol/L over temperature" in page and "Share of batches within" in page
    assert "trained once" not in page

    moved._compiled.clear()
    settings = ("units.reactor.temperature='39 degC'", "evaluation.judge_paths=0")
    loaded = load(CaseRequest(process, settings))
    study = loaded.domain.study(loaded.case, Options())
    _, table = next(study.recalculated().stages(loaded.case))
    alone = run(sweep_book(process, ["units.reactor.temperature=39,40"]), tmp_path / "three")
    assert alone["points"][0]["value"] == table["value"]


def test_a_process_under_stresses(process, tmp_path):
    """More of them than a job has; by a factor, and by a value with its unit."""
    (tmp_path / "book.toml").write_text(
        'kind = "book"\n[cases]\ntemplate = "process"\n[tasks]\npaths = 128\n[[stress]]\n'
        'name = "warm"\nset = { "units.reactor.temperature" = "44 degC" }\n'
        + "".join(
            f'[[stress]]\nname = "{i}"\nscale = {{ "units.reactor.duration" = {1 + i / 100} }}\n'
            for i in range(26)
        )
    )
    result = run(read_book(tmp_path / "book.toml"), tmp_path / "run")
    sums = {row["stress"]: row for row in result["sums"]}
    assert result["orders"]["computed"] == 2 and len(sums) == 28
    assert sums["0"]["change"] == 0.0 == sums["0"]["change_error"]
    assert sums["warm"]["value"] > sums["base"]["value"]


def test_stresses_of_a_parquet_are_those_of_a_csv(tmp_path):
    pd = pytest.importorskip("pandas")
    moves = pd.DataFrame({
        "name": ["up", "winter", "dear", "both"],
        "scale market.forward_curve": [1.1, None, None, 0.9],
        "shift market.forward_curve@2025-01-10/2025-01-12": [None, 2.5, None, None],
        "set contract.injection_cost": [None, None, 0.07, 0.08],
        "probability": [0.1, 0.2, 0.3, 0.4],
    })  # fmt: skip
    books = []
    for ending in ("csv", "parquet"):
        file = write_book(
            tmp_path / ending, ROWS[:1], stresses=f"[[stress]]\ntable = 'm.{ending}'\n"
        )
        write_table(moves, file.parent / f"m.{ending}")
        books.append(read_book(file).stresses)
    assert books[0] == books[1]
    assert [len(stress.moves) for stress in books[0]] == [1, 1, 1, 2]
    assert books[0][2].moves[0].value == "0.07" and books[0][1].moves[0].shift == 2.5


def test_a_stress_moves_a_key_once_and_labels_are_no_results(tmp_path):
    stress = f'[[stress]]\nname = "a"\nset = {{ "{COST}" = 1.0 }}\nshift = {{ "{COST}" = 1.0 }}\n'
    with pytest.raises(CaseError, match="cannot be scaled, shifted or set again"):
        read_book(write_book(tmp_path / "a", ROWS[:1], stresses=stress))
    with pytest.raises(CaseError, match="rename the column of the table"):
        read_book(write_book(tmp_path / "b", [{"name": "a", "value": 3}]))


@pytest.mark.prove
def test_a_process_has_its_bits_in_every_worker(process, tmp_path):
    """In this process, and in two of their own, which calculate other points before."""
    settings = ["units.reactor.temperature=32:46", "units.reactor.duration=3600:4800"]
    book = sweep_book(process, settings, sobol=4)
    here = run(book, tmp_path / "here")
    there = run_book(book, lambda _: None, worker_pools("", 2), out=tmp_path / "there")
    assert there["points"] == here["points"] and len(here["points"]) == 4
    assert "darker is higher" in (tmp_path / "there" / "report.html").read_text()
