"""Trains one case with several seeds, and compares the policies on common paths that are used for
nothing else."""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, Scenarios, Sobol, stream
from snapo.report.folder import RunResult
from snapo.report.record import RunRecord, entries_of
from snapo.solver import statistics
from snapo.solver.checkpoint import CheckpointError
from snapo.solver.evaluate import estimate, path_totals, value_of_groups
from snapo.solver.limits import Contender, LimitFound, best_first
from snapo.solver.solution import Solution
from snapo.solver.tables import write_csv

from . import run_folder
from .domain import CaseRequest, Loaded, load, remarks
from .initial_policy import KEPT
from .prepare import Prepared, Wanted, carried_out, decided, made_ready
from .run_folder import SEEDS
from .runs.reserve import reserved
from .study import Part, Setup, Study, StudyRun
from .training import TRAINING, with_needs

if TYPE_CHECKING:
    from .study import ProgressCallback

STREAM = 0x5EED  # of the evaluation's scenarios: those on which seeds are compared


class Trained(NamedTuple):
    """One seed: its study and the result of its training."""

    seed: int
    study: Study
    folder: Any
    result: RunResult


class SeedRow(NamedTuple):
    """One seed in the table of seeds.

    - `value`, `standard_error`: the value on the paths that all seeds share, and its error; None if
      training failed.
    - `below_best`, `below_best_error`: the value of the best seed minus this value, paired path by
      path, and its error.
    - `within`: whether all limits of the problem are met, or nearly met, on the paths of the run.
    """

    seed: int
    value: float | None
    standard_error: float | None
    below_best: float | None
    below_best_error: float | None
    within: bool
    status: str
    convergence: str
    seconds: float
    run: str


class SeedComparison(NamedTuple):
    """The comparison of all seeds.

    - `best`: the seed with the highest value, among those within their limits if there are any (see
      `solver.limits.best_first`).
    - `mean`, `worst`, `highest`, `deviation`: statistics of the values; `standard_error`: the Monte
      Carlo error of their mean, which all values share.
    - `fresh`: whether the paths are used for nothing else; `paths`: the number of paths.
    """

    rows: tuple[SeedRow, ...]
    best: int
    mean: float
    worst: float
    highest: float
    deviation: float
    standard_error: float
    fresh: bool
    paths: int

    def table(self) -> dict[str, Any]:
        """The comparison as plain data."""
        return self._asdict() | {"rows": [row._asdict() for row in self.rows]}


def compared(trained: Sequence[Trained]) -> SeedComparison:
    """Compares the policies of all seeds on common paths of the first seed's problem."""
    setup = _setup(trained[0].study)
    problem, fresh = _measured_on_others(setup)
    results = [_shares(problem, setup, item) for item in trained]
    means = [np.mean(entry) if entry is not None else np.nan for entry in results]
    values = np.array(means, np.float64)
    contenders = [_contender(value, item.result) for value, item in zip(values, trained)]
    best = best_first(contenders)[0]
    rows = tuple(
        _row(each, shares, results[best], contender.within)
        for each, shares, contender in zip(trained, results, contenders)
    )
    available = [result for result in results if result is not None and np.isfinite(result).all()]
    selected = values[np.isfinite(values)]
    error = statistics.of_shares(np.mean(available, axis=0)).standard_error if available else np.nan
    endpoints = (np.mean, np.min, np.max)
    mean, worst, highest = (
        float(endpoint(selected)) if selected.size else np.nan for endpoint in endpoints
    )
    return SeedComparison(
        rows,
        trained[best].seed,
        mean,
        worst,
        highest,
        float(selected.std(ddof=1)) if selected.size > 1 else np.nan,
        float(error),
        fresh,
        problem.sources.evaluation.available(setup.evaluation.paths),
    )


def _setup(study: Study) -> Setup:
    assert study.setup is not None
    return study.setup()


def _measured_on_others(setup: Setup) -> tuple[Problem, bool]:
    """The problem on separate scenarios for the comparison, if they can be drawn."""
    problem, sources = setup.problem, setup.problem.sources
    others: Scenarios = sources.evaluation
    fresh = isinstance(others, Pseudo | Sobol)
    if fresh:
        others = Pseudo(setup.training.seed, stream=stream(EVALUATE, STREAM))
    problem = replace(problem, sources=replace(sources, evaluation=others))
    return problem.prepared(setup.problem.schedule), fresh


def _shares(problem: Problem, setup: Setup, item: Trained) -> np.ndarray | None:
    """The values of independent groups of paths under a seed's policy; None if it has none."""
    try:
        policy = Solution.load(item.folder, like=_setup(item.study).policy).policy
    except CheckpointError:
        return None
    paths, engine = setup.evaluation.paths, setup.engines.evaluate
    totals = path_totals(problem, policy, paths, engine=engine)  # pyright: ignore
    source, controls = problem.sources.evaluation, problem.simulator.control_variates()
    value = estimate(problem.objective, totals, source, controls).value
    shares = value_of_groups(problem.objective, totals, source, controls)
    return shares if np.isfinite(value) else np.full_like(shares, np.nan)


def _contender(value: float, result: RunResult) -> Contender:
    unknown = dict[str, Any](value=np.nan, level=np.nan, multiplier=np.nan)
    limits = [
        LimitFound(**item | {name: x for name, x in unknown.items() if item[name] is None})
        for item in result.limits
    ]
    return Contender.of(float(value), limits)


def _row(
    item: Trained, shares: np.ndarray | None, best: np.ndarray | None, within: bool
) -> SeedRow:
    available = None if shares is None else statistics.of_shares(shares)
    behind = None if shares is None or best is None else statistics.of_shares(best - shares)
    result = item.result
    return SeedRow(
        item.seed,
        available and available.value,
        available and available.standard_error,
        behind and behind.value,
        behind and behind.standard_error,
        within,
        result.status,
        result.convergence,
        result.seconds["total"],
        f"seeds/{item.seed}",
    )


def describe(result: Mapping[str, Any]) -> str:
    """A sentence on the effect that the choice of the best seed has on the reported value."""
    from snapo.report.quantity import decimals, finite, number

    rows, best = result["rows"], result["best"]
    sizes = [finite(result[name]) for name in ("deviation", "standard_error")]
    digits = max(0, decimals([size for size in sizes if size] or [result["mean"]], 2))
    endpoints = [number(result[name], digits) for name in ("worst", "highest", "mean")]
    text = (
        f"Best of {len(rows)} seeds: {best}. On {result['paths']:,} common paths their values lie "
        f"between {endpoints[0]} and {endpoints[1]}, with the mean {endpoints[2]}"
    )
    if sizes[0] is not None and sizes[1] is not None:
        text += (
            f" and the standard deviation {number(sizes[0], digits)} between seeds, in addition "
            f"to a Monte Carlo error of {number(sizes[1], digits)} that all of them share"
        )
    if result["standard_error"] == 0:  # nothing is random
        return f"{text}."
    if result["fresh"]:
        return (
            f"{text}. The value of this run is from other paths, which were not used for this "
            f"choice."
        )
    return (
        f"{text}. No other paths are available, so the value of this run is from the paths on "
        f"which the best seed was chosen, and is biased slightly upwards."
    )


TABLE = "seeds"  # the name of the part, and of the folder with the runs


def solve_seeds(
    request: CaseRequest,
    progress: "ProgressCallback",
    out: Path | None,
    requested: Wanted,
    seeds: int | Sequence[int],
) -> dict[str, Any]:
    """Trains every seed, and carries out the run of the best seed; returns the content of
    result.json. `seeds`: the number of consecutive seeds from the seed of the case on, or the seeds
    themselves.

    **Raises:** `CaseError` if the case trains nothing, or the folder contains another run.
    """
    began = time.perf_counter()
    loaded = load(request)
    remarks(loaded.case.notes, progress)
    numbers = _numbers(loaded, seeds)
    first = load(_with_seed(request, numbers[0]))
    same = partial(_is_same, first, requested=requested) if requested.resume else None
    with reserved(loaded.file.parent, out, same) as folder:
        trained, ready = [], {}
        for seed in numbers:
            one = _ready(load(_with_seed(request, seed)), folder, seed, requested)
            if seed == numbers[0]:
                remarks(one.study.about["notes"], progress, ignored=loaded.case.notes)
                if requested.resume:
                    _check_same(folder, one.decides)
            ready[seed] = one
            requested = requested._replace(about=one.study.about)  # checks are those of the case
            trained.append(_trained(one, seed, requested, progress, began))
            began = time.perf_counter()
        progress(f"comparing {len(numbers)} seeds")
        result = compared(trained)
        adjacent = {"other seeds": _spent(result), "comparison": time.perf_counter() - began}
        best = replace(ready[result.best], out=folder)
        _adopt(best, folder / TABLE / str(result.best), requested.resume)
        best = replace(best, study=_with_table(best.study, result))
        return carried_out(best, True, progress, time.perf_counter(), adjacent)


def _with_seed(request: CaseRequest, seed: int) -> CaseRequest:
    return request._replace(assignments=(*request.assignments, f"training.seed={seed}"))


def _numbers(loaded: Loaded, seeds: int | Sequence[int]) -> list[int]:
    if not isinstance(seeds, int):
        return list(seeds)
    training = loaded.data.get("training")
    first = training.get("seed") if isinstance(training, Mapping) else None
    if first is None:
        first = getattr(getattr(loaded.case, "training", None), "seed", 0)
    return list(range(first, first + seeds))


def _ready(loaded: Loaded, out: Path, seed: int, requested: Wanted) -> Prepared:
    """The run of one seed, in a separate folder."""
    folder = out / TABLE / str(seed)
    selected, values = folder / run_folder.START, requested.policy
    # RUN may be the folder of the given policy, and another run by now.
    if values and requested.resume and selected.exists() and values.resolve() == out.resolve():
        requested = requested._replace(policy=selected)
    ready = made_ready(loaded, folder, requested)
    if ready.study.setup is None or TRAINING.name not in {part.name for part in ready.study.parts}:
        message = "this case trains no policy, so all seeds would give the same result"
        raise CaseError("--seeds", "", None, f"{loaded.file}: {message}")
    return ready


def _trained(
    one: Prepared, seed: int, requested: Wanted, progress: "ProgressCallback", began: float
) -> Trained:
    """Computes the parts up to the training in the folder of the seed."""
    parts = with_needs(one.study.parts, (KEPT, TRAINING.name))
    study = replace(one.study, parts=parts)

    def report(text: str) -> None:
        progress(f"seed {seed}: {text}")

    report("begins")
    result = carried_out(replace(one, study=study), requested.resume, report, began)
    return Trained(seed, one.study, one.out, RunResult.of(result))


def _is_same(loaded: Loaded, out: Path, requested: Wanted) -> bool:
    """Whether a folder has this run of several seeds, or some of its trainings. **Raises:**
    `CaseError` if it has a run that differs in more than its seed.
    """
    decides, _ = decided(loaded, out, requested)
    records = [out / run_folder.RUN, *sorted(out.glob(f"{TABLE}/*/{run_folder.RUN}"))]
    folder = next((file.parent for file in records if file.exists()), None)
    if folder is not None:
        _check_same(folder, decides)
    return folder is not None


def _check_same(out: Path, decides: Mapping[str, Any]) -> None:
    """**Raises:** `CaseError` if RUN holds a run that differs in more than its seed."""
    if not (out / run_folder.RUN).exists():
        return
    seeded = json.loads(json.dumps(decides))
    old = entries_of(RunRecord, run_folder.read(out)).settings.case.get("training", {})
    seeded["case"].setdefault("training", {})["seed"] = old.get("seed")
    if "seed" not in old:
        del seeded["case"]["training"]["seed"]
    run_folder.check_same(out, seeded)


def _adopt(best: Prepared, source: Path, resume: bool) -> None:
    """Makes the folder of the best seed RUN. If RUN already is this run, it is not changed, except
    that its table of seeds is removed."""
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
        return summary | {"seeds": table, "notes": [describe(table), *RunResult.of(summary).notes]}

    return replace(study, parts=[Part(TABLE, keep), *study.parts], result=result)


def _cells(row: SeedRow) -> Iterator[Any]:
    return ("" if item is None else item for item in row)


def _spent(comparison: SeedComparison) -> float:
    """The time of all seeds except the best one, whose time is in its run, in seconds."""
    return sum(row.seconds for row in comparison.rows if row.seed != comparison.best)
