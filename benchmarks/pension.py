"""All sensitivities of a fund by one adjoint pass, compared with bumping one input after another.

    python -m benchmarks.pension [small medium large] [--picture FILE.svg]
    python -m benchmarks.pension engines
    python -m benchmarks.pension memory

Both methods use the same engine and the same paths, and are compiled. A bump is one-sided and takes
`prepare` and a forward sweep, so that n inputs take n + 1 of them. If there are more than `SAMPLE`
inputs, the mean of `SAMPLE` random bumps is used for all. The native engine has no batches of
schedules: bumps run one by one. `engines` compares the native engine with XLA on the medium case.
`memory` is the peak memory of a separate process for a value and all derivatives of the large case.
"""

import argparse
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import NamedTuple

import jax
import numpy as np

from snapo.domains.pension import DOMAIN
from snapo.domains.pension.read.case import read_case
from snapo.domains.pension.results.setup import make_setup
from snapo.engine import Engine, Xla
from snapo.engine.native import Native
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import float64, pull_back
from snapo.study.study import Setup

from .gas_storage import alternate, timed
from .machine import machine

SIZES = ("small", "medium", "large")
PATHS, RUNS, SAMPLE, BUMP = 1024, 3, 100, 1e-6
MANY = 4096  # paths of the memory test
OUTPUT = "funding_ratio"
NEEDED = {32: 8, 290: 80, 1900: 500}  # speed-ups by number of inputs
GIGABYTE = 1e9


class Row(NamedTuple):
    """One fund: its numbers of inputs and steps; seconds of a value, of all derivatives by one
    adjoint pass, and of a bump."""

    size: str
    inputs: int
    steps: int
    value: float
    adjoint: float
    bump: float

    @property
    def speed_up(self) -> float:
        return (self.inputs + 1) * self.bump / self.adjoint


def setup_of(size: str) -> Setup:
    """The example of this size, with an untrained policy."""
    return make_setup(read_case(Path(str(DOMAIN.templates[size]))), "native")


def passes(setup: Setup, engine: Engine, paths: int = PATHS) -> tuple[Callable, Callable]:
    """Two calls, the value at some inputs and all its derivatives; each prepares its schedule
    again."""
    problem, policy = setup.problem, setup.policy
    simulator = problem.simulator
    draws = Pseudo(1).draws(np.arange(paths), simulator)
    weights = {OUTPUT: np.full(paths, 1 / paths)}

    def value(inputs) -> float:
        bound = engine.bind(replace(problem, inputs=inputs))
        totals = float64(bound.values(policy, draws, Exact()).totals)
        return float(totals[OUTPUT].mean())

    def gradient() -> dict[str, np.ndarray]:
        bound = engine.bind(replace(problem))
        found = bound.adjoint(policy, draws, Exact(), weights, wrt=("schedule",))
        return pull_back(simulator, problem.inputs, [found.schedule])

    return value, gradient


def bumped(problem: Problem, count: int) -> list[dict]:
    """Inputs with one entry moved, `count` of them drawn at random."""
    entries = [(n, k) for n, entry in problem.inputs.items() for k in range(entry.value.size)]
    chosen = np.random.default_rng(0).permutation(len(entries))[:count]
    moved = []
    for name, k in (entries[i] for i in chosen):
        array = np.array(problem.inputs[name].value)
        array.flat[k] += BUMP * max(1.0, abs(array.flat[k]))
        moved.append(problem.inputs | {name: replace(problem.inputs[name], value=array)})
    return moved


def measure(size: str, engine: Engine) -> Row:
    """Medians; adjoints, values and bumps take turns, so that a busy machine slows them alike."""
    setup = setup_of(size)
    problem = setup.problem
    count = sum(entry.value.size for entry in problem.inputs.values())
    value, gradient = passes(setup, engine)
    value(problem.inputs)
    gradient()
    moved = bumped(problem, min(count, SAMPLE))
    values, gradients, bumps = [], [], []
    for some in np.array_split(np.arange(len(moved)), RUNS):
        gradients.append(timed(gradient))
        values.append(timed(lambda: value(problem.inputs)))
        bumps += [timed(lambda inputs=moved[i]: value(inputs)) for i in some]
    steps = problem.simulator.horizon
    return Row(size, count, steps, median(values), median(gradients), median(bumps))


def table(sizes: Sequence[str] = SIZES, rows: list[Row] | None = None) -> Iterator[str]:
    """The lines of the table, each as soon as it is known; `rows` collects the figures."""
    yield f"{PATHS} paths in float64, native engine; required speed-ups: 8, 80 and 500"
    yield (
        f"{'fund':<8}{'inputs':>7}{'steps':>7}{'value':>11}{'adjoint':>11}{'ratio':>8}"
        f"{'all bumps':>12}{'speed-up':>9}"
    )
    for size in sizes:
        row = measure(size, Native("float64"))
        if rows is not None:
            rows.append(row)
        yield (
            f"{row.size:<8}{row.inputs:>7}{row.steps:>7}{row.value:>10.3f}s{row.adjoint:>10.3f}s"
            f"{row.adjoint / row.value:>8.2f}{(row.inputs + 1) * row.bump:>11.1f}s"
            f"{row.speed_up:>9.0f}"
        )


def sweeps(setup: Setup, engine: Engine) -> tuple[Callable, Callable]:
    """The time that an engine takes for a value and for its derivatives, without `prepare`."""
    bound = engine.bind(setup.problem)
    draws = Pseudo(1).draws(np.arange(PATHS), setup.problem.simulator)
    weights = {OUTPUT: np.full(PATHS, 1 / PATHS)}
    given = setup.policy, draws, Exact()
    return (
        lambda: np.asarray(bound.values(*given).totals[OUTPUT]),
        lambda: jax.block_until_ready(bound.adjoint(*given, weights).schedule),
    )


def engines() -> Iterator[str]:
    """Native compared with XLA on the medium case; required: at least 5 times the speed."""
    setup = setup_of("medium")
    yield f"medium fund, {PATHS} paths, medians of alternating runs; ratio: XLA / native"
    yield f"{'precision':<11}{'':<10}{'native':>10}{'XLA':>10}{'ratio':>8}"
    for precision in ("float32", "float64"):
        ours, theirs = (sweeps(setup, each(precision)) for each in (Native, Xla))
        found = {name: alternate(*pair) for name, *pair in zip(("value", "gradient"), ours, theirs)}
        for name, (native, xla, ratio) in found.items():
            yield f"{precision:<11}{name:<10}{native:>9.3f}s{xla:>9.3f}s{ratio:>8.2f}"


def memory() -> Iterator[str]:
    """Peak resident memory, for each precision in a separate process."""
    yield f"large fund, {MANY} paths, native engine: value and all derivatives; required: < 4 GB"
    for precision in ("float64", "float32"):
        command = [sys.executable, "-m", "benchmarks.pension", "peak", precision]
        yield subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def peak(precision: str) -> str:
    """The peak memory of this process after its start, after a value, and after all derivatives."""
    found = []
    setup = setup_of("large")
    found.append(_resident())
    value, gradient = passes(setup, Native(precision), MANY)
    value(setup.problem.inputs)
    found.append(_resident())
    gradient()
    found.append(_resident())
    ready, valued, all_of_it = found
    after = f"{valued:.2f} after a value, {all_of_it:.2f} after all derivatives"
    return f"{precision}: {ready:.2f} GB at the start, {after}"


def _resident() -> float:
    """The peak memory of this process so far, in gigabytes."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most * (1 if sys.platform == "darwin" else 1024) / GIGABYTE


def picture(speed_ups: Mapping[int, float], about: str) -> str:
    """The speed-up against the number of inputs as SVG, with the required one and the machine."""
    from snapo.report.drawing import LIGHT, draw_alone

    inputs, found = list(speed_ups), list(speed_ups.values())

    def paint(axes) -> None:
        axes.loglog(inputs, found, "o-", color=LIGHT["main"], label="One adjoint pass, measured")
        for x, y in zip(inputs, found):
            axes.annotate(f"{y:,.0f}", (x, y), (0, 8), textcoords="offset points", ha="center")
        axes.loglog(*zip(*NEEDED.items()), "_", color=LIGHT["limit"], markersize=16, label="Needed")
        axes.set_xticks(inputs, [f"{x:,}" for x in inputs], minor=False)
        axes.minorticks_off()
        axes.yaxis.set_major_formatter("{x:,.0f}")
        axes.margins(0.12)
        axes.set_xlabel("Inputs of the fund, each with a sensitivity")
        axes.set_title("Times faster than bumping every input", loc="left", pad=18)
        place = {"transform": axes.transAxes, "color": LIGHT["muted"], "fontsize": 7.5}
        axes.text(0, 1.02, f"{PATHS} paths, float64, native engine; {about}", **place)
        axes.legend(loc="upper left")

    title = "Speed-up of one adjoint pass over bumping every input: " + ", ".join(
        f"{y:,.0f} times with {x:,} inputs" for x, y in zip(inputs, found)
    )
    return draw_alone(title, paint, (560, 330), (1.0,))


def main(arguments: Sequence[str]) -> None:
    if arguments[:1] == ["peak"]:
        print(peak(arguments[1]))
        return
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pension")
    known = (*SIZES, "engines", "memory")
    parser.add_argument("what", nargs="*", help=f"some of {', '.join(known)}; by default all sizes")
    parser.add_argument("--picture", type=Path, help="writes the speed-ups as SVG")
    asked = parser.parse_args(arguments)
    if unknown := set(asked.what) - set(known):
        parser.error(f"there is no {', '.join(sorted(unknown))}; available are {', '.join(known)}")
    sizes, rows = [each for each in asked.what if each in SIZES], []
    parts = [table(sizes or SIZES, rows)] if sizes or not asked.what else []
    parts += [part() for part in (engines, memory) if part.__name__ in asked.what]
    for part in parts:
        for line in part:
            print(line, flush=True)
    if asked.picture is not None and rows:
        speed_ups = {row.inputs: row.speed_up for row in rows}
        asked.picture.write_text(picture(speed_ups, machine()), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
