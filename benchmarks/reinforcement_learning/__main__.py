"""`python -m benchmarks.reinforcement_learning PROBLEM …`: see the package."""

import argparse
import itertools
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from .clock import Budget, Point, read, write
from .table import lines, summary
from .told import TOLD

AGENTS = ("ppo", "sac", "td3")
METHODS = ("snapo", "regression", *AGENTS)
QUICK = {"snapo": 5, "ppo": 20_000, "sac": 4_000, "td3": 12_000}


def run(problem: str, method: str, seed: int, asked: argparse.Namespace) -> None:
    """One training in this process, whose clock does not count imports. Its points go to the
    file."""

    def tell(point: Point) -> None:
        print(point.told(TOLD[problem].shown), flush=True)
        write(asked.out, [point])

    steps = QUICK.get(method) if asked.quick else asked.steps
    if method == "snapo":
        from .ours import solve

        # Code that is compiled already would make snapo look faster than it is the first time.
        with tempfile.TemporaryDirectory(prefix="snapo-cold-") as cold:
            os.environ["XDG_CACHE_HOME"] = cold
            return solve(problem, seed, steps, tell)
    if method == "regression":
        from .regression import FITTED, regress

        return regress(problem, seed, tell) if problem in FITTED else None
    try:
        from .learners import learn
    except ImportError as error:
        message = "needs Stable-Baselines3: pip install 'snapo[baselines]'"
        raise SystemExit(f"{method} {message}") from error
    learn(problem, method, seed, steps, Budget(asked.seconds, asked.wall), tell)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the requested trainings (None: arguments of the command line), and prints the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reinforcement_learning")
    parser.add_argument("problems", nargs="*", metavar="PROBLEM", help=f"some of {', '.join(TOLD)}")
    parser.add_argument("--algorithm", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--steps", type=int, help="simulated steps (agents) or updates (snapo)")
    parser.add_argument("--seconds", type=float, default=300.0, help="processor time per training")
    parser.add_argument("--wall", type=float, default=3600.0, help="wall time per training")
    parser.add_argument("--out", type=Path, help="CSV to which rows are appended")
    parser.add_argument("--figure", type=Path, help="SVG of all curves in the file")
    parser.add_argument("--quick", action="store_true", help="short runs, as a test")
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args(arguments)
    if unknown := set(asked.problems) - set(TOLD):
        parser.error(f"there is no {', '.join(sorted(unknown))}; available are {', '.join(TOLD)}")
    if asked.alone:
        run(asked.problems[0], asked.algorithm[0], asked.seeds[0], asked)
        return
    from ..machine import machine

    print(machine(), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        out = asked.out or Path(folder) / "points.csv"
        for problem, seed, method in itertools.product(
            asked.problems, asked.seeds, asked.algorithm
        ):
            told = TOLD[problem]
            print(f"{told.words} (best possible: {told.exact}), {method}, seed {seed}", flush=True)
            _apart(problem, method, seed, asked, out)
        points = read(out) if out.exists() else []
        shown = {name: told.shown for name, told in TOLD.items()}
        for line in itertools.chain(lines(points, shown), [""], summary(points, shown)):
            print(line)
        if asked.figure:
            from .figures import draw

            draw(points, TOLD, asked.figure)


def _apart(problem: str, method: str, seed: int, asked: argparse.Namespace, out: Path) -> None:
    """One training in a separate process, so that no training uses what another has compiled."""
    command = [sys.executable, "-m", __package__, problem, "--algorithm", method, "--alone"]
    command += ["--seeds", str(seed), "--out", str(out), "--seconds", str(asked.seconds)]
    command += ["--wall", str(asked.wall)]
    command += ["--steps", str(asked.steps)] if asked.steps else []
    subprocess.run([*command, "--quick"] if asked.quick else command, check=True)


if __name__ == "__main__":
    main()
