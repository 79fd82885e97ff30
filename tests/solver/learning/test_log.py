"""Callbacks that stop and that write files; they change no number."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from tests.problem.families.test_family import PROBLEM

import snapo
from snapo.engine import Xla
from snapo.problem.policy import parameters
from snapo.solver.learning.log import SCALARS, crc32c
from snapo.solver.learning.progress import Record
from snapo.solver.train import initial_progress, train

SHORT = snapo.Training(steps=6, paths=32, validation_paths=64, validation_every=2)
RULE = snapo.Linear(np.zeros((1, 2), np.float32), np.zeros(1, np.float32))


def run(callbacks=(), progress=None):
    progress = progress or initial_progress(RULE, SHORT)
    return train(PROBLEM, progress, SHORT, Xla("float32"), callbacks)


@pytest.mark.prove
def test_callbacks_write_stop_and_change_nothing(tmp_path):
    quiet, seen = run(), []
    folder = tmp_path / "board"
    told = run([seen.append, snapo.log.CSV(tmp_path / "a.csv"), snapo.log.TensorBoard(folder)])
    assert np.array_equal(parameters(quiet.best), parameters(told.best))
    assert [each.record.step for each in seen] == [2, 4, 6]
    assert all(each.record.exact_error > 0 for each in seen)
    rows = (tmp_path / "a.csv").read_text().splitlines()
    assert rows[0].split(",") == list(Record._fields) and len(rows) == 7
    assert float(rows[6].split(",")[1]) == told.history[-1].objective
    (file,) = folder.iterdir()
    assert file.name.startswith("events.out.tfevents.")
    events = list(framed(file.read_bytes()))
    assert b"brain.Event:2" in events[0] and len(events) == 7
    # A validation's event has all scalars, that of another step no exact value's error.
    assert all(name.encode() in events[6] for name in SCALARS)
    assert b"exact_error" not in events[5]
    assert struct.pack("<f", told.history[-1].objective) in events[6]

    # One that returns True stops, and the others are told all the same.
    counts = []
    half = run([lambda p: p.record.step >= 4, counts.append, snapo.log.CSV(tmp_path / "b.csv")])
    assert half.status == "stopped early" and half.step == 4 and len(counts) == 2
    # The run goes on, to the same numbers; its file then holds every step.
    whole = run([snapo.log.CSV(tmp_path / "b.csv")], replace(half, status="training"))
    assert np.array_equal(parameters(whole.best), parameters(quiet.best))
    assert len((tmp_path / "b.csv").read_text().splitlines()) == 7


def framed(data: bytes):
    """The events of a file, their checksums looked at."""
    while data:
        (size,) = struct.unpack("<Q", data[:8])
        event, rest = data[12 : 12 + size], data[12 + size :]
        for part, mask in ((data[:8], data[8:12]), (event, rest[:4])):
            crc = crc32c(part)
            turned = (crc >> 15 | crc << 17) & 0xFFFFFFFF
            assert struct.unpack("<I", mask)[0] == (turned + 0xA282EAD8) & 0xFFFFFFFF
        yield event
        data = rest[4:]


def test_checksum():
    """The check value of CRC-32C (RFC 3720, appendix B.4, for 32 zeros)."""
    assert crc32c(b"123456789") == 0xE3069283
    assert crc32c(bytes(32)) == 0x8A9136AA
