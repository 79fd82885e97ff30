"""The server of the page: it serves files, one socket for each page, and downloads."""

import asyncio
import hmac
import json
import secrets
import tempfile
from collections.abc import Awaitable, Callable, Mapping, Sequence
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Any

from aiohttp import WSMsgType, web

from snapo.report.record import entries_of
from snapo.study import run_folder

from .process import WorkerProcess
from .scenarios import (
    CASE,
    MAX_NUMBERS,
    PageOrder,
    PageTables,
    Refused,
    SavedScenarios,
    chosen_of,
    csv_of,
    page_rows,
    values_of,
    zipped,
)

PATIENCE = 120  # seconds that a download waits for the worker
XLSX = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"

Last = Callable[[str, int], Mapping[str, Any] | None]


class Downloads:
    """The addresses of downloads. `last`: returns the tables of a page's last move, if there are
    any."""

    def __init__(self, run: Path, scenarios: SavedScenarios, workers: WorkerProcess, last: Last):
        self.run, self.scenarios, self.workers, self.last = run, scenarios, workers, last
        self._numbers = count(1)
        self._writing: dict[int, asyncio.Future] = {}  # those that wait for the worker

    def route(self, app: web.Application) -> None:
        """Adds the addresses to the server."""
        app.router.add_get("/{token}/scenarios.csv", self.table)
        app.router.add_get("/{token}/scenario/{id}.zip", self.case)
        app.router.add_get("/{token}/scenario/{id}.csv", self.scenario)
        app.router.add_get("/{token}/report.html", self.report)
        app.router.add_get("/{token}/shown/{at:run|p[0-9]+-[0-9]+}.csv", self.shown)
        app.router.add_get("/{token}/case/{at:run|p[0-9]+-[0-9]+}.{kind:zip|xlsx}", self.carried)

    def hear(self, message: Mapping[str, Any]) -> None:
        """Passes the worker's answer to a waiting request."""
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
        file = self.run / run_folder.REPORT
        if not file.is_file() or file.is_symlink():
            raise web.HTTPNotFound(text="This run has no report; `snapo report` writes one.")
        return _download(file.read_bytes(), "text/html", run_folder.REPORT)

    async def shown(self, request: web.Request) -> web.Response:
        """Returns everything that a page shows, as CSV."""
        at, tables = self._asked(request)
        return _download(csv_of(page_rows(tables)).encode(), "text/csv", f"shown-{at}.csv")

    async def carried(self, request: web.Request) -> web.Response:
        """Returns the case that a page shows, as a zip of its files or as a workbook."""
        tables = entries_of(PageTables, self._asked(request)[1])
        book = request.match_info["kind"] == "xlsx"
        order = {"do": "write", "page": "", "n": next(self._numbers), "workbook": book}
        order |= {"values": tables.values or {}, "chosen": tables.choices}
        order["policy"] = tables.policy
        done = asyncio.get_running_loop().create_future()
        with tempfile.TemporaryDirectory(prefix="snapo-live-") as made:
            folder = Path(made) / "case"
            self._writing[order["n"]] = done
            try:
                await self.workers.ask(order | {"folder": str(folder)})
                message = await asyncio.wait_for(done, PATIENCE)
            except TimeoutError:
                message = {"stage": "refused", "message": "the calculation is busy; try again"}
            finally:
                self._writing.pop(order["n"], None)
            if message["stage"] != "written":
                raise web.HTTPConflict(text=message["message"])
            written = list(folder.iterdir())
            if book and len(written) == 1:
                return _download(written[0].read_bytes(), XLSX, "case.xlsx")
            return _download(zipped(folder, "case"), "application/zip", "case.zip")

    def _asked(self, request: web.Request) -> tuple[str, Mapping[str, Any]]:
        """The position in an address, and its document."""
        at = request.match_info["at"]
        if at == "run":
            return at, self.workers.state.get("base") or {}
        page, _, n = at.partition("-")
        result = self.last(page, int(n))
        if result is None:
            raise web.HTTPNotFound(text="These numbers are no longer shown.")
        return at, result


def _download(body: bytes, kind: str, name: str) -> web.Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return web.Response(body=body, content_type=kind, headers=headers)


HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self' {socket}; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)

STRANDED = (
    "The address has no token, or the token of an earlier start. Run `snapo open RUN` again, and "
    "use the address that it prints. The new page offers the inputs of the previous page."
)
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def new_token() -> str:
    """256 random bits, as text for an address."""
    return secrets.token_urlsafe(32)


def guard(token: str, port: Callable[[], int]):
    """The middleware that refuses other clients and sends the permissions of the page to the
    browser."""

    @web.middleware
    async def checked(request: web.Request, handler: Handler) -> web.StreamResponse:
        names = [f"{name}:{port()}" for name in NAMES]
        if request.headers.get("Host") not in names:
            raise web.HTTPForbidden(text="This server answers requests from this machine only.")
        first = request.path.lstrip("/").partition("/")[0]
        if not hmac.compare_digest(first.encode(), token.encode()):
            raise web.HTTPForbidden(text=STRANDED)
        origin = request.headers.get("Origin")
        if origin is not None and origin not in [f"http://{name}" for name in names]:
            raise web.HTTPForbidden(
                text="A page of another site has requested this page; this is not allowed."
            )
        if request.headers.get("Upgrade") and origin is None:
            raise web.HTTPForbidden(text="Only the page itself may request this.")
        return await handler(request)

    async def harden(request: web.Request, response: web.StreamResponse) -> None:
        sockets = " ".join(f"ws://{name}:{port()}" for name in NAMES)
        response.headers["Content-Security-Policy"] = POLICY.format(socket=sockets)
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["Cache-Control"] = "no-store"
        response.headers["Cross-Origin-Resource-Policy"] = "same-origin"
        response.headers["Cross-Origin-Opener-Policy"] = "same-origin"
        response.headers.pop("Server", None)

    return checked, harden


PAGE = files("snapo.live") / "page"
KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
LONGEST = 4 << 20  # bytes of a message from a page
ASKED = ("values", "chosen", "policy")


class Server:
    """One run, one worker, any number of pages.

    - `about`: the description of the run, from its files; `worker`: the command that starts the
      worker; `problem`: a pickled problem in Python, which the worker reads first.
    """

    def __init__(
        self, run: Path, about: Mapping[str, Any], worker: Sequence[str], problem: bytes = b""
    ):
        self.token, self.port = new_token(), 0
        self.scenarios = SavedScenarios(run)
        self.about = dict(about) | {"last": self.scenarios.last()}
        self.workers = WorkerProcess(worker, self.hear, problem)
        self.pages: dict[str, web.WebSocketResponse] = {}
        self._numbers = count(1)
        self._last: dict[tuple[str, int], dict[str, Any]] = {}  # the tables of the last moves
        self._runner: web.AppRunner | None = None
        self.downloads = Downloads(run, self.scenarios, self.workers, self._shown)

    @property
    def address(self) -> str:
        """The address of the page, with its token."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    async def start(self, port: int = 0) -> None:
        """Listens for requests from this machine only. **Raises:** `OSError` if the port is
        in use."""
        checked, harden = guard(self.token, lambda: self.port)
        app = web.Application(middlewares=[checked], client_max_size=LONGEST)
        app.on_response_prepare.append(harden)
        app.router.add_get("/{token}", self.ended)
        app.router.add_get("/{token}/", self.page)
        app.router.add_get("/{token}/socket", self.socket)
        self.downloads.route(app)
        app.router.add_get("/{token}/{name:[a-z]+[.](?:css|js|svg)}", self.file)
        self._runner = web.AppRunner(app, access_log=None)
        await self._runner.setup()
        site = web.TCPSite(self._runner, HOST, port)
        await site.start()
        self.port = self._runner.addresses[0][1]
        self.workers.start()

    async def close(self) -> None:
        await self.workers.close()
        for page in list(self.pages.values()):
            await page.close()
        if self._runner is not None:
            await self._runner.cleanup()

    # Files.

    async def page(self, request: web.Request) -> web.Response:
        return _sent("index.html")

    async def ended(self, request: web.Request) -> web.Response:
        raise web.HTTPFound(f"/{self.token}/")  # the address without its last slash

    async def file(self, request: web.Request) -> web.Response:
        return _sent(request.match_info["name"])

    def _shown(self, page: str, n: int) -> Mapping[str, Any] | None:
        """The tables of a page's last move; waits until there are some."""
        result = self._last.get((page, n))
        return result if result is not None and "value" in result else None

    # Pages.

    async def socket(self, request: web.Request) -> web.WebSocketResponse:
        """Serves one page while it is open."""
        socket = web.WebSocketResponse(max_msg_size=LONGEST, heartbeat=30)
        await socket.prepare(request)
        name = f"p{next(self._numbers)}"
        self.pages[name] = socket
        try:
            await self._send(name, {"stage": "about", "about": self.about, "page": name})
            await self._send(name, self.workers.state)
            await self._send(name, self._kept())
            async for message in socket:
                if message.type == WSMsgType.TEXT:
                    await self._order(name, message.data)
        finally:
            self.pages.pop(name, None)
            self.workers.forget(name)
            await self.workers.ask({"do": "cancel", "page": name, "n": -1})
            for key in [key for key in self._last if key[0] == name]:
                del self._last[key]
        return socket

    async def _order(self, page: str, text: str) -> None:
        """Handles one request of a page; an invalid request gets an answer and has no effect."""
        n = -1
        try:
            request = json.loads(text)
            if not isinstance(request, dict):
                raise Refused("this is not a valid request")
            order = entries_of(PageOrder, request)
            n = order.n if isinstance(order.n, int) and not isinstance(order.n, bool) else -1
            match order.do:
                case "move":
                    request = {
                        "values": values_of(order.values),
                        "chosen": chosen_of(order.chosen),
                        "policy": self._policy(order.policy),
                    }
                    self._last = {k: v for k, v in self._last.items() if k[0] != page}
                    self._last[page, n] = dict(request)
                    await self.workers.ask({"do": "move", "page": page, "n": n, **request})
                case "keep":
                    await self._keep(page, n, str(order.name))
                case "train" | "bound" | "explain":
                    result = self._last.get((page, n))
                    if result is None or "value" not in result:
                        raise Refused("the value at these numbers is not ready yet; try again")
                    values = {key: result[key] for key in ASKED}
                    await self.workers.ask({"do": order.do, "page": page, "n": n, **values})
                case "cancel":
                    await self.workers.ask({"do": "cancel", "page": page, "n": -1})
                case "forget":
                    self.scenarios.forget(str(order.id))
                    await self._tell_all(self._kept())
                case _:
                    raise Refused("this is not a valid request")
        except (Refused, ValueError, OverflowError, RecursionError) as error:
            label = str(error) if isinstance(error, Refused) else "this message cannot be read"
            await self._send(page, {"stage": "refused", "n": n, "message": label})
        except OSError as error:
            label = f"the run folder cannot be written ({error.strerror})"
            await self._send(page, {"stage": "refused", "n": n, "message": label})

    def _policy(self, label: Any) -> int | str:
        """The policy of a move: the number of a policy trained on the page (0 is the run's policy),
        or the policy of a scenario."""
        if isinstance(label, str):
            return str(self.scenarios.folder_of(label) / CASE / run_folder.POLICY)
        if isinstance(label, bool) or not isinstance(label, int) or not 0 <= label < MAX_NUMBERS:
            raise Refused("a policy must be selected by its number or by its scenario")
        return label

    async def _keep(self, page: str, n: int, name: str) -> None:
        """Saves a scenario as it was valued, with its case, and notifies all pages."""
        result = self._last.get((page, n))
        if result is None or "value" not in result:
            raise Refused("the value at these numbers is not ready yet; try again")
        selected = self.scenarios.keep(name, result["values"], result)
        await self._tell_all(self._kept())
        folder = str(self.scenarios.folder_of(selected) / CASE)
        request = {key: result[key] for key in ASKED}
        await self.workers.ask({"do": "write", "page": page, "n": n, "folder": folder, **request})

    async def hear(self, message: dict[str, Any]) -> None:
        """Passes a line of the worker to the page that it concerns, or to all pages."""
        page = message.get("page")
        if page is None:
            await self._tell_all(message)
            return
        if page == "":  # a download waits for it
            self.downloads.hear(message)
            return
        tables = self._last.get((page, message["n"]))
        if tables is not None and "table" in message:
            tables[message["stage"]] = message["table"]
            if message["stage"] == "value" and not tables["policy"]:
                self.scenarios.remember({key: tables[key] for key in ("values", "chosen")})
        if message["stage"] == "written":
            await self._tell_all(self._kept())
        await self._send(page, message)

    def _kept(self) -> dict[str, Any]:
        result = self.scenarios.all()
        for item in result:
            item["case"] = (self.scenarios.folder / item["id"] / CASE).is_dir()
        return {"stage": "scenarios", "scenarios": result}

    async def _tell_all(self, message: Mapping[str, Any]) -> None:
        for page in list(self.pages):
            await self._send(page, message)

    async def _send(self, page: str, message: Mapping[str, Any]) -> None:
        socket = self.pages.get(page)
        if socket is not None and not socket.closed:
            try:
                await socket.send_str(json.dumps(message))
            except ConnectionError:
                self.pages.pop(page, None)


def _sent(name: str) -> web.Response:
    file = PAGE / name
    if not file.is_file():
        raise web.HTTPNotFound(text="There is no such file.")
    kind = KINDS[name.rpartition(".")[2]]
    return web.Response(body=file.read_bytes(), content_type=kind, charset="utf-8")
