"""A study: a problem, and the parts of a run that analyse it.

A part writes its tables to the run folder and reports its progress. If it fails, the other parts
are not lost; if a run is resumed, completed parts are not computed again.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from snapo.engine import Engines
from snapo.problem.inputs import Input
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.report.folder import NAMES
from snapo.solver import statistics
from snapo.solver.learning.progress import INTERRUPTED, Interrupted
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.relaxations.stop import Relaxation
from snapo.solver.solution import Solution
from snapo.solver.solve import Evaluation, solve
from snapo.solver.tables import write_csv

ProgressCallback = Callable[[str], None]


class Setup(NamedTuple):
    """All arguments of `snapo.solve` for the training of a study.

    `recipe`: the recipe of `policy`, if it is a general policy, so that training begins as
    `snapo.solve` does; with None training begins from `policy` itself. `case`: the prepared case,
    if the problem's simulator does not contain it.
    """

    problem: Problem
    policy: Policy
    training: TrainingPlan
    evaluation: Evaluation
    engines: Engines
    recipe: Policy | None = None
    case: Any = None

    def solve(self, **options: Any) -> Solution:
        """`snapo.solve` with these arguments; `options`: further arguments.

        **Raises:** `Interrupted` with the solution if Ctrl-C has ended the training.
        """
        solution = solve(
            self.problem,
            policy=self.policy if self.recipe is None else self.recipe,
            training=self.training,
            evaluation=self.evaluation,
            engine=self.engines,
            **options,
        )
        if solution.status == INTERRUPTED:
            raise Interrupted(solution)
        return solution


def with_change(
    setup: Callable[[], Setup], change: Callable[[Setup], Setup]
) -> Callable[[], Setup]:
    """The `setup` function of a study with a change, which is applied only once, since the setup
    may be replaced during a run."""
    made: dict[int, tuple[Setup, Setup]] = {}

    def build() -> Setup:
        local = setup()
        if id(local) not in made:  # the pair keeps `local`, and with it its number
            made[id(local)] = (local, change(local))
        return made[id(local)][1]

    return build


class Today(NamedTuple):
    """Today's decision in the terms of its domain.

    - `description`: the decision in one line, "withdraw 164 MWh"; `facts`: triples (name, number,
      unit) next to it.
    - `columns`: pairs (name, unit) of the table; `rows`: its rows.
    """

    description: str
    facts: Sequence[tuple[str, float | None, str]] = ()
    columns: Sequence[tuple[str, str]] = ()
    rows: Sequence[Sequence[Any]] = ()


class LiveTable(NamedTuple):
    """A section of the domain on the live page.

    - `title`; `description`: one line above the table; `columns`: pairs (name, unit) of the table;
      `rows`: its rows of texts and numbers.
    - `facts`: triples (name, number, unit) of the main figures, which are shown above the table.
    """

    title: str
    columns: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[Any]]
    description: str = ""
    facts: Sequence[tuple[str, float, str]] = ()


class PathTotals(NamedTuple):
    """The rollout of a policy on the paths of the page's value, from which sections are made.

    - `totals`: {output: [N]}, exact; `groups` [N]: the groups of dependent paths.
    """

    setup: Setup
    totals: Mapping[str, Any]
    groups: Any

    def mean(self, values: Any) -> tuple[float, float]:
        """The mean of numbers [N] of the paths, and its standard error."""
        average = statistics.mean(np.asarray(values, np.float64), self.groups)
        return average.value, average.standard_error

    def ratio(self, top: str, bottom: str) -> tuple[float, float]:
        """The mean of one output divided by the mean of another, and the standard error of this
        ratio."""
        ratio = statistics.ratio(self.totals[top], self.totals[bottom], self.groups)
        return ratio.value, ratio.standard_error


class DisplayedValue(NamedTuple):
    """The number that readers see instead of the value: an increasing function of the value, such
    as a "Certainty equivalent" in %.

    - `number`: the number at the value; `slope`: its derivative with respect to the value.
    """

    name: str
    unit: str
    number: float
    slope: float


class CalculatedOutput(NamedTuple):
    """An output of a study without a policy.

    - `values`: [N] the value on each path; `nominal`: the value without random effects; `within`:
      the share of paths within its limits.
    """

    name: str
    unit: str
    values: np.ndarray
    nominal: float
    within: float


class Recalculated(Protocol):
    """A study without a policy, calculated at other inputs for the live page.

    - `inputs_by_name`: its inputs.
    """

    @property
    def inputs_by_name(self) -> Mapping[str, Input]: ...

    def stages(self, case: Any) -> Iterator[tuple[str, Any]]:
        """Yields pairs (name, table).

        - "value": "value", "standard_error", "paths", "kept" [N] by path, and "outputs", each a
          `CalculatedOutput`.
        - "sections": a list of `LiveTable` as tables.
        - "deltas": rows with "of", the output that is differentiated, "input", "effect",
          "standard_error", "rows".
        """
        ...


class Part(NamedTuple):
    """A part of a run.

    - `name`: a text such as "sensitivity matrix"; its tables are saved as
      parts/sensitivity-matrix.json.
    - `work`: takes the `StudyRun` and returns {key: table} in plain data or NumPy. Reports read the
      tables by these keys (`run.get("key")`). No two parts may have the same key.
    - `needs`: the parts that must be done first; if one of them failed, this part is skipped.
    """

    name: str
    work: "Callable[[StudyRun], Mapping[str, Any]]"
    needs: tuple[str, ...] = ()

    @property
    def file(self) -> str:
        """The name of the file of the part."""
        return self.name.replace(" ", "-") + ".json"


@dataclass(frozen=True, eq=False)
class Study:
    """A problem, and the parts of its runs.

    - `kind`: the kind of the domain.
    - `about`: facts that are available before any computation: title, currency, dates, notes … for
      the report; "units" and "names" of series for report and live page, in which a series with an
      empty name is not shown.
    - `parts`: in the order in which they are done.
    - `result`: makes the content of result.json from the run so far: "value", "standard_error",
      "status" …
    - `setup`: returns the arguments of training, always the same object; None if nothing trains.
    - `relaxation`: returns the inner problem of the upper bound, or a text with the reason why
      there is no bound.
    - `setup_at`: returns, with code that is already compiled, the setup for a case that differs
      only in the numbers of its inputs. None if its inputs cannot be moved.
    - `checks`: the names of tables of the case whose figures check its numbers; a case with new
      numbers is written without these tables.
    - `today`: returns today's decision for a setup and a policy, as the rows of a table.
    - `inputs`: returns the inputs of a case by name; None if they are collected from its records.
    - `live_tables`: returns the sections of the domain on the live page.
    - `headline`: returns the headline for a value of a setup's objective; None if there is none.
    - `recalculated`: returns the calculation at other inputs for a study without training.
    - `meanwhile`: work for later parts, which a thread does during the training; if it fails, these
      parts do it again.
    """

    kind: str
    about: Mapping[str, Any]
    parts: Sequence[Part]
    result: "Callable[[StudyRun], Mapping[str, Any]]"
    setup: Callable[[], Setup] | None = None
    relaxation: Callable[[], Relaxation] | str = "there is no upper bound for this kind of case"
    setup_at: Callable[[Setup, Any], Setup] | None = None
    checks: Sequence[str] = ()
    today: Callable[[Setup, Policy], "Today"] | None = None
    inputs: Callable[[Any], Mapping[str, Input]] | None = None
    live_tables: Callable[[PathTotals], Sequence[LiveTable]] | None = None
    recalculated: Callable[[], Recalculated] | None = None
    headline: Callable[[Setup, float], DisplayedValue | None] | None = None
    meanwhile: Callable[[], object] | None = None

    def __post_init__(self):
        names = [part.name for part in self.parts]
        for position, part in enumerate(self.parts):
            if part.name in names[:position]:
                raise ValueError(f"Study: two parts are named {part.name!r}.")
            if unknown := set(part.needs) - set(names[:position]):
                raise ValueError(
                    f"Study: {part.name!r} needs {sorted(unknown)}, which are not before it."
                )

    @property
    def names(self) -> Mapping[str, str]:
        """The names of states, decisions and outputs for readers; a series with an empty name is
        not shown."""
        return self.about.get(NAMES) or {}


@dataclass(eq=False)
class StudyRun:
    """A study that is being run: the results that its parts read, and the folder that they write.

    - `folder`: the folder of the run; `resume`: whether to continue from its checkpoint.
    - `progress`: takes one line of progress.
    - `results`: the tables of all finished parts by key, in the form in which JSON returns them.
    - `troubles`: errors of writing files.
    - `mark`: a hash of everything that affects its numbers; a checkpoint with another mark is not
      used.
    """

    study: Study
    folder: Path
    progress: ProgressCallback
    resume: bool = False
    results: dict[str, Any] = field(default_factory=dict)
    troubles: list[str] = field(default_factory=list)
    trained: Solution | None = None
    mark: str = ""

    def get(self, path: str, default: Any = None) -> Any:
        """The entry "today.spot" of the tables, or `default` if it is missing or null."""
        table: Any = self.results
        for key in path.split("."):
            table = table.get(key) if isinstance(table, dict) else None
        return default if table is None else table

    @property
    def setup(self) -> Setup:
        """The arguments of the training."""
        if self.study.setup is None:
            raise ValueError(f"{self.study.kind}: this study trains nothing.")
        return self.study.setup()

    @property
    def solution(self) -> Solution:
        """The trained policy with its value, from this session or loaded from the folder of the
        run."""
        if self.trained is None:
            self.trained = Solution.load(self.folder, like=self.setup.policy)
        return self.trained

    def write_csv(self, name: str, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
        """A separate table next to the report, with all digits of its numbers."""
        write_csv(self.folder / name, header, rows)

    def write_records(self, name: str, kind: type, records: Iterable[Any]) -> None:
        """Writes dataclasses of one `kind` as such a table; the cell of a field that is None is
        empty."""
        names = [field.name for field in fields(kind)]
        rows = ([getattr(record, name) for name in names] for record in records)
        self.write_csv(name, names, (["" if x is None else x for x in row] for row in rows))
