"""An order: one contract with some of the book's stresses, as bytes; and its answer, as bytes.

The answer is a function of the order alone. An order has neither the contract's name nor its
quantity, so that twins are computed once; it is called by the hash of its bytes.
"""

import base64
import datetime
import hashlib
import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from snapo.case.toml import to_toml
from snapo.solver.provenance.versions import versions

from .file import Contract, Move, Stress, TasksTable

STRESSES = 25  # of one order
BATCHES = 512  # of paths, whose shares are kept


@dataclass(frozen=True)
class Order:
    """What a worker computes.

    - `case`: the text of case.toml; `files`: {name: content} of the files that it names.
    - `stresses`: the moves of each; the unstressed point is in every order without a policy.
    - `tasks`: of the book; `seed`: of training and paths; `judged`: whether derivatives are.
    - `policy`: the file of a trained one; None: the order trains it.
    """

    case: str
    files: Mapping[str, bytes]
    stresses: tuple[tuple[Move, ...], ...]
    tasks: TasksTable
    seed: int
    judged: bool = False
    policy: bytes | None = None

    @classmethod
    def of(
        cls,
        contract: Contract,
        stresses: Sequence[Stress],
        tasks: TasksTable,
        seed: int,
        **more: Any,
    ) -> "Order":
        """Of a contract and some of the stresses."""
        moves = tuple(stress.moves for stress in stresses)
        return cls(to_toml(contract.tables), dict(contract.files), moves, tasks, seed, **more)

    def pack(self) -> bytes:
        """The order as bytes; equal orders have equal bytes."""
        table = {
            "case": self.case,
            "files": {name: _text(data) for name, data in sorted(self.files.items())},
            "stresses": [[_plain(move) for move in moves] for moves in self.stresses],
            "tasks": self.tasks.model_dump(),
            "seed": self.seed,
            "judged": self.judged,
            "policy": None if self.policy is None else _text(self.policy),
            "versions": versions(),
        }
        return json.dumps(table, sort_keys=True).encode()

    @classmethod
    def unpack(cls, data: bytes) -> "Order":
        """The order of these bytes."""
        table = json.loads(data)
        stresses = tuple(tuple(map(_move, moves)) for moves in table["stresses"])
        policy = table["policy"]
        return cls(
            table["case"],
            {name: base64.b64decode(text) for name, text in table["files"].items()},
            stresses,
            TasksTable(**table["tasks"]),
            table["seed"],
            table["judged"],
            None if policy is None else base64.b64decode(policy),
        )


def name_of(order: bytes) -> str:
    """The name of an order: the hash of its bytes."""
    return hashlib.blake2b(order, digest_size=16).hexdigest()


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _plain(move: Move) -> dict[str, Any]:
    when = None if move.when is None else [day.isoformat() for day in move.when]
    return asdict(move) | {"when": when}


def _move(table: Mapping[str, Any]) -> Move:
    when = table["when"] and tuple(map(datetime.date.fromisoformat, table["when"]))
    return Move(table["key"], table["scale"], table["shift"], when)


class Point(NamedTuple):
    """The value at one point: unstressed, or under a stress.

    - `status`: "ok" or "failed", with a `note`.
    - `shares`: [B] mean of the value over each batch of paths; the value is their mean.
    - `changes`: {input: [n] its numbers less those of the base}, of inputs that a stress moves.
    """

    status: str
    note: str
    value: float
    standard_error: float
    shares: np.ndarray
    changes: Mapping[str, np.ndarray]


class Delta(NamedTuple):
    """The held derivatives of the base with respect to one input: `blocks` [32, n]."""

    input: str
    labels: tuple[str, ...]
    unit: str
    blocks: np.ndarray


class Answer(NamedTuple):
    """What was computed for an order.

    - `points`: the base first where the order has no policy, then those of its stresses.
    - `deltas`: of the base; `policy`: the file of the trained one.
    """

    points: tuple[Point, ...]
    deltas: tuple[Delta, ...] = ()
    policy: bytes | None = None

    def pack(self) -> bytes:
        """The answer as bytes, an archive of arrays; equal answers have equal bytes."""
        arrays: dict[str, np.ndarray] = {
            "status": np.array([point.status for point in self.points]),
            "note": np.array([point.note for point in self.points]),
            "value": np.array([point.value for point in self.points]),
            "standard_error": np.array([point.standard_error for point in self.points]),
            "changed": np.array(json.dumps([list(point.changes) for point in self.points])),
            "input": np.array([delta.input for delta in self.deltas]),
            "unit": np.array([delta.unit for delta in self.deltas]),
        }
        for i, point in enumerate(self.points):
            arrays[f"shares.{i}"] = point.shares
            arrays |= {f"change.{i}.{j}": x for j, x in enumerate(point.changes.values())}
        for i, delta in enumerate(self.deltas):
            arrays |= {f"labels.{i}": np.array(delta.labels), f"blocks.{i}": delta.blocks}
        if self.policy is not None:
            arrays["policy"] = np.frombuffer(self.policy, np.uint8)
        out = io.BytesIO()
        np.savez(out, allow_pickle=False, **arrays)
        return out.getvalue()

    @classmethod
    def unpack(cls, data: bytes) -> "Answer":
        """The answer of these bytes. **Raises:** `ValueError` where they are none."""
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                arrays = dict(file)
        except (zipfile.BadZipFile, OSError, EOFError) as error:
            raise ValueError(f"not an answer: {error}") from None
        names = json.loads(str(arrays["changed"]))
        points = tuple(
            Point(
                str(arrays["status"][i]),
                str(arrays["note"][i]),
                float(arrays["value"][i]),
                float(arrays["standard_error"][i]),
                arrays[f"shares.{i}"],
                {name: arrays[f"change.{i}.{j}"] for j, name in enumerate(names[i])},
            )
            for i in range(len(arrays["value"]))
        )
        deltas = tuple(
            Delta(
                str(arrays["input"][i]),
                tuple(map(str, arrays[f"labels.{i}"])),
                str(arrays["unit"][i]),
                arrays[f"blocks.{i}"],
            )
            for i in range(len(arrays["input"]))
        )
        policy = arrays.get("policy")
        return cls(points, deltas, None if policy is None else policy.tobytes())
