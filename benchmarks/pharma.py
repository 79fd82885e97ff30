"""The cost of derivatives of a process chain, compared with CasADi and with finite differences.

    python -m benchmarks.pharma

The chain is that of `snapo new pharma`; CasADi uses CVODES. Every ratio is the median over rounds
in which both programs take turns. Everything runs in float64 on the processor; compiling is not
counted.
"""

import importlib.util
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

import snapo.domains.pharma as domain
from snapo.domains.pharma.chapters.attribution import with_nodes
from snapo.domains.pharma.derivatives.jacobian import gradient, matrix
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.quality.draws import all_draws, all_entries
from snapo.domains.pharma.read.case import read_case

from .gas_storage import timed
from .machine import machine

CASE = Path(domain.__path__[0]) / "template" / "case.toml"
ROUNDS, SINGLE, SOME = 15, 8, 512
ROWS, COLUMNS = [0, 1, 2, 3, 4], [0, 3, 4, 5]  # all but filtration time; T_R, T_f, W, T_d
STEPS, TOLERANCE = 200, 1e-7  # ours and the peer's for derivatives to 1e-5 of a row's largest
NODES, PROFILE, STEP = 200, "crystalliser.temperature", 1e-4  # K of central differences
SAMPLES, CHUNK = 10_000, 128


def alternate(calls: dict[str, Callable], rounds: int = ROUNDS) -> dict[str, list[float]]:
    """Seconds of every call, in turns; the first run of each call is not counted."""
    for call in calls.values():
        call()
    found: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            found[name].append(timed(call))
    return found


def ratio(times: dict[str, list[float]], slow: str, fast: str) -> float:
    """The median ratio of the times of `slow` to those of the other call."""
    return median(s / f for s, f in zip(times[slow], times[fast]))


def against_casadi() -> Iterator[str]:
    """Derivatives of 5 attributes with respect to 4 parameters, in both modes, by both programs."""
    yield "5 attributes by 4 parameters; errors relative to the largest of a row (required: 1e-5)"
    if importlib.util.find_spec("casadi") is None:
        yield "  skipped: CasADi is not installed (pip install 'snapo[peer]')"
        return
    from . import pharma_casadi as peer

    case = read_case(CASE)
    process = PharmaProcess(replace(case, numerics=replace(case.numerics, steps=STEPS)))
    entries = tuple(process.entries[k] for k in COLUMNS)
    names = tuple(process.names[k] for k in ROWS)
    settings = peer.Settings(TOLERANCE, jit=shutil.which("cc") is not None)
    point = peer.POINT

    def ours(mode):
        return lambda: matrix(process, entries=entries, attributes=names, mode=mode)

    def theirs(call):
        return lambda: call(point)

    calls = {
        "snapo adjoint, 5 passes": ours("adjoint"),
        "CasADi adjoint, 5 passes": theirs(peer.adjoint(settings, ROWS, COLUMNS, False)),
        "CasADi adjoint, at once": theirs(peer.adjoint(settings, ROWS, COLUMNS, True)),
        "snapo chosen mode": ours("auto"),
        "CasADi forward": theirs(peer.forward(settings, ROWS, COLUMNS)),
        "snapo run": process.values,
        "CasADi run": theirs(peer.chain(settings)),
    }
    values, truth = peer.differences()
    values, truth = values[ROWS], truth[np.ix_(ROWS, COLUMNS)]
    largest = np.abs(truth).max(1, keepdims=True)
    times = alternate(calls)
    for name, call in calls.items():
        line = f"  {name:<28}{1e3 * median(times[name]):8.2f} ms"
        if not name.endswith("run"):
            found = call()
            v, j = found if isinstance(found, tuple) and len(found) == 2 else found[:2]
            value_error = np.max(np.abs(v / values - 1))
            error = np.max(np.abs(j - truth) / largest)
            line += f"   values {value_error:.0e}, derivatives {error:.0e}"
        yield line
    back, forward = "snapo adjoint, 5 passes", "snapo chosen mode"
    yield (
        f"  CasADi over snapo: {ratio(times, 'CasADi adjoint, 5 passes', back):.1f} by adjoint "
        f"passes ({ratio(times, 'CasADi adjoint, at once', back):.1f} with its passes at once), "
        f"{ratio(times, 'CasADi forward', forward):.1f} by the chosen mode; needed: above 1"
    )


def against_differences() -> Iterator[str]:
    """One attribute with respect to 200 temperatures: the adjoint, and central differences."""
    process = PharmaProcess(with_nodes(read_case(CASE), PROFILE, NODES))
    entries = tuple((PROFILE, k) for k in range(NODES))
    name, here = process.names[1], process.at(entries)
    moves = np.concatenate([np.eye(NODES), -np.eye(NODES)]) * STEP

    def batched(engine):
        found = process.batch(entries, here + moves, chunk=CHUNK, engine=engine).values[:, 1]
        return (found[:NODES] - found[NODES:]) / (2 * STEP)

    def looped():
        found = [process.values({PROFILE: here + move})[1] for move in moves]
        return (np.array(found[:NODES]) - found[NODES:]) / (2 * STEP)

    calls = {
        "adjoint": lambda: gradient(process, name),
        "differences, one by one": looped,
        "differences, side by side": lambda: batched("xla"),
        "the same, native engine": lambda: batched("native"),
    }
    exact = gradient(process, name)[PROFILE]
    gap = np.max(np.abs(exact - batched("native"))) / np.max(np.abs(exact))
    times = alternate(calls, 5)
    yield f"a gradient by {NODES} temperatures (needed: 10 times faster than central differences)"
    for kind, seconds in times.items():
        yield f"  {kind:<28}{1e3 * median(seconds):8.2f} ms"
    *same, native = (ratio(times, each, "adjoint") for each in list(calls)[1:])
    yield (
        f"  faster {min(same):.0f} times on the same integrator, {native:.1f} times where the "
        f"differences have the native engine; they agree to {gap:.0e} of the largest"
    )


def many_samples() -> Iterator[str]:
    """Uncertain batches, each with the derivatives of all attributes."""
    case = read_case(CASE)
    process = PharmaProcess(case)
    entries = all_entries(case)
    draws = all_draws(case, SAMPLES, 1, process.inputs)
    by = process.entries
    calls = {
        "batch": lambda: process.batch(entries, draws, by, chunk=CHUNK),
        "batch by XLA": lambda: process.batch(entries, draws[:SOME], by, CHUNK, engine="xla"),
        "same call, one by one": lambda: process.batch(entries, draws[:SINGLE], by, chunk=1),
        "matrix, one by one": lambda: [matrix(process) for _ in range(SINGLE)],
    }
    counts = dict(zip(calls, (SAMPLES, SOME, SINGLE, SINGLE)))
    times = alternate(calls, 5)
    each = {name: median(times[name]) / counts[name] for name in calls}
    yield (
        f"uncertain samples, each with derivatives of {len(process.names)} attributes with respect "
        f"to {len(by)} parameters"
    )
    for name, seconds in each.items():
        yield f"  {name:<28}{1e3 * seconds:8.3f} ms per sample, {1e4 * seconds:6.1f} s for 10,000"
    for name in ("same call, one by one", "matrix, one by one"):
        share = ratio(times, name, "batch") * SAMPLES / SINGLE
        yield f"  batch over {name}: {share:.1f} times the throughput (needed 20)"


def table() -> Iterator[str]:
    """The lines of the table, each as soon as it is known."""
    for part in (against_casadi, against_differences, many_samples):
        yield from part()


if __name__ == "__main__":
    print(machine())
    for line in table():
        print(line, flush=True)
