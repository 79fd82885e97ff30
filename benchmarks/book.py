"""The cost of a book: compiled shapes, overhead, size, and a model of its wall time.

    python -m benchmarks.book shapes       contracts of equal and of other shapes, and a stress
    python -m benchmarks.book overhead     the cost of the driver, and how long workers wait
    python -m benchmarks.book large        100 contracts under 20 stresses
    python -m benchmarks.book model        wall time with 1, 2 and 4 workers, and that of a model
    python -m benchmarks.book training     steps of 16,384 paths in one process and in two

All books use the gas storage template. Times depend on what else the machine does.
"""

import json
import multiprocessing
import os
import resource
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.book.executors import start_worker, worker_pools
from snapo.book.file import read_book
from snapo.book.job import BookJob, Cost, JobResult, opened
from snapo.book.run import plan_of, run_book
from snapo.book.work import compute
from snapo.engine import Engine, Workers
from snapo.engine.workers import results
from snapo.solver.train import Progress, initial_progress, train
from snapo.study.domain import CaseRequest, Options, find, load

from .machine import machine

CURVE = '[[stress]]\nname = "curve {change:+d} %"\nscale = {{ "market.forward_curve" = {scale} }}\n'
WINTER = """[[stress]]
name = "winter"
shift = { "market.forward_curve" = 2.0 }
when = "2021-12/2022-02"
"""
CHANGES = [x for x in range(-10, 10) if x]
STRESSES = "".join(CURVE.format(change=x, scale=1 + x / 100) for x in CHANGES) + WINTER


def write_book(
    folder: Path, rows: Sequence[dict[str, Any]], stresses: str, tasks: str = "", run: str = ""
) -> Path:
    """A book of contracts from the gas storage template, each with the keys of one row."""
    template = find("gas-storage", "").templates
    store = folder / "store"
    store.mkdir(parents=True, exist_ok=True)
    for file in next(iter(template.values())).iterdir():
        if file.is_file():
            (store / file.name).write_bytes(file.read_bytes())
    columns = list(dict.fromkeys(name for row in rows for name in row))
    lines = [",".join(columns), *(",".join(str(row.get(x, "")) for x in columns) for row in rows)]
    (folder / "contracts.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = '[cases]\ntemplate = "store"\ntable = "contracts.csv"\n'
    (folder / "book.toml").write_text(
        f'kind = "book"\n{text}{stresses}[tasks]\n{tasks}[run]\n{run}', encoding="utf-8"
    )
    return folder / "book.toml"


def rows(count: int) -> list[dict[str, Any]]:
    """Stores that differ in costs, inventory and volatility, but have one compiled shape."""
    return [
        {
            "name": f"store {i}",
            "contract.injection_cost": round(0.01 + 0.001 * (i % 37), 4),
            "contract.inventory": 500 + 13 * (i % 101),
            "model.spot_volatility": round(0.5 + 0.01 * (i % 23), 3),
        }
        for i in range(count)
    ]


class Timed(NamedTuple):
    """A job, its processor seconds, and its seconds of compiling."""

    name: str
    cpu_seconds: float
    compile_seconds: float


def shapes() -> list[str]:
    """Contracts in one process: the first, a further one, and one with the policy of the first; two
    that start later, on different dates; one with another number of days; two with bumps; and the
    first one under a stress."""
    import jax

    heard: list[float] = []

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        if event in ("/jax/core/compile/backend_compile_duration", "/snapo/compile"):
            heard.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    contracts = [
        *rows(2),
        rows(5)[4] | {"name": "shared"},
        # The days before a start carry noise: of starts after the valuation date, 2 to 32 days are
        # one shape.
        {"name": "later", "contract.start": "2021-05-01", "contract.end": "2022-04-21"},
        {"name": "other dates", "contract.start": "2021-05-11", "contract.end": "2022-05-01"},
        {"name": "other days", "contract.start": "2021-04-01", "contract.end": "2022-03-02"},
        *[row | {"name": f"judged {row['name']}"} for row in rows(4)[2:]],
    ]
    start_worker(min(os.sched_getaffinity(0)))
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        file = write_book(Path(folder), contracts, STRESSES, "judge = 0\n")
        book = read_book(file)
        table, policy = [], None
        for contract, name in zip(
            book.contracts,
            (
                "first", "further", "with its policy", "first later start", "other dates",
                "other number of days", "first judged", "judged",
            ),
        ):  # fmt: skip
            judged = name.endswith("judged")
            adopted = policy if name == "with its policy" else None
            job = BookJob.of(contract, book.tasks, book.run.seed, judged=judged, adopted=adopted)
            heard.clear()
            data, cost = opened(compute(job.pack()))
            table.append(Timed(name, cost.cpu_seconds, sum(heard)))
            stored = JobResult.unpack(data)
            assert stored.points[0].status == "ok", stored.points[0].note
            policy = stored.policy if policy is None else policy
        first = BookJob.of(book.contracts[0], book.tasks, book.run.seed, base=False, policy=policy)
        times = []
        for count in (1, 11):
            moves = tuple(stress.moves for stress in book.stresses[:count])
            _, cost = opened(compute(replace(first, stresses=moves).pack()))
            times.append(cost.cpu_seconds)
        table.append(Timed("a stress", (times[1] - times[0]) / 10, 0.0))
    cpu = {x.name: x.cpu_seconds for x in table}
    limits = {"further": 0.2, "other dates": 0.25, "other number of days": 0.67}
    needed = {
        name: f"{cpu[name] / cpu['first']:.2f} of the first (required: {limit:.2f})"
        for name, limit in limits.items()
    }
    needed["with its policy"] = f"{cpu['with its policy'] / cpu['first']:.2f} of the first"
    share = cpu["a stress"] / cpu["further"]
    needed["a stress"] = f"{share:.2f} of a further contract (required: 0.50)"
    return [
        "gas storage template, in one process; processor seconds of a job, and those of compiling",
        *(
            f"{x.name:<22}{x.cpu_seconds:>8.2f} s, compiling {x.compile_seconds:>6.2f} s   "
            f"{needed.get(x.name, '')}"
            for x in table
        ),
    ]


def idle(job: bytes, seconds: float = 0.25) -> bytes:
    """Works for this number of seconds, and returns as many bytes as a result has."""
    ended, started = time.perf_counter() + seconds, time.perf_counter()
    while time.perf_counter() < ended:
        pass
    return json.dumps([started, time.perf_counter(), os.getpid()]).encode() + b" " * 100_000


def overhead(count: int = 200) -> list[str]:
    """How long a worker waits: small jobs on one worker, which leaves a core to the driver."""
    with tempfile.TemporaryDirectory() as folder:
        book = read_book(write_book(Path(folder), rows(count), STRESSES))
        plan = plan_of(book)
        waiting = iter([plan._base(x, False).pack() for x in book.contracts])  # pyright: ignore[reportPrivateUsage]
        began, cpu, spans = time.perf_counter(), time.process_time(), []
        for _, result in results(lambda: next(waiting, None), idle, worker_pools("", 1)):
            assert isinstance(result, bytes)
            spans.append(json.loads(result))
        seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    spans.sort()
    busy = sum(last - first for first, last, _ in spans)
    span = spans[-1][1] - spans[0][0]
    return [
        f"{count} jobs of 0.25 s on one worker: {seconds:.1f} s",
        f"the worker waits {1 - busy / span:.1%} of its time (required: at most 10 %)",
        f"processor time of the driver: {cpu / seconds:.1%} of the wall time "
        "(required: at most 5 %)",
    ]


def large(contracts: int = 100) -> list[str]:
    """Contracts under 20 stresses on the cores of this machine."""
    with tempfile.TemporaryDirectory() as folder:
        file = write_book(Path(folder), rows(contracts), STRESSES)
        progress = partial(print, file=sys.stderr, flush=True)
        result = run_book(read_book(file), progress, worker_pools(""), out=Path(folder) / "run")
        peaks = _peaks(Path(folder) / "run")
    driver = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    points = contracts * len(result["sums"])
    growth = [max(of[20:]) / of[19] - 1 for of in peaks.values() if len(of) > 20]
    return [
        f"{contracts} contracts, {len(result['sums'])} points each: {result['status']}",
        f"{result['seconds']['total'] / 60:.1f} min of wall time "
        "(required: at most 25 with 100 contracts)",
        f"{result['cpu_seconds'] / points:.2f} processor seconds per point",
        f"peak memory: workers {result['peak_mb']:.0f} MB (required: at most 900), "
        f"driver {driver:.0f} MB (required: at most 400)",
        f"growth of a worker after its 20th job: {max(growth, default=0.0):.1%} "
        "(required: at most 5 %)",
    ]


def _peaks(folder: Path) -> dict[str, list[float]]:
    """{worker: its peak memory in MB after each of its jobs}."""
    table: dict[str, list[float]] = {}
    for file in sorted(folder.glob("answers/*/*"), key=lambda x: x.stat().st_mtime):
        cost: Cost = opened(file.read_bytes())[1]
        table.setdefault(cost.worker, []).append(cost.peak_mb)
    return table


def expected(durations: Sequence[float], first: float, workers: int, begin: float) -> float:
    """Wall time by event simulation: every worker starts, compiles during its first job, and takes
    the next job when it is free. Workers share the cores of a machine."""
    free = [begin] * workers
    fresh = [True] * workers
    for duration in durations:
        i = free.index(min(free))
        free[i] += duration + first * fresh[i]
        fresh[i] = False
    return max(free)


def model(contracts: int = 16) -> list[str]:
    """Wall time with 1, 2 and 4 workers on the cores of this machine, and that of the model, which
    uses only the times of one worker's jobs."""
    cores = len(os.sched_getaffinity(0))
    lines, jobs = [], []
    start = first = 0.0
    for workers in (1, 2, 4):
        with tempfile.TemporaryDirectory() as folder:
            file = write_book(Path(folder), rows(contracts), "", "judge = 0\n")
            pools = worker_pools("", workers)
            result = run_book(read_book(file), lambda _: None, pools, out=Path(folder) / "run")
            costs = [opened(x.read_bytes())[1] for x in Path(folder).glob("run/answers/*/*")]
        seconds = result["seconds"]["orders"]
        if workers == 1:
            jobs = [statistics.median(x.cpu_seconds for x in costs)] * contracts
            first = max(x.cpu_seconds for x in costs) - jobs[0]
            start = seconds - first - sum(jobs)
        # More workers than cores share them.
        share = max(1.0, workers / cores)
        wall = expected([x * share for x in jobs], first * share, workers, start * share)
        fitted = "the model is fitted to this run" if workers == 1 else f"model {wall:.1f} s"
        off = "" if workers == 1 else f" ({seconds / wall - 1:+.0%})"
        lines.append(f"{workers} workers: {seconds:.1f} s, {fitted}{off}")
    about = f"start {start:.1f} s, compiling a shape {first:.1f} s, a contract {jobs[0]:.1f} s"
    needed = "required: within 20 % of the model"
    return [f"{contracts} contracts on {cores} cores: {about} ({needed})", *lines]


def training(paths: int = 16384, rounds: int = 5) -> list[str]:
    """Training steps of one process on one core and of two such processes, in turns; then one of
    the two is killed in the middle of a step."""
    settings = (f"training.paths={paths}", "training.validation_paths=512")
    with tempfile.TemporaryDirectory() as folder, Workers(worker_pools("", 2)) as workers:
        write_book(Path(folder), rows(1), "")
        loaded = load(CaseRequest(Path(folder) / "store", settings, None))
        study = loaded.domain.study(loaded.case, Options())
        assert study.setup is not None
        setup = study.setup()
        one = replace(setup.engines.train, threads=1)
        two = setup.engines.over(workers).train
        progress = initial_progress(setup.policy, setup.training, setup.problem)

        def after(engine: Engine, steps: int = 2) -> tuple[Steps, Progress]:
            began, cpu, before = time.perf_counter(), time.process_time(), _cpu_of_workers()
            last = progress.step + steps
            moved = train(setup.problem, progress, setup.training, engine, until=last)
            wall, cpu = time.perf_counter() - began, time.process_time() - cpu
            spent = [x - before.get(pid, 0.0) for pid, x in _cpu_of_workers().items()]
            return Steps(wall / steps, (cpu + max(spent, default=0.0)) / steps), moved

        same = [_equal(after(one)[1], after(two)[1])]  # kernels are compiled, and timed
        alone, shared = [], []
        for i in range(rounds):
            done = {id(engine): after(engine) for engine in ((one, two) if i % 2 else (two, one))}
            same.append(_equal(done[id(one)][1], done[id(two)][1]))
            alone.append(done[id(one)][0])
            shared.append(done[id(two)][0])
            progress = done[id(one)][1]
        expected = after(one)[1]
        victim = multiprocessing.active_children()[0]
        killer = threading.Timer(shared[-1].wall / 2, victim.kill)
        killer.start()
        steps, moved = after(two)
        killer.join()
        assert not victim.is_alive()
    lines = [f"step of {paths:,} paths, gas storage template, including its share of validation"]
    for name in Steps._fields:
        pairs = [(getattr(x, name), getattr(y, name)) for x, y in zip(alone, shared)]
        first, second, ratio = (
            statistics.median(of(pair) for pair in pairs)
            for of in (lambda x: x[0], lambda x: x[1], lambda x: x[0] / x[1])
        )
        least, most = min(x / y for x, y in pairs), max(x / y for x, y in pairs)
        lines.append(
            f"{name:<5} one process {first:.2f} s, two {second:.2f} s: {ratio:.2f} times as fast, "
            f"from {least:.2f} to {most:.2f} in {rounds} alternating rounds (required: 1.70)"
        )
    return [
        *lines,
        "cpu: processor time of the driver and of the busier worker, the wall time on free cores",
        f"bits of both: {'equal' if all(same) else 'DIFFERENT'}; after a kill within a step: "
        f"{'equal' if _equal(expected, moved) else 'DIFFERENT'}, {steps.wall:.2f} s per step",
    ]


class Steps(NamedTuple):
    """Seconds of a step: wall time, and processor time of the driver plus the busier worker."""

    wall: float
    cpu: float


def _cpu_of_workers() -> dict[int, float]:
    """{process: its processor seconds}, of this process's workers."""
    tick, table = os.sysconf("SC_CLK_TCK"), {}
    for child in multiprocessing.active_children():
        fields = Path(f"/proc/{child.pid}/stat").read_text().rpartition(")")[2].split()
        table[child.pid] = (int(fields[11]) + int(fields[12])) / tick
    return table


def _equal(one: Progress, two: Progress) -> bool:
    """Whether two trainings have the same policy and the same history, to the last bit."""
    import jax

    policies = zip(jax.tree.leaves(one.policy), jax.tree.leaves(two.policy), strict=True)
    records = [x._replace(seconds=0.0) for x in (one.record, two.record)]
    return records[0] == records[1] and all(np.array_equal(x, y) for x, y in policies)


TABLES: dict[str, Callable[[], list[str]]] = {
    "shapes": shapes,
    "overhead": overhead,
    "large": large,
    "model": model,
    "training": training,
}

if __name__ == "__main__":
    names = sys.argv[1:] or list(TABLES)
    if unknown := set(names) - set(TABLES):
        sys.exit(f"{', '.join(unknown)}: it must be {', '.join(TABLES)}")
    print(machine())
    for name in names:
        print()
        for line in TABLES[name]():
            print(line, flush=True)
