"""Machine code made in this process, or, after many times, in one of its own.

LLVM's passes keep memory: 0.2 megabytes for a small kernel (`mallinfo2` around each of them;
modules, contexts, pass managers and targets give all of theirs back). It is bounded, not small.
"""

import itertools
import os
import subprocess
import sys
from pathlib import Path

from . import pipeline

HERE = 64  # compilations in this process; those after them take 0.3 s longer each

_numbers = itertools.count()
_CHILD = """
import sys
from snapo.lanes.machine.pipeline import object_code
sys.stdout.buffer.write(object_code(sys.stdin.buffer.read().decode()))
"""


def object_code(text: str) -> bytes:
    """Machine code for a module's text, ready to be linked."""
    apart = _apart(text) if next(_numbers) >= HERE else None
    return pipeline.object_code(text) if apart is None else apart


def _apart(text: str) -> bytes | None:
    """Made by a new process, whose memory goes with it; None where there can be none."""
    if not sys.executable:
        return None
    root = str(Path(__file__).parents[3])
    positions = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(positions)}
    command = [sys.executable, "-c", _CHILD]
    try:
        done = subprocess.run(command, input=text.encode(), capture_output=True, env=environment)
    except OSError:
        return None
    return done.stdout if done.returncode == 0 and done.stdout else None
