"""`snapo open RUN`: the page of a run, until it is ended."""

import asyncio
import sys
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.study import run_folder
from snapo.study.commands import domain_of_run
from snapo.study.study import ProgressCallback
from snapo.study.training import no_policy


def about_run(run: Path, simulator: tuple[str, str] | None = None) -> dict[str, Any]:
    """The contents of a run's files: nothing is computed.

    **Raises:** `CaseError` where there is no run, or one without a policy.
    """
    record = run_folder.read(run)
    domain_of_run(run, record, simulator)
    result = run_folder.read_table(run / run_folder.RESULT) or {}
    parts = record["parts"]
    trains = "training" in parts or not parts
    missing = trains and not (run / run_folder.POLICY).is_file()
    if missing or result.get("value") is None:
        raise no_policy(run, record)
    about = record.get("about", {})
    step = about.get("step")
    keys = ("value", "standard_error", "status", "convergence", "verdict", "bound", "paths")
    return {
        "title": about.get("title", run.name),
        "kind": record["kind"],
        "days": about.get("days"),
        "step": step if isinstance(step, str) else "step",
        "trains": trains,
        "meaning": result.get("meaning", ""),
        "folder": str(run),
        "result": {key: result.get(key) for key in keys},
    }


def open_page(
    run: Path,
    progress: ProgressCallback,
    *,
    simulator: tuple[str, str] | None = None,
    port: int = 0,
    browser: bool = True,
    paths: int | None = None,
    engine: str = "auto",
) -> None:
    """Serves the page of a run until Ctrl-C.

    **Raises:** `CaseError` where there is no such run, the port is taken, or the extra is missing.
    """
    about = about_run(run, simulator)
    try:
        from .server import Server
    except ModuleNotFoundError as error:
        message = f"the page needs {error.name}: pip install 'snapo[live]'"
        raise CaseError("snapo open", "", None, message) from None
    worker = [sys.executable, "-m", "snapo.live.worker", str(run), "--engine", engine]
    if simulator is not None:
        worker += ["--simulator", ":".join(simulator)]
    if paths is not None:
        worker += ["--paths", str(paths)]

    async def serve() -> None:
        server = Server(run, about, worker)
        try:
            await server.start(port)
        except OSError as error:
            subject = f"this machine cannot be listened to there ({error.strerror})"
            raise CaseError("--port", "", port, subject) from None
        progress(f"the page is at {server.address}")
        progress("it is for this machine only; Ctrl-C ends it")
        if browser:
            webbrowser.open(server.address)
        try:
            await asyncio.Event().wait()
        finally:
            await server.close()

    with suppress(KeyboardInterrupt):  # which is how it ends
        asyncio.run(serve())
