"""Records and run folders in which a test says what it is about, and the rest is harmless."""

from dataclasses import MISSING, asdict, fields, is_dataclass
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from snapo.report.folder import RunFiles, RunResult
from snapo.study.chapter import Chapter

Record = TypeVar("Record")
PLAIN = {float: 0.0, int: 0, str: "", bool: True, np.ndarray: np.zeros(0)}


def filled(record: type[Record], **values: Any) -> Record:
    """A record with these fields; the others have their default, or nothing in them."""
    hints = get_type_hints(record)
    for field in fields(record):  # pyright: ignore[reportArgumentType]
        if field.name not in values and field.default is MISSING:
            values[field.name] = _nothing(hints[field.name])
    return record(**values)


def _nothing(hint: Any) -> Any:
    if hint in PLAIN:
        return PLAIN[hint]
    if is_dataclass(hint):
        return filled(hint)  # pyright: ignore[reportArgumentType]
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Literal:
        return parts[0]
    if origin is tuple:
        return () if ... in parts else tuple(map(_nothing, parts))
    return {} if origin is dict else None


def folder(*results: tuple[Chapter, Any], result: Any = None, **about: Any) -> RunFiles:
    """The files of a run with the results of these chapters."""
    details = dict(about)
    for chapter, record in results:
        details |= chapter.data(record)
    return RunFiles(RunResult(**result or {}), details, {}, (), {}, {})


def plain(record: Any) -> dict[str, Any]:
    """A record as the file of a run has it."""
    return asdict(record)
