"""Checks with checksums, which are saved in run.json, whether the files of a run are unchanged."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

SELF = "checksum"  # of run.json itself
Stamps = dict[str, tuple[int, int, int]]


def stamps(folder: Path) -> Stamps:
    """The inode, time and size of every file in the folder and its subfolders; no file is read."""
    table: Stamps = {}
    for item in (*folder.glob("*"), *folder.glob("parts/*")):
        if item.is_file() and item.suffix != ".partial":
            state = item.stat()
            name = item.relative_to(folder).as_posix()
            table[name] = (state.st_ino, state.st_mtime_ns, state.st_size)
    return table


def written_since(folder: Path, before: Stamps, apart: tuple[str, ...]) -> dict[str, str]:
    """{name: checksum} of the files that are new or changed since `before`, except the files
    `apart`."""
    now = stamps(folder)
    names = [name for name in now if now[name] != before.get(name) and name not in apart]
    return {name: checksum((folder / name).read_bytes()) for name in sorted(names)}


def changed_files(folder: Path, files: Any) -> list[str]:
    """Those files of {name: checksum} that are missing or were changed."""
    available = files if isinstance(files, Mapping) else {}
    return [
        name for name, requested in available.items() if not _same(folder / str(name), requested)
    ]


def _same(file: Path, requested: Any) -> bool:
    try:
        return checksum(file.read_bytes()) == requested
    except OSError:
        return False


def checksum(content: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def sealed(record: Mapping[str, Any]) -> str:
    """A record as the text of its file, with a checksum by which a change is detected."""
    bare = {key: value for key, value in record.items() if key != SELF}
    return json.dumps({**bare, SELF: _seal(bare)}, indent=1)


def is_sealed(record: Mapping[str, Any]) -> bool:
    """Whether a record, read from its file, is unchanged; one without a checksum counts as
    unchanged."""
    bare = {key: value for key, value in record.items() if key != SELF}
    return record.get(SELF, _seal(bare)) == _seal(bare)


def _seal(bare: Mapping[str, Any]) -> str:
    return checksum(json.dumps(bare).encode())
