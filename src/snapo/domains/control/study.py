"""The run of a controlled plant: training, classical rules, closed form, maps of the policy."""

from dataclasses import replace
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.inputs import named_inputs
from snapo.problem.problem import Problem
from snapo.solver.solve import Evaluation
from snapo.solver.train import Training
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import PROFILE
from snapo.study.chapters.sensitivities import MOVES
from snapo.study.domain import Options
from snapo.study.ready import with_auto
from snapo.study.study import Setup, Study, StudyRun
from snapo.study.training import TRAINING, trained

from .chapters.baselines import BASELINES, GYMNASIUM
from .chapters.costs import reward_and_costs
from .chapters.plane import PLANE
from .chapters.today import today
from .plants.plant import MEASURED, Plant
from .records import ControlCase


def lines(case: ControlCase) -> list[str]:
    """The case in a few lines."""
    plant, numbers = case.plant, [item.input.value.size for item in named_inputs(case.inputs)]
    states = ", ".join(f"{name} ({unit(state.unit)})" for name, state in plant.states.items())
    actions = ", ".join(f"{name} ({unit(action.unit)})" for name, action in plant.actions.items())
    return [
        f"{case.title}: {plant.description}",
        f"{plant.horizon} steps; states {states}; actions {actions}",
        f"{len(numbers)} inputs with {sum(numbers)} numbers, each with a sensitivity",
        f"the {case.objective_words} is maximised",
    ]


def unit(text: str) -> str:
    """A unit, or words for a pure number."""
    return "a pure number" if text in ("", "1") else text


def units(plant: Plant) -> dict[str, str]:
    """{state or action: unit}; an action is shown as the share of its limit, as in training."""
    table = {name: state.unit for name, state in plant.states.items() if state.unit != "1"}
    table |= {f"{MEASURED}.{name}": table[name] for name in plant.measured if name in table}
    return table | {"action": "share of its limit"} if _bounded(plant) else table


def _bounded(plant: Plant) -> bool:
    return bool(np.all(np.isfinite(plant.action.bounds())))


def study(case: ControlCase, options: Options) -> Study:
    """Training, distribution, fans, moves, classical rules, the plane of states, certificate."""
    setup, plant = make_setup(case, options.engine), case.plant
    chapters = [DISTRIBUTION, PROFILE, MOVES, BASELINES, PLANE]
    if options.reference:
        if not plant.twin:
            message = f'no environment of Gymnasium is known for the plant "{plant.type}"'
            raise CaseError("--reference", "", None, message)
        chapters.append(GYMNASIUM)
    parts = [TRAINING, *(chapter.part for chapter in [*chapters, CERTIFICATE])]
    about = {
        "title": case.title,
        "step": "step",
        "unit": "",
        "units": units(plant),
        "horizon": plant.horizon,
        "plant": plant.type,
        "plant_words": plant.description,
        "objective": case.objective_words,
        "objective_output": "reward",
        "notes": list(case.notes),
    }

    return Study(
        "control",
        about,
        tuple(parts),
        _result,
        lambda: setup,
        setup_at=setup_at,
        inputs=lambda other: {entry.name: entry.input for entry in named_inputs(other.inputs)},
        live_tables=reward_and_costs,
        today=today,
    )


def _result(run: StudyRun) -> dict[str, Any]:
    """The trained policy compared with the best rule, the closed form and the real environment."""
    baselines, played = BASELINES.of(run), GYMNASIUM.of(run)
    rules = baselines.rivals if baselines else ()
    references = {rule.name: rule.value for rule in rules}
    if played:
        references[played.name] = played.mean
    advantages = [(rule.name, rule.less, rule.less_error) for rule in rules]
    return trained(run, references, advantages)


def make_setup(case: ControlCase, engine: str) -> Setup:
    """The problem with its policy and engines."""
    training = Training(**case.training.model_dump(exclude_none=True))
    evaluation = Evaluation(**case.evaluation.model_dump())
    sources = evaluation.sources(training.seed)
    problem = Problem(case.plant, case.inputs, case.objective, sources)
    setup = with_auto(engine, problem, case.recipe, training, evaluation)
    return setup._replace(case=case)


def setup_at(setup: Setup, case: ControlCase) -> Setup:
    """The setup of a case that differs only in the numbers of its inputs.

    Nothing is compiled where the case has the same form.
    """
    problem = replace(setup.problem, simulator=case.plant, inputs=case.inputs)
    if problem.form != setup.problem.form:
        return make_setup(case, setup.engines.name)
    return setup._replace(problem=problem, case=case)
