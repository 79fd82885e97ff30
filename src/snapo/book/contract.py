"""The contract of a job: its files, its case, and its case under a stress."""

import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.problem.inputs import Input
from snapo.study.assign import assigned, key_as_in
from snapo.study.domain import Domain, Options, find
from snapo.study.kind import with_other_numbers
from snapo.study.positions import InputPositions
from snapo.study.positions.files import read_files
from snapo.study.study import Setup, Study

from .job import BookJob, BookPoint
from .stress import StressMove, check_tables, moved_numbers

# Tables of a case that no input and no form of a simulator contains.
SETTINGS = ("objective", "training", "evaluation", "policy", "scenarios")


class JobContract:
    """The contract of a job: its case, and its case under a stress; `folder`: where its files are
    written.

    **Raises:** `CaseError` for a case that cannot be read.
    """

    def __init__(self, job: BookJob, folder: Path):
        self.job = job
        self.file = folder / "case.toml"
        tables, _ = assigned(tomllib.loads(job.case), _settings(job))
        for name, content in job.files.items():
            (folder / name).write_bytes(content)
        self.file.write_text(job.case, encoding="utf-8")
        self.domain: Domain = find(tables["kind"], self.file.name)
        self.tables = with_other_numbers(self.domain, tables)
        self.case = self.domain.read(self.file, self.tables)
        self.study: Study = self.domain.study(self.case, Options())

    def under(self, moves: tuple[StressMove, ...], inputs: Mapping[str, Input]) -> Any:
        """The case under a stress; `inputs`: the inputs of the unstressed case.

        Keys are set first: numbers are scaled and shifted on the days that the case then has.
        """
        check_tables(moves, self.tables)
        settings = [f"{key_as_in(self.tables, x.key)}={x.value}" for x in moves if x.value]
        scaled = [move for move in moves if not move.value]
        tables, case, of = self.tables, self.case, self.study.inputs
        if settings:
            tables, _ = assigned(tables, settings)
            case = self.domain.read(self.file, tables)
        if settings and scaled:
            inputs = self._setup_of(case).problem.inputs_by_name if of is None else of(case)
        values = moved_numbers(case, inputs, scaled)
        if not values:
            return case
        files = read_files(self.file.parent, tables)
        return InputPositions(self.domain.read, files, inputs, of, case).case_at(values).case

    def _setup_of(self, case: Any) -> Setup:
        """The setup of a case of this contract with other keys."""
        make_setup = self.domain.study(case, Options()).setup
        assert make_setup is not None
        return make_setup()

    def setup_under(self, moves: tuple[StressMove, ...], case: Any, setup: Setup) -> Setup:
        """The setup of the case under a stress. If the stress sets more than terms and numbers,
        such as the objective, nothing of the `setup` of the contract can be used."""
        keys = (key_as_in(self.tables, move.key) for move in moves if move.value)
        if any(key.partition(".")[0] in SETTINGS for key in keys):
            return self._setup_of(case)
        assert self.study.setup_at is not None
        return self.study.setup_at(setup, case)

    def stressed(self, at: Callable[[tuple[StressMove, ...]], BookPoint]) -> Iterator[BookPoint]:
        """The points of the stresses of the job, valued by `at`."""
        for moves in self.job.stresses:
            try:
                yield at(moves)
            except (CaseError, ValueError, ArithmeticError) as error:
                yield BookPoint.without_value("failed", sentence(error, str(self.file.parent)))


def sentence(error: Exception, folder: str) -> str:
    """The message of a point that failed, without the worker's own folder."""
    return f"{type(error).__name__}: {error}".replace(folder, "").strip()[:500]


def _settings(job: BookJob) -> list[str]:
    """The settings of a case that the book decides."""
    return [f"training.seed={job.seed}", f"evaluation.paths={job.tasks.paths}"]
