"""Makes the tables, sums and risk of a book from its results."""

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from snapo.solver import statistics
from snapo.solver.tables import write_csv

from .file import BASE, Book, BookContract
from .folder import POINTS, POLICIES, TABLES, BookFolder
from .job import BookJob, BookPoint, Cost, JobResult, OutputFigures, name_of
from .parquet import TableRows, TableWriter
from .plan import BookPlan, ResultReader, SharedPolicy
from .sums import BookTotal, DeltaTotal, ExposureTotal, Sum, risks

FEW = 500  # contracts, beyond which `TOGETHER` of them share a file
TOGETHER = 32


@dataclass
class BookPosition:
    """The results of a contract in the book, at all its points.

    - `points`: {stress: its point, with the cost and the shape of its result}.
    - `labels`: {stress: {label of an axis: the text of its value}}.
    - `world`: a text that is equal for two contracts if all their paths have the same scenarios.
    """

    contract: BookContract
    points: dict[str, tuple[BookPoint, Cost | None, str]]
    labels: Mapping[str, Mapping[str, str]]
    policy: bytes | None = None
    world: str = ""

    @property
    def base(self) -> BookPoint:
        return self.points[BASE][0]

    @property
    def worst(self) -> BookPoint:
        """A point that failed; None if all points have a value."""
        return next((p for p, _, _ in self.points.values() if p.status != "ok"), self.base)


def _read(
    folder: BookFolder, lost: Mapping[str, str], name: str
) -> tuple[JobResult, Cost | None] | None:
    if name in lost:
        return JobResult((BookPoint.without_value("lost", lost[name]),)), None
    return folder.read(name)


def reader(folder: BookFolder, lost: Mapping[str, str]) -> ResultReader:
    """Returns a function that reads the result of a job by its name; `lost`: {job: the reason}."""

    def read(name: str) -> JobResult | None:
        entry = _read(folder, lost, name)
        return None if entry is None else entry[0]

    return read


def position(
    plan: BookPlan, contract: BookContract, folder: BookFolder, lost: Mapping[str, str]
) -> BookPosition:
    """The points of a contract from the folder's results; `lost`: {job: the reason}."""
    names = [BASE, *(stress.name for stress in plan.book.stresses)]
    labels = {stress.name: stress.labels for stress in plan.book.stresses}
    collected = BookPosition(contract, {}, labels)
    waiting = iter(names)

    def take(job: BookJob) -> JobResult | None:
        entry = _read(folder, lost, name_of(job.pack()))
        for i, name in enumerate(itertools.islice(waiting, len(job.stresses) + job.base)):
            if entry is None:
                collected.points[name] = (
                    BookPoint.without_value("missing", "it has not been computed"),
                    None,
                    "",
                )
            else:
                result, cost = entry
                point = result.points[min(i, len(result.points) - 1)]
                collected.points[name] = point, cost if i == 0 else None, result.shape
        return None if entry is None else entry[0]

    base = plan.base(contract, reader(folder, lost))
    result = None if base is None else take(base)
    if result is not None:
        collected.policy, collected.world = result.policy, result.world
    for job in () if base is None or result is None else plan.further(base, result):
        take(job)
    for name in waiting:
        point = BookPoint.without_value("missing", "its unstressed point has not been computed")
        if result is not None:
            point = BookPoint.without_value(
                result.points[0].status, f"its base: {result.points[0].note}"
            )
        collected.points[name] = point, None, ""
    return collected


@dataclass
class PointTotal:
    """The sum of the contracts at a point of the axes, and the outputs of each of them."""

    stress: str
    total: BookTotal = field(default_factory=lambda: BookTotal(BASE))
    outputs: list[tuple[OutputFigures, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def row(self, at: Mapping[str, str]) -> dict[str, Any]:
        """The entry of this object in result.json."""
        total = self.total.at(self.stress)
        row = dict.fromkeys(Sum._fields) if total is None else total._asdict()
        if self.stress == BASE:
            row |= {"change": None, "change_error": None}
        outputs = self.outputs[0] if len(self.outputs) == 1 else ()
        return {
            "at": dict(at),
            **row,
            "outputs": [x._asdict() for x in outputs],
            "note": "; ".join(dict.fromkeys(filter(None, self.notes))),
        }


@dataclass
class Results:
    """The sums of a book, filled position by position."""

    book: Book
    total: BookTotal = field(default_factory=lambda: BookTotal(BASE))
    deltas: DeltaTotal = field(default_factory=DeltaTotal)
    exposure: ExposureTotal = field(default_factory=ExposureTotal)
    groups: dict[str, dict[str, BookTotal]] = field(default_factory=dict)
    cases: Counter[str] = field(default_factory=Counter)
    failures: list[dict[str, str]] = field(default_factory=list)
    points: dict[tuple[str, ...], PointTotal] = field(default_factory=dict)
    explained: dict[str, float] = field(default_factory=dict)
    incomplete: set[tuple[str, str, str]] = field(default_factory=set)
    cpu_seconds: float = 0.0
    peak_mb: float = 0.0
    shapes: set[str] = field(default_factory=set)
    policies: int = 0
    shared: list[SharedPolicy] = field(default_factory=list)

    def add(self, member: BookPosition) -> None:
        """Adds a contract."""
        contract = member.contract
        self.cases[member.worst.status] += 1
        self.policies += member.policy is not None
        for stress, (point, cost, _) in member.points.items():
            if point.status != "ok":
                row = {"case": contract.name, "stress": stress}
                self.failures.append(row | {"status": point.status, "note": point.note})
            if cost is not None:
                self.cpu_seconds += cost.cpu_seconds
                self.peak_mb = max(self.peak_mb, cost.peak_mb)
            more = contract.quantity * explained(member.base, point)
            self.explained[stress] = self.explained.get(stress, 0.0) + more
        self.shapes |= {shape for _, _, shape in member.points.values() if shape}
        shares = {
            stress: contract.quantity * point.shares if point.status == "ok" else None
            for stress, (point, _, _) in member.points.items()
        }
        self.total.add(contract.market, shares, member.world)
        self._add_points(member, shares)
        for column in self.book.by:
            label = contract.labels.get(column, "")
            self.groups.setdefault(column, {}).setdefault(label, BookTotal(BASE)).add(
                contract.market, shares, member.world
            )
        columns = [("", ""), *((x, contract.labels.get(x, "")) for x in self.book.by)]
        if member.base.status != "ok":
            self.incomplete |= {(column, label, contract.market) for column, label in columns}
        for x in member.base.exposure:
            for column, label in columns:
                key = (column, label, contract.market, x.output, x.unit)
                self.exposure.add(key, x.days, contract.quantity * x.blocks)
        for delta in member.base.deltas:
            labels = delta.labels if len(delta.labels) == delta.blocks.shape[1] else ("",)
            for label, blocks in zip(labels, delta.blocks.T):
                key = (contract.market, delta.input, label)
                self.deltas.add(key, contract.quantity * blocks)

    def _add_points(self, member: BookPosition, shares: Mapping[str, np.ndarray | None]) -> None:
        """Adds a contract to the points of the axes, which are its own labels or the labels of its
        stresses."""
        axes = [axis.label for axis in self.book.axes]
        for stress, (point, _, _) in member.points.items():
            of_stress = member.labels.get(stress, {})
            labels = {**member.contract.labels, **of_stress}
            if not axes or (stress != BASE and not of_stress) or not labels.keys() >= {*axes}:
                continue
            at = tuple(labels[label] for label in axes)
            entry = self.points.setdefault(at, PointTotal(stress))
            both = {BASE: shares[BASE], stress: shares[stress]}
            entry.total.add(member.contract.market, both, member.world)
            entry.outputs.append(point.outputs)
            entry.notes.append(point.note)

    def table(self) -> dict[str, Any]:
        """The content of result.json, except the cost of the run."""
        stresses = [stress.name for stress in self.book.stresses]
        names = [BASE, *stresses]
        failed_count = sum(count for status, count in self.cases.items() if status != "ok")
        status = "ok" if not failed_count else "incomplete" if self.cases["missing"] else "failed"
        return {
            "kind": "book",
            "status": status,
            "title": self.book.title,
            "cases": {"ok": self.cases["ok"], "failed": failed_count},
            "sums": [
                _sum_row(stress, self.total.at(stress), self.explained[stress]) for stress in names
            ],
            "by": {
                column: {
                    label: [_sum_row(stress, total.at(stress)) for stress in names]
                    for label, total in sorted(totals.items())
                }
                for column, totals in self.groups.items()
            },
            "risk": [risk._asdict() for risk in risks(self.total, stresses)],
            "deltas": self._deltas(),
            "exposure": self.exposure.without(self.incomplete).table(self.total.is_common),
            "points": [
                entry.row(dict(zip([axis.label for axis in self.book.axes], at)))
                for at, entry in self.points.items()
            ],
            "notes": [
                f"contracts of the market {market or 'of the book'} are not valued on common "
                f"paths (jumps with several starts, or quasi-random points with several ends), so "
                f"their sums have no errors"
                for market in self.total.shares
                if not self.total.is_common(market)
            ]
            + [
                f"a contract of the market {market or 'of the book'} has no value: derivatives "
                f"and exposures of this market are not summed"
                for market in sorted({market for _, _, market in self.incomplete})
            ],
            "failures": self.failures[:1000],
            "shapes": len(self.shapes),
            "policies": self.policies,
            "shared_policies": [_shared_row(x) for x in self.shared],
            "cpu_seconds": self.cpu_seconds,
            "peak_mb": self.peak_mb,
        }

    def _deltas(self) -> list[dict[str, Any]]:
        markets = {market for _, _, market in self.incomplete}
        months = self.deltas.without(markets).by_month()
        rows = []
        for key in months.blocks:
            value, error = months.estimate(key)
            names = dict(zip(("market", "input", "label"), key))
            common = self.total.is_common(key[0])
            rows.append(names | {"held": value, "held_error": error if common else None})
        return rows


def _shared_row(shared: SharedPolicy) -> dict[str, Any]:
    losses = [loss._asdict() | {"share": loss.share} for loss in shared.losses]
    entry = {"leader": shared.leader, "contracts": shared.contracts}
    return entry | {"is_shared": shared.policy is not None, "losses": losses}


def _sum_row(stress: str, total: Sum | None, explained: float | None = None) -> dict[str, Any]:
    row: dict[str, Any] = {"stress": stress}
    row |= dict.fromkeys(Sum._fields) if total is None else total._asdict()
    if explained is not None and total is not None and math.isfinite(explained):
        row |= {"explained": explained, "unexplained": total.change - explained}
    return row


def explained(base: BookPoint, point: BookPoint) -> float:
    """The change of value that the held derivatives at the base explain, for one contract; NaN if
    the derivative with respect to a changed input is missing."""
    sums = {delta.input: delta.blocks.mean(0) for delta in base.deltas}
    if not sums or not sums.keys() >= point.changes.keys():
        return math.nan
    return sum(float(sums[name] @ x) for name, x in point.changes.items())


def tables(member: BookPosition) -> dict[str, TableRows]:
    """The rows of a contract in every table; values, changes, derivatives and shares are multiplied
    by the quantity of the contract."""
    contract, base = member.contract, member.base
    head = {"case": contract.name, "market": contract.market}
    values, deltas, shares, outputs, exposure = ([] for _ in TABLES)
    for stress, (point, cost, shape) in member.points.items():
        entry = head | {"stress": stress}
        change = statistics.of_shares(point.shares - base.shares) if _both_ok(point, base) else None
        part = explained(base, point)
        by_deltas = contract.quantity * part if change and math.isfinite(part) else None
        change_value = None if change is None else contract.quantity * change.value
        values.append(
            entry
            | {
                "status": point.status,
                "note": point.note,
                "value": contract.quantity * point.value,
                "standard_error": abs(contract.quantity) * point.standard_error,
                "change": change_value,
                "change_error": change and abs(contract.quantity) * change.standard_error,
                "explained": by_deltas,
                "unexplained": None
                if change_value is None or by_deltas is None
                else change_value - by_deltas,
                "cpu_seconds": cost and cost.cpu_seconds,
                "peak_mb": cost and cost.peak_mb,
                "shape": shape,
                "worker": cost and cost.worker,
            }
            | {x: text for x, text in contract.labels.items() if x not in ("market", "quantity")}
            | dict(member.labels.get(stress, {}))
        )
        for x in point.outputs:
            figures = {key: number for key, number in x._asdict().items() if key != "name"}
            outputs.append(entry | {"output": x.name} | figures)
        if point.status == "ok":
            for batch, share in enumerate(point.shares):
                shares.append(entry | {"batch": batch, "share": contract.quantity * float(share)})
        for x in point.exposure:
            for day, blocks in zip(x.days, x.blocks.T):
                result = statistics.of_shares(contract.quantity * blocks)
                exposure.append(
                    entry
                    | {"output": x.output, "unit": x.unit, "day": day}
                    | {"value": result.value, "standard_error": result.standard_error}
                )
        for delta in point.deltas:
            for i, blocks in enumerate(delta.blocks.T):
                result = statistics.of_shares(contract.quantity * blocks)
                label = delta.labels[i] if i < len(delta.labels) else str(i)
                deltas.append(
                    entry
                    | {"input": delta.input, "label": label, "held": result.value}
                    | {"held_error": result.standard_error, "trusted": delta.trusted}
                )
    parts = values, deltas, shares, outputs, exposure
    return {name: _columns(rows) for name, rows in zip(TABLES, parts)}


def _both_ok(point: BookPoint, base: BookPoint) -> bool:
    return point.status == "ok" == base.status and len(point.shares) == len(base.shares)


def _columns(rows: Sequence[Mapping[str, Any]]) -> TableRows:
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}


def collect(plan: BookPlan, folder: BookFolder, lost: Mapping[str, str]) -> Results:
    """Writes the tables and policies of all contracts, and returns the sums."""
    results = Results(plan.book)
    results.shared = list(plan.shared_policies(reader(folder, lost)))
    together = TOGETHER if len(plan.book.contracts) > FEW else 1
    (folder.path / POLICIES).mkdir(exist_ok=True)
    with TableWriter(folder.path, together) as writer:
        for contract in plan.book.contracts:
            member = position(plan, contract, folder, lost)
            results.add(member)
            writer.write(file_name(contract.name), tables(member))
            if member.policy is not None:
                (folder.path / POLICIES / f"{file_name(contract.name)}.npz").write_bytes(
                    member.policy
                )
    if results.points:
        _write_points(folder.path / POINTS, results)
    return results


def _write_points(file: Path, results: Results) -> None:
    """The points of the axes as a CSV."""
    rows = results.table()["points"]
    numbers = ("value", "standard_error", "change", "change_error")
    names = dict.fromkeys(x["name"] for row in rows for x in row["outputs"])
    columns = [x for name in names for x in (name, f"{name} standard_error")]
    header = [axis.label for axis in results.book.axes]
    lines = []
    for row in rows:
        outputs = {x["name"]: x for x in row["outputs"]}
        cells = [*row["at"].values(), *(row[key] for key in numbers)]
        for name in names:
            cells += [outputs.get(name, {}).get(key) for key in ("value", "standard_error")]
        lines.append(["" if x is None else x for x in (*cells, row["note"])])
    write_csv(file, [*header, *numbers, *columns, "note"], lines, shared=True)


def file_name(case: str) -> str:
    """The name of a contract as a file name."""
    return case.replace("/", "-")
