"""The folder of a run: its settings, its parts, and files written atomically.

run.json            layout, kind, everything that determines the numbers, the state of every part,
                    with checksums of its files, of result.json, and of run.json
result.json         the headline: value, standard error, references, seconds, status
case/               a copy of the case
parts/NAME.json     the tables of one part
checkpoint.npz, policy.npz, halfway.npz, solution.npz, history.csv, sensitivities.csv: from
                    the training; the policies as `policy.save` writes them
adjoints.csv        how adjoints grow by step, if training measured them
groups.npz          values of independent groups of paths, for comparisons of runs
start.npz           the policy with which training began, if one was supplied
seeds.csv, seeds/   if several seeds were requested: their values, and their run folders
policy.onnx, policy.py, policy.csv      from `snapo export`
report.html
"""

import hashlib
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.case.report import TEXTS
from snapo.report.checksums import changed_files, checksum, is_sealed, sealed
from snapo.report.folder import RESULT, read_table
from snapo.report.record import PartState, RunRecord, RunSettings, entries_of
from snapo.solver.tables import (
    GROWTH,
    HALFWAY,
    HISTORY,
    POLICY,
    SENSITIVITIES,
    SOLUTION,
    VERDICTS,
    write_text,
)

if TYPE_CHECKING:
    from .study import Part

RUN, CASE, PARTS = "run.json", "case", "parts"
CHECKPOINT, REPORT, GROUPS = "checkpoint.npz", "report.html", "groups.npz"
PDF = "report.pdf"  # the report, printed
TABLES = "tables.xlsx"  # its tables, as a workbook
ONNX, PYTHON, DECIDED = "policy.onnx", "policy.py", "policy.csv"  # of `snapo export`
START = "start.npz"  # the policy with which training began, if one was supplied
SEEDS = "seeds.csv"  # one row for each seed, if several were asked for
WRITTEN = (
    RUN, RESULT, REPORT, PDF, TABLES, CHECKPOINT, GROUPS, POLICY, HALFWAY, SOLUTION, HISTORY,
    SENSITIVITIES, VERDICTS, GROWTH, ONNX, PYTHON, DECIDED, START, SEEDS, "profile.csv",
    "decisions.csv", "ladder.csv", "products.csv", "hedge.csv", "hedge_products.csv",
    "vega.csv",
)  # fmt: skip
LAYOUT = 4  # of the folder; it grows when older runs can no longer be read
APART = ("parts", *TEXTS)  # keys of [report] on which no number depends
BOOK = "book.json"  # of the folder of a book, which is no run
OF_A_BOOK = re.compile(r"^kind\s*=\s*['\"]book['\"]", re.MULTILINE)
CASE_FILES = (".toml", ".csv", ".npy", ".parquet", ".py")
PICTURES = (".png", ".svg")  # a logo of the report, on which no number depends
ENOUGH_SPACE = 64 << 20  # bytes that a run folder may need


def check_writable(out: Path) -> None:
    """Detects before training that a folder cannot be written or that the disk is full."""
    folder = out
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():  # nor is a link to nowhere
        raise CaseError(str(out), "", None, f"{folder} is not a folder")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        message = f"this folder cannot be written ({error.strerror})"
        raise CaseError(str(out), "", None, message) from None
    free = shutil.disk_usage(folder).free
    if free < ENOUGH_SPACE:
        message = f"{free >> 20} MB are free there; a run needs {ENOUGH_SPACE >> 20} MB"
        raise CaseError(str(out), "", None, message)


def case_files(folder: Path, pictures: bool = False) -> list[Path]:
    """The files next to a case that may belong to it; `pictures`: whether these are included."""
    suffixes = CASE_FILES + PICTURES if pictures else CASE_FILES
    return sorted(f for f in folder.iterdir() if f.is_file() and f.suffix.lower() in suffixes)


def tables_named(folder: Path, tables: Any) -> list[Path]:
    """The other TOML files in a folder that the tables of a case name, singly or in lists."""
    if isinstance(tables, Mapping):
        parts = [tables_named(folder, item) for item in tables.values()]
    elif isinstance(tables, list):
        parts = [tables_named(folder, item) for item in tables]
    elif not isinstance(tables, str) or not tables.lower().endswith(".toml"):
        return []
    else:
        parts = [[file for file in case_files(folder) if file.name == tables]]
    return [file for part in parts for file in part]


def copy_case(file: Path, out: Path, logo: str | None = None) -> None:
    """A copy of the case next to its results, with the files that may belong to it, and its
    `logo`."""
    target = out / CASE
    target.mkdir(parents=True, exist_ok=True)
    for case_file in [*case_files(file.parent), *([file.parent / logo] if logo else [])]:
        if case_file.parent.resolve() != target.resolve():
            shutil.copyfile(case_file, target / case_file.name)


def decisive(file: Path, data: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """All settings that determine the numbers of a run; a resumed run must have the same settings.
    They are the keys of the case as they were read (with `--set`), the bytes of the files next to
    the case, the options of the command, the versions of the libraries, and the machine.
    """
    from snapo.solver.provenance import versions  # late: a list of runs needs no JAX

    files = {
        case_file.name: hashlib.sha256(case_file.read_bytes()).hexdigest()
        for case_file in case_files(file.parent)
        if case_file != file
    }
    return {
        "case": json.loads(json.dumps(data, default=str)),
        "files": files,
        "options": dict(options),
        "versions": versions(),
    }


def start(out: Path, kind: str, decides: Mapping[str, Any], resume: bool) -> dict[str, Any]:
    """The record (run.json) of the run to resume, or a new record.

    A new run removes the files of the previous one.

    **Raises:** `CaseError` if a run to resume was started with other settings.
    """
    (out / PARTS).mkdir(parents=True, exist_ok=True)
    if resume and (old := check_same(out, decides)):
        return old
    for item in _written(out):
        item.unlink(missing_ok=True)
    new = {"layout": LAYOUT, "kind": kind, "decides": dict(decides), "parts": {}}
    save(out, new)
    return new


def check_same(out: Path, decides: Mapping[str, Any]) -> dict[str, Any] | None:
    """The record of the run to resume in a folder; None if there is none yet. **Raises:**
    `CaseError` if the run was started with other settings or by an earlier version.
    """
    if not any((out / name).exists() for name in (RUN, RESULT, CHECKPOINT)):
        return None
    old = read(out)
    if difference := changed(decisive_settings(old["decides"]), decisive_settings(decides)):
        message = (
            f"this run was started with {difference}; resume it with the same settings, or "
            f"solve into "
        )
        raise CaseError(str(out / RUN), "", None, message + "another folder")
    return old | {"decides": plain_json(decides)}


def _written(out: Path) -> list[Path]:
    """The files of an earlier run that a report would read; other files are not included."""
    return [*(out / PARTS).glob("*.json"), *(out / name for name in WRITTEN)]


def become(out: Path, source: Path) -> None:
    """Replaces the run in this folder by the run in another folder, except its report."""
    (out / PARTS).mkdir(parents=True, exist_ok=True)
    for file in _written(out):
        file.unlink(missing_ok=True)
    shutil.copytree(source / CASE, out / CASE, dirs_exist_ok=True)
    for file in [*source.iterdir(), *(source / PARTS).glob("*.json")]:
        if file.is_file() and file.name not in (REPORT, PDF, TABLES):
            shutil.copyfile(file, out / file.relative_to(source))


def save(out: Path, record: Mapping[str, Any]) -> None:
    """Writes run.json."""
    write_text(out / RUN, sealed(record))


def read(out: Path) -> dict[str, Any]:
    """The record of the run in a folder.

    **Raises:** `CaseError` if there is no run, or if an earlier version wrote it.
    """
    file = out / RUN
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        layout = int(record["layout"])
        if layout == LAYOUT:
            _check_record(record)
    except (FileNotFoundError, NotADirectoryError):
        raise _no_run(out) from None
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        message = f"this file cannot be read ({error}); solve the case again"
        raise CaseError(str(file), "", None, message) from None
    if layout != LAYOUT:
        message = (
            f"it must be {LAYOUT}; another version of snapo wrote this run: solve the case again"
        )
        raise CaseError(str(file), "layout", layout, message)
    return record


def _check_record(record: Mapping[str, Any]) -> None:
    """**Raises:** `ValueError` if a record of this layout is incomplete or was changed."""
    states = record["parts"]
    plain = (
        (record["kind"], str),
        (record["decides"], dict),
        (entries_of(RunRecord, record).about, Mapping),
    )
    if not all(isinstance(item, kind) for item, kind in (*plain, (states, dict))):
        raise ValueError("its tables have wrong types")
    for state in states.values():
        if not isinstance(state["state"], str) or not isinstance(state["note"], str):
            raise ValueError("the state of a part is not a text")
        float(state["seconds"])
    if not is_sealed(record):
        raise ValueError("this file was changed or damaged")


def mark(decides: Mapping[str, Any]) -> str:
    """A text that is the same for runs with the same numbers, which may share checkpoints."""
    return checksum(json.dumps(decisive_settings(decides), sort_keys=True).encode())


def decisive_settings(decides: Mapping[str, Any]) -> dict[str, Any]:
    """The settings on which numbers depend. The list of requested parts is not one of them, so that
    a run of a few parts can be continued with more parts. Neither are the texts of its page."""
    case = dict(entries_of(RunSettings, decides).case)
    if isinstance(case.get("report"), dict):
        case["report"] = {key: item for key, item in case["report"].items() if key not in APART}
        case = {key: entry for key, entry in case.items() if (key, entry) != ("report", {})}
    return {**decides, "case": case}


def check_whole(out: Path, record: Mapping[str, Any], names: tuple[str, ...]) -> None:
    """**Raises:** `CaseError` if one of these files of the run was changed."""
    files = {name: item for state in record["parts"].values() for name, item in files_of(state)}
    requested = {name: files[name] for name in names if name in files}
    for name in changed_files(out, requested):
        message = (
            "this file was changed or damaged since it was written; run snapo solve again "
            "with --resume"
        )
        raise CaseError(str(out / name), "", None, message)


def files_of(state: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(name, checksum) of the files of a part."""
    files = entries_of(PartState, state).files
    return list(files.items()) if isinstance(files, dict) else []


def _no_run(out: Path) -> CaseError:
    if (out / SOLUTION).exists() and not (out / CASE).exists():
        message = "solution.save wrote this folder, which has no case; read it with Solution.load"
        return CaseError(str(out), "", None, message)
    if (out / RESULT).exists() or (out / CHECKPOINT).exists():
        message = (
            "an earlier version of snapo wrote this run, and its files have another format; "
            f"solve its case again: snapo solve {out / CASE} --out NEW"
        )
        return CaseError(str(out), "", None, message)
    message = "this is not the folder of a run, which has a file run.json written by `snapo solve`"
    if (out / BOOK).is_file():
        message = f"this is the folder of a book; `snapo report {out}` writes its report.html"
    elif out.is_file() and OF_A_BOOK.search(out.read_text(encoding="utf-8", errors="replace")):
        message = f"this is a book, which has no live page; use snapo book {out}"
    elif out.is_file() or any((out / name).is_file() for name in ("case.toml", "case.xlsx")):
        message = f"this case has no run yet; `snapo solve {out}` computes one"
    return CaseError(str(out), "", None, message)


class Difference(NamedTuple):
    """A setting in which two runs differ: its name, and its two values (None if absent)."""

    name: str
    first: Any
    second: Any

    def describe(self) -> str:
        """The difference in one line, "training.steps: 240, 300"; a file has its name only."""
        if self.name.startswith("files."):
            return f"another {self.name.removeprefix('files.')}"
        return f"{self.name}: {in_words(self.first)}, {in_words(self.second)}"


def differences(old: Any, new: Any, where: str = "") -> Iterator[Difference]:
    """All settings that differ between two tables of settings of runs."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*old, *(key for key in new if key not in old)]:
            name = f"{where}.{key}" if where else key
            yield from differences(old.get(key), new.get(key), name)
    elif old != new:
        yield Difference(where.removeprefix("case.").removeprefix("options."), old, new)


def changed(old: Any, new: Any) -> str:
    """The first difference between two tables as a clause, "training.steps = 240, and now it is
    300"."""
    difference = next(differences(old, new), None)
    if difference is None:
        return ""
    if difference.name.startswith("files."):
        return difference.describe()
    first, second = in_words(difference.first), in_words(difference.second)
    return f"{difference.name} = {first}, and now it is {second}"


def in_words(value: Any) -> str:
    """A setting as text, cut short if it is long."""
    text = "not given" if value is None else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def write_part(out: Path, part: "Part", tables: Mapping[str, Any]) -> dict[str, Any]:
    """Saves the tables of a part, and returns them in the form in which they are read from the
    file."""
    text = json.dumps(plain_json(tables))
    write_text(out / PARTS / part.file, text)
    return json.loads(text)


def read_part(out: Path, part: "Part") -> dict[str, Any] | None:
    """The tables of a part that was done before; None if its file is missing or damaged."""
    return read_table(out / PARTS / part.file)


def plain_json(value: Any) -> Any:
    """Plain JSON data: NumPy becomes lists, non-finite numbers become null."""
    if isinstance(value, Mapping):
        return {str(key): plain_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain_json(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
