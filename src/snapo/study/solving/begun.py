"""A study whose training begins with a given policy: two more parts, and a sentence in its result.

The first part keeps a copy of the policy, so that the run can go on where the other one is gone.
The second one says what training gained over it, on the same paths of the value.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.report.quantity import decimals, finite, measured, number
from snapo.solver import statistics
from snapo.solver.evaluate import estimate, path_totals, value_of_groups

from ..run_folder import START
from ..study import Part, Setup, Study, StudyRun
from ..training import TRAINING
from .given import SuppliedPolicy

KEPT, GAIN = "given policy", "gain over the given policy"


def begun_with(study: Study, values: SuppliedPolicy, file: str) -> Study:
    """The study with `values` in the place of its untrained policy; `file` is that of its case.

    **Raises:** `CaseError` where nothing is trained, or the policy does not fit.
    """
    if study.setup is None or TRAINING.name not in {part.name for part in study.parts}:
        message = f"{file} trains no policy, so that there is nothing to begin with"
        raise CaseError("--policy", "", str(values.source), message)
    setup = _fitted(study.setup, values)
    setup()  # what does not fit is refused before anything is written
    after = 1 + next(i for i, part in enumerate(study.parts) if part.name == TRAINING.name)
    parts = [
        Part(KEPT, _kept(values)),
        *study.parts[:after],
        Part(GAIN, _gain, (KEPT, TRAINING.name)),
        *study.parts[after:],
    ]
    return replace(study, parts=parts, setup=setup, result=_told(study.result))


def _fitted(setup: Callable[[], Setup], values: SuppliedPolicy) -> Callable[[], Setup]:
    """The setup of a study, which may change while it runs, with the policy in it."""
    made: dict[int, tuple[Setup, Setup]] = {}

    def build() -> Setup:
        local = setup()
        if id(local) not in made:  # the pair keeps `local`, and with it its number
            made[id(local)] = (
                local,
                local._replace(policy=values.adopted_by(local.policy), recipe=None),
            )
        return made[id(local)][1]

    return build


def _kept(values: SuppliedPolicy) -> Callable[[StudyRun], Mapping[str, Any]]:
    def work(run: StudyRun) -> Mapping[str, Any]:
        (run.folder / START).write_bytes(values.content)
        about = {"policy": str(values.source), "checksum": values.checksum, "value": values.value}
        return {"began_with": about}

    return work


def _gain(run: StudyRun) -> Mapping[str, Any]:
    """The value of the given policy here, and what the trained one is above it."""
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
    """The result with the start, and with a sentence on it for the report."""

    def report(run: StudyRun) -> Mapping[str, Any]:
        results, start = dict(result(run)), run.get("began_with")
        if not start or results.get("value") is None:
            return results
        gain = run.get("start_gain") or {}
        sentence = describe(start, gain)
        return results | {
            "start": {**start, **gain},
            "notes": [*results.get("notes", ()), sentence],
        }

    return report


def describe(start: Mapping[str, Any], gain: Mapping[str, Any]) -> str:
    """What training began with, and by how much it came further."""
    text = f"Training began with the policy of {start['policy']}"
    if start.get("value") is not None:
        text += f", whose value there is {number(start['value'])}"
    if not gain or gain.get("before") is None:
        return f"{text}."
    before = _with_error(gain["before"], gain["before_error"])
    more = _with_error(gain["value"], gain["standard_error"])
    return f"{text}. Here it is worth {before}; training gained {more} over it on the same paths."


def _with_error(value: float, error: float | None) -> str:
    digits = max(0, decimals([error], 2)) if finite(error) else 4
    return " ".join(measured(value, error, digits)).strip()
