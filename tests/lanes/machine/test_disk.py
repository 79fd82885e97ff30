"""Code on disk: believed only where it is whole, this user's, and its own; and not kept for ever."""

import os
import sys
import time

import pytest

from snapo.lanes.machine import disk

TEXT = "define i32 @run() {\n  ret i32 7\n}"


@pytest.fixture
def made(monkeypatch):
    """The texts that were compiled."""
    texts = []
    monkeypatch.setattr(disk, "object_code", lambda text: texts.append(text) or b"code" * 100)
    return texts


def only(folder):
    (file,) = folder.iterdir()
    return file


@pytest.mark.parametrize("spoil", range(16))
def test_a_file_that_is_not_whole_is_made_anew(spoil, tmp_path, made):
    """Emptied, cut short, made longer, and a byte changed in each part of it."""
    good = disk.cached(TEXT, tmp_path)
    file = only(tmp_path)
    data = bytearray(file.read_bytes())
    if spoil < 4:
        data = data[: spoil * len(data) // 4]
    elif spoil == 4:
        data += b"more"
    elif spoil == 5:
        data = bytearray(good)  # code alone, as earlier releases kept it
    else:
        data[(spoil - 6) * len(data) // 10] ^= 0x10
    file.write_bytes(data)
    assert disk.cached(TEXT, tmp_path) == good and len(made) == 2
    assert disk.cached(TEXT, tmp_path) == good and len(made) == 2


def test_code_under_another_name_is_not_taken(tmp_path, made):
    disk.cached(TEXT, tmp_path)
    only(tmp_path).rename(tmp_path / f"{disk.key('another')}{disk.ENDING}")
    disk.cached("another", tmp_path)
    assert made == [TEXT, "another"]


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have no owners here")
def test_code_that_others_may_have_written_is_not_taken(tmp_path, made, monkeypatch):
    disk.cached(TEXT, tmp_path)
    for mode in (0o620, 0o602):
        only(tmp_path).chmod(mode)
        disk.cached(TEXT, tmp_path)
    assert len(made) == 3 and only(tmp_path).stat().st_mode & 0o777 == 0o600
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    disk.cached(TEXT, tmp_path)
    assert len(made) == 4


def test_code_is_evicted_by_age_and_size(tmp_path, made, monkeypatch):
    texts = [f"{TEXT} ; {i}" for i in range(5)]
    for age, text in enumerate(texts):
        disk.cached(text, tmp_path)
        file = tmp_path / f"{disk.key(text)}{disk.ENDING}"
        os.utime(file, (time.time() - 100 * age,) * 2)
    monkeypatch.setattr(disk, "MAX_SECONDS", 350)
    disk.evict(tmp_path)
    assert len(list(tmp_path.iterdir())) == 4
    disk.cached(texts[3], tmp_path)  # used again: the youngest now
    monkeypatch.setattr(disk, "MAX_BYTES", 2 * only_size(tmp_path))
    disk.evict(tmp_path)
    left = {each.name for each in tmp_path.iterdir()}
    assert left == {f"{disk.key(text)}{disk.ENDING}" for text in (texts[3], texts[0])}


def only_size(folder) -> int:
    (size,) = {each.stat().st_size for each in folder.iterdir()}
    return size


def test_later_code_is_made_by_another_process(monkeypatch):
    """LLVM's passes keep memory, so that a process compiles a limited number of times itself."""
    monkeypatch.setattr(disk.pipeline, "PIPELINE", disk.pipeline.Pipeline())
    here = disk.object_code(TEXT)
    monkeypatch.setattr(disk, "HERE", 0)
    monkeypatch.setattr(disk.pipeline, "object_code", lambda text: b"in this process")
    assert disk.object_code(TEXT) == here
    monkeypatch.setattr(sys, "executable", "")
    assert disk.object_code(TEXT) == b"in this process"
