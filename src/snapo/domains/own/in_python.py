"""The report and the live page of a solution in Python.

The problem becomes a kind of case whose file has the inputs; a separate folder holds the run.
"""

import atexit
import pickle
import shutil
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from snapo.case.settings import EvaluationTable, FollowingTable
from snapo.case.toml import to_toml
from snapo.engine import choose
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.record import Input
from snapo.solver.learning.settings import resolve_auto
from snapo.solver.provenance import versions
from snapo.solver.solution import Solution
from snapo.solver.solve import Evaluation
from snapo.solver.tables import write_text
from snapo.solver.train import Training
from snapo.study import run_folder
from snapo.study.carry_out import carry_out, page_of
from snapo.study.chapters.bound import value_bounds
from snapo.study.domain import Options, Report, find
from snapo.study.kind import Kind
from snapo.study.runs.origin import origin
from snapo.study.study import Part, Setup, Study
from snapo.study.training import TRAINING, saved

from . import DOMAIN
from .read import ATTRIBUTES, read_inputs
from .records import OwnCase
from .report import REPORT
from .study import study

if TYPE_CHECKING:
    from snapo.live.open import LivePage

ENGINES = ("native", "xla")
CASE = f"{run_folder.CASE}/case.toml"


@dataclass(frozen=True, eq=False)
class SolvedProblem:
    """The case of a solved problem: the problem, its policy, and their settings."""

    problem: Problem
    policy: Policy
    engine: str
    seed: int
    paths: Mapping[str, int]
    notes: tuple[str, ...]

    def setup(self, engine: str) -> Setup:
        """The problem with its policy; `engine`: "auto" for the engine of the solution."""
        problem, policy = self.problem, self.policy
        requested = self.engine if engine == "auto" and self.engine in ENGINES else engine
        plan = resolve_auto(Training(paths=self.paths["train"], seed=self.seed), problem, policy)
        evaluation = Evaluation(paths=self.paths["evaluate"])
        return Setup(problem, policy, plan, evaluation, choose(requested, problem, policy))


@dataclass(frozen=True, eq=False)
class PythonDomain(Kind):
    """The domain of one problem in Python; its cases are the problem with different numbers.

    - `solved`: the problem with its policy.
    """

    solved: SolvedProblem = field(kw_only=True)

    def read(self, file: Path, data: Mapping[str, Any]) -> OwnCase:
        solved = self.solved
        problem, kind = solved.problem, type(solved.problem.simulator)
        inputs, positions = read_inputs(data["inputs"], file, [])
        before = problem.inputs_by_name
        values = {name: x.value.reshape(before[name].value.shape) for name, x in inputs.items()}
        return OwnCase(
            file=file,
            notes=(),
            title=str(data["title"]),
            step="step",
            location=(kind.__module__, kind.__qualname__),
            code=None,
            code_hash="",
            simulator=problem.simulator,
            inputs=problem.at(values).inputs_by_name,
            objective=problem.objective,
            objective_words=str(problem.objective),
            outputs={str(at): name for at, name in enumerate(problem.objective.outputs)},
            unit="",
            units={},
            training=FollowingTable(),
            evaluation=EvaluationTable(),
            positions=positions,
        )

    def study(self, case: Any, options: Options) -> Study:
        solved = self.solved
        options = options._replace(about={"notes": list(solved.notes)})
        made = study(case, options, lambda case, engine: solved.setup(engine))

        def setup_at(setup: Setup, other: OwnCase) -> Setup:
            values = {name: x.value for name, x in other.inputs.items()}
            return setup._replace(problem=setup.problem.at_values(values))

        about = {**made.about, "simulator": case.location[1]}
        return replace(made, about=about, setup_at=setup_at)

    def report(self) -> Report:
        sections = tuple(section for section in REPORT.sections if section is not value_bounds)
        return replace(REPORT, title="A simulator in Python", sections=sections)


def write_report(solution: Solution, file: Path, problem: Problem | None) -> Path:
    """Writes the report of a solution into an HTML file; returns its path.

    **Raises:** `ValueError` for another suffix, or if the solution has no problem and was not
    loaded from the folder of a run.
    """
    if file.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"report: {file.name!r}; it must be a name that ends in .html.")
    if (folder := _run_of(solution, problem)) is not None:
        kind = run_folder.read(folder).get("kind")
        write_text(file, page_of(find(kind, str(folder / run_folder.RUN)), folder))
        return file
    with tempfile.TemporaryDirectory(prefix="snapo-report-") as made:
        _carry_out(solution, _domain(solution, problem, "report"), Path(made), every=True)
        shutil.copyfile(Path(made) / run_folder.REPORT, file)
    return file


def open_page(
    solution: Solution, problem: Problem | None, simulator: str | None, browser: bool
) -> "LivePage":
    """Opens the live page of a solution.

    **Raises:** as `write_report`."""
    import webbrowser

    from snapo.live.open import LivePage, server_of

    if (folder := _run_of(solution, problem)) is not None:
        module, _, name = (simulator or "").partition(":")
        page = LivePage(server_of(folder, simulator=(module, name) if simulator else None))
    else:
        domain = _domain(solution, problem, "open")
        made = Path(tempfile.mkdtemp(prefix="snapo-open-"))
        atexit.register(shutil.rmtree, made, ignore_errors=True)
        _carry_out(solution, domain, made, every=False)
        server = server_of(made, problem=_pickled(domain))
        page = LivePage(server, lambda: shutil.rmtree(made, ignore_errors=True))
    if browser:
        webbrowser.open(page.address)
    return page


def _run_of(solution: Solution, problem: Problem | None) -> Path | None:
    """The run folder that a solution was loaded from; None for any other solution."""
    folder = solution.folder
    is_run = folder is not None and (folder / run_folder.RUN).is_file()
    return folder if is_run and problem is None else None


def _domain(solution: Solution, problem: Problem | None, verb: str) -> PythonDomain:
    """The domain of a solution's problem.

    **Raises:** `ValueError` if something is missing."""
    problem = problem or solution.problem
    missing = f"{verb}: this solution was loaded without its"
    if problem is None:
        raise ValueError(f"{missing} problem; pass it as problem=problem.")
    if solution.policy is None:
        raise ValueError(
            f"{missing} policy; load it with snapo.Solution.load(folder, like=policy)."
        )
    solved = SolvedProblem(
        replace(problem), solution.policy, solution.engine, solution.seed, solution.paths,
        solution.notes,
    )  # fmt: skip
    return PythonDomain(
        DOMAIN.kind, DOMAIN.description, DOMAIN.package, DOMAIN.sizes, solved=solved
    )


def _carry_out(solution: Solution, domain: PythonDomain, out: Path, *, every: bool) -> None:
    """Writes a run of the solution to the folder `out`, with `every` part or those of a live
    page."""
    problem = domain.solved.problem
    data = {
        "kind": domain.kind,
        "title": type(problem.simulator).__name__,
        "inputs": {name: _table(entry) for name, entry in problem.inputs_by_name.items()},
    }
    file = out / CASE
    file.parent.mkdir()
    write_text(file, to_toml(data))
    made = domain.study(domain.read(file, data), Options())
    training = Part(TRAINING.name, lambda run: saved(run, solution))
    others = made.parts[1:] if every else ()
    made = replace(made, parts=[training, *(part for part in others if part.name != "bound")])
    decides = {"case": data, "files": {}, "options": {}, "versions": versions()}
    source = origin(file, (), out, decides)
    carry_out(cast(Any, domain), made, out, decides, False, lambda line: None, origin=source)


def _table(entry: Input) -> dict[str, Any]:
    """An input as a table of a case."""
    value = entry.value.ravel() if entry.value.ndim > 2 else entry.value
    names = {key: getattr(entry, name) for key, name in ATTRIBUTES.items()}
    table = {"value": value.tolist(), "labels": list(entry.labels), **names}
    return {key: item for key, item in table.items() if item not in (None, "", [])}


def _pickled(domain: PythonDomain) -> bytes:
    """A domain as bytes for the worker of its page, with the search path of modules.

    The bytes pass through the worker's pipe; no pickle is written to a file or read from one.
    """
    import cloudpickle  # classes of a notebook are in no module that a worker could import

    return pickle.dumps(sys.path) + cloudpickle.dumps(domain)
