"""The process that computes: it reads moves and writes tables as lines of JSON.

It is separate from the server, so that a page can respond while the worker computes, and stays open
when the worker ends. Only the newest move of a page is answered: a newer move stops the work on the
previous move.
"""

import argparse
import io
import json
import os
import pickle
import queue
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from snapo.case.error import CaseError
from snapo.report.record import EMPTY, entries_of
from snapo.solver.solution import Solution
from snapo.study.commands import domain_of_run
from snapo.study.domain import Domain, Options
from snapo.study.positions import InputPositions
from snapo.study.positions.files import read_files
from snapo.study.prepare import case_of_run, options_of_run
from snapo.study.run_folder import plain_json, read
from snapo.study.study import Study

from .headline import HeadlineTables
from .moves import Recalculation, WhatIf
from .rollout import PathCounts, numbers_of_a_path
from .terms import stopped
from .valuation import Valuation


def open_run(
    run: Path,
    simulator: tuple[str, str] | None = None,
    engine: str = "auto",
    counts: PathCounts | None = None,
    domain: Domain | None = None,
) -> WhatIf:
    """The run in a folder. `domain`: the domain of a problem in Python; by default the domain of
    the run's kind.

    **Raises:** `CaseError` if there is no such run, or it has no inputs to move.
    """
    record = read(run)
    domain = domain or domain_of_run(run, record, simulator)
    file, data = case_of_run(run, record)

    def rebuild(case: Any) -> Study:
        return domain.study(case, Options(engine))

    case = domain.read(file, data)
    study = domain.study(case, options_of_run(domain, case, record, engine))
    files = read_files(file.parent, data)
    if study.setup is None and study.recalculated is not None:
        values = study.recalculated()
        positions = InputPositions(domain.read, files, values.inputs_by_name, study.inputs, case)
        return Recalculation(study, values, positions, rebuild)
    if study.setup is None:
        message = "this run trained no policy, so no policy can be valued at other inputs"
        raise CaseError(str(run), "", None, message)
    if study.setup_at is None:
        message = f'inputs of a run of kind "{study.kind}" cannot be moved'
        raise CaseError("snapo open", "", None, message)
    setup = study.setup()
    solution = Solution.load(run, like=setup.policy)
    positions = InputPositions(domain.read, files, setup.problem.inputs_by_name, study.inputs, case)
    if counts is None:
        counts = PathCounts.enough(solution, setup.evaluation, numbers_of_a_path(setup.problem))
    return Valuation(study, solution, positions, counts, rebuild)


REST = 0.4  # seconds without an order, after which the delayed tables are computed


class Post:
    """Sends lines to the server."""

    def __init__(self, out: TextIO):
        self.out, self.lock = out, threading.Lock()

    def __call__(self, **message: Any) -> None:
        with self.lock:
            self.out.write(json.dumps(plain_json(message), allow_nan=False) + "\n")
            self.out.flush()


class WorkerOrder(NamedTuple):
    """A request of the server to `do` something for a page's move number `n`.

    - `values`, `chosen`: the moved inputs and choices by name; `policy`: the number of a policy
      that was trained here, or a file.
    - `folder`: the folder into which a case is written, if requested as a `workbook`.
    """

    do: str = ""
    page: str = ""
    n: int = -1
    values: Mapping[str, Any] = EMPTY
    chosen: Mapping[str, Any] | None = None
    policy: int | str | None = None
    folder: str = ""
    workbook: bool = False

    @property
    def choices(self) -> Mapping[str, Any]:
        """The moved choices; empty if they are missing."""
        return self.chosen or {}


class Desk:
    """Requests in the order in which they arrive; of the moves of a page, only the newest remains.
    A newer move also stops a page's training, and so does "cancel", which has no move.
    """

    def __init__(self, lines: TextIO):
        self.lines = lines
        self.orders: queue.Queue[WorkerOrder | None] = queue.Queue()
        self.newest: dict[str, int] = {}
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.lines:
            order = entries_of(WorkerOrder, json.loads(line))
            if order.do in ("move", "train", "cancel"):
                self.newest[order.page] = order.n
            if order.do == "cancel":
                continue
            self.orders.put(order)
        self.orders.put(None)

    def rests(self, seconds: float) -> bool:
        """Waits this many seconds for an order; returns True if there was none."""
        until = time.monotonic() + seconds
        while self.orders.empty() and time.monotonic() < until:
            time.sleep(0.02)
        return self.orders.empty()

    def stale(self, order: WorkerOrder) -> bool:
        """Whether the page has sent a newer request."""
        return self.newest.get(order.page) != order.n


def serve(
    valuation: WhatIf,
    desk: Desk,
    post: Post,
    module: str | None = None,
    shown: HeadlineTables | None = None,
) -> None:
    """Answers requests until there are no more lines; `module`: the module of the user's simulator;
    `shown`: converts tables to the form that the page shows."""
    shown = shown or HeadlineTables(valuation)
    while (order := desk.orders.get()) is not None:
        try:
            if isinstance(valuation, Valuation):
                valuation.use(order.policy or 0)
            if order.do == "move":
                _move(valuation, desk, post, order, shown)
            elif order.do == "train" and isinstance(valuation, Valuation):
                _train(valuation, desk, post, order, shown)
            elif order.do == "bound" and isinstance(valuation, Valuation):
                result = valuation.bound_here(order.values, order.choices)
                result = shown.table("bounded", result)
                post(page=order.page, n=order.n, stage="bounded", table=result)
            elif order.do == "explain":
                rows = valuation.explained(order.values, order.choices)
                rows = shown.table("explained", rows)
                post(page=order.page, n=order.n, stage="explained", table=rows)
            elif order.do == "write":
                _replace(valuation, order)
                post(page=order.page, n=order.n, stage="written", folder=order.folder)
        except CaseError as error:
            post(page=order.page, n=order.n, stage="refused", message=in_words(error))
        except Exception as error:
            moved = [*order.values, *order.choices]
            text = stopped(error, moved, module)
            post(page=order.page, n=order.n, stage="refused", message=text)


def _move(
    valuation: WhatIf, desk: Desk, post: Post, order: WorkerOrder, shown: HeadlineTables
) -> None:
    started, stage = time.perf_counter(), ("", None)
    stages = valuation.stages(order.values, order.choices)
    while not desk.stale(order):
        stage = next(stages, None)
        seconds = time.perf_counter() - started
        address = {"page": order.page, "n": order.n, "seconds": seconds}
        if stage is None:
            post(**address, stage="done")
            break
        post(**address, stage=stage[0], table=shown.table(*stage))
    if stage is None and desk.rests(REST):
        for name, table in valuation.afterwards():
            post(page=order.page, n=order.n, stage=name, table=table)


def _replace(valuation: WhatIf, order: WorkerOrder) -> None:
    """Writes a case to a new folder, which then replaces `order.folder` as a whole: no file of an
    earlier case remains. If the case cannot be written, the earlier case is removed as well."""
    folder = Path(order.folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="snapo-live-", dir=folder.parent) as made:
        new = Path(made) / "new"
        new.mkdir()
        try:
            _write(valuation, order, new)
        finally:
            if folder.exists():
                folder.rename(Path(made) / "old")
        new.rename(folder)


def _write(valuation: WhatIf, order: WorkerOrder, folder: Path) -> None:
    """Writes the case to a folder, or as a workbook in the folder, with the files that no sheet can
    hold, and the policy."""
    files = valuation.files(order.values, order.choices)
    if not order.workbook:
        files.write(folder)
    else:
        from snapo.case.workbook import write_workbook

        with tempfile.TemporaryDirectory(prefix="snapo-live-") as made:
            files.write(Path(made))
            write_workbook(Path(made), files.tables, folder / "case.xlsx")
            for file in Path(made).iterdir():
                if file.suffix != ".csv" and file.name != "case.toml":
                    shutil.copyfile(file, folder / file.name)
    if isinstance(valuation, Valuation):
        valuation.save_policy(folder)


class Cancelled(Exception):
    """Raised to cancel work that a page no longer needs."""


def _train(
    valuation: Valuation, desk: Desk, post: Post, order: WorkerOrder, shown: HeadlineTables
) -> None:
    address = {"page": order.page, "n": order.n}

    def report(step: int, of: int) -> None:
        if desk.stale(order):
            raise Cancelled
        post(**address, stage="training", table={"step": step, "of": of})

    try:
        result = valuation.train_again(order.values, report, order.choices)
    except Cancelled:
        post(**address, stage="cancelled")
    else:
        post(**address, stage="trained", table=shown.table("trained", result))


def in_words(error: CaseError) -> str:
    """A refusal as text for the page, without the temporary folder of the case, which the user does
    not know."""
    return " ".join(_short(item) for item in (error, *error.others))


def _short(error: CaseError) -> str:
    file = Path(error.file).name if error.file else ""
    return str(CaseError(file, error.where, error.value, error.allowed))


def _unpickled(data: bytes) -> Domain:
    """The domain of a problem in Python, from the process that opened the page."""
    stream = io.BytesIO(data)
    sys.path[:] = pickle.load(stream)  # the user's modules, by which the rest is read
    return pickle.load(stream)


def main(arguments: list[str] | None = None) -> int:
    """The program `python -m snapo.live.worker RUN`, which the server starts."""
    parser = argparse.ArgumentParser(prog="snapo.live.worker")
    parser.add_argument("run", type=Path)
    parser.add_argument("--simulator")
    parser.add_argument("--engine", default="auto")
    parser.add_argument("--paths", type=int)
    parser.add_argument("--problem", type=int, default=0)  # bytes, before the orders
    options = parser.parse_args(arguments)
    # Output of a user's code must not appear between the lines of the answers.
    out = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    post = Post(out)
    from snapo.study.prepare import use_every_core

    use_every_core()
    code = tuple(options.simulator.split(":")) if options.simulator else None
    counts = None if options.paths is None else PathCounts.of(options.paths)
    domain = _unpickled(sys.stdin.buffer.read(options.problem)) if options.problem else None
    try:
        valuation = open_run(options.run, code, options.engine, counts, domain)  # pyright: ignore
    except CaseError as error:
        post(stage="failed", message=str(error))
        return 2
    shown = HeadlineTables(valuation)
    # Which leaves nothing to compile for the first move.
    base = {name: shown.table(name, table) for name, table in valuation.stages({})}
    base |= dict(valuation.afterwards())
    counts = valuation.counted()
    available = [choice._asdict() for choice in valuation.choices]
    bounded = isinstance(valuation, Valuation) and valuation.bounded
    ready = {
        "inputs": shown.inputs(valuation.inputs()),
        "choices": available,
        "base": base,
        "counts": counts,
        "bounded": bounded,
    }
    post(stage="ready", **ready, **shown.units())
    serve(valuation, Desk(sys.stdin), post, code[0] if code else None, shown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
