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
from snapo.solver.files import write_csv

from .. import run_folder
from ..choice import chosen
from ..domain import Asked, Loaded, load, remarks
from ..run_folder import SEEDS
from ..study import Part, Study, StudyRun
from ..training import TRAINING
from .begun import KEPT
from .by_seed import Comparison, Row, Trained, compared, words
from .prepare import Ready, Wanted, carried_out, made_ready, place

if TYPE_CHECKING:
    from ..study import Tell

TABLE = "seeds"  # the name of the part, and of the folder with the runs


def solve_seeds(
    asked: Asked, tell: "Tell", out: Path | None, wanted: Wanted, seeds: int | Sequence[int]
) -> dict[str, Any]:
    """Trains every seed, and carries out the run of the best; returns what result.json says.

    `seeds`: how many, from the seed of the case on, or the seeds themselves.

    **Raises:** `CaseError` where the case trains nothing, or another run lies in the folder.
    """
    began = time.perf_counter()
    loaded = load(asked)
    remarks(loaded.case.notes, tell)
    out = place(loaded, out)
    numbers = _numbers(loaded, seeds)
    trained, ready = [], {}
    for seed in numbers:
        own = asked._replace(assignments=(*asked.assignments, f"training.seed={seed}"))
        one = _ready(load(own), out, seed, wanted)
        if seed == numbers[0]:
            remarks(one.study.about["notes"], tell, known=loaded.case.notes)
            if wanted.resume:
                _check_same(out, one)
        ready[seed] = one
        wanted = wanted._replace(about=one.study.about)  # the checks are those of the case
        trained.append(_trained(one, seed, wanted, tell, began))
        began = time.perf_counter()
    tell(f"comparing {len(numbers)} seeds")
    found = compared(trained)
    beside = {"other seeds": _spent(found), "comparison": time.perf_counter() - began}
    best = replace(ready[found.best], out=out)
    _adopt(best, out / TABLE / str(found.best), wanted.resume)
    best = replace(best, study=_with_table(best.study, found))
    return carried_out(best, True, tell, time.perf_counter(), beside)


def _numbers(loaded: Loaded, seeds: int | Sequence[int]) -> list[int]:
    if not isinstance(seeds, int):
        return list(seeds)
    training = loaded.data.get("training")
    first = training.get("seed") if isinstance(training, Mapping) else None
    if first is None:
        first = getattr(getattr(loaded.case, "training", None), "seed", 0)
    return list(range(first, first + seeds))


def _ready(loaded: Loaded, out: Path, seed: int, wanted: Wanted) -> Ready:
    """The run of one seed in its own folder."""
    folder = out / TABLE / str(seed)
    kept, given = folder / run_folder.START, wanted.policy
    # RUN may be the folder of the given policy, and another run by now.
    if given and wanted.resume and kept.exists() and given.resolve() == out.resolve():
        wanted = wanted._replace(policy=kept)
    ready = made_ready(loaded, folder, wanted)
    if ready.study.setup is None or TRAINING.name not in {each.name for each in ready.study.parts}:
        what = "this case trains no policy, so that all seeds are the same"
        raise CaseError("--seeds", "", None, f"{loaded.file}: {what}")
    return ready


def _trained(one: Ready, seed: int, wanted: Wanted, tell: "Tell", began: float) -> Trained:
    """The parts up to the training, done in the seed's folder."""
    parts = chosen(one.study.parts, (KEPT, TRAINING.name))
    study = replace(one.study, parts=parts)

    def told(text: str) -> None:
        tell(f"seed {seed}: {text}")

    told("begins")
    result = carried_out(replace(one, study=study), wanted.resume, told, began)
    return Trained(seed, one.study, one.out, result)


def _check_same(out: Path, one: Ready) -> None:
    """**Raises:** `CaseError` where RUN holds a run that differs by more than its seed."""
    if not (out / run_folder.RUN).exists():
        return
    seeded = json.loads(json.dumps(one.decides))
    old = run_folder.read(out)["decides"].get("case", {}).get("training", {})
    seeded["case"].setdefault("training", {})["seed"] = old.get("seed")
    if "seed" not in old:
        del seeded["case"]["training"]["seed"]
    run_folder.check_same(out, seeded)


def _adopt(best: Ready, source: Path, resume: bool) -> None:
    """The folder of the best seed as RUN; kept, but for the table, where it is the same already."""
    if resume and (best.out / run_folder.RUN).exists():
        record = run_folder.read(best.out)
        if run_folder.mark(record["decides"]) == run_folder.mark(best.decides):
            record["parts"].pop(TABLE, None)
            run_folder.save(best.out, record)
            return
    run_folder.become(best.out, source)


def _with_table(study: Study, found: Comparison) -> Study:
    """The study with the table of seeds as its first part, and a sentence in its result."""

    def keep(run: StudyRun) -> Mapping[str, Any]:
        write_csv(run.folder / SEEDS, Row._fields, (_cells(row) for row in found.rows))
        return {"by_seed": found.table()}

    def result(run: StudyRun) -> Mapping[str, Any]:
        told, table = dict(study.result(run)), run.get("by_seed")
        if not table:
            return told
        return told | {"seeds": table, "notes": [words(table), *told.get("notes", ())]}

    return replace(study, parts=[Part(TABLE, keep), *study.parts], result=result)


def _cells(row: Row) -> Iterator[Any]:
    return ("" if each is None else each for each in row)


def _spent(found: Comparison) -> float:
    """The seconds of the seeds that are not the best one, whose own are in its run."""
    return sum(row.seconds for row in found.rows if row.seed != found.best)
