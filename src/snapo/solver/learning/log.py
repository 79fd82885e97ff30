"""The reports of a training while it runs: `snapo.log`, callbacks that write files.

It also writes the choices of training with their reasons as sentences for a solution's notes.
"""

import struct
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from snapo.problem.policies.memory import remembering
from snapo.problem.problem import Problem
from snapo.problem.smooth import Smooth

from ..tables import write_csv
from ..verdict.constant import describe_idle
from .conditioning import Growth, sampled_norms
from .progress import Progress, Record
from .settings import TrainingPlan
from .starts import describe


def recorded(problem: Problem, progress: Progress, training: TrainingPlan) -> Progress:
    """Adds the adjoints of the trained rule, if a user set window, clip or keep and nothing else
    measured them."""
    values = isinstance(training.window, int), progress.clip is not None, progress.keep < 1
    if progress.growth is not None or not any(values):
        return progress
    smooth = Smooth(np.float32(training.temperature(progress.step)))
    problem = remembering(problem, progress.best)
    norms = sampled_norms(problem, progress.best, smooth, progress.step)
    return replace(progress, growth=Growth.of(norms, progress.step))


def start_notes(progress: Progress) -> tuple[str, ...]:
    """Sentences on the start that continued, on restarts, on the growth of adjoints and the
    response of training, and on steps that failed."""
    raced = (describe(progress.raced),) if progress.raced else ()
    if progress.redrawn:
        raced = (*raced, describe_idle(progress.redrawn, progress.history))
    slowed = (_slowed(progress.slowed),) if progress.slowed else ()
    growth = progress.growth
    if growth is None or not growth.large:
        return raced + slowed
    return (*raced, f"{growth.describe()} {went_back(progress)}", *slowed)


def _slowed(steps: tuple[int, ...]) -> str:
    """One sentence on the steps that failed, after which the rate was lowered."""
    *first, last = map(str, steps)
    summary = f"steps {', '.join(first)} and {last}" if first else f"step {last}"
    return (
        f"Training failed at {summary}, where too many paths were non-finite, and continued each "
        "time from the best policy so far with a quarter of the learning rate."
    )


def went_back(progress: Progress) -> str:
    """One sentence: windows, a bound or a decay of adjoints, and the first step with it."""
    history = progress.history
    if progress.window is not None:
        since = _before(record.window > 0 for record in history)
        return (
            f"From step {since} of the training on, windows of {progress.window} steps with a "
            "critic were used (Training(window=None) turns this off)."
        )
    ways = []
    clips = [record.clip > 0 for record in history]
    if any(clips) or progress.clip is not None:
        until, end = ",", f", by {progress.clip or 0.0:,.3g} at the end"
        if progress.clip is None:
            lifted = len(clips) - _before(reversed(clips))
            until, end = f" until step {lifted}, after which adjoints no longer grew,", ""
        ways.append(
            f"from step {_before(clips)} of the training on{until} each path's adjoint was "
            f"bounded{end} (Training(clip=None) turns this off)"
        )
    if progress.keep < 1:
        since = _before(record.keep < 1 for record in history)
        ways.append(
            f"from step {since} of the training on, every backward step kept only a share of "
            f"{progress.keep:.3g} of the adjoint (Training(keep=1.0) keeps all)"
        )
    if not ways:
        return (
            "Training did not respond to this; Training(clip=…) or Training(keep=…) bounds "
            "adjoints."
        )
    summary = "; ".join(ways)
    return f"{summary[0].upper()}{summary[1:]}."


def _before(there: Iterable[bool]) -> int:
    """The number of steps before the first one for which this is true."""
    return next((number for number, item in enumerate(there) if item), 0)


__all__ = ["CSV", "TensorBoard"]


class CSV:
    """A callback that writes a row for every step taken, after each validation.

        snapo.solve(…, callbacks=[snapo.log.CSV("training.csv")])

    Columns are those of `history.csv`. A run that continues from a `Progress` writes all its steps.
    """

    def __init__(self, file: Path | str):
        self.file, self.written = Path(file), 0

    def __call__(self, progress: Progress) -> None:
        history = progress.history
        if not self.written:
            write_csv(self.file, Record._fields, history)
        else:
            rows = (",".join(map(str, record)) for record in history[self.written :])
            with self.file.open("a", encoding="utf-8") as file:
                file.writelines(f"{row}\n" for row in rows)
        self.written = len(history)


class TensorBoard:
    """A callback that writes an event file, which TensorBoard shows: `tensorboard --logdir runs`.

        snapo.solve(…, callbacks=[snapo.log.TensorBoard("runs/first")])

    Scalars by step: objective, exact, exact_error, gradient_norm and temperature; the two exact
    ones only at validations. No other library is needed.
    """

    def __init__(self, folder: Path | str):
        Path(folder).mkdir(parents=True, exist_ok=True)
        stamp = time.time()
        self.file = Path(folder) / f"events.out.tfevents.{stamp:.6f}.snapo"
        self.written = 0
        self.file.write_bytes(_framed(_double(1, stamp) + _text(3, b"brain.Event:2")))

    def __call__(self, progress: Progress) -> None:
        with self.file.open("ab") as file:
            for record in progress.history[self.written :]:
                file.write(_framed(_event(record)))
        self.written = len(progress.history)


SCALARS = ("objective", "exact", "exact_error", "gradient_norm", "temperature")


def _event(record: Record) -> bytes:
    """An `Event` of TensorFlow's event.proto: wall time 1, step 2, summary 5 of values 1."""
    table = {name: float(getattr(record, name)) for name in SCALARS}
    values = b"".join(
        _text(1, _text(1, name.encode()) + _single(2, value))
        for name, value in table.items()
        if np.isfinite(value) and (name, value) != ("exact_error", 0.0)
    )
    return _double(1, time.time()) + b"\x10" + _varint(record.step) + _text(5, values)


def _framed(data: bytes) -> bytes:
    """A record of a TFRecord file: length, its checksum, data, its checksum."""
    length = struct.pack("<Q", len(data))
    return length + _masked(length) + data + _masked(data)


def _masked(data: bytes) -> bytes:
    crc = crc32c(data)
    return struct.pack("<I", ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF)


def crc32c(data: bytes) -> int:
    """The checksum of Castagnoli: crc32c(b"123456789") is 0xE3069283."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def _varint(number: int) -> bytes:
    numbers = bytearray()
    while number > 127:
        numbers.append(number & 127 | 128)
        number >>= 7
    return bytes([*numbers, number])


def _text(field: int, data: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def _double(field: int, value: float) -> bytes:
    return _varint(field << 3 | 1) + struct.pack("<d", value)


def _single(field: int, value: float) -> bytes:
    return _varint(field << 3 | 5) + struct.pack("<f", value)
