"""A run that leaves everything in a folder, survives being stopped, and goes on where it was."""

import hashlib
import json
import math
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.case.error import CaseError
from snapo.engine import Engines, choose
from snapo.problem.objective import Objective
from snapo.problem.policy import MLP, Policy
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Scenarios, Supplied
from snapo.problem.simulator import Schedule, Simulator, probe
from snapo.solver import checkpoint
from snapo.solver import solve as solver
from snapo.solver.files import write_csv, write_text
from snapo.solver.solution import HISTORY, RESULT, Solution
from snapo.solver.train import Progress, Record, Training, begin
from snapo.solver.versions import versions

CHECKPOINT = "checkpoint.npz"
DETAILS, PROFILE = "details.json", "profile.csv"
ENOUGH_SPACE = 64 << 20  # bytes that a run folder may need

Tell = Callable[[str], None]


class Task(NamedTuple):
    """What is solved: the arguments of `snapo.solve`, all of them settled."""

    simulator: Simulator
    inputs: PyTree
    schedule: Schedule
    policy: Policy
    objective: Objective
    training: Training
    evaluation: solver.Evaluation
    engines: Engines
    scenarios: Scenarios | None = None
    supplied: Supplied | None = None


def check_folder(out: Path) -> None:
    """An unwritable folder or a full disk is found before training, not after."""
    place = out
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise CaseError(str(out), "", None, f"{place} is not a folder")
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise CaseError(str(out), "", None, f"cannot write there ({error.strerror})") from None
    free = shutil.disk_usage(place).free
    if free < ENOUGH_SPACE:
        what = f"{free >> 20} MB are free there; a run needs {ENOUGH_SPACE >> 20} MB"
        raise CaseError(str(out), "", None, what)


def solve_into(out: Path, task: Task, resume: bool, tell: Tell) -> tuple[Solution, list[str]]:
    """Solves with a checkpoint and the history in `out`; also returns what could not be written."""
    out.mkdir(parents=True, exist_ok=True)
    mark = fingerprint(task)
    state = _state(out / CHECKPOINT, begin(task.policy, task.training), mark, resume, tell)
    troubles: list[str] = []

    def keep(state: Progress) -> None:
        """Best policy and history so far, on disk; a write that fails does not lose the run."""
        _report(state, task.training, tell)
        try:
            checkpoint.save(state, out / CHECKPOINT, mark)
            write_csv(out / HISTORY, Record._fields, state.history)
        except OSError as error:
            troubles.append(f"{error.filename or out}: {error.strerror}")
            tell(f"could not write: {troubles[-1]}")

    solution = solver.solve(
        task.simulator,
        task.inputs,
        task.policy,
        objective=task.objective,
        scenarios=task.scenarios,
        training=task.training,
        evaluation=task.evaluation,
        engine=task.engines,
        callbacks=[keep],
        progress=state,
        supplied=task.supplied,
    )
    tell(str(solution))
    return solution, troubles


def _state(file: Path, fresh: Progress, mark: Mapping, resume: bool, tell: Tell) -> Progress:
    """Where training starts: at the checkpoint when asked and there is one, else afresh."""
    if not (resume and file.exists()):
        return fresh
    try:
        state = checkpoint.load(file, fresh, mark)
    except checkpoint.CheckpointError as error:
        what = str(error).removeprefix(f"{file}: ").rstrip(".")
        raise CaseError(str(file), "", None, what) from None
    tell(f"resuming after step {state.step}")
    return state


def fingerprint(task: Task) -> dict[str, Any]:
    """What decides the numbers of a run: a resumed one must have the same."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(task.schedule):
        digest.update(np.ascontiguousarray(leaf).tobytes())
    return {
        checkpoint.DIGEST: digest.hexdigest(),
        "training": asdict(task.training),
        "objective": repr(task.objective),
        "engine": task.engines.name,
        "versions": versions(),
    }


def _report(state: Progress, training: Training, tell: Tell) -> None:
    if state.history:
        last = state.history[-1]
        tell(
            f"step {last.step:>5} of {training.steps}: exact value {last.exact:>14,.7g}, "
            f"best {last.best:>14,.7g}, {last.seconds:6.1f} s"
        )


class Pages(NamedTuple):
    """What a domain adds to a run folder.

    - `details`: the figures of the report, as plain data or NumPy.
    - `profile`: header and rows of `profile.csv`, from the details.
    - `report`: writes `report.html` from the files in a folder.
    """

    details: Callable[[], dict[str, Any]]
    profile: Callable[[dict[str, Any]], tuple[Iterable[str], Iterable[Iterable]]]
    report: Callable[[Path], Path]


def write_run(
    out: Path,
    kind: str,
    solution: Solution,
    references: Mapping[str, float | None],
    troubles: list[str],
    pages: Pages,
    tell: Tell,
) -> dict[str, Any]:
    """The files of a finished run, and what `result.json` says.

    What cannot be written, now or during training (`troubles`), becomes a status.
    """
    found = solution.summary()
    head = ("value", "standard_error", "smooth_value", "smoothing_gap", "policy_gradient_norm")
    result = {"kind": kind} | {key: found.pop(key) for key in head} | {"references": references}
    status = "not written" if troubles else solution.status
    result |= found | {"status": status, "run": str(out)}
    try:
        solution.save(out)
        write_text(out / RESULT, json.dumps(plain_json(result), indent=1))
        tell("measuring what the report shows")
        details = pages.details()
        write_text(out / DETAILS, json.dumps(plain_json(details)))
        write_csv(out / PROFILE, *pages.profile(details))
        pages.report(out)
    except OSError as error:
        tell(f"could not write: {error.filename or out}: {error.strerror}")
        result["status"] = "not written"
    return result


def copy_case(file: Path, out: Path) -> None:
    """A copy of the case beside its results, with the plain files that may belong to it."""
    target = out / "case"
    target.mkdir(exist_ok=True)
    for each in file.parent.iterdir():
        if each.is_file() and each.suffix.lower() in (".toml", ".csv"):
            shutil.copyfile(each, target / each.name)


def plain_json(value: Any) -> Any:
    """Plain JSON data: NumPy becomes lists, what is not finite becomes null."""
    if isinstance(value, dict):
        return {str(key): plain_json(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain_json(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def solve_own(
    *,
    simulator: Simulator,
    inputs: PyTree,
    objective: Objective,
    training: Any,
    evaluation: Any,
    out: Path,
    seed: int,
    engine: str,
    resume: bool,
    progress: Tell,
) -> dict[str, Any]:
    """A simulator of the user's own, for `snapo solve CASE --simulator module:Class`."""
    check_folder(Path(out))
    settings = replace(Training(**training.model_dump()), seed=seed)
    schedule = prepare(simulator, inputs)
    features = probe(simulator, schedule)[1].shape[0]
    policy = MLP(simulator.action, features, key=jax.random.key(seed))
    engines = choose(engine, simulator, policy, schedule)
    measured = solver.Evaluation(**evaluation.model_dump())
    task = Task(simulator, inputs, schedule, policy, objective, settings, measured, engines)
    solution, troubles = solve_into(Path(out), task, resume, progress)
    solution.save(out)
    status = "not written" if troubles else solution.status
    return {"kind": type(simulator).__name__} | solution.summary() | {"status": status, "run": out}
