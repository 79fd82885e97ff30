"""What a training tells while it runs: `snapo.log`, callbacks that write files."""

import struct
import time
from pathlib import Path

import numpy as np

from ..files import write_csv
from .progress import Progress, Record

__all__ = ["CSV", "TensorBoard"]


class CSV:
    """A callback that writes a row for every step taken, after each validation.

        snapo.solve(…, callbacks=[snapo.log.CSV("training.csv")])

    Columns are those of `history.csv`. A run that goes on from a `Progress` writes all its steps.
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

    Scalars by step: objective, exact, exact_error, gradient_norm and temperature; those of the
    exact simulator at validations. No other library is needed.
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
