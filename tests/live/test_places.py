"""Inputs are written where the case's own reader finds them again."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest

from snapo.case.error import CaseError
from snapo.case.given import ConvertedNumber, NoPosition
from snapo.domains.pension.quantities import AMOUNT
from snapo.live.terms import usual
from snapo.live.worker import Desk, serve
from snapo.study import commands
from snapo.study.domain import Options
from snapo.study.positions import InputPositions
from snapo.study.positions.files import read_files, readable


@pytest.fixture(scope="module")
def storage(tmp_path_factory):
    from snapo.domains.gas_storage.contract.records import storage_inputs

    folder = tmp_path_factory.mktemp("storage")
    commands.new("gas-storage", folder)
    loaded = commands.load(commands.CaseRequest(folder))
    files = read_files(folder, loaded.data)
    return InputPositions(loaded.domain.read, files, storage_inputs(loaded.case))


def counted(folder):
    """The places of a storage case, and a list with an entry for each time that it is read."""
    from snapo.domains.gas_storage.contract.records import storage_inputs

    loaded, readings = commands.load(commands.CaseRequest(folder)), []

    def read(file, data):
        readings.append(file)
        return loaded.domain.read(file, data)

    inputs, files = storage_inputs(loaded.case), read_files(folder, loaded.data)
    return InputPositions(read, files, inputs, case=loaded.case), readings


REFUSED = {  # by the contract: the template's others move with them, or not at all
    "min_inventory": "the limits allow",
    "max_inventory": "must reach max_inventory",
    "ratchet_inventory": "must reach min_inventory",
    "min_injection": "cannot be reached",
}


def test_every_input_of_a_store_is_written_and_read_once(tmp_path):
    commands.new("gas-storage", tmp_path / "case")
    places, readings = counted(tmp_path / "case")
    for name, x in places.inputs.items():
        wanted = x.value + usual(x)
        wanted += 1e-3 * np.array_equal(wanted, x.value)
        if name in REFUSED:
            with pytest.raises(CaseError, match=REFUSED[name]):
                places.case_at({name: wanted})
        else:
            assert np.array_equal(storage_values(places.case_at({name: wanted}), name), wanted)
    assert len(readings) == len(places.inputs) == 21


def storage_values(moved, name):
    from snapo.domains.gas_storage.contract.records import storage_inputs

    return storage_inputs(moved.case)[name].value


@pytest.mark.prove
@pytest.mark.parametrize(
    ("kind", "size", "simulator"),
    [("inventory", "spare-part", None), ("inventory", "line", None),
     ("inventory", "stores", None), ("control", "pendulum", None), ("control", "measured", None),
     ("control", "linear-quadratic", None), ("own", "reservoir", ("simulator", "Reservoir"))],
)  # fmt: skip
def test_every_input_of_an_item_a_plant_and_a_simulator_is_written_and_read_once(
    kind, size, simulator, tmp_path
):
    commands.new(kind, tmp_path / "case", size)
    loaded = commands.load(commands.CaseRequest(tmp_path / "case", simulator=simulator))
    inputs_of, readings = loaded.domain.study(loaded.case, Options("xla")).inputs, []
    assert inputs_of is not None

    def read(file, data):
        readings.append(file)
        return loaded.domain.read(file, data)

    files = read_files(tmp_path / "case", loaded.data)
    inputs = inputs_of(loaded.case)
    places = InputPositions(read, files, inputs, inputs_of, loaded.case)
    for name, x in inputs.items():
        wanted = x.value * (1 + 2.0**-20) + 1e-9 * (x.value == 0) * (name[:5] != "noise")
        moved = inputs_of(places.case_at({name: wanted}).case)
        assert np.array_equal(moved[name].value, wanted)
        assert all(
            np.array_equal(moved[key].value, inputs[key].value) for key in moved if key != name
        )
    assert len(readings) == len(inputs)


def test_a_curve_with_decimal_commas_is_written_where_it_was_read(tmp_path):
    commands.new("gas-storage", tmp_path)
    curve = tmp_path / "curve.csv"
    lines = curve.read_text().replace(",", ";").replace(".", ",").splitlines()
    curve.write_text("\n".join(["# of a spreadsheet", *lines, ""]))
    places, _ = counted(tmp_path)
    wanted = places.inputs["forward_curve"].value + 0.5
    moved = places.case_at({"forward_curve": wanted})
    assert np.array_equal(storage_values(moved, "forward_curve"), wanted)
    assert len(moved.files.sheets["curve.csv"].rows) == 13


def test_numbers_of_a_table_that_is_no_csv_say_why_they_stay(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    import pyarrow

    commands.new("gas-storage", tmp_path)
    lines = (tmp_path / "curve.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines if not line.startswith("#")][1:]
    table = {"date": [row[0] for row in rows], "price": [float(row[1]) for row in rows]}
    parquet.write_table(pyarrow.table(table), tmp_path / "curve.parquet")
    case = tmp_path / "case.toml"
    case.write_text(case.read_text().replace("curve.csv", "curve.parquet"))
    places, _ = counted(tmp_path)
    with pytest.raises(
        CaseError, match=r"curve\.parquet: only numbers in a CSV next to the case can be changed"
    ):
        places.case_at({"forward_curve": places.inputs["forward_curve"].value + 0.5})


def test_both_entries_of_a_correlation_are_written(tmp_path):
    commands.new("gas-storage", tmp_path)
    case = tmp_path / "case.toml"
    head, _, tail = case.read_text().partition("[model]")
    rest = tail[tail.index("\n[") :]
    case.write_text(
        f"{head}[model]\nkind = 'multi-factor'\ncorrelation = [[1.0, 0.3], [0.3, 1.0]]\n"
        "factors = [{ mean_reversion = 12.0, volatility = 0.6 }, "
        f"{{ mean_reversion = 0.5, volatility = 0.2 }}]\n{rest}"
    )
    places, _ = counted(tmp_path)
    wanted = {"correlation": np.array([0.25]), "volatility": np.array([0.7, 0.3])}
    moved = places.case_at(wanted)
    assert moved.files.tables["model"]["correlation"] == [[1.0, 0.25], [0.25, 1.0]]
    assert [x["volatility"] for x in moved.files.tables["model"]["factors"]] == [0.7, 0.3]


def test_a_curve_stays_monthly_where_its_months_are_flat(storage):
    curve = storage.inputs["forward_curve"]
    files = storage.case_at({"forward_curve": curve.value + 0.25}).files
    sheet = files.sheets["curve.csv"]
    assert len(sheet.rows) == 13 and sheet.rows[0] == ["2021-04", "16.86"]
    bent = curve.value.copy()
    bent[3] += 1 / 3
    moved = storage.case_at({"forward_curve": bent})
    assert np.array_equal(moved.case.market.forward_curve.values, bent)
    assert ["2021-04-28", repr(float(bent[3]))] in moved.files.sheets["curve.csv"].rows


def test_numbers_of_all_kinds_come_back_to_the_bits(storage):
    wanted = {
        "inventory": np.array([1234.5678901234567]),
        "spot_volatility": np.array([0.1 + 0.2]),
        "injection_fuel": np.array([0.01]),  # a key that the case does not have
        "ratchet_injection": storage.inputs["ratchet_injection"].value * (1 - 1e-9),
    }
    moved = storage.case_at(wanted)
    contract = moved.case.contract
    assert contract.inventory.values == wanted["inventory"]
    assert contract.injection_fuel.values == wanted["injection_fuel"]
    assert np.array_equal(contract.ratchets.injection.values, wanted["ratchet_injection"])
    assert moved.files.tables["contract"]["injection_fuel"] == 0.01


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("inventory", 9000.0, "limits allow 0 to 7000"),
        ("inventory", -1.0, "a number of at least 0"),
        ("max_inventory", 8000.0, "last row of this block must reach"),
        ("injection_fuel", 1.5, "of at least 0 and below 1"),
    ],
)
def test_the_limits_are_those_of_the_case_format(storage, name, value, words):
    with pytest.raises(CaseError, match=words):
        storage.case_at({name: np.array([value])})


def test_a_written_case_is_a_case(storage, tmp_path):
    files = storage.case_at({"inventory": np.array([2000.0])}).files
    files.write(tmp_path / "moved")
    loaded = commands.load(commands.CaseRequest(tmp_path / "moved"))
    assert loaded.case.contract.inventory.values == 2000.0
    assert (tmp_path / "moved" / "ratchets.csv").is_file()


def test_a_case_written_again_replaces_every_file(storage, tmp_path):
    """A scenario that is saved again under its name: with the curve of the run, and no policy."""
    prices = storage.inputs["forward_curve"].value
    from snapo.domains.gas_storage.contract.records import storage_inputs

    folder, posts, curves = tmp_path / "scenarios" / "cold" / "case", [], []
    for values in ({"forward_curve": [2.0 * x for x in prices.tolist()]}, {}):
        order = {"do": "write", "page": "p", "n": 1, "values": values, "folder": str(folder)}
        posts.append(answered(storage, order))
        loaded = commands.load(commands.CaseRequest(folder))
        curves.append(storage_inputs(loaded.case)["forward_curve"].value)
        assert not (folder / "policy.npz").exists()
        (folder / "policy.npz").write_bytes(b"of the first save")
    assert posts == ["written", "written"]
    np.testing.assert_array_equal(curves, [2.0 * prices, prices])
    assert [file.name for file in folder.parent.iterdir()] == ["case"]


def test_a_case_that_cannot_be_written_leaves_no_earlier_case(storage, tmp_path):
    folder, posts = tmp_path / "cold" / "case", []
    for values in ({}, {"inventory": [8000.0]}):
        order = {"do": "write", "page": "p", "n": 1, "values": values, "folder": str(folder)}
        posts.append(answered(storage, order))
    assert posts == ["written", "refused"]
    assert list(folder.parent.iterdir()) == []


class WrittenOnly:
    """A run of which cases are written, and nothing else."""

    def __init__(self, positions):
        self.positions = positions

    def files(self, values, choices):
        arrays = {name: np.array(numbers) for name, numbers in values.items()}
        return self.positions.case_at(arrays).files


def answered(positions, order):
    """The stage that answers an order to the process of a page."""
    posts = []
    desk = Desk(io.StringIO(json.dumps(order)))
    serve(WrittenOnly(positions), desk, lambda **post: posts.append(post["stage"]), None, object())
    return posts[-1]


def fund(folder, size="small", **files):
    """The positions of the numbers of a fund, some of whose files are rewritten by a function."""
    from snapo.domains.pension.records.inputs import pension_inputs

    commands.new("pension", folder, size)
    for stem, changed in files.items():
        (file,) = folder.glob(f"{stem}.*")
        file.write_text(changed(file.read_text()))
    loaded = commands.load(commands.CaseRequest(folder))
    files = read_files(folder, loaded.data)
    return InputPositions(loaded.domain.read, files, pension_inputs(loaded.case), case=loaded.case)


@pytest.mark.parametrize("size", ["small", "medium", "large", "wtp"])
def test_every_input_of_a_fund_has_its_position(size, tmp_path):
    places = fund(tmp_path, size)
    assert sorted(places.recorded) == sorted(places.inputs)


def moved_to(places, name, wanted):
    """The files of a case with other numbers of an input, which are read as exactly these."""
    from snapo.domains.pension.records.inputs import pension_inputs

    moved = places.case_at({name: np.array(wanted)})
    for key, x in pension_inputs(moved.case).items():
        expected = wanted if key == name else places.inputs[key].value
        assert np.array_equal(x.value.ravel(), np.ravel(expected))
    return moved.files


CONTINUOUS = '# compounding = "continuous"'


def test_an_annual_rate_is_written_so_that_the_same_continuous_one_is_read(tmp_path):
    places = fund(tmp_path, case=lambda text: text.replace(CONTINUOUS, 'compounding = "annual" #'))
    rates = places.inputs["zero_rate"].value
    sheet = moved_to(places, "zero_rate", rates + 1e-4).sheets["curve.csv"]
    column = np.array(sheet.column(sheet.header.index("zero")), float)
    assert np.allclose(column, np.expm1(rates + 1e-4), rtol=1e-15)


def test_an_inverse_is_exact_where_a_float_is_and_else_next_to_it():
    """Of annual rates of 0 to 3 %, and of what is paid in a step of a third of a year."""
    numbers = np.random.default_rng(0).uniform(0.0, 0.03, 200)
    annual = ConvertedNumber(None, np.log1p, np.expm1)
    assert all(np.log1p(annual.inverse(x)) == x for x in [0.0, *numbers])
    thirds = ConvertedNumber(None, lambda x: x / 3, lambda x: 3 * x)
    read = np.array([thirds.inverse(x) / 3 for x in numbers])
    assert 0.5 < np.mean(read == numbers) < 1 and (np.abs(read - numbers) <= np.spacing(read)).all()
    assert all(thirds.inverse(x) / 3 == x for x in read)
    entry = AMOUNT.input("cost", numbers, [""] * 200, positions=(thirds,) * 200)
    assert np.array_equal(readable(entry, numbers), read)


def test_both_cells_of_a_correlation_are_written(tmp_path):
    def mirrored(text):
        rows = [line.split(",") for line in text.splitlines() if line and line[0] != "#"]
        for i, row in enumerate(rows[1:], 1):
            row += [""] * (len(rows) - len(row))
            row[i + 1 :] = [other[i] for other in rows[i + 1 :]]
        return "\n".join(map(",".join, rows)) + "\n"

    places = fund(tmp_path, "large", correlations=mirrored)
    wanted = places.inputs["correlation"].value * 0.99
    sheet = moved_to(places, "correlation", wanted).sheets["correlations.csv"]
    matrix = np.array([row[1:] for row in sheet.rows], float)
    assert np.array_equal(matrix, matrix.T)
    assert np.array_equal(matrix[np.tril_indices(len(matrix), -1)], wanted)


def test_volatilities_in_a_file_that_a_cell_names_are_written_there(tmp_path):
    places = fund(tmp_path, "large")
    wanted = places.inputs["asset_volatility"].value * 1.01
    files = moved_to(places, "asset_volatility", wanted)
    assert files.changed == {"assets.csv", "equity_volatility.csv"}


def test_a_repaired_correlation_says_why_it_stays(tmp_path):
    places = fund(tmp_path, "large")
    name, repaired = "correlation", places.recorded["correlation"]
    reason = NoPosition("the matrix was repaired")
    places.recorded[name] = replace(repaired, positions=(reason,) * len(repaired.values))
    places.case_at({name: repaired.values})
    with pytest.raises(CaseError, match=r"correlation.*the matrix was repaired"):
        places.case_at({name: repaired.values * 0.99})
