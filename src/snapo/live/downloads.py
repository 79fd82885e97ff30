"""What the page gives to take away: scenarios, what is shown, the case of it, the report."""

import asyncio
import tempfile
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import Any

from aiohttp import web

from snapo.study.run_folder import REPORT

from .crew import WorkerProcess
from .export import csv_of, page_rows, zipped
from .scenarios import Refused, SavedScenarios

PATIENCE = 120  # seconds that a download waits for the worker
XLSX = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"

Last = Callable[[str, int], Mapping[str, Any] | None]


class Downloads:
    """The addresses of downloads. `last`: the tables of a page's move, where it has them."""

    def __init__(self, run: Path, scenarios: SavedScenarios, workers: WorkerProcess, last: Last):
        self.run, self.scenarios, self.workers, self.last = run, scenarios, workers, last
        self._numbers = count(1)
        self._writing: dict[int, asyncio.Future] = {}  # those that wait for the worker

    def route(self, app: web.Application) -> None:
        """Adds the addresses."""
        app.router.add_get("/{token}/scenarios.csv", self.table)
        app.router.add_get("/{token}/scenario/{id}.zip", self.case)
        app.router.add_get("/{token}/scenario/{id}.csv", self.scenario)
        app.router.add_get("/{token}/report.html", self.report)
        app.router.add_get("/{token}/shown/{at:run|p[0-9]+-[0-9]+}.csv", self.shown)
        app.router.add_get("/{token}/case/{at:run|p[0-9]+-[0-9]+}.{kind:zip|xlsx}", self.carried)

    def hear(self, message: Mapping[str, Any]) -> None:
        """The worker's answer to one that waits."""
        waiting = self._writing.get(message["n"])
        if waiting is not None and not waiting.done():
            waiting.set_result(message)

    async def table(self, request: web.Request) -> web.Response:
        return _download(self.scenarios.table().encode(), "text/csv", "scenarios.csv")

    async def case(self, request: web.Request) -> web.Response:
        result = request.match_info["id"]
        try:
            body = self.scenarios.zipped(result)
        except Refused as error:
            raise web.HTTPNotFound(text=str(error)) from None
        return _download(body, "application/zip", f"{result}.zip")

    async def scenario(self, request: web.Request) -> web.Response:
        result = request.match_info["id"]
        try:
            body = self.scenarios.one(result).encode()
        except Refused as error:
            raise web.HTTPNotFound(text=str(error)) from None
        return _download(body, "text/csv", f"{result}.csv")

    async def report(self, request: web.Request) -> web.Response:
        file = self.run / REPORT
        if not file.is_file() or file.is_symlink():
            raise web.HTTPNotFound(text="This run has no report: snapo report makes one.")
        return _download(file.read_bytes(), "text/html", REPORT)

    async def shown(self, request: web.Request) -> web.Response:
        """Everything that a page shows, as CSV."""
        at, tables = self._asked(request)
        return _download(csv_of(page_rows(tables)).encode(), "text/csv", f"shown-{at}.csv")

    async def carried(self, request: web.Request) -> web.Response:
        """The case that a page shows: its files in a zip, or a workbook."""
        _, tables = self._asked(request)
        book = request.match_info["kind"] == "xlsx"
        order = {"do": "write", "page": "", "n": next(self._numbers), "workbook": book}
        order |= {"values": tables.get("values", {}), "chosen": tables.get("chosen", {})}
        done = asyncio.get_running_loop().create_future()
        with tempfile.TemporaryDirectory(prefix="snapo-live-") as made:
            self._writing[order["n"]] = done
            try:
                await self.workers.ask(order | {"folder": made})
                message = await asyncio.wait_for(done, PATIENCE)
            except TimeoutError:
                message = {"stage": "refused", "message": "the calculation is busy; try again"}
            finally:
                self._writing.pop(order["n"], None)
            if message["stage"] != "written":
                raise web.HTTPConflict(text=message["message"])
            written = list(Path(made).iterdir())
            if book and len(written) == 1:
                return _download(written[0].read_bytes(), XLSX, "case.xlsx")
            return _download(zipped(Path(made), "case"), "application/zip", "case.zip")

    def _asked(self, request: web.Request) -> tuple[str, Mapping[str, Any]]:
        """The place in an address, and what is shown there."""
        at = request.match_info["at"]
        if at == "run":
            return at, self.workers.state.get("base") or {}
        page, _, n = at.partition("-")
        result = self.last(page, int(n))
        if result is None:
            raise web.HTTPNotFound(text="These numbers are not shown any more.")
        return at, result


def _download(body: bytes, kind: str, name: str) -> web.Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return web.Response(body=body, content_type=kind, headers=headers)
