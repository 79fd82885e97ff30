"""`snapo explain RUN_A RUN_B`: the change of value between two runs, as a table and a report."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.solver.statistics import plus_minus
from snapo.solver.tables import write_csv, write_text
from snapo.study.prepare import use_every_core
from snapo.study.run_folder import plain_json

from .flows import read_flows
from .page import page
from .parts import ChangePart, ExplainedChange, explained_change
from .runs import ValuedRun

FOLDER, PARTS, MOVES, RESULT, REPORT = (
    "explain", "explain.csv", "curve.csv", "explain.json", "explain.html",
)  # fmt: skip


def explain(
    first: Path, second: Path, progress, *, flows: Path | None = None, out: Path | None = None
) -> dict[str, Any]:
    """Explains the change of value from the first run to the second one, and writes the parts.

    - `flows`: a CSV file of the flows on the days between, with columns date,volume,price.
    - `out`: folder of the results, by default `explain` in that of the second run.

    **Raises:** `CaseError` where a run has no value, or the second one cannot follow the first;
    nothing is written.
    """
    use_every_core()
    taken = None if flows is None else read_flows(flows)
    change = explained_change(ValuedRun.read(first), ValuedRun.read(second), progress, taken)
    folder, answer = second / FOLDER if out is None else out, _answer(change)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        head = ("part", "period", "amount", "standard_error", "note")
        write_csv(folder / PARTS, head, _cells(head, change.parts))
        head = ("period", "days", "move", "delta")
        write_csv(folder / MOVES, head, _cells(head, change.moves))
        write_text(folder / RESULT, json.dumps(plain_json(answer), indent=1))
        write_text(folder / REPORT, page(change))
    except OSError as error:
        message = f"the folder cannot be written ({error.strerror})"
        raise CaseError(str(folder), "", None, message) from None
    return answer | {"folder": folder}


def _cells(names: Sequence[str], records: Sequence[Any]) -> Iterator[list[Any]]:
    for record in records:
        values = [getattr(record, name) for name in names]
        yield ["" if value is None else value for value in values]


def _answer(change: ExplainedChange) -> dict[str, Any]:
    return {
        "status": "ok",
        "runs": [str(run) for run in change.runs],
        "dates": list(change.dates),
        "currency": change.currency,
        "values": list(change.values),
        "standard_errors": list(change.errors),
        "change": change.change,
        "cash": change.cash,
        "profit": change.profit,
        "parts": [asdict(row) for row in change.parts],
        "totals": [asdict(row) for row in change.totals],
        "curve": [asdict(row) for row in change.moves],
        "flows": [flow._asdict() for flow in change.flows],
        "paths": change.paths,
        "notes": list(change.notes),
        "digits": change.digits,
    }


def summary(answer: Mapping[str, Any]) -> str:
    """The answer for a reader."""
    return "\n".join(_lines(answer))


def _lines(answer: Mapping[str, Any]) -> Iterator[str]:
    digits, (before, now) = answer["digits"], answer["dates"]
    rows = [ChangePart(**row) for row in answer["parts"]]
    amounts = [*answer["values"], *(row.amount for row in rows)]
    width = max(14, *(len(f"{x:,.{digits}f}") + 2 for x in amounts))

    def line(name: str, amount: float, error: float | None = None, note: str = "") -> str:
        half = "" if error is None else plus_minus(error)
        return f"{name:<26}{amount:>{width},.{digits}f} {half:<11} {note}".rstrip()

    yield f"{answer['currency']}; ± is half of a 95 % interval, on {answer['paths']:,} paths"
    yield line(f"value before, {before}", *_value(answer, 0))
    for total in (ChangePart(**row) for row in answer["totals"]):
        yield line(f"  {total.part}", total.amount, total.standard_error, total.note)
    yield line(f"value now, {now}", *_value(answer, 1))
    yield line("change of value", answer["change"])
    if answer["cash"] or answer["flows"]:
        yield line("profit and loss", answer["profit"], None, "change of value and cash")
    if any(row.period and row.amount for row in rows):
        yield from _curve(answer, rows, digits, width)
    for note in answer["notes"]:
        yield f"note: {note}"
    yield f"report: {answer['folder'] / REPORT}"


def _value(answer: Mapping[str, Any], k: int) -> tuple[float, float]:
    return answer["values"][k], answer["standard_errors"][k]


def _curve(
    answer: Mapping[str, Any], rows: Sequence[ChangePart], digits: int, width: int
) -> Iterator[str]:
    yield ""
    yield f"{'curve':<16}{'move':>12}{'delta':>14}{'first order':>{width}}{'second':>{width}}"
    orders = [[row for row in rows if row.part == part] for part in dict.fromkeys(
        row.part for row in rows if row.period
    )]  # fmt: skip
    for move, first, second in zip(answer["curve"], *orders, strict=True):
        delta = "" if move["delta"] is None else f"{move['delta']:,.1f}"
        text = f"{move['period']:<16}{move['move']:>12,.4f}{delta:>14}"
        yield text + "".join(f"{x.amount:>{width},.{digits}f}" for x in (first, second))
