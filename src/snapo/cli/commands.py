"""The functions of the commands: they call `snapo.study.commands`, print the answer, and return the
exit code."""

import argparse
import errno
import gc
import json
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snapo.case.error import CaseError
from snapo.study import commands
from snapo.study.commands import CaseRequest
from snapo.study.domain import GOOD

from .answers import bounds, summary, to_json

if TYPE_CHECKING:
    from snapo.engine import Workers

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
FAULTS = (errno.ENOSPC, errno.EDQUOT, errno.EIO)  # of a disk, not of a name


def run(options: argparse.Namespace) -> int:
    """Runs the command that `options` name; a mistake in the input is reported as one message."""
    available = {
        "new": _new,
        "check": _check,
        "solve": _solve,
        "book": _book,
        "sweep": _sweep,
        "certify": _certify,
        "calibrate": _calibrate,
        "backtest": _backtest,
        "report": _report,
        "export": _export,
        "open": _open,
        "compare": _compare,
        "explain": _explain,
        "runs": _runs,
        "bench": _bench,
        "schema": _schema,
        "cache": _cache,
    }
    gc.set_threshold(20_000, 20, 20)  # tracing makes many objects, which are all needed
    try:
        # stdout is only for the answer
        with redirect_stdout(sys.stderr), stoppable():
            answer, text, code = available[options.command](options)
    except CaseError as error:
        say(f"snapo: {error}")
        answer, text, code = {"status": "bad-input", "message": str(error)}, "", BAD_INPUT
    except OSError as error:
        if error.filename is None or error.errno in FAULTS:  # no name that somebody gave
            raise
        message = f"{error.filename}: {error.strerror}"
        say(f"snapo: {message}")
        answer, text, code = {"status": "bad-input", "message": message}, "", BAD_INPUT
    except KeyboardInterrupt as stop:
        say("snapo: interrupted")
        result = getattr(stop, "result", None)  # of a run of `snapo solve`, up to here
        result = result if isinstance(result, Mapping) else {}
        text = (
            f"{summary(result)}\nto continue, run the same command with --resume" if result else ""
        )
        answer, code = {**result, "status": "interrupted"}, INTERRUPTED
    if options.json:
        print(to_json(answer))
    elif text:
        print(text)
    return code


@contextmanager
def stoppable() -> Iterator[None]:
    """Treats SIGTERM as an interrupt: finished work is reported before the process ends."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def say(text: str) -> None:
    """Prints one line for a reader on stderr, without buffering."""
    print(text, file=sys.stderr, flush=True)


Answer = tuple[Mapping[str, Any], str, int]  # for --json, for a person, and the exit code


def _new(options: argparse.Namespace) -> Answer:
    if options.kind is None:
        result = commands.kinds()
        lines = [f"{kind:<14}{text}{_sizes(sizes)}" for kind, text, sizes in result]
        kinds = {kind: {"words": label, "sizes": sizes} for kind, label, sizes in result}
        return {"status": "ok", "kinds": kinds}, "\n".join(lines), OK
    if options.folder is None:
        message = f"specify the folder: snapo new {options.kind} DIR"
        raise CaseError("DIR", "", None, message)
    if options.xlsx:
        written = commands.new_workbook(options.kind, options.folder, options.size)
        position = written[0]
    else:
        written = commands.new(options.kind, options.folder, options.size)
        position = options.folder
    say(f"now: {commands.next_command(options.kind, position)}")
    answer = {"status": "ok", "kind": options.kind, "files": written}
    return answer, "\n".join(map(str, written)), OK


def _sizes(sizes: tuple[str, ...]) -> str:
    return f" (--size {', '.join(sizes)})" if len(sizes) > 1 else ""


def _asked(options: argparse.Namespace) -> CaseRequest:
    seed = [] if options.seed is None else [f"training.seed={options.seed}"]
    return CaseRequest(options.case, (*options.assignments, *seed), options.simulator)


def _check(options: argparse.Namespace) -> Answer:
    if _is_book(options.case):
        from snapo.book import commands as book

        lines = book.check(options.case)
    else:
        lines = commands.check(_asked(options), say)
    return {"status": "ok", "lines": lines}, "\n".join(lines), OK


def _solve(options: argparse.Namespace) -> Answer:
    with _workers(options) as workers:
        result = commands.solve(
            _asked(options),
            say,
            out=options.out,
            engine=options.engine,
            reference=options.reference,
            ladder=options.ladder,
            hedge=options.hedge,
            gamma=options.gamma,
            resume=options.resume,
            policy=options.policy,
            seeds=options.seeds,
            workers=workers,
        )
    return result, summary(result), OK if result.get("status") in GOOD else FAILED


def _workers(options: argparse.Namespace) -> "AbstractContextManager[Workers | None]":
    """The workers of `--on` or `--workers`; without these options nothing is imported."""
    if not (options.on or options.workers):
        return nullcontext()
    from snapo.book.executors import worker_pools
    from snapo.engine import Workers

    return Workers(worker_pools(options.on, options.workers, options.trust_network))


def _book(options: argparse.Namespace) -> Answer:
    from snapo.book import commands as book

    if options.sql is not None:
        columns, rows = book.query(options.book, options.sql)
        return {"status": "ok", "columns": columns, "rows": rows}, _as_table(columns, rows), OK
    result = book.solve(
        options.book,
        say,
        out=options.out,
        workers=options.workers,
        on=options.on,
        trust_network=options.trust_network,
        shard=options.shard,
        resume=options.resume,
    )
    return result, book.summary(result), OK if result["status"] == "ok" else FAILED


def _sweep(options: argparse.Namespace) -> Answer:
    from snapo.book import commands as book

    seed = [] if options.seed is None else [f"training.seed={options.seed}"]
    result = book.sweep(
        options.case,
        (*options.assignments, *seed),
        say,
        sobol=options.sobol,
        train=options.train,
        out=options.out,
        workers=options.workers,
        resume=options.resume,
    )
    return result, book.summary(result), OK if result["status"] == "ok" else FAILED


def _as_table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    cells = [list(columns), *([_cell(value) for value in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells)]
    return "\n".join("  ".join(map(str.rjust, row, widths)) for row in cells)


def _cell(value: Any) -> str:
    return f"{value:,.6g}" if isinstance(value, float) else "" if value is None else str(value)


def _is_book(path: Path) -> bool:
    """Whether a file is marked as a book; its reader reports any mistakes in it."""
    from snapo.case.load import load

    try:
        return path.suffix == ".toml" and load(path)[1].get("kind") == "book"
    except CaseError:
        return False


def _certify(options: argparse.Namespace) -> Answer:
    from snapo.study.runs.store import located

    result = commands.certify(
        located(options.run),
        say,
        paths=options.paths,
        penalty=options.penalty,
        engine=options.engine,
        simulator=options.simulator,
    )
    failed = (result.get("failures") or {}).get("bound")
    code = FAILED if failed else OK
    return result, bounds(result) if not failed else summary(result), code


def _calibrate(options: argparse.Namespace) -> Answer:
    from snapo.domains.gas_storage.history.calibrate import calibrate
    from snapo.domains.gas_storage.history.calibrate import summary as estimates
    from snapo.study.runs.store import located

    run = None if options.run is None else located(options.run)
    result = calibrate(options.case, say, out=options.out, run=run)
    return result, estimates(result), OK if result["status"] == "ok" else FAILED


def _backtest(options: argparse.Namespace) -> Answer:
    from snapo.domains.gas_storage.history.backtest import backtest
    from snapo.domains.gas_storage.history.results import summary as realised
    from snapo.study.runs.store import located

    policy = None if options.policy is None else located(options.policy)
    result = backtest(
        options.case,
        options.history,
        say,
        every=options.every,
        calibrate=options.calibrate,
        hedge=options.hedge,
        policy=policy,
        out=options.out,
    )
    return result, realised(result), OK


def _report(options: argparse.Namespace) -> Answer:
    from snapo.study.runs.store import located, shown

    run = located(options.run)
    if (run / "book.json").is_file():
        from snapo.book import commands as book

        file = book.report(run)
        return {"status": "ok", "report": file}, str(file), OK
    tables = {"report": commands.report(run)}
    if options.pdf:
        tables["pdf"] = commands.printed(run)
    if options.xlsx:
        tables["xlsx"] = commands.tables(run)
    tables = {name: shown(file.parent) / file.name for name, file in tables.items()}
    return {"status": "ok", **tables}, "\n".join(map(str, tables.values())), OK


def _export(options: argparse.Namespace) -> Answer:
    from .export import export

    files = export(
        options.run, options.onnx, options.table, options.python, simulator=options.simulator
    )
    return {"status": "ok", **files}, "\n".join(map(str, files.values())), OK


def _open(options: argparse.Namespace) -> Answer:
    from snapo.live.open import open_page
    from snapo.study.runs.store import located

    open_page(
        located(options.run),
        say,
        simulator=options.simulator,
        port=options.port,
        browser=not options.no_browser,
        paths=options.paths,
        engine=options.engine,
    )
    return {"status": "ok"}, "", OK


def _compare(options: argparse.Namespace) -> Answer:
    from snapo.study.compare import compare_all
    from snapo.study.runs.store import located

    result = compare_all([located(run) for run in options.runs])
    return {"status": "ok", **result.table()}, str(result), OK


def _explain(options: argparse.Namespace) -> Answer:
    from snapo.domains.gas_storage.explain.command import explain
    from snapo.domains.gas_storage.explain.command import summary as parts
    from snapo.study.runs.store import located

    runs = located(options.first), located(options.second)
    result = explain(*runs, say, flows=options.flows, cash=options.cash, out=options.out)
    return result, parts(result), OK


def _runs(options: argparse.Namespace) -> Answer:
    from snapo.study.runs.history import described, listed, removed

    if options.remove or options.keep is not None:
        names = removed(options.case, options.remove, options.keep)
        return {"status": "ok", "removed": names}, "\n".join(names) or "nothing to remove", OK
    rows = listed(options.case)
    answer = {"status": "ok", "runs": [row.table() for row in rows]}
    return answer, "\n".join(described(rows)), OK


def _bench(options: argparse.Namespace) -> Answer:
    result = commands.bench(options.kind, options.engine, say)
    text = "\n\n".join(f"{kind}\n{times}" for kind, times in result.items())
    return {"status": "ok", "times": result}, text, OK


def _schema(options: argparse.Namespace) -> Answer:
    from .completion import schema_of_kind

    schema = schema_of_kind(options.kind)
    return schema, json.dumps(schema, indent=2, ensure_ascii=False), OK


def _cache(options: argparse.Namespace) -> Answer:
    from snapo.lanes.machine import code_cache

    if options.empty:
        code_cache.empty()
    folders = code_cache.contents()
    table = [{"folder": str(x.path), "files": x.files, "bytes": x.size} for x in folders]
    return {"status": "ok", "folders": table}, "\n".join(map(str, folders)), OK
