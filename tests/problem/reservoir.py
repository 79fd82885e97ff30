"""The README's reservoir, for tests that need a simulator which another process can import."""

import runpy
from pathlib import Path

_example = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "own_simulator.py"))
Reservoir, inputs = _example["Reservoir"], _example["inputs"]
