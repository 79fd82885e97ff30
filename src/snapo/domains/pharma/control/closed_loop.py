"""The best fixed recipe with which a policy is compared, and the objective of both.

The recipe is tuned at least as hard as the policy: both are one `Feedback`, trained by the same
steps. From several starts the best recipe is kept; from there recipe and policy go on side by
side, for as many steps each.
"""

from collections.abc import Callable
from dataclasses import replace

from snapo.engine import Engines
from snapo.problem.objective import CVaR, Mean, Objective
from snapo.problem.problem import Problem
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.train import begin, train

from ..flowsheet.case import PharmaCase
from .policy import Feedback
from .records import Goal

SHORTFALL = 0.01  # a small share of the violation shows the way where no batch succeeds
STARTS, SPREAD = 3, 0.3  # recipes that tuning starts from: the case's own, and some moved ones


def objective(case: PharmaCase) -> Objective:
    """The objective of `[goal]`, of the totals "success", "violation" and "attribute.NAME"."""
    goal: Goal = case.goal
    if goal.kind == "probability":
        return Mean("success") - SHORTFALL * Mean("violation")
    margin = next(each.margin for each in case.attributes if each.name == goal.attribute)
    name = f"attribute.{goal.attribute}"
    kept: Objective = CVaR(name, goal.level) if goal.kind == "cvar" else goal.sense * Mean(name)
    return kept - goal.penalty * margin * Mean("violation")


def in_words(goal: Goal) -> str:
    """The objective in words, in the unit of the goal's attribute where it has one."""
    if goal.kind == "probability":
        return "probability of all limits"
    which = f"mean of the worst {1 - goal.level:.3g}" if goal.kind == "cvar" else "mean"
    sign = "minus the " if goal.kind == "mean" and goal.sense < 0 else ""
    lost = f"less {goal.penalty:g} of its margins for every margin beyond a limit"
    return f"{sign}{which} of {goal.attribute}, {lost}"


def best_recipe(
    problem: Problem,
    own: Feedback,
    training: TrainingPlan,
    engines: Engines,
    tell: Callable[[str], None] = lambda text: None,
) -> tuple[Feedback, Feedback]:
    """The best of several recipes, each trained; and it again, trained as long once more.

    `own`: the case's recipe. The first is where a policy starts that is to be compared with the
    second.
    """

    def tuned(recipe: Feedback, plan: TrainingPlan, what: str) -> tuple[float, Feedback]:
        found = train(problem, begin(recipe, plan), plan, engines.train)
        tell(f"{what}: exact value {found.best_value:,.7g}")
        assert isinstance(found.best, Feedback)
        return found.best_value, found.best

    starts = [own, *(own.moved(SPREAD, training.seed + k) for k in range(1, STARTS))]
    found = [tuned(each, training, f"recipe from start {i + 1}") for i, each in enumerate(starts)]
    first = max(found, key=lambda each: each[0])[1]
    again = replace(training, seed=training.seed + 1)
    return first, tuned(first, again, "best recipe, trained on")[1]
