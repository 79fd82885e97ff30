"""A run as the page needs it: its case read again, and its policy loaded where it has one."""

from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.solver.solution import Solution
from snapo.study.again import case_of_run, options_of_run
from snapo.study.commands import domain_of_run
from snapo.study.domain import Options
from snapo.study.run_folder import read
from snapo.study.study import Study

from .case.files import read_files
from .case.places import Places
from .counts import Counts
from .moves import Moves
from .recalculation import Recalculation
from .rolled import numbers_of_a_path
from .valuation import Valuation


def open_run(
    run: Path,
    simulator: tuple[str, str] | None = None,
    engine: str = "auto",
    counts: Counts | None = None,
) -> Moves:
    """The run in a folder.

    **Raises:** `CaseError` where there is no such run, or nothing to move.
    """
    record = read(run)
    domain = domain_of_run(run, record, simulator)
    file, data = case_of_run(run, record)

    def anew(case: Any) -> Study:
        return domain.study(case, Options(engine))

    case = domain.read(file, data)
    study = domain.study(case, options_of_run(domain, case, record, engine))
    files = read_files(file.parent, data)
    if study.setup is None and study.recalculated is not None:
        given = study.recalculated()
        places = Places(domain.read, files, given.named, study.inputs)
        return Recalculation(study, given, places, anew)
    if study.setup is None:
        what = "this run trained no policy, and there is none to value again"
        raise CaseError(str(run), "", None, what)
    if study.moved is None:
        what = f'inputs of a run of kind "{study.kind}" cannot be moved yet'
        raise CaseError("snapo open", "", None, what)
    setup = study.setup()
    solution = Solution.load(run, like=setup.policy)
    places = Places(domain.read, files, setup.problem.named, study.inputs)
    if counts is None:
        counts = Counts.enough(solution, setup.evaluation, numbers_of_a_path(setup.problem))
    return Valuation(study, solution, places, counts, anew)
