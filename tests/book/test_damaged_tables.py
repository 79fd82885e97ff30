"""Damaged tables of quotes and of stresses: one message with file, line and remedy, or the same
numbers; never a traceback, and never another number."""

import pytest
from tests.book.books import write_book
from tests.book.test_quotes import prices, sheet, store

from snapo.book.file import read_book
from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.gas_storage.read.case import read_case

QUOTES = (sheet(prices(lambda name, x: x)) + "\n").encode()
MOVES = (
    b"name,scale market.forward_curve,shift market.forward_curve@2025-01-10/2025-01-12,"
    b"set contract.injection_cost,probability\nup,1.1,,,0.1\nwinter,,2.5,,0.2\ndear,,,0.07,0.3\n"
)
SAME = "the same numbers"
NUMBER = "it must be a finite number"
DATE = "there is no such day or month in the calendar"
PERIOD = "two months or days separated by a slash"


def with_text(old, new):
    return lambda data: data.replace(old.encode(), new.encode())


def headed(change):
    """`change` of the header only."""
    return lambda data: change(data.partition(b"\n")[0]) + b"\n" + data.partition(b"\n")[2]


# {name: (damage, message)} of any table.
FORMS = {
    "byte-order mark": (lambda x: b"\xef\xbb\xbf" + x, SAME),
    "CRLF": (lambda x: x.replace(b"\n", b"\r\n"), SAME),
    "CR": (lambda x: x.replace(b"\n", b"\r"), SAME),
    "semicolons": (lambda x: x.replace(b",", b";"), SAME),
    "tabs": (lambda x: x.replace(b",", b"\t"), SAME),
    "empty column": (lambda x: x.replace(b"\n", b",\n"), SAME),
    "capital letters": (headed(bytes.upper), SAME),
    "no last line end": (bytes.rstrip, SAME),
    "comments": (lambda x: b"# of Monday\n\n" + x, SAME),
    "empty": (lambda x: b"", "the file is empty"),
    "blank": (lambda x: b"\n \n", "the file is empty"),
    "header only": (headed(lambda x: x), SAME),
    "no rows": (lambda x: x.partition(b"\n")[0], "there are no rows below the header"),
    "no header": (lambda x: x.partition(b"\n")[2], "line 1: got the header .* is missing"),
    "UTF-16": (lambda x: x.decode().encode("utf-16"), "byte 0xff on line 1 is not UTF-8"),
    "UTF-16 without mark": (lambda x: x.decode().encode("utf-16-le"), "save it as CSV in UTF-8"),
    "Latin-1": (lambda x: x + "é,3\n".encode("latin-1"), "byte 0xe9 on line . is not UTF-8"),
    "picture": (lambda x: b"\x89PNG\r\n\x1a\n" + x, "byte 0x89 on line 1 is not UTF-8"),
    "archive": (lambda x: b"PK\x03\x04" + bytes(50), "zero bytes"),
    "zero byte": (lambda x: x[:30] + b"\0" + x[30:], "zero bytes"),
    "web page": (lambda x: b"<html>log in</html>", "line 1: got the header .* is missing"),
    "row twice": (lambda x: x + x.split(b"\n")[1] + b"\n", "line 2"),
    "table twice": (lambda x: x + x, "line ., column .*: got '"),
    "cell missing": (
        lambda x: x.rstrip().rpartition(b",")[0],
        "line .: got . cells; the row must have",
    ),
    "open quotation mark": (lambda x: x + b'"a', "line .: "),
    "column twice": (headed(lambda x: x + b"," + x.rpartition(b",")[2]), "column appears twice"),
}
PRICES = {
    "decimal commas": (lambda x: x.replace(b",", b";").replace(b".", b","), SAME),
    "no column": (with_text("price", "prise"), "line 1: .* column price is missing"),
    "columns swapped": (with_text("product,price", "price,product"), "line 2, column product"),
    "units": (with_text("price\n", "price\n[1],[EUR]\n"), "line 2, column product: got '.1.'"),
    **{
        f"price {text!r}": (with_text("28.0", text), f"line 3, column price: got .*{NUMBER}")
        for text in (
            "", "abc", "nan", "inf", "-inf", "1e400", "1e300", "1 000", '"1,000"', "€28", "0x1C",
            "2_8", "٢٨", "28 %", "−28", "-", "=28",
        )
    },
    **{
        f"price {text}": (with_text("28.0", text), "line 5, column price: .* together give")
        for text in ("-28.0", "0.0", "280.0")
    },
    **{
        f"product {text!r}": (with_text("2025-02", text), f"line 3, column product: .*{message}")
        for text, message in {
            "": "a product is", "Feb 2025": "a product is", "02-2025": "a product is",
            "20250-02": "a product is", "2025-Q5": "a product is", "2025-13": DATE,
            "2025-02-30": DATE, "0000-02": DATE, "9999-12": DATE, "9999-12-31": "1900 to 2199",
            "2025-02-10/2025-02-01": "the last day is before the first", "2025-01": "line 2 has",
            "weekend 2025-01-01": "not a Saturday",
        }.items()
    },
    "too many days": (with_text("2025-02", "1950-01-01/2025-02-28"),
                      "column product: .* the first quoted day is 1950-01-01"),
}  # fmt: skip
MOVES_ONLY = {
    **{
        f"number {text!r}": (with_text("1.1", text), f"line 2, column scale .*{NUMBER}")
        for text in ("abc", "nan", "inf", "1e400", "1e300", "10%", '"1,1"', '"1,000"', "None", "=1")
    },
    **{
        f"value {text!r}": (with_text("0.07", text), f"line 4, column set .*: {message}")
        for text, message in {
            "abc": "got 'abc'; a text needs quotation marks", "nan": f"got 'nan'; {NUMBER}",
            "inf": f"got 'inf'; {NUMBER}", '"[1, 2"': ".* not a valid value in TOML",
            "x.csv": "got 'x.csv'; a text needs quotation marks.",
        }.items()
    },
    **{
        f"period {text!r}": (with_text("2025-01-10/2025-01-12", text), f"header.*: .*{message}")
        for text, message in {
            "2025-01-10/2025-02-30": PERIOD, "2025-01": PERIOD, "10.01.2025/12.01.2025": PERIOD,
            "2025-02/2025-01": "the first day is after the last", "": "with @PERIOD",
        }.items()
    },
    **{
        f"column {new!r}": (with_text(old, new), f"header: got '{new.lower()}.*columns are name")
        for old, new in {
            "scale market": "scal market", "scale market.forward_curve": "scale",
            "probability": "when", "scale market.f": "market.f", "set c": "sets c",
        }.items()
    },
    "period of a value": (with_text("injection_cost", "injection_cost@2025-01"), "columns are name"),
    "no column": (with_text("name", "nam"), "line 1: .*column name is missing"),
    "no name": (with_text("up,", ","), "line 2, column name: got an empty cell"),
    "name of the base": (with_text("up,", "base,"), "line 2, name: got 'base'"),
    "nothing moved": (with_text("up,1.1", "up,"), "line 2, column name: .* at least one of"),
    "moved and set": (
        lambda x: with_text("up,1.1,,,", "up,1.1,,2.0,")(
            with_text("set contract.injection_cost", "set market.forward_curve")(x)
        ),
        "line 2, column set market.forward_curve: .*in this row the key is already set",
    ),
}  # fmt: skip


def of_quotes(folder, data):
    (folder / "quotes.csv").write_bytes(data)
    return read_case(*load(folder)).market.forward_curve.values.tolist()


def of_moves(folder, data):
    (folder / "moves.csv").write_bytes(data)
    stresses = read_book(folder / "book.toml").stresses
    table = [(x.name, sorted(map(str, x.moves))) for x in stresses]
    return str(table).casefold()


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("damaged")
    table = '[[stress]]\ntable = "moves.csv"\n'
    write_book(folder / "moves", [{"name": "a"}], stresses=table)
    return {"quotes": store(folder / "quotes"), "moves": folder / "moves"}


ALL = [
    (kind, name, *entry)
    for kind, more in (("quotes", PRICES), ("moves", MOVES_ONLY))
    for name, entry in (FORMS | more).items()
]


@pytest.mark.parametrize(
    ("kind", "damage", "expected"),
    [(kind, damage, expected) for kind, _, damage, expected in ALL],
    ids=[f"{kind}: {name}" for kind, name, *_ in ALL],
)
def test_a_damaged_table(folders, kind, damage, expected):
    whole, read = {"quotes": (QUOTES, of_quotes), "moves": (MOVES, of_moves)}[kind]
    data = damage(whole)
    assert data != whole or expected == SAME
    if expected == SAME:
        assert read(folders[kind], data) == read(folders[kind], whole)
        return
    with pytest.raises(CaseError, match=expected) as caught:
        read(folders[kind], data)
    text = str(caught.value)
    assert text.startswith(f"{kind}.csv") and "\n" not in text and text.endswith(".")


def test_scale_and_shift_of_a_row_in_either_order(folders):
    """As in book.toml, value * scale + shift; it was (value + shift) * scale where the column of the shift
    is first."""
    columns = "shift market.forward_curve,scale market.forward_curve"
    (folders["moves"] / "moves.csv").write_text(f"name,{columns}\na,2,1.5\n")
    (stress,) = read_book(folders["moves"] / "book.toml").stresses
    assert [(x.scale, x.shift) for x in stress.moves] == [(1.5, 2.0)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            'table = "moves.csv"\nname = "a"',
            r"stress\[1\]\.name: got 'a'; a stress with a table may have",
        ),
        ('name = "a"\nset = { "a.b" = 1 }\nwhen = "2025-01/2025-01"', r"stress\[1\]\.when: got"),
        ('name = "base"\nset = { "a.b" = 1 }', "this name means the unstressed point"),
    ],
)
def test_keys_that_had_no_effect(folders, text, expected):
    file = folders["moves"] / "wrong.toml"
    file.write_text(f'kind = "book"\n[cases]\ntemplate = "store"\n[[stress]]\n{text}\n')
    with pytest.raises(CaseError, match=expected):
        read_book(file)
