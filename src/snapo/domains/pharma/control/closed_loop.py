"""The process in closed loop: a policy decides temperatures and ratios from measurements. The
module also has the objective, the search for the best of several recipes, and the setups for
training.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from snapo.engine import Engines
from snapo.problem.chain import Chain
from snapo.problem.objective import CVaR, Mean, Objective
from snapo.problem.problem import Problem, prepare
from snapo.problem.record import Input
from snapo.problem.simulator import Simulator, probe
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solve import Evaluation
from snapo.solver.train import initial_progress
from snapo.solver.train import train as climb
from snapo.study.ready import engines_for
from snapo.study.study import Setup

from ..flowsheet.case import PharmaCase
from ..flowsheet.inputs import pharma_inputs
from ..flowsheet.stiffness import with_stiff_steps
from ..given import Form
from .policy import Feedback, history_length
from .records import Goal
from .stages import Stage
from .staging import LoopRecord, decided, staged


class ControlLoop(NamedTuple):
    """A closed loop, ready for `snapo.solve`.

    - `inputs`: {name: Input}. `baseline`: the recipe of the case, as a policy without observations;
      trained, it is the best fixed recipe. `policy`: the same recipe with feedback.
    - `stages`: the stages in order. `outputs`: names of the attributes' totals. Two further totals:
      "success" is 1 if all limits are met, and "violation" is the sum of the violations in margins.
    """

    simulator: Simulator
    inputs: dict[str, Input]
    policy: Feedback
    baseline: Feedback
    stages: tuple[Stage, ...]
    outputs: tuple[str, ...]


def closed_loop(
    case: PharmaCase, inputs: dict[str, Any] | None = None, seed: int = 0
) -> ControlLoop:
    """The simulator, a policy to train and the fixed recipe as a policy, at `inputs`."""
    if case.control is None:
        raise ValueError("closed_loop: the case has no [control].")
    case = with_stiff_steps(case)
    stages = stages_of(case)
    moves = [NextStage(before, after) for before, after in pairwise(stages)]
    simulator = Chain(stages, moves) if moves else stages[0]
    result = pharma_inputs(case)
    for name, value in (inputs or {}).items():
        result[name] = eqx.tree_at(lambda item: item.value, result[name], np.asarray(value, float))
    features = probe(simulator, prepare(simulator, result))[1].shape[0]
    recipe = nominal_recipe(case, stages, result)
    baseline = Feedback(recipe, features, key=jax.random.key(seed))
    names = tuple(f"attribute.{attribute.name}" for attribute in case.attributes)
    return ControlLoop(simulator, result, baseline.closed(), baseline, tuple(stages), names)


def stages_of(case: PharmaCase) -> list[Stage]:
    """A stage for each unit with decisions or sensors, and one for decisions on all the others."""
    control, form = case.control, Form.of(LoopRecord.of(case), case.held)
    assert control is not None
    steps, units = dict(control.steps), staged(case.units, control)
    rest = decided(case.units, control, "") or not units
    counts = [steps.get(item.name, 1) for item in units] + [1] * bool(rest)
    starts, stages = np.cumsum([0, *counts]).tolist(), []
    for i, count in enumerate(counts):
        name, history = "", 0
        if i < len(units):
            interval = float(units[i].duration.used()) / count
            name, history = units[i].name, history_length(control.measurements, interval)
        stages.append(Stage(form, name, count, starts[i], starts[-1], history))  # pyright: ignore[reportCallIssue]
    return stages


@dataclass(frozen=True)
class NextStage:
    """The transition from the end of one stage to the beginning of the next."""

    before: Stage
    after: Stage

    def __call__(self, constants, state, later):
        return self.after.enter(later, self.before.leave(constants, state))


def nominal_recipe(case: PharmaCase, stages: list[Stage], inputs: dict[str, Input]) -> np.ndarray:
    """[T, size] actions that follow the case's profiles and numbers."""
    assert case.control is not None
    size = max(stage.action.size for stage in stages)
    table = np.full((stages[-1].total, size), 0.5)
    for stage in stages:
        for position, i in enumerate(stage.decided):
            item = case.control.manipulated[i]
            value = inputs[item.input].value
            endpoints = (np.arange(stage.horizon) + 1) / stage.horizon
            requested = _course(case, item.input, value, endpoints)
            rows = slice(stage.before, stage.before + stage.horizon)
            table[rows, position] = np.clip((requested - item.low) / (item.high - item.low), 0, 1)
    return table


def _course(case: PharmaCase, name: str, value: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The values of a control at shares of its unit's duration: of its profile, or a constant
    number."""
    unit = next(item for item in case.units if item.name == name.partition(".")[0])
    profile = next((entry for entry in unit.profiles if entry.value.name == name), None)
    if profile is None:
        return np.full(len(share), value[0])
    if profile.kind == "linear":
        return np.interp(share, profile.share, value)
    return value[np.searchsorted(profile.share[1:-1], share - 1e-9, side="right")]


SHORTFALL = 0.01  # a small share of the violation shows the way where no batch succeeds
STARTS, SPREAD = 3, 0.3  # recipes that tuning starts from: the case's own, and some moved ones


def objective(case: PharmaCase) -> Objective:
    """The objective of `[goal]`, made of the totals "success", "violation" and "attribute.NAME"."""
    goal: Goal = case.goal
    if goal.kind == "probability":
        return Mean("success") - SHORTFALL * Mean("violation")
    margin = next(
        attribute.margin for attribute in case.attributes if attribute.name == goal.attribute
    )
    name = f"attribute.{goal.attribute}"
    selected: Objective = CVaR(name, goal.level) if goal.kind == "cvar" else goal.sense * Mean(name)
    return selected - goal.penalty * margin * Mean("violation")


def in_words(goal: Goal) -> str:
    """The objective as text; the unit is that of the goal's attribute, if there is one."""
    if goal.kind == "probability":
        return "probability of all limits"
    worst = f" over the worst {100 * (1 - goal.level):.3g} % of batches"
    over = worst if goal.kind == "cvar" else ""
    sign = "minus the " if goal.kind == "mean" and goal.sense < 0 else ""
    lost = f"minus {goal.penalty:g} times the margin for every margin by which a limit is exceeded"
    return f"{sign}mean of {goal.attribute}{over}, {lost}"


def best_recipe(
    problem: Problem,
    feedback: Feedback,
    training: TrainingPlan,
    engines: Engines,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[Feedback, Feedback]:
    """The best of several trained recipes, and the same recipe after a second training.

    `feedback`: the case's recipe. A policy that is compared with the second recipe starts from the
    first one.
    """

    def tuned(recipe: Feedback, plan: TrainingPlan, subject: str) -> tuple[float, Feedback]:
        result = climb(problem, initial_progress(recipe, plan), plan, engines.train)
        progress(f"{subject}: exact value {result.best_value:,.7g}")
        assert isinstance(result.best, Feedback)
        return result.best_value, result.best

    starts = [feedback, *(feedback.perturbed(SPREAD, training.seed + k) for k in range(1, STARTS))]
    results = [
        tuned(start, training, f"recipe from start {i + 1}") for i, start in enumerate(starts)
    ]
    first = max(results, key=lambda item: item[0])[1]
    repeated = replace(training, seed=training.seed + 1)
    return first, tuned(first, repeated, "best recipe, trained further")[1]


TOO_LONG = "a step of a process is larger than the native engine supports"


class ClosedLoop:
    """What the parts of a run on the closed loop share: the loop, its problem, and the recipes once
    they are tuned."""

    def __init__(self, case: PharmaCase, engine: str):
        self.case, self.engine = case, engine
        self.training = TrainingPlan.from_settings(case.training.model_dump())
        self.evaluation = Evaluation(**case.evaluation.model_dump())
        self.first: Feedback | None = None

    @cached_property
    def loop(self) -> ControlLoop:
        return closed_loop(self.case, seed=self.training.seed)

    @cached_property
    def problem(self) -> Problem:
        sources = self.evaluation.sources(self.training.seed)
        return Problem(self.loop.simulator, self.loop.inputs, objective(self.case), sources)

    @cached_property
    def engines(self) -> Engines:
        # A step of a process is far more than the native engine takes, and asking it costs a trace.
        name = "xla" if self.engine == "auto" else self.engine
        engines = engines_for(name, self.problem, self.loop.policy)
        if self.engine != "auto":
            return engines
        return engines._replace(reason=engines.reason.replace("it was asked for", TOO_LONG))

    @cached_property
    def _setups(self) -> dict[bool, Setup]:
        return {}

    def setup(self) -> Setup:
        """The setup for training; the policy starts from the first recipe, after that was tuned."""
        available = self.first is not None
        if available not in self._setups:
            policy = (self.first or self.loop.baseline).closed()
            self._setups[available] = Setup(
                self.problem, policy, self.training, self.evaluation, self.engines, case=self.case
            )
        return self._setups[available]

    def setup_at(self, before: Setup, other: PharmaCase) -> Setup:
        """The setup of a case that differs from this one only in the numbers of its inputs. Nothing
        is compiled if the case has the same form.
        """
        loop = closed_loop(other, seed=self.training.seed)
        problem = replace(before.problem, simulator=loop.simulator, inputs=loop.inputs)
        if problem.form != before.problem.form:
            return ClosedLoop(other, self.engine).setup()
        return before._replace(problem=problem, case=other)
