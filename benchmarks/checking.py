"""The time of `snapo check`: processor seconds of the whole command, for each kind's template.

    python -m benchmarks.checking [KIND …]

Each command runs in a separate process, in turns with a process that only imports JAX and Equinox.
The table has the minimum of a few rounds for both, their ratio, and the ratio that is required. A
case of kind "own" has no required ratio: its check compiles the user's simulator and examines it.
Both processes run from bytecode, as installed packages do: the first round writes it, whatever the
environment variables are.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from snapo.study.commands import new
from snapo.study.domain import find, installed

ROUNDS = 3
IMPORTS = ("-c", "import equinox")
NEEDED = 0.8


def seconds(arguments: Sequence[str], bytecode: str) -> float:
    """Processor seconds of Python with these arguments; `bytecode`: the folder for it."""
    about = os.environ | {"PYTHONPYCACHEPREFIX": bytecode, "PYTHONDONTWRITEBYTECODE": ""}
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL, env=about)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(arguments)}: exit code {process.returncode}")
    return usage.ru_utime + usage.ru_stime


def table(kinds: Sequence[str] = ()) -> Iterator[str]:
    """The lines of the table, each as soon as it is known."""
    yield f"{'snapo check':<16}{'processor s':>12}{'imports s':>11}{'ratio':>7}{'needed':>8}"
    for kind in kinds or installed():
        example = getattr(find(kind, "here"), "example", None)
        with tempfile.TemporaryDirectory() as folder:
            case, bytecode = Path(folder) / "case", str(Path(folder) / "bytecode")
            new(kind, case)
            command = ["-m", "snapo", "check", str(case)]
            command += [] if example is None else ["--simulator", example]
            rounds = [
                (seconds(command, bytecode), seconds(IMPORTS, bytecode)) for _ in range(ROUNDS)
            ]
        own, imports = map(min, zip(*rounds))
        needed = "-" if example is not None else NEEDED
        yield f"{kind:<16}{own:12.2f}{imports:11.2f}{own / imports:7.2f}{needed:>8}"


if __name__ == "__main__":
    for line in table(sys.argv[1:]):
        print(line, flush=True)
