"""`python -m benchmarks.intervals [PROBLEM …] [--seeds 4] [--runs FOLDER]`: checks of intervals.

Every problem with an exact solution is solved with default settings and several seeds. The program
counts the 95 % intervals that contain the exact derivative of the value when all numbers of an
input move together, or the exact secant over one percent to either side. Secants count because the
value has corners if decisions are whole numbers, and a derivative at a point then says little.
`--runs` is the folder for solutions: a run that was stopped continues from them. `python -m
benchmarks.intervals.sampling` checks only sampling errors.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

import snapo

from ..machine import machine
from .problems import PROBLEMS
from .references import slope

POINT, SECANT = 1e-4, 0.01  # shares of an input: the derivative at a point, and over one percent
ROUND_OFF = 1e-6  # of the value
SMALL = 1e-3  # of the value: a smaller derivative has no relative width


def solved(name: str, seed: int) -> dict[str, Any]:
    """One problem solved once: intervals of derivatives with respect to relative changes."""
    known, began = PROBLEMS[name], time.perf_counter()
    solution = snapo.solve(
        known.simulator,
        known.inputs,
        known.policy,
        objective=known.objective,
        training=snapo.Training(seed=seed),
    )
    found = solution.sensitivities
    assert found is not None
    rows = {}
    for key, number in known.at.items():
        x = np.asarray(number, float)
        interval = found.along(key, x if x.any() else np.ones(x.shape))
        exact = [slope(known.value, dict(known.at), key, share) for share in (POINT, SECANT)]
        rows[key] = {"interval": interval, "source": found.source(key), "exact": exact}
    return {
        "problem": name, "seed": seed, "value": solution.value, "exact": known.value(**known.at),
        "error": solution.standard_error, "selected": solution.selected,
        "convergence": solution.convergence, "seconds": time.perf_counter() - began,
        "parts": dict(solution.seconds), "rows": rows,
    }  # fmt: skip


def scored(run: dict[str, Any]) -> list[tuple[bool, float, float]]:
    """Of each input: whether the interval contains the truth, relative half-width and distance."""
    level, scores = abs(run["exact"]), []
    for row in run["rows"].values():
        value, low, high, *_ = row["interval"]
        least, most = sorted(row["exact"])
        room = ROUND_OFF * level
        holds = bool(low - room <= most and high + room >= least)
        size = abs(row["exact"][0])
        if size > SMALL * level:
            away = max(least - value, value - most, 0.0)
            scores.append((holds, (high - low) / 2 / size, away / size))
        else:
            scores.append((holds, np.nan, np.nan))
    return scores


def table(runs: list[dict[str, Any]]) -> list[str]:
    """One line for each problem, and one for all."""
    lines = [
        f"{'problem':24}{'inputs':>8}{'contain':>8}{'half-width':>12}{'off':>8}{'below exact':>14}"
    ]
    groups = {name: [run for run in runs if run["problem"] == name] for name in PROBLEMS}
    groups["all"] = runs
    for name, members in groups.items():
        scores = [score for run in members for score in scored(run)]
        if not scores:
            continue
        holds, half, away = np.array(scores, float).T
        short = np.mean([(run["exact"] - run["value"]) / abs(run["exact"]) for run in members])
        lines.append(
            f"{name:24}{len(scores):8}{holds.mean():8.1%}{np.nanmedian(half):12.2%}"
            f"{np.nanmedian(away):8.2%}{short:14.3%}"
        )
    half = np.array([score[1] for run in runs for score in scored(run)])
    limit = np.nanquantile(half, 0.9)
    lines.append(f"90 % of the half-widths, relative to the derivative, are below {limit:.1%}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.intervals")
    parser.add_argument("problems", nargs="*", default=list(PROBLEMS), metavar="PROBLEM")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--runs", type=Path, help="a folder for the solved problems")
    asked = parser.parse_args()
    runs = []
    for seed in range(asked.first, asked.first + asked.seeds):
        for name in asked.problems:
            file = asked.runs and asked.runs / f"{name.replace(' ', '-')}-{seed}.json"
            if file and file.exists():
                run = json.loads(file.read_text())
            else:
                run = solved(name, seed)
                if file:
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_text(json.dumps(run, default=float))
            runs.append(run)
            missed = [key for key, score in zip(run["rows"], scored(run)) if not score[0]]
            words = f"missed {', '.join(missed)}" if missed else ""
            print(f"{name}, seed {seed}: {run['seconds']:.0f} s {words}", flush=True)
    print(machine())
    print("\n".join(table(runs)))


if __name__ == "__main__":
    main()
