"""The time of `snapo solve` of the flagship store, in two checkouts at the same time.

    python -m benchmarks.demo ../base [times]

Each run begins with empty caches of compiled code. Both runs are slowed alike by whatever else the
machine does; two runs one after the other may differ by a fifth and more for this reason.
"""

import os
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

HERE = Path(__file__).parents[1]
CHILD = """
import resource, sys, time
from snapo.cli.main import main
started = time.perf_counter()
assert main(sys.argv[1:]) == 0
used = resource.getrusage(resource.RUSAGE_SELF)
print("took", time.perf_counter() - started, used.ru_utime + used.ru_stime)
"""


def started(root: Path, folder: str) -> subprocess.Popen[str]:
    """Makes the case in an empty folder, and starts its solution."""
    environment = os.environ | {"PYTHONPATH": str(root / "src"), "XDG_CACHE_HOME": folder}
    child = [sys.executable, "-c", CHILD]
    quiet = {"cwd": folder, "env": environment, "text": True, "stderr": subprocess.DEVNULL}
    subprocess.run(
        [*child, "new", "gas-storage", "store"], check=True, stdout=subprocess.DEVNULL, **quiet
    )
    return subprocess.Popen([*child, "solve", "store"], stdout=subprocess.PIPE, **quiet)


def ended(run: subprocess.Popen[str]) -> tuple[float, float]:
    """Wall seconds and processor seconds of a run, once it has ended."""
    text, _ = run.communicate()
    line = next(line for line in text.splitlines() if line.startswith("took"))
    wall, used = map(float, line.split()[1:])
    return wall, used


def main() -> None:
    """Prints each pair of times, and the medians of the ratios of this checkout to the other."""
    other, times = Path(sys.argv[1]).resolve(), int(sys.argv[2]) if len(sys.argv) > 2 else 3
    ratios = []
    for _ in range(times):
        with TemporaryDirectory() as here, TemporaryDirectory() as there:
            ours, theirs = map(ended, [started(HERE, here), started(other, there)])
        ratios.append((ours[0] / theirs[0], ours[1] / theirs[1]))
        print(f"here {ours[0]:.1f} s (processor {ours[1]:.1f}), there {theirs[0]:.1f} "
              f"({theirs[1]:.1f}); ratio {ratios[-1][0]:.3f} ({ratios[-1][1]:.3f})")  # fmt: skip
    print("median ratios: {:.3f} (processor {:.3f})".format(*map(median, zip(*ratios))))


if __name__ == "__main__":
    main()
