"""Stresses of the quotes from which a curve is made: the curve is made again."""

import datetime
import shutil

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from tests.book.books import SHORT
from tests.domains.energy.energy_cases import HOME, tables_at
from tests.miniatures import thirty_days

from snapo.book.file import read_book
from snapo.book.job import BookJob, JobResult, opened
from snapo.book.stress import StressMove, moved_numbers
from snapo.book.work import compute
from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.energy.read.case import EnergyCase
from snapo.domains.energy.read.case import read_case as read_contract
from snapo.domains.gas_storage.contract.records import storage_inputs
from snapo.domains.gas_storage.read.case import read_case
from snapo.study.positions import InputPositions
from snapo.study.positions.files import read_files

QUOTES = {"2025-01": 30.0, "2025-02": 28.0, "2025-03": 26.0, "2025-Q1": None}


def prices(change):
    """Quotes after a change of those that are free; the quarter is the mean of its days."""
    months = {name: change(name, x) for name, x in QUOTES.items() if x is not None}
    days = np.array([31, 28, 31]) / 90
    return months | {"2025-Q1": float(days @ list(months.values()))}


def sheet(quotes):
    return "\n".join(["product,price", *(f"{name},{price!r}" for name, price in quotes.items())])


def store(folder, **files):
    folder.mkdir()
    texts = thirty_days()
    curve = next(line for line in texts["case.toml"].splitlines() if "forward_curve =" in line)
    texts["case.toml"] = texts["case.toml"].replace(curve, 'quotes = "quotes.csv"')
    del texts["curve.csv"]
    for name, text in texts.items():
        (folder / name).write_text(text)
    for name, quotes in ({"quotes": prices(lambda name, x: x)} | files).items():
        (folder / f"{name}.csv").write_text(sheet(quotes))
    return folder


def january(name, price):
    return price + 2.0 * (name == "2025-01")


MOVES = {
    "all": (StressMove("market.quotes", scale=1.1), lambda name, x: x * 1.1 + 0.0),
    "a product": (StressMove("market.quotes.2025-01", shift=2.0), january),
    "a period": (
        StressMove("market.quotes", shift=2.0,
                   when=(datetime.date(2025, 1, 1), datetime.date(2025, 1, 31))),
        january,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(MOVES))
def test_a_stress_of_the_quotes_is_a_case_with_other_quotes(tmp_path, name):
    """The same bits of the curve, the quarter that its months imply included."""
    move, change = MOVES[name]
    one = store(tmp_path / "one")
    other = read_case(*load(store(tmp_path / "other", quotes=prices(change))))
    file, data = load(one)
    case = read_case(file, data)
    inputs = storage_inputs(case)
    places = InputPositions(read_case, read_files(one, data), inputs, case=case)
    values = moved_numbers(case, inputs, [move])
    moved = places.case_at(values).case
    assert_array_equal(moved.market.forward_curve.values, other.market.forward_curve.values)
    assert np.any(moved.market.forward_curve.values != case.market.forward_curve.values)
    assert "forward_curve" not in places.movable and places.movable["quotes"].value.size == 3


@pytest.mark.prove
def test_a_book_values_the_same_bits(tmp_path):
    move, change = MOVES["all"]
    store(tmp_path / "store", other=prices(change))
    (tmp_path / "contracts.csv").write_text(
        ",".join(["name", *SHORT]) + "\n" + ",".join(["a", *map(str, SHORT.values())]) + "\n"
    )
    (tmp_path / "book.toml").write_text(
        'kind = "book"\n[cases]\ntemplate = "store"\ntable = "contracts.csv"\n[tasks]\n'
        "paths = 256\nexposure = false\njudge = 0\n"
    )
    book = read_book(tmp_path / "book.toml")
    stresses = (move,), (StressMove("market.quotes", value='"other.csv"'),)
    job = BookJob.of(book.contracts[0], book.tasks, 3, stresses=stresses)
    packed, _ = opened(compute(job.pack()))
    base, one, other = JobResult.unpack(packed).points
    assert [x.note for x in (base, one, other)] == ["", "", ""]
    assert one.value == other.value != base.value
    assert_array_equal(one.changes["forward_curve"], other.changes["forward_curve"])


def test_a_product_that_is_not_free_and_a_period_without_one(tmp_path):
    case = read_case(*load(store(tmp_path / "one")))
    inputs = storage_inputs(case)
    with pytest.raises(CaseError, match="it must be one of 2025-01, 2025-02, 2025-03"):
        moved_numbers(case, inputs, [StressMove("market.quotes.2025-Q1", shift=1.0)])
    days = datetime.date(2025, 1, 10), datetime.date(2025, 1, 20)
    with pytest.raises(CaseError, match="has all of its days in 2025-01-10/2025-01-20"):
        moved_numbers(case, inputs, [StressMove("market.quotes", shift=1.0, when=days)])


def test_a_swing_has_its_quotes_too(tmp_path):
    shutil.copytree(HOME / "template_swing", tmp_path / "swing")
    quotes = {"gas year 2026": 30.0, "2026-10": 27.0}
    (tmp_path / "swing" / "quotes.csv").write_text(sheet(quotes))
    changes = {"market.forward_curve": None, "market.quotes": "quotes.csv"}
    file, data = tables_at(tmp_path / "swing", changes)
    case = read_contract(file, data)
    places = InputPositions(
        read_contract, read_files(file.parent, data), case.inputs(), EnergyCase.inputs, case
    )
    values = moved_numbers(case, case.inputs(), [StressMove("market.quotes", scale=1.1)])
    moved = places.case_at(values).case
    (tmp_path / "swing" / "quotes.csv").write_text(sheet({x: 1.1 * y for x, y in quotes.items()}))
    other = read_contract(file, data)
    assert_array_equal(moved.market.forward_curve.values, other.market.forward_curve.values)
