"""The parts of a run that decide in closed loop: recipe, policy, and the two side by side."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import jax
import numpy as np

from snapo.engine import Engines
from snapo.problem.inputs import Input
from snapo.problem.objective import CVaR, Mean, Objective
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solve import Evaluation
from snapo.solver.train import begin
from snapo.solver.train import train as climb
from snapo.study.ready import at_values, engines_for
from snapo.study.study import Part, Setup, StudyRun
from snapo.study.training import train

from ..flowsheet.case import PharmaCase
from ..results.setpoints import HEADER, decided
from .loop import Loop, closed_loop
from .policy import Feedback
from .records import Goal
from .rivals import first_settings, in_units
from .rules import Loops, Wire
from .stages import Stage

LOW, HIGH = 0.1, 0.9  # quantiles over batches, of a band


def courses(
    case: PharmaCase, stages: Sequence[Stage], inputs: Mapping[str, Input], actions: np.ndarray
) -> list[dict[str, Any]]:
    """One row for each control: its values [T, N] after each decision, from actions [T, N, size].

    In the domain's units; `time` [T]: s since the unit's start, at the end of each decision. Ramps
    hold over the nominal duration.
    """
    assert case.control is not None
    found = []
    for stage in stages:
        seconds = None
        if stage.unit is not None:
            seconds = float(inputs[stage.unit.duration.name].value[0]) / stage.horizon
        for place, i in enumerate(stage.decided):
            item = case.control.manipulated[i]
            part = actions[stage.before : stage.before + stage.horizon, :, place]
            values = item.low + np.asarray(part, float) * (item.high - item.low)
            if item.ramp is not None and seconds is not None:
                values = _within(values, float(inputs[item.input].value[0]), item.ramp * seconds)
            ends = (np.arange(stage.horizon) + 1) * (seconds or 0.0)
            unit = inputs[item.input].unit
            found.append({"input": item.input, "unit": unit, "time": ends, "values": values})
    return found


def _within(values: np.ndarray, start: float, most: float) -> np.ndarray:
    """Values that move by at most `most` from one decision to the next."""
    found, last = np.empty_like(values), np.full(values.shape[1], start)
    for t, wanted in enumerate(values):
        found[t] = last = np.clip(wanted, last - most, last + most)
    return found


def side_by_side(policy: list, best: list, given: list) -> list[dict[str, Any]]:
    """Of each control the policy's median and band, and both recipes."""
    return [
        {
            "input": ours["input"],
            "unit": ours["unit"],
            "time": ours["time"],
            "policy": np.median(ours["values"], 1),
            "policy_low": np.quantile(ours["values"], LOW, 1),
            "policy_high": np.quantile(ours["values"], HIGH, 1),
            "values": fixed["values"][:, 0],
            "given": first["values"][:, 0],
        }
        for ours, fixed, first in zip(policy, best, given, strict=True)
    ]


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
        found = climb(problem, begin(recipe, plan), plan, engines.train)
        tell(f"{what}: exact value {found.best_value:,.7g}")
        assert isinstance(found.best, Feedback)
        return found.best_value, found.best

    starts = [own, *(own.moved(SPREAD, training.seed + k) for k in range(1, STARTS))]
    found = [tuned(each, training, f"recipe from start {i + 1}") for i, each in enumerate(starts)]
    first = max(found, key=lambda each: each[0])[1]
    again = replace(training, seed=training.seed + 1)
    return first, tuned(first, again, "best recipe, trained on")[1]


RECIPE, TRAINED, RULES = "best fixed recipe", "training", "rules"
TOO_LONG = "a step of a process is more than the native engine takes"
SETPOINTS = "setpoints_closed_loop.csv"
SHOWN = 256  # batches from which the policy's course over time is drawn
SURE = 2.0  # standard errors from which one rival counts as better


class ClosedLoop:
    """What these parts share: the loop, its problem, and the recipes once they are tuned."""

    def __init__(self, case: PharmaCase, engine: str):
        self.case, self.engine = case, engine
        self.training = TrainingPlan.given(case.training.model_dump())
        self.evaluation = Evaluation(**case.evaluation.model_dump())
        self.first: Feedback | None = None

    @cached_property
    def loop(self) -> Loop:
        return closed_loop(self.case, seed=self.training.seed)

    @cached_property
    def problem(self) -> Problem:
        sources = self.evaluation.sources(self.training.seed)
        return Problem(self.loop.simulator, self.loop.inputs, objective(self.case), sources)

    @cached_property
    def engines(self) -> Engines:
        # A step of a process is far more than the native engine takes, and asking it costs a trace.
        name = "xla" if self.engine == "auto" else self.engine
        found = engines_for(name, self.problem, self.loop.policy)
        if self.engine != "auto":
            return found
        return found._replace(reason=found.reason.replace("it was asked for", TOO_LONG))

    @cached_property
    def _setups(self) -> dict[bool, Setup]:
        return {}

    def setup(self) -> Setup:
        """The policy starts from the first recipe, once that is there."""
        known = self.first is not None
        if known not in self._setups:
            policy = (self.first or self.loop.baseline).closed()
            self._setups[known] = Setup(
                self.problem, policy, self.training, self.evaluation, self.engines
            )
        return self._setups[known]

    def moved(self, before: Setup, other: PharmaCase) -> Setup:
        """The setup of a case that differs in the numbers of its inputs alone."""
        loop = closed_loop(other, seed=self.training.seed)
        values = {name: each.value for name, each in loop.inputs.items()}
        return at_values(
            before, loop.simulator, values, lambda: ClosedLoop(other, self.engine).setup()
        )

    def parts(self) -> list[Part]:
        """In the order in which they are done."""
        control = self.case.control
        rules = [Part(RULES, self.tune_rules, (RECIPE,))] if control and control.rules else []
        return [
            Part(RECIPE, self.tune),
            Part(TRAINED, self.train, (RECIPE,)),
            *rules,
            Part("closed loop", self.compare, (TRAINED, *(each.name for each in rules))),
        ]

    def tune(self, run: StudyRun) -> dict[str, Any]:
        """The logits of both recipes, [T, size]."""
        first, best = best_recipe(
            self.problem, self.loop.baseline, self.training, self.engines, run.tell
        )
        return {"recipes": {"first": np.asarray(first.table), "best": np.asarray(best.table)}}

    def recipe(self, run: StudyRun, name: str) -> Feedback:
        """A recipe as its part left it."""
        return self.loop.baseline.on(np.array(run.get(f"recipes.{name}"), np.float32))

    def train(self, run: StudyRun) -> dict[str, Any]:
        self.first = self.recipe(run, "first")
        return train(run)

    def tune_rules(self, run: StudyRun) -> dict[str, Any]:
        """Every rule with its first settings, and trained from there as long as the policy is."""
        case, found = self.case, []
        control = case.control
        assert control is not None
        recipe = np.asarray(self.recipe(run, "first").actions(), float)
        for rule in control.rules:
            tuned = first_settings(case, self.loop.stages, self.problem, rule, recipe)
            first, plan = tuned.policy, self.training
            best = climb(self.problem, begin(first, plan), plan, self.engines.train).best
            assert isinstance(best, Loops)
            for name, each in ((f"{rule.name}, first settings", first), (rule.name, best)):
                found.append(
                    {
                        "name": name,
                        "table": np.asarray(each.table),
                        "setpoints": np.asarray(each.setpoints.array),
                        "gains": each.gains(),
                        "gains_own": in_units(control, each),
                        "times": each.times(),
                        "wires": [tuple(wire) for wire in each.wires],
                        "sensors": [control.measurements[x.sensor].state for x in tuned.loops],
                        "of": [control.manipulated[x.of].input for x in rule.loops],
                    }
                )
            run.tell(f"{rule.name}: gains {in_units(control, best)}, times {best.times()} s")
        return {"rules": found}

    def compare(self, run: StudyRun) -> dict[str, Any]:
        """Policy, rules and best recipe on the same fresh batches."""
        best, goal, solution = self.recipe(run, "best"), self.problem.objective, run.solution
        evaluate, paths = self.engines.evaluate, self.evaluation.paths
        fixed = path_totals(self.problem, best, paths, engine=evaluate)
        first = path_totals(self.problem, self.loop.baseline, paths, engine=evaluate)
        ours, theirs, given = (
            np.asarray(each["success"]) for each in (solution.totals, fixed, first)
        )
        with jax.enable_x64(True):
            baseline_goal = float(goal.value(fixed))
        groups = self.problem.sources.evaluation.groups(np.arange(ours.size))
        rules = [self.beside(each, ours, theirs, groups) for each in run.get("rules", [])]
        recipe = self.decided(best, run)
        run.write_csv(SETPOINTS, HEADER, decided(recipe))
        table = {
            **rates(ours, theirs, given, groups),
            "goal": in_words(self.case.goal),
            "objective": solution.value,
            "objective_error": solution.standard_error,
            "baseline_objective": baseline_goal,
            "recipe": recipe,
            "rules": rules,
            "engine": solution.engine,
            "paths": dict(solution.paths),
            "status": solution.status,
        }
        return {"closed_loop": table}

    def beside(self, rule: dict[str, Any], ours, theirs, groups) -> dict[str, Any]:
        """A rule on the same batches: its share, and the policy's and the recipe's beside it."""
        found = path_totals(
            self.problem, restored(rule), self.evaluation.paths, engine=self.engines.evaluate
        )
        own = np.asarray(found["success"])
        wanted = {"": own, "policy_gain": ours - own, "recipe_gain": theirs - own}
        row: dict[str, Any] = {"name": rule["name"]}
        for name, each in wanted.items():
            share = statistics.mean(each, groups)
            row[name or "value"] = share.value
            row[f"{name}_error" if name else "standard_error"] = share.standard_error
        kept = ("gains_own", "times", "sensors", "of")
        return row | {key: rule[key] for key in kept}

    def decided(self, best: Feedback, run: StudyRun) -> list[dict[str, Any]]:
        """Every control over time, of the policy and of both recipes, in the domain's units."""
        source = self.problem.sources.evaluation
        block = next(iter(source.blocks(source.available(SHOWN), 1)))
        draws = source.draws(block, self.problem.simulator)
        bound = self.engines.evaluate.bind(self.problem)
        rolled = bound.values(run.solution.policy, draws, Exact(), record=("action",))
        actions = [np.asarray(rolled.record["action"], float)]
        actions += [each.actions()[:, None] for each in (best, self.loop.baseline)]
        inputs, stages = self.loop.inputs, self.loop.stages
        return side_by_side(*(courses(self.case, stages, inputs, each) for each in actions))


def restored(rule: dict[str, Any]) -> Loops:
    """A rule as its part left it."""
    wires = tuple(Wire(*each) for each in rule["wires"])
    policy = Loops(np.asarray(rule["table"]), wires, np.asarray(rule["setpoints"]))
    for i, (gain, time) in enumerate(zip(rule["gains"], rule["times"])):
        policy = policy.tuned(i, float(gain), float(time))
    return policy


def rates(
    ours: np.ndarray, theirs: np.ndarray, given: np.ndarray, groups: np.ndarray
) -> dict[str, Any]:
    """Shares of batches [N] that keep all limits, of policy, best and given recipe, with errors.

    `groups` [N]: batches of one group are not independent. Limits on two sides are kept or missed
    by both batches of an antithetic pair, so that pairs taken for two would halve the variance.
    """
    wanted = {"": ours, "baseline": theirs, "gain": ours - theirs, "given": given}
    found: dict[str, Any] = {}
    for name, each in wanted.items():
        share = statistics.mean(each, groups)
        found[name or "value"] = share.value
        found[f"{name}_error" if name else "standard_error"] = share.standard_error
    return found | {"better": better(found["gain"], found["gain_error"])}


def better(gain: float, error: float) -> str:
    """Which of both keeps all limits more often on the same batches: "policy", "recipe", ""."""
    if abs(gain) <= SURE * error:
        return ""
    return "policy" if gain > 0 else "recipe"
