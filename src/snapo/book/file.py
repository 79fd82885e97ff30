"""Reads the file of a book: contracts, the markets that they share, stresses, and tasks.

A contract is a case: a template with other values in a row of a table, or a separate file. If the
book has markets, they replace the tables `[market]` and `[model]` of their contracts.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError, Unquoted
from snapo.case.load import load
from snapo.case.table import CaseTable, Range, TableContext, Title, doc, parse, subtable
from snapo.study.assign import assigned, key_as_in
from snapo.study.domain import find
from snapo.study.run_folder import case_files, tables_named

from .axes import MAX_POINTS, Axis, AxisTable, Design, read_design
from .stress import BookStress, BookStressTable, read_stresses

BASE = "base"  # the name of the unstressed point
NAME = re.compile(r"[^\x00-\x1f/\\]{1,80}")
SHARED = ("market", "model")  # tables of a case that its market gives
ROW_COLUMNS = ("name", "market", "quantity")
RESERVED = (
    "case",
    "stress",
    "status",
    "note",
    "value",
    "standard_error",
    "change",
    "change_error",
    "explained",
    "unexplained",
    "cpu_seconds",
    "peak_mb",
    "shape",
    "worker",
)  # columns of the results


class CasesTable(CaseTable):
    """`[cases]`"""

    template: str = doc(
        "case that is copied for every contract", "",
        'the folder of a case, relative to the book: "store"',
    )  # fmt: skip
    files: str = doc("cases of the book", "", 'a pattern of paths, "contracts/*/case.toml"')
    table: str = doc(
        "contracts: each row changes a copy of the template",
        "",
        'the CSV of the contracts, "contracts.csv"',
    )
    by: list[str] = doc(
        "labels by which values are summed",
        [],
        "columns of the table; contracts with equal labels are summed",
    )


class BookMarketTable(CaseTable):
    """`[markets.NAME]`"""

    file: str = doc(
        "market of contracts, which replaces their own market and model",
        allowed="a TOML file with [market], and [model] if it has one",
    )


class TasksTable(CaseTable):
    """`[tasks]`"""

    policy: Literal["contract", "stress", "shape"] = doc(
        "policies to train: one for each contract, one for each stress, or one for similar "
        "contracts together",
        "contract",
    )
    deltas: Literal["base", "all", "none"] = doc(
        "values that have derivatives: the unstressed values, all values, or none", "base"
    )
    judge: Annotated[float, Range(0, 1)] = doc(
        "share of the contracts whose derivatives are tested by bumps", 0.1
    )
    paths: Annotated[int, Range(64, 2**24)] = doc("number of paths for a value", 16384)
    exposure: bool = doc(
        "whether to compute the mean of every output by day at the unstressed point", True
    )


class RunTable(CaseTable):
    """`[run]`"""

    seed: Annotated[int, Range(0, 2**32 - 1)] = doc("seed of all contracts", 0)
    processor: Literal["", "x86-64-v2", "x86-64-v3", "x86-64-v4"] = doc(
        "processor for which all workers compile; by default the processor of this machine", ""
    )


class BookTable(CaseTable):
    """The whole file."""

    kind: Literal["book"] = doc("kind of the file")
    title: Title = "Book"
    cases: dict[str, Any] = subtable("contracts of the book", "cases")
    markets: dict[str, dict[str, Any]] = doc("markets by name", {}, "tables [markets.NAME]")
    axis: list[dict[str, Any]] = doc(
        "grid of contracts, one for every combination of values", [], "tables [[axis]]"
    )
    stress: list[dict[str, Any]] = doc("stresses of all contracts", [], "tables [[stress]]")
    tasks: dict[str, Any] = doc("tasks of the book", {}, "a table")
    run: dict[str, Any] = doc("seed and processor", {}, "a table")


FORMATS = {
    "": BookTable,
    "cases": CasesTable,
    "markets.*": BookMarketTable,
    "axis[]": AxisTable,
    "stress[]": BookStressTable,
    "tasks": TasksTable,
    "run": RunTable,
}


class Origin(NamedTuple):
    """The files with the numbers of a contract: the file of its case, the row of the table that
    changes it (None if there is none), and the file of its market (None if it has no market)."""

    case: Path
    row: Row | None = None
    market: Path | None = None


@dataclass(frozen=True)
class BookContract:
    """A contract of the book, which is a case.

    - `quantity`: the number of these contracts in the book; a negative number means sold contracts.
    - `tables`: the tables of the case after all changes; `files`: {name: content} of the files that
      they name.
    - `labels`: {column: text} of its row in the table of contracts.
    - `origin`: the files from which its numbers come; None for a case without a book.
    """

    name: str
    market: str
    quantity: float
    tables: Mapping[str, Any]
    files: Mapping[str, bytes]
    labels: Mapping[str, str]
    origin: Origin | None = None


@dataclass(frozen=True)
class Book:
    """The content of a book's file."""

    file: Path
    title: str
    contracts: tuple[BookContract, ...]
    stresses: tuple[BookStress, ...]
    by: tuple[str, ...]
    tasks: TasksTable
    run: RunTable
    axes: tuple[Axis, ...] = ()


def read_book(path: Path) -> Book:
    """Reads a book; the cases themselves are checked when they are used.

    **Raises:** `CaseError` for every mistake in the file, its tables and its markets.
    """
    file, data = load(path)
    table = parse(BookTable, data, str(file), "")
    context = TableContext(file, "cases", [])
    cases = parse(CasesTable, table.cases, str(file), "cases")
    tasks = parse(TasksTable, table.tasks, str(file), "tasks")
    run = parse(RunTable, table.run, str(file), "run")
    markets = {name: _market(file, name, entry) for name, entry in table.markets.items()}
    contracts = tuple(_contracts(context, cases, markets))
    if not contracts:
        raise context.error("table", cases.table or cases.files, "the book has no contract")
    if taken := [column for column in contracts[0].labels if column in RESERVED]:
        message = "the results have a column of this name; rename the column of the table"
        raise context.error("table", taken[0], message)
    design = read_design(file, table.axis, run.seed, (*RESERVED, *contracts[0].labels))
    if len(contracts) * len(design.points) > MAX_POINTS:
        message = f"{len(contracts):,} contracts at {len(design.points):,} points of the axes"
        raise CaseError(str(file), "axis", None, f"{message}; at most {MAX_POINTS:,} are allowed")
    if design.axes:
        contracts = tuple(along(design, contracts))
    _check_names((_position(file, x), x.name, "contracts") for x in contracts)
    stresses = tuple(read_stresses(file, table.stress))
    for stress in stresses:
        if stress.name == BASE:
            message = "this name means the unstressed point; rename the stress"
            raise CaseError(stress.file, f"{stress.where}, name", BASE, message)
    _check_names(((x.file, x.where), x.name, "stresses") for x in stresses)
    for column in cases.by:
        if column not in contracts[0].labels:
            names = ", ".join(contracts[0].labels) or "none"
            raise context.error("by", column, f"it must be a column of the table: {names}")
    by = tuple(cases.by)
    return Book(file, table.title, contracts, stresses, by, tasks, run, design.axes)


def _position(file: Path, contract: BookContract) -> tuple[str, str]:
    """The file with the name of a contract, and the position of the name in it."""
    row = None if contract.origin is None else contract.origin.row
    return (str(file), "cases") if row is None else (row.file, f"line {row.line}")


def _check_names(entries: Iterable[tuple[tuple[str, str], str, str]]) -> None:
    """**Raises:** `CaseError` for a name that occurs twice; `entries`: position, name, and the
    noun."""
    first = dict[str, tuple[str, str]]()
    for position, name, noun in entries:
        if name in first:
            at = ", ".join(first[name])
            message = f"two {noun} have this name; the first is in {at}"
            raise CaseError(position[0], f"{position[1]}, name", name, message)
        first[name] = position


class MarketFiles(NamedTuple):
    """A market: its file, the tables in it, and {name: content} of the files next to it."""

    path: Path
    tables: Mapping[str, Any]
    contents: Mapping[str, bytes]


def _market(file: Path, name: str, entry: Mapping[str, Any]) -> MarketFiles:
    """The tables of a market, and the files next to it."""
    table = parse(BookMarketTable, entry, str(file), f"markets.{name}")
    path = _in_folder(file, f"markets.{name}.file", table.file)
    tables = load(path)[1]
    if other := set(tables) - set(SHARED):
        raise CaseError(
            str(path),
            sorted(other)[0],
            None,
            "the file of a market may have only the tables [market] and [model]",
        )
    if not tables:
        raise CaseError(str(path), "market", None, "this table is missing")
    return MarketFiles(path, tables, contents(path.parent, tables))


def _in_folder(file: Path, where: str, name: str) -> Path:
    """A path that the book names, which must lie in the folder of the book or below it."""
    path = file.parent / name
    if not path.exists() or not path.resolve().is_relative_to(file.parent.resolve()):
        raise CaseError(str(file), where, name, "it must be a path in the folder of the book")
    return path


def contents(folder: Path, tables: Mapping[str, Any]) -> dict[str, bytes]:
    """{name: content} of the files in this folder that a case with these tables may name."""
    files = [item for item in case_files(folder) if item.suffix != ".toml"]
    return {x.name: x.read_bytes() for x in [*files, *tables_named(folder, tables)]}


def _contracts(
    context: TableContext, cases: CasesTable, markets: Mapping[str, MarketFiles]
) -> Iterator[BookContract]:
    file = context.file
    if bool(cases.template) == bool(cases.files):
        raise context.error(
            "template", cases.template, "specify either a template or files, not both"
        )
    if cases.files:
        paths = sorted(file.parent.glob(cases.files))
        for path in paths:
            _, tables = load(path)
            name = (
                str(path.parent.relative_to(file.parent)) if path.name == "case.toml" else path.stem
            )
            origin = Origin(path)
            yield _contract(
                context, name, tables, contents(path.parent, tables), "", markets, 1.0, {}, origin
            )
        return
    path, tables = load(_in_folder(file, "cases.template", cases.template))
    files, origin = contents(path.parent, tables), Origin(path)
    if not cases.table:
        yield _contract(context, cases.template, tables, files, "", markets, 1.0, {}, origin)
        return
    reference = FileReference(context, "table", cases.table, below=True)
    rows = read_rows(reference, ("name",), with_keys=True)
    _check_columns(cases.table, rows)
    for row in rows:
        yield _of_row(context, row, tables, files, markets, origin._replace(row=row))


def _check_columns(name: str, rows: Sequence[Row]) -> None:
    """**Raises:** `CaseError` for a column without a name but with cells, and for one whose name is
    close to a column that has a meaning, as it would be taken for a label."""
    for column in rows[0].cells:
        close = get_close_matches(column, ROW_COLUMNS, n=1, cutoff=0.8)
        unnamed = not column and any(row.cells[column] for row in rows)
        if unnamed or (close and column not in ROW_COLUMNS):
            message = "columns are name, market, quantity, keys such as contract.max_inventory, and"
            meant = f"; the nearest known column is {close[0]}" if close else ""
            got = column or Unquoted("a column without a name")
            raise CaseError(name, "header", got, f"{message} labels{meant}")


def _of_row(context, row: Row, tables, contents, markets, origin: Origin) -> BookContract:
    """The template with the values of a row; columns whose name has a point are keys."""
    labels = {column: text for column, text in row.cells.items() if column not in ("name", "")}
    keys = [column for column in labels if "." in column and labels[column] != ""]
    try:
        settings = [f"{key_as_in(tables, key)}={labels[key]}" for key in keys]
        row_tables, _ = assigned(tables, settings)
    except CaseError as error:
        at = {str(x).casefold() for x in (error.where, error.value)}
        key = next((key for key in keys if key.casefold() in at), keys[0])
        raise row.error(key, error.allowed.partition("; in a shell")[0]) from None
    quantity = row.number("quantity") if "quantity" in labels else 1.0
    name = row.label("name")
    if not NAME.fullmatch(name):
        raise row.error("name", "a name of 1 to 80 characters without / and \\")
    labels = {column: text for column, text in labels.items() if "." not in column}
    return _contract(
        context,
        name,
        row_tables,
        contents,
        labels.get("market", ""),
        markets,
        quantity,
        labels,
        origin,
    )


def _contract(
    context,
    name,
    tables,
    contents,
    market,
    markets: Mapping[str, MarketFiles],
    quantity,
    labels,
    origin: Origin,
) -> BookContract:
    if markets:
        if not market and len(markets) == 1:
            (market,) = markets
        if market not in markets:
            allowed = f"the market of {name}; it must be one of {', '.join(markets)}"
            raise context.error("table", market or None, allowed)
        shared = markets[market]
        tables, origin = {**tables, **shared.tables}, origin._replace(market=shared.path)
        for file, content in shared.contents.items():
            if contents.get(file, content) != content:
                message = f"the case and the market {market} have different files of this name"
                raise CaseError(str(context.file), f"markets.{market}.file", file, message)
        contents = {**contents, **shared.contents}
    find(tables.get("kind"), str(origin.case))
    return BookContract(name, market, quantity, tables, contents, labels, origin)


def along(design: Design, contracts: Sequence[BookContract]) -> Iterator[BookContract]:
    """Every contract at every point of the axes; the values of the axes are also labels."""
    for contract in contracts:
        for point in design.points:
            labels = design.labels(point)
            settings = [f"{key}={text}" for key, text in design.settings(contract.tables, point)]
            yield replace(
                contract,
                name=", ".join([contract.name, *map(" ".join, labels.items())]),
                tables=assigned(contract.tables, settings)[0],
                labels={**contract.labels, **labels},
            )
