"""`snapo open RUN`: serves the page of a run until the user ends it; the same for a Python
session."""

import asyncio
import sys
import threading
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import suppress
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from snapo.case.error import CaseError
from snapo.report.drawing import times_of
from snapo.report.record import RunRecord, entries_of
from snapo.study import run_folder
from snapo.study.commands import domain_of_run
from snapo.study.study import ProgressCallback
from snapo.study.training import no_policy

if TYPE_CHECKING:
    from .server import Server


class AboutRun(NamedTuple):
    """Entries of a study's `about`: the title, the days and the step of the time axis, and the name
    of the number that is shown instead of the value."""

    title: str | None = None
    days: list[str] | None = None
    step: Any = None
    headline: str = ""
    local_times: Sequence[tuple[int, str]] = ()
    horizon: int = 0

    @property
    def times(self) -> list[str] | None:
        """The days or hours of the steps; None if steps have only numbers."""
        if not self.local_times:
            return self.days
        hourly = self.step == "hour"
        times = times_of(self.local_times, 24 if hourly else 1, self.horizon)
        return [f"{x:%Y-%m-%d %H:%M}" if hourly else f"{x:%Y-%m-%d}" for x in times]


def about_run(run: Path, simulator: tuple[str, str] | None = None) -> dict[str, Any]:
    """Reads the files of a run without any computation.

    **Raises:** `CaseError` if there is no run, or if it has no policy.
    """
    record = run_folder.read(run)
    domain_of_run(run, record, simulator)
    result = run_folder.read_table(run / run_folder.RESULT) or {}
    parts = record["parts"]
    trains = "training" in parts or not parts
    missing = trains and not (run / run_folder.POLICY).is_file()
    if missing or result.get("value") is None:
        raise no_policy(run, record)
    about = entries_of(AboutRun, entries_of(RunRecord, record).about)
    keys = ("value", "standard_error", "status", "convergence", "verdict", "bound", "paths")
    return {
        "title": run.name if about.title is None else about.title,
        "kind": record["kind"],
        "days": about.times,
        "step": about.step if isinstance(about.step, str) else "step",
        "trains": trains,
        # A value that is shown as another number follows with the calculation.
        "meaning": about.headline or result.get("meaning", ""),
        "follows": bool(about.headline),
        "folder": str(run),
        "restart": f'Start it again with "snapo open {run}": the new page offers the inputs '
        "of this page.",
        "result": {key: result.get(key) for key in keys},
    }


def server_of(
    run: Path,
    *,
    simulator: tuple[str, str] | None = None,
    paths: int | None = None,
    engine: str = "auto",
    problem: bytes = b"",
) -> "Server":
    """The server of a run's page, which is not started yet; `problem`: a pickled problem in Python.

    **Raises:** `CaseError` if there is no such run; `ModuleNotFoundError` without aiohttp.
    """
    from .server import Server

    about = about_run(run, simulator)
    if problem:
        about["folder"] = "solved in Python"
        about["restart"] = "Call open() of the solution in Python again."
    worker = [sys.executable, "-m", "snapo.live.worker", str(run), "--engine", engine]
    if simulator is not None:
        worker += ["--simulator", ":".join(simulator)]
    if paths is not None:
        worker += ["--paths", str(paths)]
    if problem:
        worker += ["--problem", str(len(problem))]
    return Server(run, about, worker, problem)


async def served(
    server: "Server", port: int, ready: Callable[[], None], ended: asyncio.Event
) -> None:
    """Serves the page until `ended`. **Raises:** `CaseError` if the port is in use."""
    try:
        await server.start(port)
    except OSError as error:
        subject = f"this machine cannot listen on that port ({error.strerror})"
        raise CaseError("--port", "", port, subject) from None
    ready()
    try:
        await ended.wait()
    finally:
        await server.close()


def open_page(
    run: Path,
    progress: ProgressCallback,
    *,
    port: int = 0,
    browser: bool = True,
    **options: Any,
) -> None:
    """Serves the page of a run until Ctrl-C; `options`: the options of `server_of`. **Raises:**
    `CaseError` as in `server_of`, and if the port is in use.
    """
    server = server_of(run, **options)

    def ready() -> None:
        progress(f"the page is at {server.address}")
        progress("it can be reached from this machine only; Ctrl-C closes it")
        if browser:
            webbrowser.open(server.address)

    async def until_ended() -> None:
        await served(server, port, ready, asyncio.Event())

    with suppress(KeyboardInterrupt):  # which is how it ends
        asyncio.run(until_ended())


class LivePage:
    """The live page of a solution, as long as the Python session that opened it.

    - `address`: for a browser on this machine; a notebook shows it as a link.
    """

    def __init__(self, server: "Server", closed: Callable[[], None] = lambda: None):
        self._closed, started = closed, threading.Event()
        self._loop, self._ended = asyncio.new_event_loop(), asyncio.Event()
        self._failed: list[BaseException] = []

        def run() -> None:
            try:
                self._loop.run_until_complete(served(server, 0, started.set, self._ended))
            except CaseError as error:
                self._failed.append(error)
            finally:
                started.set()

        # A thread that ends with the session; its worker ends when nobody can ask it any more.
        self._thread = threading.Thread(target=run, name="snapo live page", daemon=True)
        self._thread.start()
        started.wait()
        if self._failed:
            closed()
            raise self._failed[0]
        self.address = server.address

    def close(self) -> None:
        """Ends the page and its calculation."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join()
        self._closed()

    def __repr__(self) -> str:
        state = "open until close(), or the end of this session" if self._open else "closed"
        return f"{self.address} ({state})"

    def _repr_html_(self) -> str:
        if not self._open:
            return "<p>This page is closed.</p>"
        link = f'<a href="{escape(self.address)}" target="_blank">Open the live page</a>'
        return f"<p>{link}; it ends with this session, or with <code>close()</code>.</p>"

    @property
    def _open(self) -> bool:
        return self._thread.is_alive()
