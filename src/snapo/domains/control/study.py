"""What a run of a controlled plant does: training, rivals, closed form, maps of the policy."""

from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.inputs import named
from snapo.problem.problem import Problem
from snapo.solver.solve import Evaluation
from snapo.solver.train import Training
from snapo.study.domain import Options
from snapo.study.parts.certificate import CERTIFICATE
from snapo.study.parts.distribution import distribution_part
from snapo.study.parts.moves import MOVES
from snapo.study.parts.profile import profile_part
from snapo.study.ready import at_values, following
from snapo.study.study import Setup, Study, StudyRun
from snapo.study.training import TRAINING, trained

from .plants.plant import MEASURED, Plant
from .records import ControlCase
from .results.gymnasium import gymnasium_part
from .results.plane import plane_part
from .results.rivals import rivals_part
from .results.shown import reward_and_costs
from .results.today import today


def lines(case: ControlCase) -> list[str]:
    """The case in a few lines."""
    plant, numbers = case.plant, [each.input.value.size for each in named(case.inputs)]
    states = ", ".join(f"{name} ({unit(each.unit)})" for name, each in plant.states.items())
    actions = ", ".join(f"{name} ({unit(each.unit)})" for name, each in plant.actions.items())
    return [
        f"{case.title}: {plant.words}",
        f"{plant.horizon} steps; states {states}; actions {actions}",
        f"{len(numbers)} inputs with {sum(numbers)} numbers, each with a sensitivity",
        f"the {case.objective_words} is made as large as possible",
    ]


def unit(text: str) -> str:
    """A unit, or words for a pure number."""
    return "a pure number" if text in ("", "1") else text


def units(plant: Plant) -> dict[str, str]:
    """{state or action: unit}; an action is told as the share of its limit, as it is trained."""
    found = {name: each.unit for name, each in plant.states.items() if each.unit != "1"}
    found |= {f"{MEASURED}.{name}": found[name] for name in plant.measured if name in found}
    return found | {"action": "share of its limit"} if _bounded(plant) else found


def _bounded(plant: Plant) -> bool:
    return bool(np.all(np.isfinite(plant.action.bounds())))


def study(case: ControlCase, options: Options) -> Study:
    """Training, distribution, fans, moves, rivals, the plane of states, and the certificate."""
    setup, plant = make_setup(case, options.engine), case.plant
    parts = [
        TRAINING,
        distribution_part(units(plant)),
        profile_part(units(plant)),
        MOVES,
        rivals_part(plant),
        plane_part(plant),
    ]
    if options.reference:
        if not plant.twin:
            what = f'no environment of Gymnasium is known for the plant "{plant.type}"'
            raise CaseError("--reference", "", None, what)
        parts.append(gymnasium_part(plant))
    parts.append(CERTIFICATE)
    about = {
        "title": case.title,
        "step": "step",
        "unit": "",
        "units": units(plant),
        "horizon": plant.horizon,
        "plant": plant.type,
        "plant_words": plant.words,
        "objective": case.objective_words,
        "objective_output": "reward",
        "notes": list(case.notes),
    }

    def moved(before: Setup, other: ControlCase) -> Setup:
        values = {each.name: each.input.value for each in named(other.inputs)}
        return at_values(before, other.plant, values, lambda: make_setup(other, options.engine))

    return Study(
        "control",
        about,
        tuple(parts),
        _result,
        lambda: setup,
        moved=moved,
        inputs=lambda other: {each.name: each.input for each in named(other.inputs)},
        shown=reward_and_costs,
        today=today,
    )


def _result(run: StudyRun) -> dict[str, Any]:
    """The trained policy beside the best rival, the closed form and the real environment."""
    references = {each["name"]: each["value"] for each in run.get("rivals", [])}
    if run.get("gymnasium"):
        references[run.get("gymnasium.name")] = run.get("gymnasium.mean")
    leads = [(each["name"], each["less"], each["less_error"]) for each in run.get("rivals", [])]
    return trained(run, references, leads)


def make_setup(case: ControlCase, engine: str) -> Setup:
    """The problem with its policy and engines."""
    training = Training(**case.training.model_dump(exclude_none=True))
    evaluation = Evaluation(**case.evaluation.model_dump())
    sources = evaluation.sources(training.seed)
    problem = Problem(case.plant, case.inputs, case.objective, sources)
    return following(engine, problem, case.recipe, training, evaluation)
