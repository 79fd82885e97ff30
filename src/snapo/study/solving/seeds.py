"""`snapo solve CASE --seeds N`: one training for each seed, and the whole run of the best.

Every seed has a run folder of its own, RUN/seeds/SEED, in which training is done: the same numbers
as of `snapo solve CASE --seed SEED`, so that it can be resumed, compared and reported by itself.
The seeds are compared on common paths. The best one's folder becomes RUN, and its other parts are
done there; its value is on paths that the comparison has not seen.
"""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snapo.case.error import CaseError
from snapo.solver.tables import write_csv

from .. import run_folder
from ..choice import with_needs
from ..domain import CaseRequest, Loaded, load, remarks
from ..run_folder import SEEDS
from ..study import Part, Study, StudyRun
from ..training import TRAINING
from .begun import KEPT
from .by_seed import SeedComparison, SeedRow, Trained, compared, describe
from .prepare import Prepared, Wanted, carried_out, made_ready, output_folder

if TYPE_CHECKING:
    from ..study import ProgressCallback

TABLE = "seeds"  # the name of the part, and of the folder with the runs


def solve_seeds(
    request: CaseRequest,
    progress: "ProgressCallback",
    out: Path | None,
    requested: Wanted,
    seeds: int | Sequence[int],
) -> dict[str, Any]:
    """Trains every seed, and carries out the run of the best; returns what result.json says.

    `seeds`: how many, from the seed of the case on, or the seeds themselves.

    **Raises:** `CaseError` where the case trains nothing, or another run lies in the folder.
    """
    began = time.perf_counter()
    loaded = load(request)
    remarks(loaded.case.notes, progress)
    out = output_folder(loaded, out)
    numbers = _numbers(loaded, seeds)
    trained, ready = [], {}
    for seed in numbers:
        local = request._replace(assignments=(*request.assignments, f"training.seed={seed}"))
        one = _ready(load(local), out, seed, requested)
        if seed == numbers[0]:
            remarks(one.study.about["notes"], progress, ignored=loaded.case.notes)
            if requested.resume:
                _check_same(out, one)
        ready[seed] = one
        requested = requested._replace(about=one.study.about)  # the checks are those of the case
        trained.append(_trained(one, seed, requested, progress, began))
        began = time.perf_counter()
    progress(f"comparing {len(numbers)} seeds")
    result = compared(trained)
    adjacent = {"other seeds": _spent(result), "comparison": time.perf_counter() - began}
    best = replace(ready[result.best], out=out)
    _adopt(best, out / TABLE / str(result.best), requested.resume)
    best = replace(best, study=_with_table(best.study, result))
    return carried_out(best, True, progress, time.perf_counter(), adjacent)


def _numbers(loaded: Loaded, seeds: int | Sequence[int]) -> list[int]:
    if not isinstance(seeds, int):
        return list(seeds)
    training = loaded.data.get("training")
    first = training.get("seed") if isinstance(training, Mapping) else None
    if first is None:
        first = getattr(getattr(loaded.case, "training", None), "seed", 0)
    return list(range(first, first + seeds))


def _ready(loaded: Loaded, out: Path, seed: int, requested: Wanted) -> Prepared:
    """The run of one seed in its own folder."""
    folder = out / TABLE / str(seed)
    selected, values = folder / run_folder.START, requested.policy
    # RUN may be the folder of the given policy, and another run by now.
    if values and requested.resume and selected.exists() and values.resolve() == out.resolve():
        requested = requested._replace(policy=selected)
    ready = made_ready(loaded, folder, requested)
    if ready.study.setup is None or TRAINING.name not in {part.name for part in ready.study.parts}:
        message = "this case trains no policy, so that all seeds are the same"
        raise CaseError("--seeds", "", None, f"{loaded.file}: {message}")
    return ready


def _trained(
    one: Prepared, seed: int, requested: Wanted, progress: "ProgressCallback", began: float
) -> Trained:
    """The parts up to the training, done in the seed's folder."""
    parts = with_needs(one.study.parts, (KEPT, TRAINING.name))
    study = replace(one.study, parts=parts)

    def report(text: str) -> None:
        progress(f"seed {seed}: {text}")

    report("begins")
    result = carried_out(replace(one, study=study), requested.resume, report, began)
    return Trained(seed, one.study, one.out, result)


def _check_same(out: Path, one: Prepared) -> None:
    """**Raises:** `CaseError` where RUN holds a run that differs by more than its seed."""
    if not (out / run_folder.RUN).exists():
        return
    seeded = json.loads(json.dumps(one.decides))
    old = run_folder.read(out)["decides"].get("case", {}).get("training", {})
    seeded["case"].setdefault("training", {})["seed"] = old.get("seed")
    if "seed" not in old:
        del seeded["case"]["training"]["seed"]
    run_folder.check_same(out, seeded)


def _adopt(best: Prepared, source: Path, resume: bool) -> None:
    """The folder of the best seed as RUN; kept, but for the table, where it is the same already."""
    if resume and (best.out / run_folder.RUN).exists():
        record = run_folder.read(best.out)
        if run_folder.mark(record["decides"]) == run_folder.mark(best.decides):
            record["parts"].pop(TABLE, None)
            run_folder.save(best.out, record)
            return
    run_folder.become(best.out, source)


def _with_table(study: Study, comparison: SeedComparison) -> Study:
    """The study with the table of seeds as its first part, and a sentence in its result."""

    def keep(run: StudyRun) -> Mapping[str, Any]:
        write_csv(run.folder / SEEDS, SeedRow._fields, (_cells(row) for row in comparison.rows))
        return {"by_seed": comparison.table()}

    def result(run: StudyRun) -> Mapping[str, Any]:
        summary, table = dict(study.result(run)), run.get("by_seed")
        if not table:
            return summary
        return summary | {"seeds": table, "notes": [describe(table), *summary.get("notes", ())]}

    return replace(study, parts=[Part(TABLE, keep), *study.parts], result=result)


def _cells(row: SeedRow) -> Iterator[Any]:
    return ("" if item is None else item for item in row)


def _spent(comparison: SeedComparison) -> float:
    """The seconds of the seeds that are not the best one, whose own are in its run."""
    return sum(row.seconds for row in comparison.rows if row.seed != comparison.best)
