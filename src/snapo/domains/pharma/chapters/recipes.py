"""The alternatives to a policy: the best of several fixed recipes, and rules around a recipe."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from snapo.solver.train import initial_progress
from snapo.solver.train import train as climb
from snapo.study.chapter import Chapter, Floats
from snapo.study.study import Part, StudyRun
from snapo.study.training import TRAINING, train

from ..control.closed_loop import ClosedLoop, best_recipe
from ..control.policy import Feedback
from ..control.rivals import first_settings, in_units
from ..control.rules import LoopConnection, Loops
from ..shared import closed_loop


@dataclass(frozen=True, eq=False)
class RecipeLogits:
    """Logits of the recipe with which training starts, and of the best recipe, [T, size]."""

    first: Floats
    best: Floats

    def policy(self, loop: ClosedLoop, name: str) -> Feedback:
        """The recipe "first" or "best" as a policy."""
        return loop.loop.baseline.on(np.array(getattr(self, name), np.float32))


def tune(run: StudyRun) -> RecipeLogits:
    """Trains recipes from several starting points."""
    loop = closed_loop(run)
    recipes = best_recipe(
        loop.problem, loop.loop.baseline, loop.training, loop.engines, run.progress
    )
    return RecipeLogits(*(np.asarray(recipe.table) for recipe in recipes))


def recipe(run: StudyRun, name: str) -> Feedback:
    """A recipe as saved by its part of the run."""
    logits = RECIPES.of(run)
    assert logits is not None
    return logits.policy(closed_loop(run), name)


def train_policy(run: StudyRun) -> dict[str, Any]:
    """Trains the policy, which starts from the first recipe."""
    closed_loop(run).first = recipe(run, "first")
    return train(run)


RECIPES = Chapter(
    "best fixed recipe", "Best fixed recipe", RecipeLogits, tune, lambda run, result: [],
    needs=(), key="recipes"
)  # fmt: skip
TRAINED = Part(TRAINING.name, train_policy, (RECIPES.name,))


@dataclass(frozen=True, eq=False)
class TunedRule:
    """PI controllers; `gains_own` in the units of the domain, `times` in s.

    - `table`, `setpoints`, `gains`, `wires`: of the policy. `sensors`, `of`: the state that each
      controller measures, and the input that it moves.
    """

    name: str
    table: Floats
    setpoints: Floats
    gains: Floats
    gains_own: Floats
    times: Floats
    wires: tuple[LoopConnection, ...]
    sensors: tuple[str, ...]
    of: tuple[str, ...]

    def policy(self) -> Loops:
        """The rule, as saved by its part of the run."""
        policy = Loops(self.table, self.wires, self.setpoints)
        for i, (gain, time) in enumerate(zip(self.gains, self.times)):
            policy = policy.tuned(i, float(gain), float(time))
        return policy


def tune_rules(run: StudyRun) -> tuple[TunedRule, ...]:
    """Every rule of the case twice: with its first settings, and trained for as long as the
    policy."""
    loop, rows = closed_loop(run), []
    control, plan = loop.case.control, loop.training
    assert control is not None
    actions = np.asarray(recipe(run, "first").actions(), float)
    for rule in control.rules:
        tuned = first_settings(loop.case, loop.loop.stages, loop.problem, rule, actions)
        best = climb(
            loop.problem, initial_progress(tuned.policy, plan), plan, loop.engines.train
        ).best
        assert isinstance(best, Loops)
        for name, policy in ((f"{rule.name}, first settings", tuned.policy), (rule.name, best)):
            rows.append(
                TunedRule(
                    name=name, table=np.asarray(policy.table),
                    setpoints=np.asarray(policy.setpoints.array), gains=policy.gains(),
                    gains_own=in_units(control, policy), times=policy.times(),
                    wires=tuple(policy.connections),
                    sensors=tuple(control.measurements[x.sensor].state for x in tuned.loops),
                    of=tuple(control.manipulated[x.of].input for x in rule.loops),
                )
            )  # fmt: skip
        run.progress(f"{rule.name}: gains {in_units(control, best)}, times {best.times()} s")
    return tuple(rows)


RULES = Chapter(
    "rules", "Rules", tuple[TunedRule, ...], tune_rules, lambda run, result: [],
    needs=(RECIPES.name,), key="rules"
)  # fmt: skip
