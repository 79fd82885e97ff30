"""Inputs are written where the case's own reader finds them again."""

import numpy as np
import pytest

from snapo.case.error import CaseError
from snapo.live.case.files import read_files
from snapo.live.case.places import Places
from snapo.study import commands


@pytest.fixture(scope="module")
def storage(tmp_path_factory):
    from snapo.domains.gas_storage.contract.inputs import storage_inputs

    folder = tmp_path_factory.mktemp("storage")
    commands.new("gas-storage", folder)
    loaded = commands.load(commands.Asked(folder))
    files = read_files(folder, loaded.data)
    return Places(loaded.domain.read, files, storage_inputs(loaded.case))


def test_a_curve_stays_monthly_where_its_months_are_flat(storage):
    curve = storage.inputs["forward_curve"]
    files = storage.moved({"forward_curve": curve.value + 0.25}).files
    sheet = files.sheets["curve.csv"]
    assert len(sheet.rows) == 12 and sheet.rows[0] == ["2021-04", "16.86"]
    bent = curve.value.copy()
    bent[3] += 1 / 3
    moved = storage.moved({"forward_curve": bent})
    assert np.array_equal(moved.case.market.forward_curve.values, bent)
    assert ["2021-04-28", repr(float(bent[3]))] in moved.files.sheets["curve.csv"].rows


def test_numbers_of_all_kinds_come_back_to_the_bits(storage):
    wanted = {
        "inventory": np.array([1234.5678901234567]),
        "spot_volatility": np.array([0.1 + 0.2]),
        "injection_fuel": np.array([0.01]),  # a key that the case does not have
        "ratchet_injection": storage.inputs["ratchet_injection"].value * (1 - 1e-9),
    }
    moved = storage.moved(wanted)
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
        ("injection_fuel", 1.5, "from 0 up to but not 1"),
    ],
)
def test_the_limits_are_those_of_the_case_format(storage, name, value, words):
    with pytest.raises(CaseError, match=words):
        storage.moved({name: np.array([value])})


def test_a_written_case_is_a_case(storage, tmp_path):
    files = storage.moved({"inventory": np.array([2000.0])}).files
    files.write(tmp_path / "moved")
    loaded = commands.load(commands.Asked(tmp_path / "moved"))
    assert loaded.case.contract.inventory.values == 2000.0
    assert (tmp_path / "moved" / "ratchets.csv").is_file()


def test_every_input_of_a_fund_has_its_place(tmp_path):
    from snapo.domains.pension.records.inputs import pension_inputs

    commands.new("pension", tmp_path / "fund", "small")
    loaded = commands.load(commands.Asked(tmp_path / "fund"))
    inputs = pension_inputs(loaded.case)
    places = Places(loaded.domain.read, read_files(tmp_path / "fund", loaded.data), inputs)
    assert [name for name in inputs if places.place(name) is None] == []
