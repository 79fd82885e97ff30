"""Machine code kept on disk between runs."""

import hashlib
import os
import tempfile
from pathlib import Path

from .pipeline import PIPELINE, object_code


def kept(text: str, folder: Path) -> bytes:
    """Machine code for this text, from the folder where it was made before.

    The name of a file is a hash of the text and of the pipeline's identity: code that other passes
    or another LLVM made, or code for another processor, is not found.
    """
    path = folder / f"{key(text)}.o"
    data = _read(path)
    if data is None:
        data = object_code(text)
        _write(path, data)
    return data


def key(text: str) -> str:
    """The name under which code is kept."""
    digest = hashlib.sha256()
    for part in (PIPELINE.identity(), text):
        digest.update(hashlib.sha256(part.encode()).digest())
    return digest.hexdigest()


def cache_home() -> Path:
    """The user's folder for files that can be made again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _read(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _write(path: Path, data: bytes) -> None:
    """Whole or not at all; a disk that cannot be written is no reason to fail."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(data)
        os.replace(file.name, path)
    except OSError:
        pass
