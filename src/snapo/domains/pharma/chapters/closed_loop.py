"""The closed loop: policy, best fixed recipe and rules on the same fresh batches."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from snapo.problem.record import Input
from snapo.problem.smooth import Exact
from snapo.report.drawing import LIGHT, draw
from snapo.report.evidence import training_history
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Chart, Mark, Table, Text
from snapo.report.quantity import decimals, measured, number, with_unit
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals
from snapo.study.chapter import Chapter, Floats, Number
from snapo.study.study import StudyRun

from ..control.closed_loop import ClosedLoop, in_words
from ..control.policy import Feedback
from ..control.stages import Stage
from ..flowsheet.case import PharmaCase
from ..setpoints import HEADER
from ..shared import closed_loop
from . import pictures
from .recipes import RULES, TunedRule, recipe

LOW, HIGH = 0.1, 0.9  # quantiles over batches, of a band
FILE = "setpoints_closed_loop.csv"
SHOWN = 256  # batches from which the policy's trajectory is drawn
SIGNIFICANT = 2.0  # standard errors from which one of two counts as better


@dataclass(frozen=True)
class KeptShares:
    """Shares of batches that meet all limits, with standard errors, on the same batches.

    - `value`: the share under the policy; `baseline`: the share under the best fixed recipe;
      `gain`: their difference; `given`: the share under the recipe of the case. `better`: "policy",
      "recipe", or "" if the difference is not significant.
    """

    value: Number
    standard_error: Number
    baseline: Number
    baseline_error: Number
    gain: Number
    gain_error: Number
    given: Number
    given_error: Number
    better: str

    @property
    def verdict(self) -> str:
        """A sentence on whether to use the policy or the best fixed recipe."""
        both = f"{100 * self.value:.1f} % under the policy, {100 * self.baseline:.1f} % under "
        both += "the best fixed recipe, on the same batches"
        match self.better:
            case "policy":
                return f"The policy does better than the best fixed recipe: {both}."
            case "recipe":
                return (
                    f"The best fixed recipe does better than the policy: {both}. Take the recipe."
                )
            case _:
                return f"The policy and the best fixed recipe do not differ significantly: {both}."


@dataclass(frozen=True, eq=False)
class ControlCourse:
    """A control after each decision, at `time` in s since its unit's start.

    - `policy`, `policy_low`, `policy_high`: median and band over batches; `values`: the values of
      the best fixed recipe; `given`: those of the recipe of the case.
    """

    input: str
    unit: str
    time: Floats
    policy: Floats
    policy_low: Floats
    policy_high: Floats
    values: Floats
    given: Floats


@dataclass(frozen=True, eq=False)
class RuleShares:
    """A rule on the same batches, its settings, and by how much the policy and the recipe exceed
    its share."""

    name: str
    value: Number
    standard_error: Number
    policy_gain: Number
    policy_gain_error: Number
    recipe_gain: Number
    recipe_gain_error: Number
    gains_own: Floats
    times: Floats
    sensors: tuple[str, ...]
    of: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ClosedLoopResult(KeptShares):
    """Policy, recipe and rules; `objective`: value of the `goal`, if not of the probability."""

    goal: str
    objective: Number
    objective_error: Number
    baseline_objective: Number
    recipe: tuple[ControlCourse, ...]
    rules: tuple[RuleShares, ...]
    engine: str
    paths: dict[str, int]
    status: str


def measure(run: StudyRun) -> ClosedLoopResult:
    """Policy, rules and best recipe on the same fresh batches."""
    loop, best, solution = closed_loop(run), recipe(run, "best"), run.solution
    problem, evaluate, paths = loop.problem, loop.engines.evaluate, loop.evaluation.paths
    fixed = path_totals(problem, best, paths, engine=evaluate)
    first = path_totals(problem, loop.loop.baseline, paths, engine=evaluate)
    ours, theirs, values = (np.asarray(x["success"]) for x in (solution.totals, fixed, first))
    with jax.enable_x64(True):
        baseline_goal = float(problem.objective.value(fixed))
    groups, rules = problem.sources.evaluation.groups(np.arange(ours.size)), RULES.of(run) or ()
    trajectories = _courses_of(loop, best, run)
    run.write_csv(FILE, HEADER, decided(trajectories))
    return ClosedLoopResult(
        **vars(rates(ours, theirs, values, groups)), goal=in_words(loop.case.goal),
        objective=solution.value, objective_error=solution.standard_error,
        baseline_objective=baseline_goal, recipe=trajectories,
        rules=tuple(_beside(loop, x, ours, theirs, groups) for x in rules), engine=solution.engine,
        paths=dict(solution.paths), status=solution.status,
    )  # fmt: skip


def rates(
    ours: np.ndarray, theirs: np.ndarray, values: np.ndarray, groups: np.ndarray
) -> KeptShares:
    """Shares of batches that meet all limits under the policy, the best and the initial recipe.

    The arguments have one entry for each of N batches; the shares have standard errors. `groups`
    [N]: batches of one group are not independent. Both batches of an antithetic pair often meet or
    violate a two-sided limit together, so counting them as two would halve the variance.
    """
    numbers = [
        number
        for selected in (ours, theirs, ours - theirs, values)
        for number in _mean(selected, groups)
    ]
    return KeptShares(*numbers, better=better(numbers[4], numbers[5]))


def _mean(values: np.ndarray, groups: np.ndarray) -> tuple[float, float]:
    share = statistics.mean(values, groups)
    return share.value, share.standard_error


def better(gain: float, error: float) -> str:
    """Which of the two meets all limits more often on the same batches: "policy", "recipe", or
    ""."""
    if abs(gain) <= SIGNIFICANT * error:
        return ""
    return "policy" if gain > 0 else "recipe"


def _beside(loop: ClosedLoop, rule: TunedRule, ours, theirs, groups) -> RuleShares:
    """A rule on the same batches: its share, and the differences of policy and recipe from it."""
    paths, engine = loop.evaluation.paths, loop.engines.evaluate
    local = np.asarray(path_totals(loop.problem, rule.policy(), paths, engine=engine)["success"])
    numbers = [
        x for selected in (local, ours - local, theirs - local) for x in _mean(selected, groups)
    ]
    return RuleShares(
        rule.name, *numbers, gains_own=rule.gains_own, times=rule.times, sensors=rule.sensors,
        of=rule.of,
    )  # fmt: skip


def _courses_of(loop: ClosedLoop, best: Feedback, run: StudyRun) -> tuple[ControlCourse, ...]:
    """Every control over time, of the policy and of both recipes, in the domain's units."""
    source = loop.problem.sources.evaluation
    block = next(iter(source.blocks(source.available(SHOWN), 1)))
    draws = source.draws(block, loop.problem.simulator)
    bound = loop.engines.evaluate.bind(loop.problem)
    rollout = bound.values(run.solution.policy, draws, Exact(), record=("action",))
    actions = [np.asarray(rollout.record["action"], float)]
    actions += [policy.actions()[:, None] for policy in (best, loop.loop.baseline)]
    inputs, stages = loop.loop.inputs, loop.loop.stages
    three = (trajectories(loop.case, stages, inputs, x) for x in actions)
    return tuple(
        ControlCourse(
            input=name, unit=inputs[name].unit, time=time, policy=np.median(policy, 1),
            policy_low=np.quantile(policy, LOW, 1), policy_high=np.quantile(policy, HIGH, 1),
            values=fixed[:, 0], given=first[:, 0],
        )
        for (name, time, policy), (*_, fixed), (*_, first) in zip(*three, strict=True)
    )  # fmt: skip


def trajectories(
    case: PharmaCase, stages: Sequence[Stage], inputs: Mapping[str, Input], actions: np.ndarray
) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """(name, time, values) of each control, from actions [T, N, size]: values [T, N] after each
    decision, in the domain's units; `time` [T]: s since the unit's start. Ramps are met over the
    nominal duration."""
    assert case.control is not None
    rows = []
    for stage in stages:
        seconds = None
        if stage.unit is not None:
            seconds = float(inputs[stage.unit.duration.name].value[0]) / stage.horizon
        for position, i in enumerate(stage.decided):
            item = case.control.manipulated[i]
            part = actions[stage.before : stage.before + stage.horizon, :, position]
            values = item.low + np.asarray(part, float) * (item.high - item.low)
            if item.ramp is not None and seconds is not None:
                values = _within(values, float(inputs[item.input].value[0]), item.ramp * seconds)
            rows.append((item.input, (np.arange(stage.horizon) + 1) * (seconds or 0.0), values))
    return rows


def _within(values: np.ndarray, start: float, maximum: float) -> np.ndarray:
    """Values that move by at most `maximum` from one decision to the next."""
    limited, last = np.empty_like(values), np.full(values.shape[1], start)
    for t, target in enumerate(values):
        limited[t] = last = np.clip(target, last - maximum, last + maximum)
    return limited


def decided(rows: Sequence[ControlCourse]) -> list[tuple]:
    """Setpoints of the best fixed recipe: its value at the end of each decision."""
    return [
        (x.input.partition(".")[0], x.input, "linear" if len(x.time) > 1 else "once",
         float(time), float(value), x.unit)
        for x in rows
        for time, value in zip(x.time, x.values)
    ]  # fmt: skip


def show(run: RunFiles, result: ClosedLoopResult) -> list[Block]:
    """The policy against the best fixed recipe, on the same fresh batches."""
    certain = result.gain > 3 * result.gain_error
    rows = [
        ("Trained policy", *_share(result.value, result.standard_error)),
        ("Best fixed recipe", *_share(result.baseline, result.baseline_error)),
        ("Original recipe", *_share(result.given, result.given_error)),
        ("Policy minus best recipe", *_share(result.gain, result.gain_error)),
    ]
    head = [("", ""), ("Probability of all limits", "%"), ("", "")]
    batches = number(result.paths.get("evaluate"), 0)
    caption = f"Shares of the same {batches} fresh batches, with exact limits"
    clear = Mark(certain, "yes" if certain else "no")
    blocks: list[Block] = [
        Text(run.result.verdict),
        Table(head, rows, caption),
        Table([], [("Gain above three standard errors", clear)], "", 2),
    ]
    if result.rules:
        blocks += _rules(result.rules)
    if run.result.references.get("goal") is not None:
        blocks.append(_goal(result))
    blocks += [_course(x) for x in result.recipe if len(x.time) > 1]
    once = [x for x in result.recipe if len(x.time) == 1]
    if once:
        blocks.append(_once(once))
    return [*blocks, *training_history(run, "objective").blocks]


def _share(value: float, error: float) -> tuple[str, str]:
    """A share in per cent, and half of its interval."""
    return measured(100 * value, 100 * error, 2)


def _goal(result: ClosedLoopResult) -> Table:
    """The objective, if it is not the probability itself."""
    digits = decimals([result.objective, result.baseline_objective], 4)
    rows = [
        ("Trained policy", *measured(result.objective, result.objective_error, digits)),
        ("Best fixed recipe", number(result.baseline_objective, digits), ""),
    ]
    head = [("", ""), ("Goal", ""), ("", "")]
    return Table(head, rows, f"The goal: {result.goal}")


def _rules(rules: Sequence[RuleShares]) -> list[Block]:
    """PI controllers: their shares on the same batches, and their settings."""
    shares = [
        (
            x.name,
            *_share(x.value, x.standard_error),
            *_share(x.policy_gain, x.policy_gain_error),
            *_share(x.recipe_gain, x.recipe_gain_error),
        )
        for x in rules
    ]
    settings = [
        (x.name, sensor, number(gain), number(time / 60))
        for x in rules
        for sensor, gain, time in zip(x.sensors, x.gains_own, x.times)
    ]
    head = [("", ""), ("All limits met", "%"), ("", ""), ("Policy minus rule", "%"), ("", ""),
            ("Recipe minus rule", "%"), ("", "")]  # fmt: skip
    local = ("Rule", "Measured", "Gain, units of the computation", "Integral time, min")
    return [
        Table(head, shares, "Rules on the same batches, paired differences"),
        Table([(name, "") for name in local], settings, "Settings of the rules", 2),
        Text("“First settings” are those of the case or of a tuning formula. The rule without "
            "this label was trained: from these settings, together with its recipe, and in as "
            "many steps as the policy."),
    ]  # fmt: skip


def _course(result: ControlCourse) -> Chart:
    """A control over time: the policy's median and band, and both recipes."""
    minutes = result.time / 60
    lines = [
        ("Policy, median", result.policy),
        ("Best fixed recipe", result.values),
        ("Original recipe", result.given),
    ]

    def paint(axes):
        band = result.policy_low, result.policy_high
        axes.fill_between(minutes, *band, color=LIGHT["inject-soft"], linewidth=0)
        pictures.curves(axes, minutes, lines, with_unit(result.input, result.unit))
        axes.set_xlabel("Time at the end of each decision, min")

    svg = draw(f"course-{result.input}", "A control over time: the policy's median and its band "
               "over batches, the best fixed recipe, and the original recipe.", paint,
               220)  # fmt: skip
    text = "The band contains the policy's decisions in 80 % of the batches (10 to 90 % quantile)."
    return Chart(svg, f"{result.input}: {text}")


def _once(rows: Sequence[ControlCourse]) -> Table:
    """The numbers that are decided once in a batch."""
    cells = [
        (
            with_unit(x.input, x.unit), *(number(y[0]) for y in (x.policy, x.values, x.given)),
            f"{number(x.policy_low[0])} – {number(x.policy_high[0])}",
        )
        for x in rows
    ]  # fmt: skip
    names = ("Number", "Policy, median", "Best fixed recipe", "Original recipe", "Policy, 10–90 %")
    return Table([(name, "") for name in names], cells, "Numbers that are decided once in a batch")


CLOSED_LOOP = Chapter(
    "closed loop", "Closed loop", ClosedLoopResult, measure, show, key="closed_loop",
    table="control"
)  # fmt: skip
