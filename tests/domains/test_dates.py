"""Days and months as other countries write them, in every column of every file that holds any."""

import dataclasses
import re
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES, changed
from tests.domains.pension.read.test_cash_plan import plan

from snapo.case.csv import FileReference, read_rows
from snapo.case.table import TableContext
from snapo.domains.inventory.read.settings import read_season
from snapo.domains.own.read import read_inputs
from snapo.domains.pension.read.cells import TimeGrid
from snapo.domains.pension.read.scenarios import _step

# How a day is written, and how a month is: every line is promised by docs/files.md.
DIALECTS = {
    "points": ("{2}.{1}.{0}", "{1}/{0}"),
    "points without zeros": ("{d}.{m}.{0}", "{m}/{0}"),
    "days first": ("{2}/{1}/{0}", "{1}/{0}"),
    "months first": ("{1}/{2}/{0}", "{1}/{0}"),
    "midnight": ("{0}-{1}-{2} 00:00:00", "{0}-{1}"),
    "midnight of ISO": ("{0}-{1}-{2}T00:00:00", "{0}-{1}"),
    "points and midnight": ("{2}.{1}.{0} 00:00", "{1}/{0}"),
    "days first and midnight": ("{2}/{1}/{0} 00:00:00", "{1}/{0}"),
}
PERIOD = re.compile(r"(\d{4})-(\d\d)(?:-(\d\d))?")

FILES = {
    # A day above twelve in every file tells days from months.
    "curve.csv": "date,price\n2025-01,27.5\n2025-02,26\n2025-01-13,30\n2025-01-14,31\n",
    "rates.csv": "date,zero_rate\n2025-01-05,0.02\n2025-03-31,0.03\n",
    "paid.csv": "delivery_month,date\n2025-01,2025-02-20\n2025-02,2025-03-05\n",
    "fixed.csv": "date,amount\n2025-01-04,10\n2025-01-25,20\n",
    "outages.csv": "from,to,injection_factor,withdrawal_factor\n2025-01-06,2025-01-20,0.5,1\n",
    "rows.csv": "date,inventory,max_withdrawal,max_injection\n"
    "2025-01-01,0,10,5\n,50,12,4\n2025-01-17,0,9,5\n2025-01-17,50,8,4\n",
    "dated.csv": "date,value\n2025-01-01,0.01\n2025-01-17,0.02\n",
    "levels.csv": "date,value\n2025-01-01,50\n2025-01-17,45\n",
}
DATED = ("injection_cost", "withdrawal_cost", "inventory_cost", "injection_fuel", "inventory_loss")
CONTRACT = {
    **dict.fromkeys((*DATED, "withdrawal_fuel"), "dated.csv"),
    "max_inventory": "levels.csv",
    "min_inventory": "dated.csv",
    "ratchets": "rows.csv",
    "max_injection": None,
    "max_withdrawal": None,
    "fixed_costs": "fixed.csv",
    "outages": "outages.csv",
    "injection_cost_settlement": "paid.csv",
    "withdrawal_cost_settlement": "paid.csv",
    "end_inventory": "free",
    "end_value": 20.0,
}
MARKET = {"forward_curve": "curve.csv", "interest_rate": "rates.csv", "settlement": "paid.csv"}
PERIODS = ("2025-01-01", "2025-01-17", "2025-02")


def other(text: str, name: str) -> str:
    """A file with every day and every month written another way."""

    def written(cell: str) -> str:
        if not (found := PERIOD.fullmatch(cell)):
            return cell
        year, month, day = found.groups()
        form = DIALECTS[name][0 if day else 1]
        return form.format(year, month, day, d=int(day or 1), m=int(month))

    return "\n".join(",".join(map(written, line.split(","))) for line in text.split("\n"))


def numbers(record: Any) -> Iterator[tuple[str, Any]]:
    """All that a record holds, by path, but for its file and its notes."""
    if dataclasses.is_dataclass(record):
        fields = [field.name for field in dataclasses.fields(record)]
        record = {name: getattr(record, name) for name in fields if name not in ("file", "notes")}
    if isinstance(record, Mapping):
        for key, each in record.items():
            yield from ((f"{key}.{path}", leaf) for path, leaf in numbers(each))
    elif isinstance(record, list | tuple) and not isinstance(record, str):
        for key, each in enumerate(record):
            yield from ((f"{key}.{path}", leaf) for path, leaf in numbers(each))
    else:
        yield "", np.asarray(record).tolist()


@pytest.mark.parametrize("name", DIALECTS)
def test_gas_storage_reads_days_and_months_of_every_dialect(name, tmp_path):
    """Each file alone is written another way, so that each reader is seen."""
    folder = Path(shutil.copytree(CASES / "quick", tmp_path / "case"))
    tables = {"contract": CONTRACT, "market": MARKET, "model": {"volatility": "dated.csv"}}
    for file, text in FILES.items():
        (folder / file).write_text(text)
    plain = dict(numbers(changed(folder, **tables)))
    for file, text in FILES.items():
        assert other(text, name) != text
        (folder / file).write_text(other(text, name))
        assert dict(numbers(changed(folder, **tables))) == plain, file
        (folder / file).write_text(text)


@pytest.mark.parametrize("name", DIALECTS)
def test_payments_of_a_fund_are_read_and_labelled_alike(name, tmp_path):
    text = "date,amount\n2025-03-31,5000000\n2026-04-01,4e6\n2027-12-20,1\n"
    plain, same = (plan(tmp_path, each)[0] for each in (text, other(text, name)))
    assert same.step.tolist() == plain.step.tolist()
    assert same.amount.labels == plain.amount.labels == ("2025-03-31", "2026-04-01", "2027-12-20")


@pytest.mark.parametrize("name", DIALECTS)
def test_dates_of_scenarios_are_steps(name, tmp_path):
    # The seventeenth tells days from months.
    text = "path,date\n1,2025-01-17\n1,2025-02-03\n1,2025-03-28\n"
    (tmp_path / "paths.csv").write_text(other(text, name))
    rows = read_rows(
        FileReference(TableContext(tmp_path / "case.toml", "", []), "training", "paths.csv"), ()
    )
    grid = TimeGrid(36, 1 / 12, "GBP")
    assert [_step(row, grid, "2024-12-31") for row in rows] == [0, 1, 2]


@pytest.mark.parametrize("name", DIALECTS)
def test_days_and_months_as_labels_are_those_of_the_calendar(name, tmp_path):
    """Labels of one's own inputs and of a season: the same text in whatever way it was written."""
    text = "period,factor\n2025-01-01,1\n2025-01-17,2\n2025-02,3\n"
    (tmp_path / "season.csv").write_text(other(text, name))
    section = TableContext(tmp_path / "case.toml", "season", [])
    assert read_season(section, {"file": "season.csv"}).labels == PERIODS
    table = {"file": "season.csv", "column": "factor", "label": "period"}
    assert read_inputs({"factor": table}, section.file, [])[0]["factor"].labels == PERIODS


def test_a_label_that_could_be_two_days_stays_as_it_is(tmp_path):
    (tmp_path / "season.csv").write_text("period,factor\n04/05/2025,1\n05/05/2025,2\n")
    section = TableContext(tmp_path / "case.toml", "season", [])
    assert read_season(section, {"file": "season.csv"}).labels == ("04/05/2025", "05/05/2025")
