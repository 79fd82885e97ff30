"""The server's side of a worker: starts it, exchanges messages with it, and starts it again when it
ends."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import Any

LONGEST_LINE = 64 << 20
TRIES = 2  # deaths before it was ready: then it is no accident

Hear = Callable[[dict[str, Any]], Awaitable[None]]


class WorkerProcess:
    """One worker process. Its latest state is saved for pages that are opened later.

    - `first`: bytes that every worker receives before its orders.
    """

    def __init__(self, command: Sequence[str], hear: Hear, first: bytes = b""):
        self.command, self.hear, self.first = command, hear, first
        self.state: dict[str, Any] = {"stage": "starting"}
        self.process: asyncio.subprocess.Process | None = None
        self._waiting: dict[str, dict[str, Any]] = {}  # the newest move of each page
        self._deaths = 0
        self._closed = False
        self._task: asyncio.Task | None = None

    def start(self) -> None:
        self._task = asyncio.create_task(self._live())

    async def close(self) -> None:
        """Ends the worker and waits until it has ended."""
        self._closed = True
        self._kill()
        if self._task is not None:
            await self._task
        if self.process is not None:
            await self.process.wait()

    def _kill(self) -> None:
        if self.process is not None and self.process.returncode is None:
            with suppress(ProcessLookupError):
                self.process.kill()

    async def ask(self, order: dict[str, Any]) -> None:
        """Passes an order to the worker, immediately or when the worker has started."""
        if order["do"] == "move":
            self._waiting[order["page"]] = order
        if self.state["stage"] == "ready":
            self._write(order)
        elif order["do"] not in ("move", "cancel"):
            text = "the calculation is starting; try again in a moment"
            await self.hear(
                {"page": order["page"], "n": order["n"], "stage": "refused", "message": text}
            )

    def forget(self, page: str) -> None:
        """Records that a page has been closed."""
        self._waiting.pop(page, None)

    def _write(self, order: dict[str, Any]) -> None:
        assert self.process is not None and self.process.stdin is not None
        with suppress(ConnectionError, RuntimeError):
            self.process.stdin.write((json.dumps(order) + "\n").encode())

    async def _live(self) -> None:
        while not self._closed and self.state["stage"] != "failed":
            await self._once()
            if self._closed or self.state["stage"] == "failed":
                return
            self._deaths += self.state["stage"] != "ready"
            text = "the calculation ended unexpectedly and is starting again"
            self.state = {"stage": "starting", "message": text}
            if self._deaths >= TRIES:
                self.state = {"stage": "failed", "message": "the calculation cannot be started"}
            await self.hear(dict(self.state))

    async def _once(self) -> None:
        """Runs the process once, until it ends."""
        self.process = await asyncio.create_subprocess_exec(
            *self.command,
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, limit=LONGEST_LINE,
            start_new_session=True,  # Ctrl-C is for the server, which ends this one
        )  # fmt: skip
        if self._closed:  # while the process began, so that it could not be killed
            self._kill()
        assert self.process.stdin is not None and self.process.stdout is not None
        with suppress(ConnectionError, RuntimeError):
            self.process.stdin.write(self.first)
        async for line in self.process.stdout:
            message = json.loads(line)
            if message["stage"] in ("ready", "failed"):
                self.state = message
                await self.hear(message)
                for order in list(self._waiting.values()):
                    self._write(order)
                continue
            if message["stage"] in ("done", "refused"):
                waiting = self._waiting.get(message["page"])
                if waiting is not None and waiting["n"] == message["n"]:
                    del self._waiting[message["page"]]
            await self.hear(message)
        await self.process.wait()
