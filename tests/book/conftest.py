"""A book of five small stores that was valued once for all tests of a process."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from tests.book.books import HERE, TASKS, write_book

from snapo.book import work
from snapo.book.file import Book, read_book
from snapo.book.run import run_book

ROWS = [
    {"name": "first", "desk": "A", "quantity": 1, "contract.injection_cost": 0.02},
    {"name": "twin", "desk": "A", "quantity": 1, "contract.injection_cost": 0.02},
    {"name": "sold", "desk": "B", "quantity": -2, "contract.injection_cost": 0.02},
    {"name": "dearer", "desk": "B", "quantity": 3, "contract.injection_cost": 0.04},
    {"name": "wrong", "desk": "B", "quantity": 0, "contract.max_inventory": -1},
]


class Valued(NamedTuple):
    """A book that was valued: its file, its folder, and its result."""

    book: Book
    out: Path
    result: dict[str, Any]


@pytest.fixture(scope="session", autouse=True)
def compiled_code_stays():
    """The process of the tests is larger than a worker, which would drop its code after each job."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(work, "LARGE", 1 << 40)
        yield


@pytest.fixture(scope="session")
def valued(tmp_path_factory) -> Valued:
    """The first four contracts: all are in order."""
    folder = tmp_path_factory.mktemp("book")
    file = write_book(folder, ROWS[:4], more=TASKS)
    result = run_book(read_book(file), lambda _: None, HERE, out=folder / "run")
    assert json.loads((folder / "run" / "result.json").read_text()) == result
    return Valued(read_book(file), folder / "run", result)
