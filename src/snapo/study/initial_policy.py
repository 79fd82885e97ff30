"""A trained policy from a file, with which the training of a study begins.

It is the policy.npz of a run folder, or a file that `policy.save` wrote: arrays, and texts that
describe them. Reading it executes no code. The trained numbers come from the file; everything else,
such as limits of an action or present holdings, comes from the case. The study gets two more parts:
a copy of the policy, so that the run can be resumed without the original file, and the gain of
training over this policy on the paths of the value.
"""

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.case.error import CaseError
from snapo.problem.carry.arrays import read_arrays
from snapo.problem.carry.latest import followed
from snapo.problem.carry.save import PolicyFileError, described, stored
from snapo.problem.policy import Policy, trainable
from snapo.report.folder import RunResult
from snapo.report.quantity import decimals, finite, measured, number
from snapo.report.record import RunRecord, entries_of
from snapo.solver import statistics
from snapo.solver.evaluate import estimate, path_totals, value_of_groups
from snapo.solver.learning.progress import INTERRUPTED
from snapo.solver.solution import POLICY

from . import run_folder
from .run_folder import START
from .study import Part, Setup, Study, StudyRun, with_change
from .training import TRAINING, no_policy

ZIP = b"PK"  # with which every .npz begins
OWN = re.compile(r"\.(low|high|groups)(\W|$)")  # settings that are those of the case, not trained


@dataclass(frozen=True, eq=False)
class SuppliedPolicy:
    """A policy to begin with, before its fit has been checked.

    - `source`: the run folder or the file, as the command names it; `file`: the file that was read.
    - `content`: the bytes of the file; `value`: the value of the policy in its run, if there is
      one.
    - `arrays`: all numbers of the policy, in order; `text`: {position: kinds, sizes, functions}.
    """

    source: Path
    file: Path
    content: bytes
    arrays: tuple[np.ndarray, ...]
    text: Mapping[str, str]
    value: float | None = None

    @property
    def checksum(self) -> str:
        """The checksum of the file; a resumed run must begin with the same file."""
        return f"sha256 {hashlib.sha256(self.content).hexdigest()[:16]}"

    def adopted_by(self, local: Policy) -> Policy:
        """The policy of a case, `local`, with the trained numbers of this policy. **Raises:**
        `CaseError` if the kinds or the sizes of the two policies differ.
        """
        needed = described({"policy": local})
        for position, word in needed.items():
            if self.text.get(position, word) != word and not OWN.search(position):
                has, needs = self.text[position], word
                raise self._misfit(_name(position), has, needs)
        leaves = jax.tree_util.tree_flatten_with_path(eqx.filter(local, eqx.is_array))[0]
        sizes = [array.shape for array in self.arrays], [leaf.shape for _, leaf in leaves]
        if len(sizes[0]) != len(sizes[1]):
            raise self._misfit("sizes", *map(_sizes, sizes))
        moved = {path for path, _ in jax.tree_util.tree_flatten_with_path(trainable(local)[0])[0]}
        for (path, leaf), result in zip(leaves, self.arrays):
            if path in moved and leaf.shape != result.shape:
                message = f"{jax.tree_util.keystr(path).strip('.')} of size"
                raise self._misfit(message, _size(result.shape), _size(leaf.shape), _seen(*sizes))
        return _with(local, moved, self.arrays)

    def _misfit(self, subject: str, has: str, needs: str, more: str = "") -> CaseError:
        text = (
            f"this policy does not fit the case: it has {subject} {has}, but the case needs {needs}"
        )
        return CaseError(str(self.file), "", None, text + more)


def read(source: Path, kind: str, out: Path, resume: bool) -> SuppliedPolicy:
    """The policy of a run folder or of a file.

    - `kind`: the kind of the case; `out`: the folder of the new run. If both folders are the same,
      the policy is read before the new run removes it, and a resumed run reads its copy.

    **Raises:** `CaseError` if there is no policy, or it is damaged, or from a run of a different
    kind.
    """
    source = followed(source)
    value, file = None, source
    if source.is_dir():
        if resume and (out / run_folder.START).exists() and source.resolve() == out.resolve():
            file = out / run_folder.START
        else:
            value, file = _of_run(source, kind), source / POLICY
    if not file.is_file():
        message = (
            "there is no policy here; name a folder that `snapo solve` wrote, its policy.npz, "
        )
        raise CaseError("--policy", "", str(source), message + "or a file that policy.save wrote")
    try:
        content = file.read_bytes()
        if not content.startswith(ZIP):
            raise ValueError("this is not an .npz file")
        header = read_arrays(file)[1]
    except OSError as error:
        raise CaseError(str(file), "", None, f"cannot be read ({error.strerror})") from None
    except ValueError as error:
        message = str(error).removeprefix(f"{file}: ").rstrip(".")
        raise CaseError(str(file), "", None, message) from None
    text, leaves = _parted(file, header)
    return SuppliedPolicy(source, file, content, tuple(leaves), text, value)


def _of_run(run: Path, kind: str) -> float | None:
    """The value of a run whose policy is undamaged."""
    record = run_folder.read(run)
    if record["kind"] != kind:
        message = f'this run is of kind "{record["kind"]}", but the case is of kind "{kind}"'
        raise CaseError(str(run / run_folder.RUN), "", None, message)
    state = entries_of(RunRecord, record).part(TRAINING.name).state
    if state not in ("done", INTERRUPTED):
        raise no_policy(run, record)
    run_folder.check_whole(run, record, (POLICY,))
    return RunResult.read(run).value


def _parted(file: Path, header: Any) -> tuple[Mapping[str, str], list[Any]]:
    """The texts and arrays of the policy."""
    if isinstance(header, dict) and isinstance(header.get("header"), dict):
        message = (
            "this file is the state of a training; name the folder of its run, or the "
            "policy.npz in it"
        )
        raise CaseError(str(file), "", None, message)
    try:
        content = stored(file, Policy)
    except PolicyFileError as error:
        message = str(error).removeprefix(f"{file}: ").rstrip(".")
        raise CaseError(str(file), "", None, message) from None
    return content.described, content.leaves


def _with(policy: Policy, names: set[Any], arrays: tuple[np.ndarray, ...]) -> Policy:
    """The policy with new numbers in place of the trained numbers."""
    numbers, rest = eqx.partition(policy, eqx.is_array)
    flat, structure = jax.tree_util.tree_flatten_with_path(numbers)
    new = [
        jnp.asarray(result, leaf.dtype) if path in names else leaf
        for (path, leaf), result in zip(flat, arrays)
    ]
    return eqx.combine(structure.unflatten(new), rest)


def _name(position: str) -> str:
    """A part of a policy as text: "the activation" for "policy.network.activation"."""
    if position == "policy kind":
        return "the kind"
    return position.removeprefix("policy.").replace(" kind", "")


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) or "1"


def _sizes(shapes: list[tuple[int, ...]]) -> str:
    return ", ".join(map(_size, shapes))


def _seen(has: list[tuple[int, ...]], needs: list[tuple[int, ...]]) -> str:
    """A clause on the numbers of observations of the two policies, if these differ."""
    first = [
        next((shape[1] for shape in shapes if len(shape) == 2), None) for shapes in (has, needs)
    ]
    if None in first or first[0] == first[1]:
        return ""
    return f": its network takes {first[0]} numbers, but the case has {first[1]}"


KEPT, GAIN = "given policy", "gain over the initial policy"


def begun_with(study: Study, values: SuppliedPolicy, file: str) -> Study:
    """The study with the supplied policy instead of its untrained policy; `file`: the file of its
    case. **Raises:** `CaseError` if nothing is trained, or the policy does not fit.
    """
    if study.setup is None or TRAINING.name not in {part.name for part in study.parts}:
        message = f"{file} trains no policy, so an initial policy cannot be used"
        raise CaseError("--policy", "", str(values.source), message)

    def adopt(setup: Setup) -> Setup:
        return setup._replace(policy=values.adopted_by(setup.policy), recipe=None)

    setup = with_change(study.setup, adopt)
    setup()  # a misfit is refused before anything is written
    after = 1 + next(i for i, part in enumerate(study.parts) if part.name == TRAINING.name)
    parts = [
        Part(KEPT, _kept(values)),
        *study.parts[:after],
        Part(GAIN, _gain, (KEPT, TRAINING.name)),
        *study.parts[after:],
    ]
    return replace(study, parts=parts, setup=setup, result=_told(study.result))


def _kept(values: SuppliedPolicy) -> Callable[[StudyRun], Mapping[str, Any]]:
    def work(run: StudyRun) -> Mapping[str, Any]:
        (run.folder / START).write_bytes(values.content)
        about = {"policy": str(values.source), "checksum": values.checksum, "value": values.value}
        return {"began_with": about}

    return work


def _gain(run: StudyRun) -> Mapping[str, Any]:
    """The value of the supplied policy in this run, and the gain of the trained policy over it."""
    setup, solution = run.setup, run.solution
    problem, engine = setup.problem, setup.engines.evaluate
    source, controls = problem.sources.evaluation, problem.simulator.control_variates()
    totals = path_totals(problem, setup.policy, solution.paths["evaluate"], engine=engine)
    value = estimate(problem.objective, totals, source, controls)
    both = (solution.totals, totals)
    shares = [value_of_groups(problem.objective, item, source) for item in both]
    with np.errstate(invalid="ignore"):
        more = statistics.of_shares(np.subtract(*shares))
    return {
        "start_gain": {
            "before": value.value,
            "before_error": value.standard_error,
            "value": more.value,
            "standard_error": more.standard_error,
        }
    }


def _told(result: Callable[[StudyRun], Mapping[str, Any]]):
    """The result with the initial policy, and a sentence on it for the report."""

    def report(run: StudyRun) -> Mapping[str, Any]:
        results, start = dict(result(run)), run.get("began_with")
        head = RunResult.of(results)
        if not start or head.value is None:
            return results
        gain = run.get("start_gain") or {}
        sentence = describe(start, gain)
        return results | {
            "start": {**start, **gain},
            "notes": [*head.notes, sentence],
        }

    return report


def describe(start: Mapping[str, Any], gain: Mapping[str, Any]) -> str:
    """The initial policy of training, and the gain over it."""
    text = f"Training began with the policy of {start['policy']}"
    if start["value"] is not None:
        text += f", whose value in its run is {number(start['value'])}"
    if not gain or gain["before"] is None:
        return f"{text}."
    before = _with_error(gain["before"], gain["before_error"])
    more = _with_error(gain["value"], gain["standard_error"])
    return (
        f"{text}. In this run its value is {before}; training gained {more} over it on the "
        f"same paths."
    )


def _with_error(value: float, error: float | None) -> str:
    digits = max(0, decimals([error], 2)) if finite(error) else 4
    return " ".join(measured(value, error, digits)).strip()
