"""Where the numbers of a case stand: another value is written there, and read from there."""

import shutil

import numpy as np
import pytest
from tests.domains.pension.every_key import CASES, written
from tests.domains.pension.miniature import TEMPLATES

from snapo.case.given import NoPosition
from snapo.case.load import load
from snapo.case.toml import to_toml
from snapo.domains.pension.read.case import read_case, resolve
from snapo.domains.pension.records.inputs import every_given, pension_inputs
from snapo.study.positions import InputPositions
from snapo.study.positions.files import read_files, readable, with_numbers

LITTLE = 2.0**-21  # weights still add up to one


def inputs(case):
    named = pension_inputs(case)
    return {given.name: given for given in every_given(case) if given.name in named}


def written_back(file, folder):
    """Every input, as it was asked for and as it is read, and the names of those that stay."""
    file, data = load(file)
    case = resolve(file, data)
    files, wanted, stay = read_files(file.parent, data), {}, set()
    for name, given in inputs(case).items():
        assert len(given.positions) == len(given.values), name
        moved = [x * (1 - LITTLE) + (x == 0) * LITTLE for x in given.values]
        no_file = [x is None or isinstance(x, NoPosition) for x in given.positions]
        if any(isinstance(x, NoPosition) for x in given.positions):
            stay.add(name)
        moved = np.where(no_file, given.values, moved)
        files = with_numbers(files, given, moved)
        wanted[name] = readable(given, moved)
    read = inputs(read_case(files.write(folder)))
    assert set(read) == set(inputs(case))
    return wanted, {name: read[name].values for name in wanted}, stay


@pytest.mark.parametrize("size", ["small", "wtp"])
def test_every_number_of_a_template_is_written_back(size, tmp_path):
    shutil.copytree(TEMPLATES / size, tmp_path / "case")
    wanted, read, stay = written_back(tmp_path / "case", tmp_path / "moved")
    assert stay == set()
    for name, values in wanted.items():
        assert np.array_equal(read[name], values), name


def case_of(name, folder):
    """One of the cases that use every key, in a folder with its files."""
    folder.mkdir()
    data = {key: value for key, value in CASES[name].items() if value is not None}
    written(folder).write_text(to_toml(data))
    return folder


def test_a_file_of_two_numbers_is_the_position_of_neither(tmp_path):
    """Moved there, the volatility of inflation would move that of prices, too."""
    file, data = load(case_of("everything", tmp_path / "case"))
    case = resolve(file, data)
    assert case.inflation.volatility.positions == case.inflation.index_volatility.positions
    places = InputPositions(resolve, read_files(file.parent, data), pension_inputs(case), case=case)
    both = {"inflation_volatility", "index_volatility"}
    assert not both & set(places.recorded) and "wage_volatility" in places.recorded


@pytest.mark.parametrize("name", CASES)
def test_every_number_of_a_case_is_written_back(name, tmp_path):
    wanted, read, stay = written_back(case_of(name, tmp_path / "case"), tmp_path / "moved")
    assert stay <= {"correlation", "asset_volatility"}
    for key, values in wanted.items():
        assert np.array_equal(read[key], values), key
