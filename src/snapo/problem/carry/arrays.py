"""Arrays and plain data in one file: written atomically, and never executed."""

import json
import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


def write_arrays(file: Path, arrays: Mapping[str, np.ndarray], header: Any) -> None:
    """Writes through a temporary file next to the target; `header` is data for JSON."""
    text = np.frombuffer(json.dumps(header).encode(), np.uint8)
    with replacing(file) as partial, partial.open("wb") as stream:
        np.savez(stream, header=text, **arrays)  # pyright: ignore[reportArgumentType]
        stream.flush()
        os.fsync(stream.fileno())


@contextmanager
def replacing(file: Path, shared: bool = False) -> Iterator[Path]:
    """A new file, to be written in the block, which then replaces `file` as a whole; if the block
    fails, `file` does not change. `shared`: whether several processes may write it at once, each
    under another name; otherwise a file that a killed process has left is used again."""
    unique = f".{file.name}.{os.getpid()}-{secrets.token_hex(4)}.partial"
    partial = file.with_name(unique if shared else f"{file.name}.partial")
    try:
        yield partial
        partial.replace(file)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def read_arrays(file: Path) -> tuple[dict[str, np.ndarray], Any]:
    """The arrays `leaf_0`, `leaf_1` … in their order, and the header.

    **Raises:** `ValueError` for any defect of the file.
    """
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            header = json.loads(stored["header"].tobytes().decode())
            names = [f"leaf_{i}" for i in range(len(stored.files) - 1)]
            return {name: stored[name] for name in names}, header
    except Exception as error:  # a damaged byte can be a compression, a key or a size as well
        message = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{file}: this file cannot be read ({message}).") from None
