"""A job, which is one contract with some of the book's stresses, and its result; both as bytes.

The result depends on nothing but the job. A job has neither the contract's name nor its
quantity, so that contracts with equal cases are computed once; its name is the hash of its bytes.
"""

import base64
import datetime
import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from snapo.case.report import TEXTS
from snapo.case.toml import to_toml
from snapo.solver import statistics
from snapo.solver.derivatives.interval import HELD
from snapo.solver.derivatives.table import Sensitivities
from snapo.solver.provenance import versions

from .file import BookContract, TasksTable
from .stress import StressMove

STRESSES = 25  # of one job
BATCHES = 512  # of paths, whose shares are kept


@dataclass(frozen=True)
class BookJob:
    """The work of a worker: one contract with some stresses.

    - `case`: the text of case.toml; `files`: {name: content} of the files that it names.
    - `stresses`: the moves of each stress.
    - `tasks`: the tasks of the book; `seed`: the seed of training and paths.
    - `base`: whether the unstressed point is computed too, before the stresses.
    - `judged`: whether bumps test all derivatives. If not, they test the derivatives with respect
      to the inputs `bumped`, because a bump refuted these in a similar contract.
    - `policy`: the file of a trained policy. If it is None, the job trains a policy: for the base
      or, if a policy is trained for each stress, for its only stress.
    - `adopted`: the file of the policy of a similar contract; the base uses its trained numbers and
      needs no training.
    - `processor`: the target of compiled code, "" for the processor of the worker; `fingerprint`:
      the fingerprint of the processors that give bit-identical results.
    """

    case: str
    files: Mapping[str, bytes]
    stresses: tuple[tuple[StressMove, ...], ...]
    tasks: TasksTable
    seed: int
    base: bool = True
    judged: bool = False
    bumped: tuple[str, ...] = ()
    policy: bytes | None = None
    processor: str = ""
    fingerprint: str = ""
    adopted: bytes | None = None

    @classmethod
    def of(cls, contract: BookContract, tasks: TasksTable, seed: int, **more: Any) -> "BookJob":
        """The job of a contract; `more`: other fields of the job, by default without stresses."""
        fields = {"stresses": (), **more}
        report = contract.tables.get("report", {})
        numbers = {key: value for key, value in report.items() if key not in TEXTS}
        tables = {**contract.tables, "report": numbers} if report else contract.tables
        return cls(to_toml(tables), contract.files, tasks=tasks, seed=seed, **fields)

    def pack(self) -> bytes:
        """The job as bytes; equal jobs have equal bytes."""
        table = {
            "case": self.case,
            "files": {name: _text(data) for name, data in sorted(self.files.items())},
            "stresses": [[_plain(move) for move in moves] for moves in self.stresses],
            "tasks": self.tasks.model_dump(),
            "seed": self.seed,
            "base": self.base,
            "judged": self.judged,
            "bumped": self.bumped,
            "policy": None if self.policy is None else _text(self.policy),
            "adopted": None if self.adopted is None else _text(self.adopted),
            "processor": self.processor,
            "fingerprint": self.fingerprint,
            "versions": versions(),
        }
        return json.dumps(table, sort_keys=True).encode()

    @classmethod
    def unpack(cls, data: bytes) -> "BookJob":
        """The job of these bytes."""
        table = json.loads(data)
        stresses = tuple(tuple(map(_move, moves)) for moves in table["stresses"])
        policy, adopted = (
            None if table[key] is None else base64.b64decode(table[key])
            for key in ("policy", "adopted")
        )
        return cls(
            table["case"],
            {name: base64.b64decode(text) for name, text in table["files"].items()},
            stresses,
            TasksTable(**table["tasks"]),
            table["seed"],
            table["base"],
            table["judged"],
            tuple(table["bumped"]),
            policy,
            table["processor"],
            table["fingerprint"],
            adopted,
        )


def name_of(job: bytes) -> str:
    """The name of a job: the hash of its bytes."""
    return hashlib.blake2b(job, digest_size=16).hexdigest()


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _plain(move: StressMove) -> dict[str, Any]:
    when = None if move.when is None else [day.isoformat() for day in move.when]
    return asdict(move) | {"when": when}


def _move(table: Mapping[str, Any]) -> StressMove:
    if table["when"] is None:
        return StressMove(**table)
    first, last = map(datetime.date.fromisoformat, table["when"])
    return StressMove(**{**table, "when": (first, last)})


class BookPoint(NamedTuple):
    """The value at one point: unstressed, or under a stress.

    - `status`: "ok" or "failed", with a `note`.
    - `shares`: [B] mean of the value over each batch of paths; the value is their mean.
    - `changes`: {input: [n] its numbers minus those of the base}, for the inputs that a stress
      moves.
    - `deltas`: held derivatives with respect to the inputs, if the book asks for them.
    - `outputs`: statistics of the totals of the paths; `exposure`: the mean outputs by day.
    """

    status: str
    note: str
    value: float
    standard_error: float
    shares: np.ndarray
    changes: Mapping[str, np.ndarray]
    deltas: "tuple[Delta, ...]" = ()
    outputs: "tuple[OutputFigures, ...]" = ()
    exposure: "tuple[Exposure, ...]" = ()

    @classmethod
    def without_value(cls, status: str, note: str) -> "BookPoint":
        """A point that was not valued, and the reason."""
        return cls(status, note, np.nan, np.nan, np.full(1, np.nan), {})


class OutputFigures(NamedTuple):
    """An output of a simulator, or a quality attribute of a process, over the paths of a point.

    - `value`, `standard_error`: its mean and the error of the mean; `deviation`, `p05`, `p95`: the
      standard deviation and quantiles between paths.
    - `nominal`: the value of a quality attribute at the set point of the process; `within`: the
      share of batches within its limits. Both are None for the outputs of a simulator.
    """

    name: str
    unit: str
    value: float
    standard_error: float
    deviation: float
    p05: float
    p95: float
    nominal: float | None = None
    within: float | None = None

    @classmethod
    def of(
        cls,
        name: str,
        unit: str,
        values: np.ndarray,
        groups: np.ndarray | None,
        nominal: float | None = None,
        within: float | None = None,
    ) -> "OutputFigures":
        """The statistics over the paths [N] that are finite."""
        finite = np.isfinite(values)
        values, groups = values[finite], None if groups is None else groups[finite]
        if len(values) < 2:
            none = np.nan, np.nan, np.nan, np.nan, np.nan
            return cls(name, unit, *none, nominal, within)
        mean = statistics.mean(values, groups)
        p05, p95 = np.quantile(values, [0.05, 0.95])
        spread = float(values.std(ddof=1)), float(p05), float(p95)
        return cls(name, unit, mean.value, mean.standard_error, *spread, nominal, within)


class Delta(NamedTuple):
    """The held derivatives with respect to the `n` numbers of one input.

    - `labels`, `unit`: the labels and the unit of the input; `blocks`: [32 to 64, n] the
      derivatives on independent blocks of paths.
    - `trusted`: whether no bump of the input refuted the derivatives; None if there was no bump.
    """

    input: str
    labels: tuple[str, ...]
    unit: str
    blocks: np.ndarray
    trusted: bool | None = None

    @classmethod
    def of_table(cls, table: Sensitivities | None) -> "tuple[Delta, ...]":
        """The held derivatives of a table; empty if there is no table."""
        if table is None:
            return ()
        verdicts = table.verdicts or {}
        return tuple(
            cls(
                name,
                tuple(map(str, table.inputs[name].names())),
                table.inputs[name].unit,
                estimate.blocks.reshape(len(estimate.blocks), -1),
                verdicts[name].source == HELD if name in verdicts else None,
            )
            for name, estimate in table.held.items()
        )


class Exposure(NamedTuple):
    """The mean of an output at every step.

    - `days`: [T] dates, or the numbers of steps from 1 if a case has no dates.
    - `blocks`: [32 or fewer, T] the means over independent blocks of paths.
    """

    output: str
    unit: str
    days: tuple[str, ...]
    blocks: np.ndarray


class JobResult(NamedTuple):
    """The results of a job.

    - `points`: the base first, if the job has one, then the points of its stresses.
    - `policy`: the file of the trained policy; `shape`: the hash of everything for which code is
      compiled.
    - `world`: a text that is equal for two results if all their paths have the same scenarios
      (`Scenarios.world`).
    """

    points: tuple[BookPoint, ...]
    policy: bytes | None = None
    shape: str = ""
    world: str = ""

    def pack(self) -> bytes:
        """The result as bytes, an archive of arrays; equal results have equal bytes."""
        arrays = dict[str, np.ndarray]()
        points = []
        for i, point in enumerate(self.points):
            arrays[f"shares.{i}"] = point.shares
            arrays |= {f"change.{i}.{j}": x for j, x in enumerate(point.changes.values())}
            arrays |= {f"blocks.{i}.{j}": x.blocks for j, x in enumerate(point.deltas)}
            arrays |= {f"exposure.{i}.{j}": x.blocks for j, x in enumerate(point.exposure)}
            points.append(
                point._asdict()
                | {"shares": None, "changes": list(point.changes)}
                | {"deltas": [x._replace(blocks=None)._asdict() for x in point.deltas]}  # pyright: ignore[reportArgumentType]
                | {"exposure": [x[:-1] for x in point.exposure]}
            )
        if self.policy is not None:
            arrays["policy"] = np.frombuffer(self.policy, np.uint8)
        table = json.dumps({"points": points, "shape": self.shape, "world": self.world})
        out = io.BytesIO()
        np.savez(out, allow_pickle=False, table=np.array(table), **arrays)
        return out.getvalue()

    @classmethod
    def unpack(cls, data: bytes) -> "JobResult":
        """The result of these bytes.

        **Raises:** `ValueError` if they are not a result."""
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                arrays = dict(file)
            table = json.loads(str(arrays["table"]))
            points = tuple(_point(i, row, arrays) for i, row in enumerate(table["points"]))
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, KeyError) as error:
            raise ValueError(f"not a result: {error}") from None
        policy = arrays.get("policy")
        policy = None if policy is None else policy.tobytes()
        return cls(points, policy, table["shape"], table["world"])


def _point(i: int, row: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> BookPoint:
    deltas = tuple(
        Delta(**entry | {"labels": tuple(entry["labels"]), "blocks": arrays[f"blocks.{i}.{j}"]})
        for j, entry in enumerate(row["deltas"])
    )
    changes = {name: arrays[f"change.{i}.{j}"] for j, name in enumerate(row["changes"])}
    parts: dict[str, Any] = row | {"shares": arrays[f"shares.{i}"], "changes": changes}
    outputs = tuple(OutputFigures(*entry) for entry in row["outputs"])
    exposure = tuple(
        Exposure(output, unit, tuple(days), arrays[f"exposure.{i}.{j}"])
        for j, (output, unit, days) in enumerate(row["exposure"])
    )
    return BookPoint(**parts | {"deltas": deltas, "outputs": outputs, "exposure": exposure})


class Cost(NamedTuple):
    """The cost of a result, which is stored apart from it.

    - `cpu_seconds`: the processor time of all threads of the worker, in seconds; `peak_mb`: its
      peak memory so far, in MB.
    - `worker`: the process and machine of the worker.
    """

    cpu_seconds: float
    peak_mb: float
    worker: str


def enclosed(result: bytes, cost: Cost) -> bytes:
    """A result with its cost, and a checksum that shows that it is complete."""
    head = {"checksum": name_of(result), "cost": cost._asdict()}
    return json.dumps(head).encode() + b"\n" + result


def opened(data: bytes) -> tuple[bytes, Cost]:
    """The result and its cost.

    **Raises:** `ValueError` if they are not complete."""
    head, _, result = data.partition(b"\n")
    try:
        table = json.loads(head)
        cost, checksum = Cost(**table["cost"]), table["checksum"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"not a result: {error}") from None
    if checksum != name_of(result):
        raise ValueError("the result is not complete")
    return result, cost
