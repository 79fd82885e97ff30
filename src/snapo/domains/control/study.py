"""The run of a controlled plant: training, classical rules, the optimum in closed form, and maps of
the policy."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.case.objective import make_objective
from snapo.problem.inputs import named_inputs
from snapo.problem.objective import Objective
from snapo.problem.policies.memory import GRU, LastObservations, first_decision
from snapo.problem.policy import MLP, Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.solver.solve import Evaluation
from snapo.solver.train import Training
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import PROFILE
from snapo.study.chapters.sensitivities import MOVES
from snapo.study.domain import Options
from snapo.study.ready import with_auto
from snapo.study.study import Setup, Study, StudyRun, Today
from snapo.study.training import TRAINING, trained

from .chapters.baselines import BASELINES, GYMNASIUM, check_same
from .chapters.costs import reward_and_costs
from .chapters.plane import PLANE
from .kinds import MEASURED
from .plants import TYPES
from .plants.plant import Plant
from .records import ControlCase

WINDOW = 4  # default number of observations in a policy with memory = "Recent"


def units(plant: Plant) -> dict[str, str]:
    """{state or action: unit}; an action is shown as a share of its limit, as in training."""
    table = {name: state.unit for name, state in plant.states.items() if state.unit != "1"}
    table |= {f"{MEASURED}.{name}": table[name] for name in plant.measured if name in table}
    return table | {"action": "share of the limit"} if _bounded(plant) else table


def _bounded(plant: Plant) -> bool:
    return bool(np.all(np.isfinite(plant.action.bounds())))


def study(case: ControlCase, options: Options) -> Study:
    """The parts of a run: training, distribution, fans, moves, classical rules, plane of states,
    certificate."""
    setup = make_setup(case, options.engine)
    plant = setup.problem.simulator
    assert isinstance(plant, Plant)
    chapters = [DISTRIBUTION, PROFILE, MOVES, BASELINES, PLANE]
    if options.reference:
        check_same(plant, case.inputs, setup.problem.objective)
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
    """Compares the trained policy with the best rule, the optimum in closed form and Gymnasium."""
    baselines, played = BASELINES.of(run), GYMNASIUM.of(run)
    rules = baselines.rivals if baselines else ()
    references = {rule.name: rule.value for rule in rules}
    if played:
        references[played.name] = played.mean
    advantages = [(rule.name, rule.less, rule.less_error) for rule in rules]
    return trained(run, references, advantages)


def plant_at(case: ControlCase) -> Plant:
    """The plant of a case."""
    return TYPES[case.kind.type](case.inputs, case.horizon, case.timer)


def objective_of(case: ControlCase) -> Objective:
    """The objective that is maximised, a statistic of the reward."""
    return make_objective(case.objective, "reward")


def recipe(case: ControlCase) -> Policy:
    """The recipe of the policy to train, with or without a memory."""
    if case.memory == "Recent":
        return LastObservations(case.window or WINDOW, MLP(hidden=case.hidden))
    if case.memory is None:
        return MLP(hidden=case.hidden)
    return GRU(hidden=None if case.hidden is None else case.hidden[0])


def make_setup(case: ControlCase, engine: str) -> Setup:
    """The problem with its policy and engines."""
    training = Training(**case.training.model_dump(exclude_none=True))
    evaluation = Evaluation(**case.evaluation.model_dump())
    sources = evaluation.sources(training.seed)
    problem = Problem(plant_at(case), case.inputs, objective_of(case), sources)
    setup = with_auto(engine, problem, recipe(case), training, evaluation)
    return setup._replace(case=case)


def setup_at(setup: Setup, case: ControlCase) -> Setup:
    """The setup of a case that differs only in the numbers of its inputs.

    If the case has the same form, nothing is compiled.
    """
    problem = replace(setup.problem, simulator=plant_at(case), inputs=case.inputs)
    if problem.form != setup.problem.form:
        return make_setup(case, setup.engines.name)
    return setup._replace(problem=problem, case=case)


def today(setup: Setup, policy: Policy) -> Today:
    """The physical action of the first step, at the mean of the initial state."""
    plant, schedule = setup.problem.simulator, setup.problem.schedule
    assert isinstance(plant, Plant)
    start = schedule.constants["start"]
    state = {name: _middle(start[name], keys) for name, keys in plant.starts}

    def decide(state: Any) -> Any:
        observed = plant.observe(schedule.constants, at(schedule.steps, 0), state)
        return plant.drive(schedule.constants["plant"], first_decision(policy, observed))

    action = np.ravel(np.asarray(jax.jit(decide)(jax.tree.map(jnp.asarray, state)), np.float64))
    facts = [(f"first {name}", *_one(x, plant.states[name].unit)) for name, x in state.items()]
    by_name = [(name, item.unit) for name, item in plant.actions.items()]
    if len(by_name) != len(action):  # one name for several numbers
        by_name = [(f"{by_name[0][0]} {i + 1}", by_name[0][1]) for i in range(len(action))]
    summary = [
        (name, float(x), "" if unit == "1" else unit) for (name, unit), x in zip(by_name, action)
    ]
    text = ", ".join(f"{name} {x:,.4g} {unit}".strip() for name, x, unit in summary)
    return Today(text, [fact for fact in facts if fact[1] is not None], (), ())


def _middle(start: dict[str, Any], keys: tuple[str, ...]) -> np.ndarray:
    if keys == ("low", "high"):
        return (np.asarray(start["low"], np.float64) + np.asarray(start["high"])) / 2
    return np.asarray(start[keys[0]], np.float64)


def _one(value: np.ndarray, unit: str) -> tuple[float | None, str]:
    """A number with its unit; the number is None for a state of several numbers."""
    return (float(value) if np.size(value) == 1 else None), "" if unit == "1" else unit
