"""The commands of a book: value it, check it, report it, query it."""

import math
import re
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from snapo.case.csv import Row
from snapo.case.error import CaseError, Unquoted, counted
from snapo.case.load import load
from snapo.case.table import parse
from snapo.case.toml import impossible_moment
from snapo.solver.statistics import plus_minus
from snapo.solver.tables import write_text
from snapo.study.assign import OPTION, assigned
from snapo.study.domain import Domain, Options, RunsCode, find
from snapo.study.kind import with_other_numbers
from snapo.study.study import ProgressCallback

from .axes import RANGE, read_design
from .contract import JobContract
from .executors import worker_pools
from .file import (
    SHARED,
    Book,
    BookContract,
    RunTable,
    TasksTable,
    along,
    contents,
    read_book,
)
from .folder import POINTS, REPORT, BookFolder
from .parquet import query as query
from .plan import BookPlan
from .run import Shard, run_book
from .stress import BookStress, StressMove
from .work import valuation

# Processor seconds of the gas storage template (AMD EPYC, AVX-512): `python -m benchmarks.book
# shapes`. A new shape costs so much more than a further contract.
OF_A_SHAPE, OF_A_CONTRACT, OF_A_JUDGED, OF_A_STRESS = 11.7, 4.1, 12.9, 0.7
OF_A_TRAINING = 1.6  # and the measurements that a trained policy takes

MAX_LINES = 60  # points of the axes that are printed


def solve(
    path: Path,
    progress: ProgressCallback,
    *,
    out: Path | None = None,
    workers: int | None = None,
    on: str = "",
    trust_network: bool = False,
    shard: tuple[int, int] | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """Values a book; see `run_book`. `on`: where its jobs run, see `executors.worker_pools`.

    **Raises:** `CaseError` for a mistake in the book, or if its workers cannot be reached.
    """
    book = read_book(path)  # a mistake in it is named before a cluster is joined
    made = worker_pools(on, workers, trust_network)
    part = None if shard is None else Shard(*shard)
    return run_book(book, progress, made, out=out, shard=part, resume=resume)


def sweep(
    path: Path,
    assignments: Sequence[str],
    progress: ProgressCallback,
    *,
    sobol: int | None = None,
    train: bool = False,
    out: Path | None = None,
    workers: int | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """Values a case at all points of some axes, as a book; see `run_book`.

    - `assignments`: as in `--set`; "KEY=5:35:7" and "KEY=1,2,5" are axes of values, "KEY=5:35" is
      an axis of `sobol` Sobol points.
    - `train`: whether each point trains its policy; otherwise the policy of the case decides at all
      points.

    **Raises:** `CaseError` for a mistake in the case, its axes, or one of their points.
    """
    book = sweep_book(path, assignments, sobol=sobol, train=train)
    folder = book.file.parent / "sweep" if out is None else out
    return run_book(book, progress, worker_pools("", workers), out=folder, resume=resume)


def sweep_book(
    path: Path, assignments: Sequence[str], *, sobol: int | None = None, train: bool = False
) -> Book:
    """The book of a sweep: the case under a stress for each point, or a contract for each."""
    file, tables = load(path)
    if file.suffix != ".toml":
        message = "a sweep cannot read a workbook; write its tables into a TOML file and CSV files"
        raise CaseError(str(file), "", None, message)
    entries, fixed = _axes(assignments, sobol)
    tables, _ = assigned(tables, fixed)
    domain = find(tables.get("kind"), str(file))
    if isinstance(domain, RunsCode):
        message = f'a case of kind "{domain.kind}" runs user code, which sweeps do not support'
        raise CaseError(str(file), "kind", None, message)
    case: Any = domain.read(file, tables)
    seed, paths = case.training.seed, case.evaluation.paths
    try:
        design = read_design(Path(OPTION), entries, seed)
    except CaseError as error:
        number = re.match(r"axis\[(\d+)\]", error.where)
        where = entries[int(number[1]) - 1]["key"] if number else ""
        raise CaseError(OPTION, where, error.value, error.allowed) from None
    settings = [design.settings(tables, point) for point in design.points]
    for point in (settings[0], settings[-1]):
        _read_at(domain, file, tables, point)
    title = str(tables.get("title") or file.parent.resolve().name)
    contract = BookContract(title, "", 1.0, tables, contents(file.parent, tables), {})
    contracts, stresses = (contract,), ()
    study = domain.study(case, Options())
    if train or study.setup is None:
        contracts = tuple(along(design, contracts))
    else:
        stresses = tuple(
            BookStress(
                ", ".join(map(" ".join, design.labels(point).items())),
                tuple(StressMove(key, value=text) for key, text in values),
                design.labels(point),
            )
            for point, values in zip(design.points, settings)
        )
    tasks = parse(
        TasksTable,
        {
            "deltas": "none" if train else "base",
            "judge": 0.0,
            "paths": max(64, paths),
            "exposure": False,
        },
        "",
        "",
    )
    return Book(
        file,
        title,
        contracts,
        stresses,
        (),
        tasks,
        parse(RunTable, {"seed": seed}, str(file), "training"),
        design.axes,
    )


def _axes(assignments: Sequence[str], sobol: int | None) -> tuple[list[dict[str, Any]], list[str]]:
    """The tables of those assignments that are axes, and the other assignments."""
    entries, fixed = list[dict[str, Any]](), list[str]()
    for text in assignments:
        key, _, written = (part.strip() for part in text.partition("="))
        match = RANGE.fullmatch(written)
        values: list[Any] = []
        with suppress(tomllib.TOMLDecodeError):
            values = tomllib.loads(f"values = [{written}]")["values"]
        if match is None and not values and (moment := impossible_moment(written)):
            raise CaseError(OPTION, key, Unquoted(moment[0]), moment[1])
        if match is not None and match[3] is None and sobol is not None:
            entries.append({"key": key, "range": written, "sobol": sobol})
        elif match is not None:
            entries.append({"key": key, "values": written})
        elif len(values) > 1:
            entries.append({"key": key, "values": values})
        else:
            fixed.append(text)
    if not entries:
        message = (
            "at least one key needs several values; write a range (KEY=0:2000:5) or a list "
            "(KEY=1,2,5)"
        )
        raise CaseError(OPTION, "", fixed[0] if fixed else None, message)
    if sobol is not None and not any("sobol" in entry for entry in entries):
        message = "Sobol points need a range without a number of values: --set KEY=0:2000"
        raise CaseError("--sobol", "", sobol, message)
    return entries, fixed


def _read_at(
    domain: Domain, file: Path, tables: Mapping[str, Any], settings: Sequence[tuple[str, str]]
) -> None:
    """**Raises:** `CaseError` if the case cannot be read at a point."""
    data, _ = assigned(tables, [f"{key}={text}" for key, text in settings])
    try:
        domain.read(file, with_other_numbers(domain, data))
    except CaseError as error:
        for item in (error, *error.others):
            item.file = f"{item.file} with {OPTION}"
        raise


def check(path: Path) -> list[str]:
    """Describes a book in a few lines: contracts, jobs, shapes, and expected processor time.

    **Raises:** `CaseError` for every mistake in the book, in its contracts, and in the stresses of
    the first contract of each template and market.
    """
    book = read_book(path)
    plan = BookPlan(book)
    _check_contracts(plan)
    stresses, distinct = len(book.stresses), sum(map(len, plan.similar.values()))
    judged, shapes = len(plan.judged), len(plan.similar)
    trainings = 1 + stresses if book.tasks.policy == "stress" else 1
    seconds = (
        shapes * OF_A_SHAPE
        + distinct * OF_A_CONTRACT * trainings
        + judged * OF_A_JUDGED
        + (distinct * stresses * OF_A_STRESS if trainings == 1 else 0.0)
        - len(plan.adopting) * OF_A_TRAINING
    )
    repeated = len(book.contracts) - distinct
    same = f", of which {repeated:,} repeat the case of another contract" if repeated else ""
    markets = sorted({contract.market for contract in book.contracts} - {""})
    return [
        f"{book.title}: {counted(len(book.contracts), 'contract')}{same}, "
        f"{counted(stresses, 'stress')}",
        *([f"markets: {', '.join(markets)}"] if markets else []),
        f"{counted(plan.size, 'job')}; {counted(1 + stresses, 'point')} for each contract",
        f"shapes of contracts: about {shapes:,}; contracts whose derivatives are tested by "
        f"bumps: {judged:,}",
        f"expected: {_duration(seconds)} of processor time, if all contracts are gas stores of "
        f"one year",
    ]


MAX_MISTAKES = 10  # that are named in one message


def _check_contracts(plan: BookPlan) -> None:
    """Reads every contract in the same way as a worker."""
    mistakes, stressed = dict[tuple[str, str], CaseError](), set[Any]()
    for contract, job in plan.distinct:
        with tempfile.TemporaryDirectory(prefix="snapo-book-") as folder:
            origin = contract.origin
            try:
                read = JobContract(job, Path(folder))
                if plan.book.stresses and (key := origin and (origin.case, origin.market)):
                    if key not in stressed:
                        _check_stresses(read, plan.book.stresses)
                    stressed.add(key)
            except CaseError as error:
                for item in (error, *error.others):
                    _locate(item, plan.book, contract, folder)
                    mistakes.setdefault((item.file, item.where), item)
        if len(mistakes) >= MAX_MISTAKES:
            break
    if mistakes:
        first, *others = mistakes.values()
        raise CaseError(first.file, first.where, first.value, first.allowed, others)


def _check_stresses(contract: JobContract, stresses: Sequence[BookStress]) -> None:
    inputs = valuation(contract).inputs
    for stress in stresses:
        try:
            contract.under(stress.moves, inputs)
        except CaseError as error:
            where = ", ".join(part for part in (stress.where, error.where) if part)
            raise CaseError(stress.file, where, error.value, error.allowed) from None


def _locate(error: CaseError, book: Book, contract: BookContract, folder: str) -> None:
    """Replaces the worker's copy of a file by the user's file in the message."""
    origin, key = contract.origin, error.where
    if origin is None or error.file in {stress.file for stress in book.stresses}:
        return
    market = origin.market
    if error.file != str(Path(folder) / "case.toml"):  # a file that the case names
        shared = market is not None and (market.parent / error.file).exists()
        home = market.parent if market is not None and shared else origin.case.parent
        error.file = str(home / error.file)
    elif key in {axis.key for axis in book.axes}:
        error.file, error.where = str(book.file), f"axis {key}"
    elif origin.row is not None and (column := _column(origin.row, key)):
        error.file, error.where = origin.row.file, f"line {origin.row.line}, column {column}"
    else:
        shared = market is not None and key.split(".")[0] in SHARED
        error.file = str(market if shared else origin.case)


def _column(row: Row, key: str) -> str:
    """The column of a row that has a value for a key; "" if there is none."""
    columns = (column for column, text in row.cells.items() if text)
    return next((column for column in columns if column.casefold() == key.casefold()), "")


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:,.0f} s"
    return f"{seconds / 60:,.0f} min" if seconds < 7200 else f"{seconds / 3600:,.1f} h"


def report(path: Path) -> Path:
    """Writes the report in a book's folder again; returns the path of the report."""
    from snapo.report.page import render

    from .report import page

    folder = BookFolder(path)
    record = folder.record()
    write_text(path / REPORT, render(page(folder.result(), record)))
    return path / REPORT


def summary(result: Mapping[str, Any]) -> str:
    """The result as text for the terminal."""
    jobs = result["orders"]
    counts = f"{counted(jobs['computed'], 'job')} computed, {jobs['reused']:,} reused"
    lines = [f"book: {result['status']}; ± is half of a 95 % interval, simulation error only"]
    if result.get("points"):
        lines += _table_of_points(result)
    elif "sums" in result:
        cases = result["cases"]
        lines.append(f"{'contracts':<24}{cases['ok']:>16,}   {cases['failed']:,} failed")
        rows = result["sums"]
        displayed = rows if len(rows) <= 12 else [rows[0], *_worst(rows[1:])]
        for row in displayed:
            if row["value"] is None:
                lines.append(f"{row['stress']:<24}{'none':>16}")
                continue
            change = f"   change {row['change']:+,.2f}{_plus_minus(row['change_error'])}"
            line = f"{row['stress']:<24}{row['value']:>16,.2f}{_plus_minus(row['standard_error'])}"
            lines.append(line + (change if row is not rows[0] else ""))
        lines += [f"note: {note}" for note in result["notes"]]
    if "sums" in result:
        lines += [f"{x['case']} under {x['stress']}: {x['note']}" for x in result["failures"][:5]]
    else:
        number, count = result["shard"]
        counts += f"; this is part {number} of {count}: other parts are still missing"
    lines.append(f"{counts}, {result['seconds']['total']:,.1f} s")
    if "sums" in result:
        lines.append(f"report: {Path(result['run']) / REPORT}")
    return "\n".join(lines)


def _table_of_points(result: Mapping[str, Any]) -> list[str]:
    """A table with a line for each point of the axes."""
    rows = result["points"][:MAX_LINES]
    table = [[*rows[0]["at"], "value", "", "change"]]
    for row in rows:
        value = "none" if row["value"] is None else f"{row['value']:,.6g}"
        change = "" if row["change"] is None else f"{row['change']:+,.6g}"
        errors = _plus_minus(row["standard_error"]).strip(), _plus_minus(row["change_error"])
        table.append([*row["at"].values(), value, errors[0], f"{change}{errors[1]}"])
    if not any(row[-1] for row in table[1:]):
        table = [row[:-1] for row in table]
    widths = [max(map(len, column)) for column in zip(*table)]
    lines = ["  ".join(map(str.rjust, row, widths)).rstrip() for row in table]
    if len(result["points"]) > len(rows):
        lines.append(f"… {len(result['points']) - len(rows):,} more")
    return [*lines, f"all points: {Path(result['run']) / POINTS}"]


def _plus_minus(error: float | None) -> str:
    return "" if error is None else f" {plus_minus(error)}"


def _worst(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The ten worst stresses: first those without a value, then those with the largest losses."""
    return sorted(rows, key=lambda x: -math.inf if x["change"] is None else x["change"])[:10]
