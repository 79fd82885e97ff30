"""A line with the progress of a training and the time left, in a terminal or in a notebook.
Elsewhere, as in a file, a test or a pipe, nothing is written."""

import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

VARIABLE = "SNAPO_BAR"
WIDTH, OFTEN = 20, 0.2  # of the bar; seconds between two lines


class ProgressLine:
    """The line of one training; `write` replaces it, and removes it if the text is empty."""

    def __init__(self, write: Callable[[str], None] | None):
        self.write, self.last = write, 0.0
        self.first: tuple[int, float] | None = None

    def tell(self, text: str) -> None:
        """Replaces the line by a text."""
        if self.write is not None:
            with suppress(OSError, ValueError):  # a closed terminal stops no training
                self.write(text)

    def step(self, done: int, steps: int, value: float) -> None:
        """Shows the progress of a training and the best value so far."""
        now = time.perf_counter()
        self.first = self.first or (done, now)  # the step before it has compiled
        if self.write is None or now - self.last < OFTEN:
            return
        self.last = now
        began, since = self.first
        left = (steps - done) * (now - since) / (done - began) if done > began else None
        more = "" if left is None else f", at most {_duration(left)} left"
        full = WIDTH * done // max(steps, 1)
        line = "█" * full + "░" * (WIDTH - full)
        self.tell(f"training {line} {done} of {steps}{more}, best value {value:,.6g}")


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {rest:02} s" if minutes else f"{rest} s"


@contextmanager
def shown(wanted: bool | None) -> Iterator[ProgressLine]:
    """Shows the line during the work of the block. `wanted`: True shows it, False hides it. None
    shows it in a terminal and in a notebook, unless SNAPO_BAR=0 is set in the environment, as for
    notebooks that run unattended.
    """
    hidden = wanted is False or (wanted is None and os.environ.get(VARIABLE) == "0")
    bar = ProgressLine(None if hidden else _notebook() or _terminal(wanted is True))
    try:
        yield bar
    finally:
        bar.tell("")


def _terminal(always: bool) -> Callable[[str], None] | None:
    out = sys.stderr
    if out is None or not (always or (out.isatty() and os.environ.get("TERM") != "dumb")):
        return None

    def write(text: str) -> None:
        columns = shutil.get_terminal_size().columns
        out.write(f"\r{text[: columns - 1]}\x1b[K")
        out.flush()

    return write


def in_notebook() -> bool:
    """Whether this is the kernel of a notebook; IPython in a terminal is not."""
    if "ipykernel" not in sys.modules:
        return False
    from IPython.core.getipython import get_ipython  # pyright: ignore[reportMissingImports]

    return hasattr(get_ipython(), "kernel")


def _notebook() -> Callable[[str], None] | None:
    """Replaces one output of the cell."""
    if not in_notebook():
        return None
    from IPython.display import display  # pyright: ignore[reportMissingImports]

    handles: list[Any] = []

    def write(text: str) -> None:
        data = {"text/plain": text}
        if handles:
            handles[0].update(data, raw=True)
        elif text:
            handles.append(display(data, raw=True, display_id=True))

    return write
