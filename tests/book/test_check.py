"""`snapo check` of a book names what would fail in a run, in the files of the user."""

import json
import shutil

import pytest
from tests.book.books import write_book

from snapo.book import commands
from snapo.book.file import read_book
from snapo.book.folder import BookFolder
from snapo.case.error import CaseError
from snapo.cli.main import main

STORE = "store/case.toml"


def mistakes(file):
    with pytest.raises(CaseError) as caught:
        commands.check(file)
    return str(caught.value).replace(str(file.parent), "").splitlines()


@pytest.mark.parametrize(
    ("rows", "old", "new", "expected"),
    [
        ({"contract.max_inventry": 5}, "", "",
         "contracts.csv, line 2, column contract.max_inventry: got 5; there is no such key"),
        ({"contract.max_inventory": -1}, "", "",
         "contracts.csv, line 2, column contract.max_inventory: got -1; it must be"),
        ({"CONTRACT.Max_Inventory": -1}, "", "",
         "contracts.csv, line 2, column CONTRACT.Max_Inventory: got -1; it must be"),
        ({}, "[model]", "[model]\nvolatilty = 3.0",
         "/store/case.toml, model.volatilty: got 3; there is no such key"),
        ({}, "[model]", "[modell]", "/store/case.toml, modell: got "),
        ({}, '"curve.csv"', '"curv.csv"', "/store/case.toml, market.forward_curve: got 'curv.csv'"),
        ({}, '"gas-storage"', '"gas"', "/store/case.toml, kind: got 'gas'; it must be one of "),
    ],
)  # fmt: skip
def test_a_mistake_of_a_contract(tmp_path, rows, old, new, expected):
    """Each was accepted, and a line of failures after a run."""
    file = write_book(tmp_path, [{"name": "a", **rows}, {"name": "b"}], stresses="")
    text = (tmp_path / STORE).read_text()
    assert old in text
    (tmp_path / STORE).write_text(text.replace(old, new, 1))
    assert mistakes(file)[0].startswith(expected)


def test_a_mistake_of_all_contracts_is_named_once(tmp_path):
    file = write_book(tmp_path, [{"name": x, "quantity": 1} for x in "abc"], stresses="")
    (tmp_path / STORE).write_text((tmp_path / STORE).read_text() + "\n[other]\nkey = 1\n")
    assert len(mistakes(file)) == 1


@pytest.mark.prove  # it makes a problem of the case
def test_a_mistake_of_a_stress(tmp_path):
    for text, expected in {
        'scale = { "market.forwrd_curve" = 1.1 }': ", market.forwrd_curve: it must be one of ",
        'scale = { "markt.forward_curve" = 1.1 }':
            ", markt.forward_curve: the case has no table markt; the nearest is market.",
        'set = { "contract.injction_cost" = 1.1 }': ", contract.injction_cost: got 1.1; there is no",
        'set = { "contract.max_inventory" = -1 }': ", contract.max_inventory: got -1; it must be",
        'scale = { "market.forward_curve" = 1.1 }\nwhen = "2030-01/2030-02"':
            ", market.forward_curve: none of its numbers lies in 2030-01-01/2030-02-28.",
    }.items():  # fmt: skip
        stress = f'[[stress]]\nname = "a"\n{text}\n'
        assert mistakes(write_book(tmp_path, [{"name": "a"}], stresses=stress))[0].startswith(
            f"/book.toml, stress[1]{expected}"
        )
    (tmp_path / "moves.csv").write_text("name,shift market.spot\na,1\n")
    stress = '[[stress]]\ntable = "moves.csv"\n'
    (one,) = mistakes(write_book(tmp_path, [{"name": "a"}], stresses=stress))
    assert one.startswith("moves.csv, line 2, market.spot: it must be one of ")
    file = write_book(tmp_path, [{"name": "a"}])
    assert commands.check(file)[0] == "North: 1 contract, 2 stresses"


@pytest.mark.parametrize(
    ("column", "near"), [("quantty", "quantity"), ("maket", "market"), ("Names", "name")]
)
def test_a_column_that_would_count_as_a_label(tmp_path, column, near):
    """A quantity that is misspelt was 1."""
    file = write_book(tmp_path, [{"name": "a", column: 3}], stresses="")
    (one,) = mistakes(file)
    assert one.startswith(f"contracts.csv, header: got '{column.lower()}'; columns are name, ")
    assert one.endswith(f"the nearest known column is {near}.")


@pytest.mark.parametrize("command", [["check"], ["solve"], ["book"], ["sweep", "--set", "a=1,2"]])
def test_a_book_of_another_kind(tmp_path, capsys, command):
    """ "book" was not among the kinds, and each of them was listed twice."""
    file = tmp_path / "b.toml"
    file.write_text('kind = "bok"\n[cases]\ntemplate = "store"\n')
    assert main([command[0], str(file), *command[1:]]) == 2
    text = capsys.readouterr().err
    assert "kind: got 'bok'; it must be " in text and '"book"' in text
    assert text.count("gas-storage") <= 1
    if command != ["book"]:
        assert text.rstrip().endswith("the nearest known kind is book.")


@pytest.mark.parametrize("command", ["solve", "sweep"])
def test_a_book_is_not_a_case(tmp_path, capsys, command):
    file = tmp_path / "b.toml"
    file.write_text('kind = "book"\n[cases]\ntemplate = "store"\n')
    assert main([command, str(file), "--set", "a=1,2"][: 2 if command == "solve" else 4]) == 2
    assert (
        "got 'book'; this is a book of contracts: use snapo book to value it"
        in capsys.readouterr().err
    )


RESULTS = {
    "": "result.json, line 1: this is not valid JSON",
    '{"sums": [': "result.json, line 1: this is not valid JSON",
    "[1]": "result.json: got [1]; a table is expected; this file was changed",
    "{}": "result.json, title: this key is missing; this file was changed",
}


@pytest.mark.prove  # it damages a book that was valued
def test_a_damaged_folder_says_what_is_wrong(valued, tmp_path, monkeypatch):
    """All were "this file was changed", as was a fault of the report itself, or a missing file."""

    def message(change):
        for name in ("book.json", "result.json"):
            shutil.copy(valued.out / name, tmp_path / name)
        change()
        with pytest.raises(CaseError) as caught:
            commands.report(tmp_path)
        return str(caught.value).replace(f"{tmp_path}/", "")

    def with_key(*path, value):
        def change():
            file = tmp_path / "result.json"
            table = position = json.loads(file.read_text())
            for key in path[:-1]:
                position = position[key]
            position[path[-1]] = value
            file.write_text(json.dumps(table))

        return change

    result, record = tmp_path / "result.json", tmp_path / "book.json"
    for text, expected in RESULTS.items():
        assert message(lambda text=text: result.write_text(text)).startswith(expected)
    assert message(result.unlink).startswith("result.json: this book has no results yet")
    assert message(record.unlink) == "book.json: this is not the folder of a book."
    assert "book.json, line 1: this is not valid JSON" in message(lambda: record.write_text("x"))
    assert "book.json, layout: got 7; it must be 1" in message(
        lambda: record.write_text('{"layout": 7}')
    )
    assert "book.json, cases: this key is missing" in message(
        lambda: record.write_text('{"layout": 1}')
    )
    assert message(lambda: result.write_bytes(b"\xff")).startswith(
        "result.json: byte 0xff on line 1 is not UTF-8"
    )
    assert message(with_key("sums", 0, "value", value="3")).startswith(
        "result.json, sums[0].value: got '3'; input should be a valid number; this file was changed"
    )
    assert "result.json, sums: " in message(with_key("sums", 0, "stress", value="other"))
    monkeypatch.setattr("snapo.book.report.page", lambda *_: {}["fault"])
    for name in ("book.json", "result.json"):
        shutil.copy(valued.out / name, tmp_path / name)
    with pytest.raises(KeyError, match="fault"):  # of the program, not of the file
        commands.report(tmp_path)
    assert BookFolder(valued.out).result()["title"] == "North"


def test_the_tables_of_a_book_may_be_in_a_folder_below(tmp_path):
    """Unlike the files of a case, they are read once and never copied."""
    file = write_book(
        tmp_path, [{"name": "one"}], stresses='[[stress]]\ntable = "data/moves.csv"\n'
    )
    (tmp_path / "data").mkdir()
    (tmp_path / "contracts.csv").rename(tmp_path / "data" / "contracts.csv")
    (tmp_path / "data" / "moves.csv").write_text("name,shift contract.injection_cost\ndear,0.05\n")
    file.write_text(file.read_text().replace('"contracts.csv"', '"data/contracts.csv"'))
    book = read_book(file)
    assert [x.name for x in book.contracts] == ["one"]
    assert [x.name for x in book.stresses] == ["dear"]
