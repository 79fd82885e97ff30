"""The part of a study that trains, with a checkpoint so that a killed run can continue."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.lanes.machine.threads import in_thread
from snapo.problem.scenarios import Scenarios, Supplied
from snapo.report.folder import LEFT_OUT, PLANNED, RunResult
from snapo.report.record import RunRecord, entries_of
from snapo.solver import checkpoint
from snapo.solver.derivatives import solution_file
from snapo.solver.derivatives.rebuilt import LONG
from snapo.solver.evaluate import value_of_groups
from snapo.solver.learning.practice import refused
from snapo.solver.learning.progress import Interrupted
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solution import HISTORY, Solution
from snapo.solver.statistics import half_width, plus_minus, rounded, with_error
from snapo.solver.tables import write_csv
from snapo.solver.train import Progress, Record, initial_progress
from snapo.solver.verdict.convergence import CONVERGED, SIGNIFICANT, UNDECIDED, without_advice
from snapo.solver.verdict.further import Room, room

from .run_folder import CHECKPOINT, GROUPS
from .study import Part, Setup, StudyRun


def train(run: StudyRun) -> dict[str, Any]:
    """Solves the study's problem into the run folder.

    **Raises:** `Interrupted` after Ctrl-C, with the tables of the best policy so far.
    """
    setup, meanwhile = run.setup, run.study.meanwhile
    long = setup.problem.simulator.horizon > LONG  # its tables take much memory
    try:
        with in_thread(meanwhile) if meanwhile and not long else nullcontext():
            solution = setup.solve(
                callbacks=[lambda state: _keep(run, state, setup.training)],
                progress=_resumed(run, setup),
            )
    except Interrupted as stop:
        raise Interrupted(saved(run, stop.result)) from None
    return saved(run, solution)


def saved(run: StudyRun, solution: Solution) -> dict[str, Any]:
    """Writes a solution into the run folder, and returns the tables of the part."""
    run.trained = solution
    solution.save(run.folder)
    _keep_groups(run, solution)
    # Advice to train on comes with the bound, where one follows.
    automatic = any(part.name == "bound" for part in run.study.parts)
    run.progress("\n".join(without_advice(solution.lines()) if automatic else solution.lines()))
    return {
        "solution": solution.summary(),
        "engine": {"name": solution.engine, "reason": solution.reason},
        "paths": dict(solution.paths),
        "seed": solution.seed,
        "versions": dict(solution.versions),
    }


TRAINING = Part("training", train)


# A rule, the trained policy's gain over it, and its error.
Advantage = tuple[str, float | None, float | None]


def trained(
    run: StudyRun,
    references: Mapping[str, float | None] | None = None,
    advantages: Iterable[Advantage] = (),
    exact: float | None = None,
) -> dict[str, Any]:
    """The result of a study that trains; empty before the training.

    If the run has an upper bound or an `exact` value, the possible gain is the "verdict" on the
    terminal and the first note. `advantages`: the advantages over classical rules, on the same
    paths. If a rule is better than the policy, a note names the rule and replaces the verdict.
    """
    result = dict(run.get("solution", {}))
    if not result:
        return {}
    head = ("value", "standard_error", "smooth_value", "smoothing_gap", "policy_gradient_norm")
    first = {key: result.pop(key) for key in head}
    if left := room(first["value"], first["standard_error"], run.get("bound"), exact):
        result |= _with_room(RunResult.of(result), left)
    if beaten := _beaten(advantages):
        result |= {"notes": [*RunResult.of(result).notes, beaten], "verdict": beaten}
    return first | {"references": dict(references or {})} | result


def _with_room(result: RunResult, left: Room) -> dict[str, Any]:
    """The word for convergence, and the notes, if the possible gain is available; next to a bound,
    no note asks for more steps."""
    notes, word = result.notes, result.convergence
    if left.near:
        notes = without_advice(notes)
        word = CONVERGED if word in UNDECIDED else word
    return {"notes": [left.description, *notes], "convergence": word, "verdict": left.description}


def _beaten(advantages: Iterable[Advantage]) -> str:
    """A sentence on the rule that is furthest above the trained policy; empty if no rule is above
    it."""
    available = [(name, -lead, error) for name, lead, error in advantages if lead is not None]
    certain = [item for item in available if item[1] > SIGNIFICANT * (item[2] or 0.0)]
    if not certain:
        return ""
    name, more, error = max(certain, key=lambda entry: entry[1])
    return (
        f"The classical rule “{name}” does better than the trained policy, by "
        f"{rounded(more, 3)} {plus_minus(error or 0.0)} on the same paths; use this rule, or "
        f"train longer (training.steps)."
    )


def _keep_groups(run: StudyRun, solution: Solution) -> None:
    """Saves the values of independent groups of paths, and the fingerprint of their scenarios, for
    comparisons."""
    problem = run.setup.problem
    source, simulator = problem.sources.evaluation, problem.simulator
    controls = simulator.control_variates()
    value = value_of_groups(problem.objective, solution.totals, source, controls)
    noise = (simulator.horizon, simulator.initial_noise_size, simulator.noise_size)
    scenarios = {"source": fingerprint(source), "noise": noise, "paths": solution.paths["evaluate"]}
    solution_file.save_named(run.folder / GROUPS, {("groups",): value}, scenarios)


def fingerprint(source: Scenarios) -> str:
    """A text that is equal for equal scenarios; two runs on equal scenarios can be paired."""
    if not isinstance(source, Supplied):
        return repr(source)
    digest = hashlib.sha256(source.step_noise.tobytes())
    if source.initial_noise is not None:
        digest.update(source.initial_noise.tobytes())
    return f"supplied {source.step_noise.shape} {digest.hexdigest()}"


def _resumed(run: StudyRun, setup: Setup) -> Progress | None:
    """The state of the checkpoint, if it is requested and exists; else None."""
    file, training = run.folder / CHECKPOINT, setup.training
    if result := refused(setup.problem, training):
        key, why = result
        raise CaseError("case.toml", f"training.{key}", getattr(training, key), why)
    try:
        fresh = initial_progress(setup.policy, training, setup.problem)
    except ValueError as error:
        message = str(error).removeprefix("Training: window ").rstrip(".")
        raise CaseError("case.toml", "training.window", training.window, message) from None
    if not (run.resume and file.exists()):
        return None
    state = load_checkpoint(file, fresh, run.mark)
    run.progress(f"resuming after step {state.step}")
    return state


def load_checkpoint(file: Path, fresh: Progress, mark: str = "") -> Progress:
    """The state of training in `file`, shaped like `fresh`.

    **Raises:** `CaseError` if it is damaged, or belongs to a different policy or to a run with a
    different `mark`.
    """
    try:
        return checkpoint.load(file, fresh, mark)
    except solution_file.CheckpointError as error:
        message = str(error).removeprefix(f"{file}: ").rstrip(".")
        message = f"{message}; solve without --resume, or remove this file"
        raise CaseError(str(file), "", None, message) from None


def _keep(run: StudyRun, state: Progress, training: TrainingPlan) -> None:
    """Writes the best policy and the history so far to disk; if writing fails, the run
    continues."""
    if state.history:
        last = state.history[-1]
        half = half_width(last.exact_error)
        best = with_error(last.best, half).partition(" ±")[0]
        run.progress(
            f"step {last.step:>5} of {training.steps}: validation "
            f"{with_error(last.exact, half):>20}, best {best:>12}, {last.seconds:6.1f} s"
        )
    try:
        checkpoint.save(state, run.folder / CHECKPOINT, run.mark)
        write_csv(run.folder / HISTORY, Record._fields, state.history)
    except OSError as error:
        run.troubles.append(f"{error.filename or run.folder}: {error.strerror}")
        run.progress(f"could not write: {run.troubles[-1]}")


def with_needs(parts: Sequence[Part], requested: Sequence[str]) -> list[Part]:
    """The parts with these names, and the parts that they need; all parts if there are no names."""
    if not requested:
        return list(parts)
    by_name = {part.name: part for part in parts}
    selected: set[str] = set()
    left = [name for name in requested if name in by_name]
    while left:
        name = left.pop()
        if name not in selected:
            selected.add(name)
            left += by_name[name].needs
    return [part for part in parts if part.name in selected]


def summary(parts: Sequence[Part], selected: Sequence[Part]) -> dict[str, list[str]]:
    """Entries in a study's `about` for a report: the names of the parts that are `selected`, and of
    those that are omitted."""
    return {
        PLANNED: [part.name for part in selected],
        LEFT_OUT: [part.name for part in parts if part not in selected],
    }


def no_policy(out: Path, record: Mapping[str, Any]) -> CaseError:
    """The reason why the run in a folder, with this record, has no trained policy."""
    message = "this run has no trained policy; solve its case again, or continue with --resume"
    if TRAINING.name in entries_of(RunRecord, record).about.get(LEFT_OUT, ()):
        message = (
            "this run has no trained policy, because its `[report] parts` do not include "
            "the training"
        )
    return CaseError(str(out), "", None, message)
