"""The commands of a book: value it, check it, report it, query it."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.solver.tables import write_text
from snapo.study.study import ProgressCallback

from .executors import worker_pools
from .file import read_book
from .folder import REPORT, RESULT, BookFolder
from .parquet import query as query
from .plan import BookPlan
from .run import Shard, run_book

# Processor seconds of the gas storage template (AMD EPYC, AVX-512): `python -m benchmarks.book
# shapes`. A new shape costs so much more than a further contract.
OF_A_SHAPE, OF_A_CONTRACT, OF_A_JUDGED, OF_A_STRESS = 13.0, 17.0, 8.4, 1.2


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
    """Values a book; see `run_book`. `on`: where, see `executors.worker_pools`.

    **Raises:** `CaseError` for a mistake in the book, or where its workers cannot be reached.
    """
    book = read_book(path)  # a mistake in it is named before a cluster is joined
    made = worker_pools(on, workers, trust_network)
    part = None if shard is None else Shard(*shard)
    return run_book(book, progress, made, out=out, shard=part, resume=resume)


def check(path: Path) -> list[str]:
    """A book in a few lines: contracts, orders, shapes, and expected processor time."""
    book = read_book(path)
    plan = BookPlan(book)
    stresses, distinct = len(book.stresses), sum(map(len, plan.similar.values()))
    judged, shapes = len(plan.judged), len(plan.similar)
    trainings = 1 if book.tasks.policy == "contract" else 1 + stresses
    seconds = (
        shapes * OF_A_SHAPE
        + distinct * OF_A_CONTRACT * trainings
        + judged * OF_A_JUDGED
        + (distinct * stresses * OF_A_STRESS if trainings == 1 else 0.0)
    )
    repeated = len(book.contracts) - distinct
    same = f", {repeated:,} of them with the case of another one" if repeated else ""
    markets = sorted({contract.market for contract in book.contracts} - {""})
    return [
        f"{book.title}: {len(book.contracts):,} contracts{same}, {stresses:,} stresses",
        *([f"markets: {', '.join(markets)}"] if markets else []),
        f"{plan.size:,} orders of {1 + stresses:,} points for each contract",
        f"shapes: about {shapes:,}; derivatives of {judged:,} contracts are judged by bumps",
        f"expected: {_duration(seconds)} of processor time on gas stores of a year",
    ]


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:,.0f} s"
    return f"{seconds / 60:,.0f} min" if seconds < 7200 else f"{seconds / 3600:,.1f} h"


def report(path: Path) -> Path:
    """Writes the report of a book's folder again; returns its path."""
    from snapo.report.page import render

    from .report import page

    folder = BookFolder(path)
    record = folder.record()
    try:
        result = json.loads((path / RESULT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        message = "this book has no results yet: snapo book BOOK --resume computes the rest"
        raise CaseError(str(path / RESULT), "", None, message) from None
    write_text(path / REPORT, render(page(result, record)))
    return path / REPORT


def summary(result: Mapping[str, Any]) -> str:
    """The result for a reader."""
    orders = result["orders"]
    counts = f"{orders['computed']:,} orders computed, {orders['reused']:,} used again"
    lines = [f"book: {result['status']}"]
    if "sums" in result:
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
        lines += [f"{x['case']} under {x['stress']}: {x['note']}" for x in result["failures"][:5]]
    else:
        number, count = result["shard"]
        counts += f"; part {number} of {count}: others are missing yet"
    lines.append(f"{counts}, {result['seconds']['total']:,.1f} s")
    if "sums" in result:
        lines.append(f"report: {Path(result['run']) / REPORT}")
    return "\n".join(lines)


def _plus_minus(error: float | None) -> str:
    return "" if error is None else f" ± {error:,.2g}"


def _worst(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The ten that lose most, and before them those without a value."""
    return sorted(rows, key=lambda x: -math.inf if x["change"] is None else x["change"])[:10]
