"""The time that a user waits after a move of an input on the page of `snapo open`, in a browser.

    python -m benchmarks.live_browser RUN [MOVES] [--simulator MODULE:CLASS]

RUN is a solved run. Chromium opens its page and moves, by the keyboard, one handle after another of
its first input with many numbers (for a store, the forward curve), or its sliders if there is no
such input. The times are those from the key press until a table or chart of the page changes, as an
observer of the document reports it; the last one is that at which the frame was painted.
"processor" is the processor time of the worker until then. The program needs playwright, and
Chromium on the path.
"""

import asyncio
import os
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from snapo.live.open import about_run
from snapo.live.server import Server

MOVES = 50
PATIENCE = 600_000  # milliseconds, of the first page: its code is compiled
PLACES = {
    "value": "#error",
    "deltas": "#delta-table",
    "today": "#today-table",
    "fans": "#fan-chart",
}

# Presses a key in a control, and waits until every place was written anew.
WATCH = """
async ([at, key, places]) => {
  const control = document.querySelectorAll(at.selector)[at.index];
  control.focus();
  const found = {}, started = performance.now();
  const all = new Promise((resolve) => {
    for (const [name, selector] of Object.entries(places)) {
      const place = document.querySelector(selector);
      const watch = new MutationObserver(() => {
        if (name === "value" && !place.textContent.startsWith("±")) return;
        if (found[name] === undefined) found[name] = (performance.now() - started) / 1000;
        if (Object.keys(found).length === Object.keys(places).length) resolve();
      });
      watch.observe(place, { childList: true, characterData: true, subtree: true });
    }
  });
  if (control.type === "range") {
    control.value = String(Number(control.value) + key);
    control.dispatchEvent(new Event("input", { bubbles: true }));
    control.dispatchEvent(new Event("change", { bubbles: true }));
  } else {
    const pressed = { key, bubbles: true, cancelable: true };
    control.dispatchEvent(new KeyboardEvent("keydown", pressed));
  }
  const first = (performance.now() - started) / 1000;
  await all;
  await new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)));
  found.painted = (performance.now() - started) / 1000;
  return { "first order": first, ...found };
}
"""


@contextmanager
def served(run: Path, simulator: tuple[str, str] | None = None, **about: Any) -> Iterator[Server]:
    """The server of the page of a run; `about`: entries that replace those of the run."""
    command = [sys.executable, "-m", "snapo.live.worker", str(run)]
    if simulator is not None:
        command += ["--simulator", ":".join(simulator)]
    with running(Server(run, about_run(run, simulator) | about, command)) as server:
        yield server


@contextmanager
def running(server: Server) -> Iterator[Server]:
    """A server in a separate thread."""
    loop, up = asyncio.new_event_loop(), threading.Event()

    async def start() -> None:
        await server.start()
        up.set()

    def live() -> None:
        loop.run_until_complete(start())
        loop.run_forever()

    thread = threading.Thread(target=live)
    thread.start()
    assert up.wait(30)
    try:
        yield server
    finally:
        asyncio.run_coroutine_threadsafe(server.close(), loop).result(30)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def moves_of(page, moves: int) -> Iterator[tuple[dict, object]]:
    """(control, key) of every move: handles of the first chart, else sliders."""
    chart = "[data-input] .handle"
    if (count := page.locator(".input:has(.handle)").first.locator(".handle").count()) > 1:
        name = page.locator(".input:has(.handle)").first.get_attribute("data-input")
        chart = f'[data-input="{name}"] .handle'
        for move in range(moves):
            yield {"selector": chart, "index": move % count}, "ArrowUp"
        return
    sliders = "[data-input] input[type=range]"
    count = page.locator(sliders).count()
    for move in range(moves):
        yield {"selector": sliders, "index": move % count}, 5


def table(run: Path, moves: int = MOVES, simulator: tuple[str, str] | None = None) -> Iterator[str]:
    """The lines of the table."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    with served(run, simulator) as server, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        page.goto(server.address)
        page.locator("#deltas").wait_for(timeout=PATIENCE)
        page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true })")
        shown = {k: v for k, v in PLACES.items() if page.locator(v).is_visible()}
        assert server.workers.process is not None
        worker, found, busy, errors = server.workers.process.pid, [], [], []
        for control, key in moves_of(page, moves):
            before = processor(worker)
            found.append(page.evaluate(WATCH, [control, key, shown]))
            busy.append(processor(worker) - before)
            value, error = _value(server)
            errors.append(abs(error / value) if value else 0.0)
            page.locator("#status", has_text="revalued in").wait_for(timeout=PATIENCE)
        browser.close()
        counts = server.workers.state["counts"]
    yield f"{moves} moves; paths {counts}"
    yield f"standard error at most {100 * max(errors):.3f} % of the value"
    for name in found[0]:
        seconds = [each[name] for each in found]
        yield f"{name:<10} median {np.median(seconds):6.3f} s, worst {max(seconds):6.3f} s"
    yield f"processor  median {np.median(busy):6.3f} s, worst {max(busy):6.3f} s"


def _value(server: Server) -> tuple[float, float]:
    """The value after the last move, and its standard error."""
    found = list(server._last.values())[-1]["value"]
    return found["value"], found["standard_error"]


def processor(process: int) -> float:
    """The processor time of a process so far, in seconds."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    given = [each for each in sys.argv[1:] if not each.startswith("--")]
    code = None
    if "--simulator" in sys.argv:
        module, _, name = given.pop(-1).partition(":")
        code = module, name
    for line in table(Path(given[0]), *map(int, given[1:2]), simulator=code):
        print(line, flush=True)
