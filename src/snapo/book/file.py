"""Reads the file of a book: contracts, the markets that they share, stresses, and tasks.

A contract is a case: a template with other values in a row of a table, or a file of its own. Where
the book has markets, they replace the tables `[market]` and `[model]` of their contracts.
"""

import datetime
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.case.table import TITLE, CaseTable, TableContext, Title, parse
from snapo.case.toml import one_value
from snapo.study.assign import assigned
from snapo.study.domain import find
from snapo.study.run_folder import case_files

from .axes import MAX_POINTS, Axis, CaseKey, Design, read_design

BASE = "base"  # the name of the unstressed point
NAME = re.compile(r"[^\x00-\x1f/\\]{1,80}")
PERIOD = re.compile(r"(\d{4}-\d{2}(?:-\d{2})?)/(\d{4}-\d{2}(?:-\d{2})?)", re.ASCII)
SHARED = ("market", "model")  # tables of a case that its market gives
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

    template: str = Field("", description='the folder of a case, relative to the book: "store"')
    files: str = Field("", description='cases by a pattern, "contracts/*/case.toml"')
    table: str = Field("", description='the CSV of the contracts, "contracts.csv"')
    by: list[str] = Field([], description="columns of the table to sum by")


class BookMarketTable(CaseTable):
    """`[markets.NAME]`"""

    file: str = Field(description="a TOML file with [market], and [model] where it has one")


class BookStressTable(CaseTable):
    """`[[stress]]`"""

    name: str = Field("", description="a name")
    scale: dict[CaseKey, float] = Field(
        {}, description='factors, { "market.forward_curve" = 1.10 }'
    )
    shift: dict[CaseKey, float] = Field({}, description='amounts, { "market.forward_curve" = 2.0 }')
    set: dict[CaseKey, Any] = Field(
        {}, description='other values of keys, { "contract.injection_cost" = 0.05 }'
    )
    when: str = Field("", description='months or days, the last included: "2026-12/2027-02"')
    table: str = Field("", description="a file with a stress in each row")


class TasksTable(CaseTable):
    """`[tasks]`"""

    policy: Literal["contract", "stress", "shape"] = Field(
        "contract",
        description="trained once for each contract, again under each stress, or once for similar "
        "contracts",
    )
    deltas: Literal["base", "all", "none"] = Field("base", description="at which points")
    judge: float = Field(
        0.1,
        ge=0,
        le=1,
        description="the share of contracts whose derivatives are tested by bumps, 0 to 1",
    )
    paths: int = Field(16384, ge=64, le=2**24, description="paths of every value, 64 or more")
    exposure: bool = Field(True, description="the mean of every output by day, unstressed")


class RunTable(CaseTable):
    """`[run]`"""

    seed: int = Field(0, ge=0, le=2**32 - 1, description="of all contracts, 0 or more")
    processor: Literal["", "x86-64-v2", "x86-64-v3", "x86-64-v4"] = Field(
        "", description="the processor for which all workers compile; default: that of this machine"
    )


class BookTable(CaseTable):
    """The whole file."""

    kind: Literal["book"]
    title: Title = Field("Book", description=TITLE)
    cases: dict[str, Any] = Field(description="the table [cases]")
    markets: dict[str, dict[str, Any]] = Field({}, description="tables [markets.NAME]")
    axis: list[dict[str, Any]] = Field([], description="tables [[axis]]")
    stress: list[dict[str, Any]] = Field([], description="tables [[stress]]")
    tasks: dict[str, Any] = Field({}, description="a table")
    run: dict[str, Any] = Field({}, description="a table")


@dataclass(frozen=True)
class StressMove:
    """One input under a stress: `value * scale + shift`, on the dates of `when`; or a key of the
    case with another value.

    - `key`: of the case, "market.forward_curve".
    - `when`: first and last day; None: everywhere.
    - `value`: as TOML writes it; "": that of the case.
    """

    key: str
    scale: float = 1.0
    shift: float = 0.0
    when: tuple[datetime.date, datetime.date] | None = None
    value: str = ""


@dataclass(frozen=True)
class BookStress:
    """Other numbers for some inputs; `labels`: {label of an axis: the text of its value}."""

    name: str
    moves: tuple[StressMove, ...]
    labels: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class BookContract:
    """A case of the book.

    - `quantity`: how many of it the book has; negative: sold.
    - `tables`: of the case as they count; `files`: {name: content} of the files that they name.
    - `labels`: {column: text} of its row.
    """

    name: str
    market: str
    quantity: float
    tables: Mapping[str, Any]
    files: Mapping[str, bytes]
    labels: Mapping[str, str]


@dataclass(frozen=True)
class Book:
    """A book that was read."""

    file: Path
    title: str
    contracts: tuple[BookContract, ...]
    stresses: tuple[BookStress, ...]
    by: tuple[str, ...]
    tasks: TasksTable
    run: RunTable
    axes: tuple[Axis, ...] = ()


def read_book(path: Path) -> Book:
    """Reads a book; the cases themselves are checked where they are used.

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
        raise context.error("table", cases.table or cases.files, "it has no contract")
    if taken := [column for column in contracts[0].labels if column in RESERVED]:
        message = "the results have a column of this name; give that of the table another one"
        raise context.error("table", taken[0], message)
    design = read_design(file, table.axis, run.seed, (*RESERVED, *contracts[0].labels))
    if len(contracts) * len(design.points) > MAX_POINTS:
        message = f"{len(contracts):,} contracts at {len(design.points):,} points of the axes"
        raise CaseError(str(file), "axis", None, f"{message}; allowed are {MAX_POINTS:,} together")
    if design.axes:
        contracts = tuple(along(design, contracts))
    _unique_names(file, "cases", [contract.name for contract in contracts])
    stresses = tuple(_stresses(file, table.stress))
    _unique_names(file, "stress", [BASE, *(stress.name for stress in stresses)])
    for column in cases.by:
        if column not in contracts[0].labels:
            names = ", ".join(contracts[0].labels) or "none"
            raise context.error("by", column, f"allowed is a column of the table: {names}")
    by = tuple(cases.by)
    return Book(file, table.title, contracts, stresses, by, tasks, run, design.axes)


def _unique_names(file: Path, where: str, names: Sequence[str]) -> None:
    visited: set[str] = set()
    for name in names:
        if name in visited:
            raise CaseError(str(file), f"{where}.name", name, "two have this name")
        visited.add(name)


MarketFiles = tuple[Mapping[str, Any], Mapping[str, bytes]]


def _market(file: Path, name: str, entry: Mapping[str, Any]) -> MarketFiles:
    """The tables of a market, and the files next to it."""
    table = parse(BookMarketTable, entry, str(file), f"markets.{name}")
    path = _in_folder(file, f"markets.{name}.file", table.file)
    tables = load(path)[1]
    if other := set(tables) - set(SHARED):
        raise CaseError(str(path), sorted(other)[0], None, "a market has [market] and [model] only")
    if not tables:
        raise CaseError(str(path), "market", None, "this table is missing")
    return tables, contents(path.parent)


def _in_folder(file: Path, where: str, name: str) -> Path:
    """A path of the book, which must lie in its folder or below it."""
    path = file.parent / name
    if not path.exists() or not path.resolve().is_relative_to(file.parent.resolve()):
        raise CaseError(str(file), where, name, "allowed is a path in the folder of the book")
    return path


def contents(folder: Path) -> dict[str, bytes]:
    """{name: content} of the files that a case of this folder may name."""
    return {item.name: item.read_bytes() for item in case_files(folder) if item.suffix != ".toml"}


def _contracts(
    context: TableContext, cases: CasesTable, markets: Mapping[str, MarketFiles]
) -> Iterator[BookContract]:
    file = context.file
    if bool(cases.template) == bool(cases.files):
        raise context.error("template", cases.template, "give a template, or files; one of them")
    if cases.files:
        paths = sorted(file.parent.glob(cases.files))
        for path in paths:
            _, tables = load(path)
            name = (
                str(path.parent.relative_to(file.parent)) if path.name == "case.toml" else path.stem
            )
            yield _contract(context, name, tables, contents(path.parent), "", markets, 1.0, {})
        return
    _, tables = load(_in_folder(file, "cases.template", cases.template))
    files = contents(_in_folder(file, "cases.template", cases.template))
    if not cases.table:
        yield _contract(context, cases.template, tables, files, "", markets, 1.0, {})
        return
    for row in read_rows(FileReference(context, "table", cases.table), ("name",)):
        yield _of_row(context, row, tables, files, markets)


def _of_row(context, row: Row, tables, contents, markets) -> BookContract:
    """The template with the values of a row: columns with a point are keys."""
    labels = {column: text for column, text in row.cells.items() if column not in ("name", "")}
    keys = [column for column in labels if "." in column and labels[column] != ""]
    try:
        row_tables, _ = assigned(tables, [f"{key}={labels[key]}" for key in keys])
    except CaseError as error:
        raise row.error(keys[0], str(error.allowed)) from None
    quantity = row.number("quantity") if "quantity" in labels else 1.0
    name = row.label("name")
    if not NAME.fullmatch(name):
        raise row.error("name", "a name of 1 to 80 characters without / and \\")
    labels = {column: text for column, text in labels.items() if "." not in column}
    return _contract(
        context, name, row_tables, contents, labels.get("market", ""), markets, quantity, labels
    )


def _contract(
    context, name, tables, contents, market, markets: Mapping[str, MarketFiles], quantity, labels
) -> BookContract:
    if markets:
        if not market and len(markets) == 1:
            (market,) = markets
        if market not in markets:
            allowed = f"the market of {name}; allowed is one of {', '.join(markets)}"
            raise context.error("table", market or None, allowed)
        of_market, files = markets[market]
        tables = {**tables, **of_market}
        for file, content in files.items():
            if contents.get(file, content) != content:
                message = f"the case and the market {market} have different files of this name"
                raise CaseError(str(context.file), f"markets.{market}.file", file, message)
        contents = {**contents, **files}
    find(tables.get("kind"), str(context.file))
    return BookContract(name, market, quantity, tables, contents, labels)


def along(design: Design, contracts: Sequence[BookContract]) -> Iterator[BookContract]:
    """Every contract at every point of the axes; their values are labels too."""
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


def _stresses(file: Path, entries: Sequence[Mapping[str, Any]]) -> Iterator[BookStress]:
    for i, entry in enumerate(entries):
        where = f"stress[{i + 1}]"
        table = parse(BookStressTable, entry, str(file), where)
        if table.table:
            yield from _of_table(TableContext(file, where, []), table.table)
            continue
        if not table.name or not (table.scale or table.shift or table.set):
            message = "a stress has a name, and scale, shift or set; or a table"
            raise CaseError(str(file), where, table.name or None, message)
        when = _period(str(file), f"{where}.when", table.when)
        keys = dict.fromkeys([*table.scale, *table.shift])
        if twice := [key for key in keys if key in table.set]:
            message = "this key is set to a value; it cannot be scaled or shifted as well"
            raise CaseError(str(file), f"{where}.set", twice[0], message)
        yield BookStress(
            table.name,
            (
                *(StressMove(key, value=one_value(value)) for key, value in table.set.items()),
                *(
                    StressMove(key, table.scale.get(key, 1.0), table.shift.get(key, 0.0), when)
                    for key in keys
                ),
            ),
        )


def _of_table(context: TableContext, name: str) -> Iterator[BookStress]:
    """A stress in each row: `name`, and columns `scale KEY`, `shift KEY`, or `scale KEY@PERIOD`;
    `set KEY` has a value as `--set` takes it."""
    for row in read_rows(FileReference(context, "table", name), ("name",)):
        moves = []
        for column in row.cells:
            kind, _, rest = column.partition(" ")
            if kind not in ("scale", "shift", "set") or not rest or not row.cells[column]:
                continue
            key, _, text = rest.strip().partition("@")
            if kind == "set":
                moves.append(StressMove(rest.strip(), value=row.label(column)))
                continue
            when = _period(row.file, f"line {row.line}, column {column}", text)
            number, move = row.number(column), StressMove(key, when=when)
            moves.append(
                replace(move, scale=number) if kind == "scale" else replace(move, shift=number)
            )
        if not moves:
            raise row.error(
                "name", "a row with at least one of the columns scale KEY, shift KEY, set KEY"
            )
        yield BookStress(row.label("name"), tuple(moves))


def _period(file: str, where: str, text: str) -> tuple[datetime.date, datetime.date] | None:
    """First and last day of "2026-12/2027-02"."""
    if not text:
        return None
    match = PERIOD.fullmatch(text)
    try:
        first, last = (_day(part, end) for part, end in zip(match.groups(), (False, True)))  # pyright: ignore
    except (AttributeError, ValueError):
        allowed = 'two months or days with a slash, the last one included: "2026-12/2027-02"'
        raise CaseError(file, where, text, allowed) from None
    if last < first:
        raise CaseError(file, where, text, "the first day is after the last")
    return first, last


def _day(text: str, end: bool) -> datetime.date:
    if len(text) == 10:
        return datetime.date.fromisoformat(text)
    first = datetime.date.fromisoformat(f"{text}-01")
    if not end:
        return first
    next_month = (first.replace(day=28) + datetime.timedelta(days=4)).replace(day=1)
    return next_month - datetime.timedelta(days=1)
