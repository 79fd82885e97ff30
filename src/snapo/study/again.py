"""The case of a run, read again from the copy in its folder, as it counted when it was solved."""

import datetime
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.case.load import load

from .domain import Domain, Options, RunsCode
from .run_folder import CASE, differences


def case_of_run(out: Path, record: Mapping[str, Any]) -> tuple[Path, dict[str, Any]]:
    """The file of a run's case, and its tables with the keys that `--set` changed.

    **Raises:** `CaseError` where the copy in the run folder is gone.
    """
    recorded = record["decides"]["case"]
    results = [load(file) for file in sorted((out / CASE).glob("*.toml"))]
    if not results:
        message = "the copy of the case is gone: solve the case again"
        raise CaseError(str(out / CASE), "", None, message)
    file, data = min(results, key=lambda item: len(list(differences(_plain(item[1]), recorded))))
    return file, _as_recorded(data, recorded)


def options_of_run(domain: Domain, case: Any, record: Mapping[str, Any], engine: str) -> Options:
    """As the case of a run is studied again: without the checks that it passed, unless it runs code
    that has changed since."""
    decided = record["decides"].get("options", {})
    same = not isinstance(domain, RunsCode) or domain.decides(case).items() <= decided.items()
    return Options(engine, about=record.get("about") if same else None)


def _as_recorded(data: Any, recorded: Any) -> Any:
    """Tables of a file with the recorded values; those that are the same keep their types."""
    if isinstance(data, dict) and isinstance(recorded, dict):
        return {key: _as_recorded(data.get(key), value) for key, value in recorded.items()}
    if isinstance(data, list) and isinstance(recorded, list) and len(data) == len(recorded):
        return [_as_recorded(old, new) for old, new in zip(data, recorded, strict=True)]
    if _plain(data) == recorded:
        return data
    if isinstance(data, datetime.date) and isinstance(recorded, str):
        return datetime.date.fromisoformat(recorded)
    return recorded


def _plain(data: Any) -> Any:
    """As run.json holds it."""
    return json.loads(json.dumps(data, default=str))
