"""Books of a month's store: small, with every part of a book."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

from tests.miniatures import thirty_days

from snapo.book.file import Book, read_book
from snapo.book.folder import BookFolder
from snapo.book.job import JobResult, name_of
from snapo.book.plan import BookPlan
from snapo.engine.workers import WorkerPool

SHORT = {
    "training.steps": 2,
    "training.paths": 32,
    "training.validation_paths": 64,
    "evaluation.sensitivity_paths": 128,
    "evaluation.judge_paths": 64,
    "evaluation.selection_paths": 0,
    "evaluation.search_paths": 0,
}
TASKS = "[tasks]\npaths = 512\njudge = 0\n"
STRESSES = """
[[stress]]
name = "up 10 %"
scale = { "market.forward_curve" = 1.10 }
[[stress]]
name = "dear injection"
shift = { "contract.injection_cost" = 0.05 }
"""


def write_book(
    folder: Path, rows: list[dict[str, Any]], *, stresses: str = STRESSES, more: str = ""
) -> Path:
    """Writes a book of stores that differ in the keys of their rows; returns its file."""
    store = folder / "store"
    store.mkdir(parents=True, exist_ok=True)
    for name, text in thirty_days().items():
        (store / name).write_text(text, encoding="utf-8")
    columns = list(dict.fromkeys(name for row in rows for name in (*row, *SHORT)))
    lines = [",".join(columns)]
    lines += [",".join(str((SHORT | row).get(name, "")) for name in columns) for row in rows]
    (folder / "contracts.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    # The pictures of exposures take longer than a contract.
    tasks = more or TASKS + "exposure = false\n"
    text = 'kind = "book"\ntitle = "North"\n[cases]\ntemplate = "store"\ntable = "contracts.csv"\n'
    by = 'by = ["desk"]\n' if "desk" in columns else ""
    (folder / "book.toml").write_text(text + by + stresses + tasks, encoding="utf-8")
    return folder / "book.toml"


class InProcess(Executor):
    """Computes at once, in this process."""

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        future = Future[Any]()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


HERE = [WorkerPool(InProcess)]


def results_of(book: Book, folder: Path) -> dict[str, JobResult]:
    """{contract: the result of its first job}, as the folder has them."""
    from snapo.book.run import plan_of

    plan, files = plan_of(book), BookFolder(folder)

    def read(name: str) -> JobResult | None:
        entry = files.read(name)
        return None if entry is None else entry[0]

    results = {}
    for contract in book.contracts:
        job = plan.base(contract, read)
        result = None if job is None else read(name_of(job.pack()))
        if result is not None:
            results[contract.name] = result
    return results


__all__ = ["HERE", "BookPlan", "InProcess", "read_book", "results_of", "write_book"]
