"""Whether the files of a run are still what was written: checksums, kept in run.json."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

SELF = "checksum"  # of run.json itself
Stamps = dict[str, tuple[int, int, int]]


def stamps(folder: Path) -> Stamps:
    """What tells, without reading it, that a file of the folder or of its parts is another one."""
    table: Stamps = {}
    for item in (*folder.glob("*"), *folder.glob("parts/*")):
        if item.is_file() and item.suffix != ".partial":
            state = item.stat()
            name = item.relative_to(folder).as_posix()
            table[name] = (state.st_ino, state.st_mtime_ns, state.st_size)
    return table


def written_since(folder: Path, before: Stamps, apart: tuple[str, ...]) -> dict[str, str]:
    """{name: checksum} of the files that are new or another since `before`, but for some."""
    now = stamps(folder)
    names = [name for name in now if now[name] != before.get(name) and name not in apart]
    return {name: checksum((folder / name).read_bytes()) for name in sorted(names)}


def changed_files(folder: Path, files: Any) -> list[str]:
    """Those of {name: checksum} that are gone, or not what was written."""
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
    """A record as the text of its file, which tells whether it was changed."""
    bare = {key: value for key, value in record.items() if key != SELF}
    return json.dumps({**bare, SELF: _seal(bare)}, indent=1)


def is_sealed(record: Mapping[str, Any]) -> bool:
    """Whether a record, read from its file, is what was written; one without a seal is."""
    bare = {key: value for key, value in record.items() if key != SELF}
    return record.get(SELF, _seal(bare)) == _seal(bare)


def _seal(bare: Mapping[str, Any]) -> str:
    return checksum(json.dumps(bare).encode())
