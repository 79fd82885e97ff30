"""`run` next to a case points to the folder of its latest run in `runs`.

It is a symbolic link, or a small text file if links are not possible, so that every reader of a
run folder goes through `followed`.
"""

import os
import re
from pathlib import Path

RUNS, LATEST = "runs", "run"
NAME = re.compile(r"\d{4}-\d\d-\d\dT\d{4}-[0-9a-f]{4}")  # of a run: when it began, and four digits
LONGEST = 100  # bytes of the text file


def target(link: Path) -> Path | None:
    """The folder that `link` points to; None if it is neither such a link nor such a file."""
    try:
        if link.is_symlink():
            text = os.readlink(link)
        elif link.is_file() and link.stat().st_size <= LONGEST:
            text = link.read_text(encoding="utf-8")
        else:
            return None
    except (OSError, ValueError):
        return None
    folder, _, name = text.strip().replace("\\", "/").partition("/")
    return link.parent / RUNS / name if folder == RUNS and NAME.fullmatch(name) else None


def followed(path: Path) -> Path:
    """The path of a run folder or of a file in it, with `run` replaced by the run it points to."""
    for part in (path, *path.parents):
        if part.name == LATEST and (folder := target(part)) is not None:
            return folder / path.relative_to(part)
    return path
