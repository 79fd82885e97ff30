"""Compares the trained policy with classical rules, the optimum in closed form, and Gymnasium."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.error import show as text_of
from snapo.engine import Xla
from snapo.problem.inputs import plain
from snapo.problem.objective import Mean, Objective
from snapo.problem.policy import Policy
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Text
from snapo.report.quantity import decimals, number, plus_minus
from snapo.report.rows import Bar, Column, WithError, ladder, table
from snapo.solver.evaluate import path_totals, value_of_groups
from snapo.solver.statistics import of_shares
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..inputs import make_inputs
from ..plants.plant import Plant
from ..regulator import optimum
from ..rules import classical_rules

if TYPE_CHECKING:
    from snapo.gym.agent import Agent

STARTS = 2000


@dataclass(frozen=True)
class Baseline:
    """A rule: its `value`, and the advantage of the trained policy over it on the same paths.

    - `less`, `less_error`: the value of the policy minus that of the rule, and its standard error.
    """

    name: str
    value: Number
    less: Number
    less_error: Number


@dataclass(frozen=True)
class Baselines:
    """The rules, with the best first; `optimum`: the largest mean reward in closed form, None if it
    is unknown or the objective is not the mean reward."""

    rivals: tuple[Baseline, ...]
    optimum: float | None = None


def measure(run: StudyRun) -> Baselines:
    """Values all classical rules of the plant on the paths of the trained policy."""
    problem, plant = run.setup.problem, plant_of(run)
    source, objective = problem.sources.evaluation, problem.objective
    trained = value_of_groups(objective, run.solution.totals, source)
    rules = []
    for name, rule in classical_rules(plant, problem.inputs).items():
        # A rule is valued once: XLA compiles it faster than the native engine.
        totals = path_totals(
            problem, rule, run.solution.paths["evaluate"], engine=Xla(precision="float64")
        )
        shares = value_of_groups(objective, totals, source)
        gap = of_shares(trained - shares)
        rules.append(Baseline(name, float(np.mean(shares)), gap.value, gap.standard_error))
    rules.sort(key=lambda rule: -rule.value)
    best = optimum(plant, plain(problem.inputs)) if isinstance(objective, Mean) else None
    return Baselines(tuple(rules), best)


def plant_of(run: StudyRun) -> Plant:
    """The plant of the run's problem."""
    plant = run.setup.problem.simulator
    assert isinstance(plant, Plant)
    return plant


def objective_text(run: RunFiles) -> str:
    """The objective as text, "mean reward of an episode"."""
    return str(run.get("objective", "objective"))


def show(run: RunFiles, result: Baselines) -> Sequence[Block]:
    """A ladder of values, and the advantage of the policy over each rule."""
    value = run.result.value
    rules = [rule for rule in result.rivals if np.isfinite(rule.value)]
    if not rules or value is None:
        return [why_missing(run, "rivals")]
    bars = [Bar("trained policy", value, run.result.standard_error, strong=True)]
    bars += [Bar(rule.name, rule.value) for rule in rules]
    if result.optimum is not None:
        bars.append(Bar("optimum, in closed form", result.optimum))
    digits = decimals([bar.value for bar in bars], 5)
    bars.sort(key=lambda bar: -bar.value)
    objective = objective_text(run)
    columns = (
        Column("Rule", "name"),
        Column("Value", "value"),
        Column("Policy earns more", lambda x: WithError(x.less, x.less_error), sign=True),
    )
    caption = f"{objective[:1].upper()}{objective[1:]}; higher is better."
    blocks: list[Block] = [
        ladder("rivals-ladder", bars, caption, digits),
        table(
            rules,
            columns,
            "Classical rules, valued on the same paths as the policy",
            decimal_places=digits,
        ),
    ]
    if best := result.optimum:
        share = 100 * (best - value) / abs(best)
        blocks.append(Text(f"The policy costs {share:.2f} % more than the optimum in closed form."))
    if (real := GYMNASIUM.of(run)) is not None:
        mean, error = number(real.mean, 2), plus_minus(real.standard_error, 2)
        reward = f"In Gymnasium's {real.name} the policy earns {mean} {error}"
        starts = f"over {number(real.starts, 0)} initial states (reset with the seeds 0, 1, …)."
        blocks.append(Text(f"{reward} {starts}"))
    regulator = (
        "The linear regulator is the solution of the Riccati equation for the plant, linearised "
        "at its target; its decisions are clipped to the limits."
    )
    return [*blocks, Text(regulator)]


BASELINES = Chapter("rivals", "Comparison with classical rules", Baselines, measure, show)


@dataclass(frozen=True)
class TwinReward:
    """Episodes of the policy in an environment of Gymnasium: mean reward and standard error.

    - `starts`: the number of episodes, which start from `reset(seed=0)`, `reset(seed=1)` …
    """

    name: str
    mean: Number
    standard_error: Number
    starts: int


def agent(plant: Plant, policy: Policy, inputs: Any) -> "Agent":
    """The policy as a function from the environment's observations to its actions."""
    from snapo.gym import Agent

    p = plain(inputs)["plant"]
    return Agent(
        policy,
        lambda observation: plant.from_twin(p, observation),
        lambda action: plant.to_twin(p, action),
    )


def play_twin(run: StudyRun) -> TwinReward:
    """The trained policy in the environment that has the plant's numbers."""
    from snapo.gym.environments import play

    problem, plant, policy = run.setup.problem, plant_of(run), run.solution.policy
    assert policy is not None
    played = play(agent(plant, policy, problem.inputs), plant.twin, STARTS)
    return TwinReward(plant.twin, played.mean, played.standard_error, STARTS)


def check_same(plant: Plant, inputs: Any, objective: Objective) -> None:
    """Refuses a case that differs from the environment, or does not maximise the mean reward."""
    if not plant.twin:
        message = f'Gymnasium has no environment for the plant "{plant.type}"'
        raise CaseError("--reference", "", None, message)
    values, usual = _settings(inputs), _settings(make_inputs(type(plant)))
    values["plant.horizon"], usual["plant.horizon"] = plant.horizon, plant.steps
    for name, value in values.items():
        if value != usual[name]:
            allowed = f"it must be {text_of(usual[name])}, as in {plant.twin}; or leave out "
            allowed += "--reference"
            raise CaseError("--reference", name, value, allowed)
    if plant.disturbed_parts or plant.measured or plant.time_feature:
        allowed = f"{plant.twin} has no disturbances, no noise and no observed time; "
        allowed += "leave --reference out"
        raise CaseError("--reference", "", None, allowed)
    if not isinstance(objective, Mean):
        allowed = f"the episodes of {plant.twin} give a mean reward, and the case has another "
        allowed += "objective; leave --reference out"
        raise CaseError("--reference", "objective.kind", None, allowed)


def _settings(inputs: Any) -> dict[str, Any]:
    """{"plant.mass": number, "start.angle": {"low": number, ...}, ...}."""

    def numbers(x: Any) -> Any:
        if isinstance(x, Mapping):
            return {key: numbers(y) for key, y in x.items()}
        return float(x.value)

    groups = ("plant", "cost", "start")
    return {f"{group}.{key}": numbers(x) for group in groups for key, x in inputs[group].items()}


GYMNASIUM = Chapter(
    "gymnasium", "In Gymnasium", TwinReward, play_twin, lambda run, played: [], key="gymnasium"
)
