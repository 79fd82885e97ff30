"""The closed loop as a problem: its objective, the best of several recipes, and its setups."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

from snapo.engine import Engines
from snapo.problem.objective import CVaR, Mean, Objective
from snapo.problem.problem import Problem
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solve import Evaluation
from snapo.solver.train import initial_progress
from snapo.solver.train import train as climb
from snapo.study.ready import engines_for
from snapo.study.study import Setup

from ..flowsheet.case import PharmaCase
from .loop import ControlLoop, closed_loop
from .policy import Feedback
from .records import Goal

SHORTFALL = 0.01  # a small share of the violation shows the way where no batch succeeds
STARTS, SPREAD = 3, 0.3  # recipes that tuning starts from: the case's own, and some moved ones


def objective(case: PharmaCase) -> Objective:
    """The objective of `[goal]`, of the totals "success", "violation" and "attribute.NAME"."""
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
    """The objective as text, in the unit of the goal's attribute where it has one."""
    if goal.kind == "probability":
        return "probability of all limits"
    which = f"mean of the worst {1 - goal.level:.3g}" if goal.kind == "cvar" else "mean"
    sign = "minus the " if goal.kind == "mean" and goal.sense < 0 else ""
    lost = f"less {goal.penalty:g} of its margins for every margin beyond a limit"
    return f"{sign}{which} of {goal.attribute}, {lost}"


def best_recipe(
    problem: Problem,
    feedback: Feedback,
    training: TrainingPlan,
    engines: Engines,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[Feedback, Feedback]:
    """The best of several recipes, each trained; and it again, trained as long once more.

    `feedback`: the case's recipe. The first is where a policy starts that is to be compared with
    the second.
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
    return first, tuned(first, repeated, "best recipe, trained on")[1]


TOO_LONG = "a step of a process is more than the native engine takes"


class ClosedLoop:
    """What these parts share: the loop, its problem, and the recipes once they are tuned."""

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
        """The policy starts from the first recipe, once that is there."""
        available = self.first is not None
        if available not in self._setups:
            policy = (self.first or self.loop.baseline).closed()
            self._setups[available] = Setup(
                self.problem, policy, self.training, self.evaluation, self.engines, case=self.case
            )
        return self._setups[available]

    def setup_at(self, before: Setup, other: PharmaCase) -> Setup:
        """The setup of a case that differs only in the numbers of its inputs.

        Nothing is compiled where the case has the same form.
        """
        loop = closed_loop(other, seed=self.training.seed)
        problem = replace(before.problem, simulator=loop.simulator, inputs=loop.inputs)
        if problem.form != before.problem.form:
            return ClosedLoop(other, self.engine).setup()
        return before._replace(problem=problem, case=other)
