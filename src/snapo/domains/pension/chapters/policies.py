"""The learned policy against classical ones, each tuned on the same objective and bounds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from snapo.problem.objective import Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios
from snapo.report.bands import scatter
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Table, Text
from snapo.report.quantity import decimals, measured, number, plus_minus
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, value_of
from snapo.solver.solution import Solution
from snapo.solver.train import initial_progress, train
from snapo.study.chapter import Chapter, Number
from snapo.study.study import ProgressCallback, Setup, StudyRun

from ..policies.classical import ConstantMix, OneOf, followers, present_mixes
from ..records.case import PensionCase
from ..results.setup import case_in, outcome_measure
from ..run import PensionRun, points, with_measure
from .objective import equivalent

LEARNED, MIX = "learned", "constant_mix"  # keys: of the policy that the others are compared with
PRESENT = ("present_mix", "present_mix_yearly")  # keys of the mixes that are held
EVEN = 1.0, 1.0  # funding ratios of a glide path that is not asked yet
RATE = 0.05  # learning rate of rules of a few numbers each, which have far to go


@dataclass(frozen=True)
class PolicyWorth:
    """A policy on the evaluation's paths.

    - `difference`: the value of the learned policy minus that of this policy, path by path.
    - `equivalent`: the certainty equivalent; `lead`: the lead of the learned policy, as a log ratio
      per year; both are NaN if the objective is not a utility of a ratio.
    - `median`, `p05`, `underfunded`: median and 5 % quantile of the final ratio, and the share of
      paths on which it is below 1.
    - `pv_contribution`: the mean present value of contributions, in money.
    """

    key: str = ""
    name: str = ""
    value: Number = np.nan
    difference: Number = np.nan
    difference_error: Number = np.nan
    equivalent: Number = np.nan
    lead: Number = np.nan
    lead_error: Number = np.nan
    median: Number = np.nan
    p05: Number = np.nan
    underfunded: Number = np.nan
    pv_contribution: Number = np.nan


def measure(run: StudyRun) -> tuple[PolicyWorth, ...]:
    """Value, certainty equivalent and paired difference of every policy, the learned one first.

    All policies are valued on the same fresh paths. A positive difference is a lead of the learned
    policy, and its standard error comes from the differences path by path. The classical policies
    are trained for as many steps as the network; those that depend on the funding ratio start from
    the trained constant mix. The best version of every training is used. The present mix,
    rebalanced at every step or yearly, is not tuned, and may be outside the bounds.
    """
    return tuple(compare(run.setup, run.solution, run.progress))


def compare(setup: Setup, solution: Solution, progress: ProgressCallback) -> list[PolicyWorth]:
    """The rows of `measure`."""
    problem, case = setup.problem, case_in(setup)
    local = {name: np.asarray(total) for name, total in solution.totals.items()}
    policies = [_worth(setup, LEARNED, "Learned policy", local, local)]

    def evaluate(key: str, name: str, policy: Policy) -> Totals:
        paths, engine = setup.evaluation.paths, setup.engines.evaluate
        totals = path_totals(problem, policy, paths, engine=engine)
        policies.append(_worth(setup, key, name, totals, local))
        return totals

    progress("tuning constant mix")
    mix = tuned(setup, _one_of(_rules(case, ConstantMix(case), EVEN), MIX))
    totals = evaluate(MIX, "Constant mix", mix)
    rules, held = _rules(case, mix.rule, reached(problem, totals)), present_mixes(case)
    for key, (name, _) in list(rules.items())[1:]:
        policy = _one_of(rules, key)
        progress(f"{'holding' if key in held else 'tuning'} {name.lower()}")
        evaluate(key, name, policy if key in held else tuned(setup, policy))
    return policies


def _rules(case: PensionCase, mix, ratios: tuple[float, float]) -> dict[str, tuple[str, Policy]]:
    """{key: (name, rule)} of all rules, those that follow the funding ratio starting at `mix`."""
    followed = followers(case, mix, ratios)
    return {MIX: ("Constant mix", mix), **followed, **present_mixes(case)}


def _one_of(rules: dict[str, tuple[str, Policy]], key: str) -> OneOf:
    return OneOf([rule for _, rule in rules.values()], list(rules).index(key))


def reached(problem: Problem, totals: Totals) -> tuple[float, float]:
    """The range that contains today's funding ratio and the middle 80 % of the final ones."""
    now = float(problem.schedule.constants.assets / problem.schedule.constants.liability)
    low, high = np.quantile(totals["funding_ratio"], [0.1, 0.9])
    return min(now, float(low)), max(now, float(high))


def tuned(setup: Setup, policy: OneOf) -> OneOf:
    """The best version of the rule in its training, as for the network."""
    rate = max(RATE, setup.training.learning_rate)
    training = replace(setup.training, learning_rate=rate)
    result = train(setup.problem, initial_progress(policy, training), training, setup.engines.train)
    return result.best  # pyright: ignore[reportReturnType]


def _worth(setup: Setup, key: str, name: str, totals, local) -> PolicyWorth:
    case, problem = case_in(setup), setup.problem
    objective, source = problem.objective, problem.sources.evaluation
    value, mine = value_of(objective, totals), value_of(objective, local)
    with np.errstate(invalid="ignore"):
        # Ruin in both is no difference that can be measured.
        spread = objective.influence(local) - objective.influence(totals)
        error = _error(spread, source)
    final = np.asarray(totals[outcome_measure(case).output])
    policy = PolicyWorth(
        key,
        name,
        value,
        mine - value,
        error,
        median=float(np.median(final)),
        p05=float(np.quantile(final, 0.05)),
        underfunded=float((final < 1).mean()),
        pv_contribution=float(np.mean(totals["pv_contribution"])),
    )
    ratio, best = equivalent(objective, value), equivalent(objective, mine)
    if ratio is None or best is None:
        return policy
    years = case.steps * case.step
    # ln of a certain ratio per year moves by its slope over the ratio for one unit of utility.
    ours = objective.influence(local) * best.slope / best.ratio
    theirs = objective.influence(totals) * ratio.slope / ratio.ratio
    return replace(
        policy,
        equivalent=ratio.ratio,
        lead=math.log(best.ratio / ratio.ratio) / years,
        lead_error=_error(ours - theirs, source) / years,
    )


def _error(values: np.ndarray, source: Scenarios) -> float:
    """The standard error of a mean over independent groups of paths (antithetic pairs)."""
    return statistics.mean(values, source.groups(np.arange(values.size))).standard_error


def show(run: PensionRun, policies: tuple[PolicyWorth, ...]) -> Sequence[Block]:
    """A table of all policies, and contributions against the ratio in bad times."""
    certain = all(np.isfinite(policy.equivalent) for policy in policies)
    body = [_row(run, policy, certain) for policy in policies]
    head = [("Policy", "")]
    if certain:
        head += [("Certainty equivalent", "%"), ("Learned policy's lead", "bp a year"), ("", "")]
    else:
        head += [("Objective", ""), ("Learned policy's lead", ""), ("", "")]
    _, unit = run.size([policy.pv_contribution for policy in policies])
    text = ("Median pension", "Below today's") if run.personal else ("Median F", "P(F < 1)")
    head += [(text[0], "%"), ("5 % quantile", "%"), (text[1], "%"), ("PV contributions", unit)]
    caption = (
        "All policies are valued on the same fresh paths. The classical ones are tuned on the same"
        " objective within the same bounds; the present mix is not tuned. The lead of the learned"
        " policy is computed path by path."
    )
    table = Table(head, body, "", 1, strong=frozenset([0]))
    return [table, Text(caption, True), _cloud(run, policies, unit)]


def leads(policies: Sequence[PolicyWorth]) -> str:
    """The lead over the present mix and over the best of the other rules, in a sentence; empty
    if no rule was valued."""
    others = [x for x in policies if x.key != LEARNED]
    certain = bool(others) and all(np.isfinite(x.equivalent) for x in policies)
    first = next((x for x in others if x.key == PRESENT[0]), None)
    rules = [x for x in others if x.key not in PRESENT]
    best = min(rules, key=lambda x: x.lead if certain else x.difference, default=None)
    parts = []
    for policy, name in ((first, "the present mix"), (best, "the best tuned classical rule")):
        if policy is None:
            continue
        lead, error, unit = policy.difference, policy.difference_error, "in the objective"
        if certain:
            lead, error, unit = 1e4 * policy.lead, 1e4 * policy.lead_error, "bp a year"
        digits = 1 if certain else max(0, decimals([error], 2))
        more, half = measured(lead, error, digits, True)
        label = name if policy is first else f"{name} ({policy.name.lower()})"
        parts.append(f"{more} {half} {unit} over {label}")
    return f"Advantage: {'; '.join(parts)}." if parts else ""


def _cloud(run: PensionRun, policies: Sequence[PolicyWorth], unit: str) -> Chart:
    """Contributions of each policy against the funding ratio in bad times."""
    marks = [(x.name, _contribution(run, x), 100 * x.p05, x.key == LEARNED) for x in policies]
    name, short = "funding ratio", "F"
    if run.personal:
        name = short = "pension over today's"
    units = (f"Mean present value of contributions, {unit}", f"5 % quantile of {short}, %")
    alt = f"Policies by present value of contributions and 5 % quantile of the {name}."
    svg = draw("frontier", alt, lambda axes: scatter(axes, marks, units), 230)
    text = (
        f"Contributions against the {name} in bad times; points further up and to the left "
        "are better."
    )
    return Chart(svg, text)


def _contribution(run: PensionRun, policy: PolicyWorth) -> float:
    return policy.pv_contribution / run.size(policy.pv_contribution)[0]


def _row(run: PensionRun, policy: PolicyWorth, certain: bool) -> tuple[str, ...]:
    if certain:
        value = points(policy.equivalent, 2)
        lead = number(1e4 * policy.lead, 1, True), plus_minus(1e4 * policy.lead_error, 1)
    else:
        value = number(policy.value)
        lead = number(policy.difference, None, True), plus_minus(policy.difference_error, 4)
    return (
        policy.name,
        value,
        *(("", "") if policy.key == LEARNED else lead),
        points(policy.median, 1),
        points(policy.p05, 1),
        points(policy.underfunded, 1),
        number(_contribution(run, policy), 2),
    )


POLICIES = Chapter(
    "classical policies", with_measure("Learned and classical policies"), tuple[PolicyWorth, ...],
    measure, show, "Policies", key="policies", anchor="policies",
)  # fmt: skip
