"""The generic mistakes, on a small reader that is right and on readers that let something pass."""

from pathlib import Path

import pytest

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.case.table import CaseTable, parse
from snapo.testing.mistakes import UNKNOWN, refusals, spoilt_files, spoilt_keys

CASE = """kind = "toy"
[tank]
volume = 2.5
stages = 3
open = true
levels = [1.0, 2.0]
prices = "prices.csv"
"""
PRICES = "# invented\ndate,price\n2025-01,1.5\n2025-02,-2\n"


class Tank(CaseTable):
    volume: float
    stages: int
    open: bool
    levels: list[float]
    prices: str


class Toy(CaseTable):
    kind: str
    tank: dict


def read(file: Path, data) -> Tank:
    """A reader that is right."""
    top = parse(Toy, data, str(file), "")
    tank = parse(Tank, top.tank, str(file), "tank")
    _prices(file.parent / tank.prices)
    return tank


def _prices(file: Path) -> list[float]:
    def error(what: str) -> CaseError:
        return CaseError(file.name, "", None, what)

    try:
        lines = [line for line in file.read_text("utf-8").splitlines() if line[:1] != "#"]
    except (OSError, UnicodeDecodeError, ValueError):
        raise error("cannot be read") from None
    if lines[:1] != ["date,price"] or len(lines) < 2:
        raise error("the columns are date and price")
    for line in lines[1:]:
        cells = line.split(",")
        if len(cells) != 2 or not cells[1].lstrip("-").replace(".", "", 1).isdigit():
            raise error("a row is a date and a number")
    return []


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "case.toml").write_text(CASE)
    (tmp_path / "case" / "prices.csv").write_text(PRICES)
    return tmp_path / "case"


def test_a_reader_that_is_right_has_no_complaints(folder, tmp_path):
    spoilt = [*spoilt_keys(folder), *spoilt_files(folder)]
    assert refusals(read, folder, spoilt, tmp_path / "scratch") == []
    names = {mistake.name for mistake in spoilt}
    assert len(names) == len(spoilt) > 60
    for name in (
        "the case: unknown key", "tank: a number instead of a table", "tank.volume: not a number",
        "tank.stages: a truth value", "tank.levels.1: infinite", "tank.open: left out",
        "prices.csv: missing", "prices.csv: unknown column for price",
        "prices.csv, line 4, price: another sign",
    ):  # fmt: skip
        assert name in names, names


def test_the_case_itself_stays_as_it_is(folder, tmp_path):
    before = load(folder)[1]
    refusals(read, folder, [*spoilt_keys(folder), *spoilt_files(folder)], tmp_path / "scratch")
    assert load(folder)[1] == before
    assert (folder / "prices.csv").read_text() == PRICES
    assert not list((tmp_path / "scratch").iterdir())


def test_a_reader_that_ignores_unknown_keys(folder, tmp_path):
    def careless(file, data):
        if isinstance(data.get("tank"), dict):
            data["tank"].pop(UNKNOWN, None)
        return read(file, data)

    found = refusals(careless, folder, spoilt_keys(folder), tmp_path / "scratch")
    assert found == ["tank: unknown key: accepted"]


def test_a_reader_that_ends_in_a_traceback(folder, tmp_path):
    def careless(file, data):
        return {0: "closed", 1: "open"}[data["tank"]["open"]], read(file, data)

    found = refusals(careless, folder, spoilt_keys(folder), tmp_path / "scratch")
    assert "tank.open: left out: KeyError instead of a CaseError: 'open'" in found
    assert any(line.startswith("tank.open: a table: TypeError") for line in found)


def test_a_message_without_its_place(folder, tmp_path):
    def careless(file, data):
        try:
            return read(file, data)
        except CaseError:
            raise CaseError(str(file), "", None, "something is wrong") from None

    found = refusals(careless, folder, spoilt_keys(folder), tmp_path / "scratch")
    assert any("tank.stages: text: stages not in the message" in line for line in found)
