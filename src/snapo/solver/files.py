"""Files of a run, written whole or not at all."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np


def write_csv(file: Path, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """A table with a header; numbers keep all their digits."""

    def lines() -> Iterable[str]:
        yield ",".join(header)
        for row in rows:
            yield ",".join(_cell(value) for value in row)

    write_text(file, "\n".join(lines()) + "\n")


def _cell(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return repr(float(value))
    text = str(value)
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\n') else text


def write_text(file: Path, text: str) -> None:
    """Writes a file whole or not at all."""
    partial = file.with_name(file.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(file)
