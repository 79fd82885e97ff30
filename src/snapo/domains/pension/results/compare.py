"""The learned policy against classical ones, each tuned on the same objective and bounds."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.objective import CRRA, ExpectedUtility, Objective, Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, worth
from snapo.solver.solution import Solution
from snapo.solver.train import begin, train
from snapo.study.study import Setup, StudyRun, Tell

from ..policies.classical import ConstantMix, followers
from ..policies.one_of import OneOf
from ..policies.present_mix import present_mixes
from ..records.case import PensionCase
from .setup import FUNDING, PENSION, case_in, yardstick

LEARNED, MIX = "learned", "constant_mix"  # keys: of the policy that the others are compared with
EVEN = 1.0, 1.0  # funding ratios of a glide path that is not asked yet
RATE = 0.05  # learning rate of rules of a few numbers each, which have far to go


class Equivalent(NamedTuple):
    """A utility of the final funding ratio, or of the mean pension over today's, as a sure ratio:
    `slope` is d ratio / d utility."""

    ratio: float
    slope: float


def equivalent(objective: Objective, utility: float) -> Equivalent | None:
    """The sure final ratio that is worth as much; None for other objectives."""
    ratios = FUNDING.output, PENSION.output
    if not (isinstance(objective, ExpectedUtility) and objective.output in ratios):
        return None
    crra: CRRA = objective.utility
    ratio = crra.certainty_equivalent(utility)
    if not math.isfinite(ratio):
        return None
    return Equivalent(ratio, 1 / float(crra.slope(np.array(ratio))))


def work(run: StudyRun) -> dict[str, Any]:
    """ "policies": value, certainty equivalent and paired difference of every policy, the learned
    one first.

    Paired: on the same fresh paths; a positive difference is the learned policy's lead, and its
    standard error comes from the differences path by path. The classical policies take as many
    steps of training as the network did, those that follow the funding ratio on top of the
    constant mix from which they start; of each the best along the way is kept. The present mix,
    rebalanced at every step and yearly, is held as it is: it may leave the bounds.
    """
    return {"policies": compare(run.setup, run.solution, run.tell)}


def compare(setup: Setup, solution: Solution, tell: Tell) -> list[dict[str, Any]]:
    """The rows of `work`."""
    problem, case = setup.problem, case_in(setup)
    own = {name: np.asarray(total) for name, total in solution.totals.items()}
    found = [_row(problem, LEARNED, "Learned policy", own, own)]

    def measure(key: str, name: str, policy: Policy) -> Totals:
        paths, engine = setup.evaluation.paths, setup.engines.evaluate
        totals = path_totals(problem, policy, paths, engine=engine)
        found.append(_row(problem, key, name, totals, own))
        return totals

    tell("tuning constant mix")
    mix = tuned(setup, _one_of(_rules(case, ConstantMix(case), EVEN), MIX))
    totals = measure(MIX, "Constant mix", mix)
    rules, held = _rules(case, mix.rule, reached(problem, totals)), present_mixes(case)
    for key, (name, _) in list(rules.items())[1:]:
        policy = _one_of(rules, key)
        tell(f"{'holding' if key in held else 'tuning'} {name.lower()}")
        measure(key, name, policy if key in held else tuned(setup, policy))
    return found


def _rules(case: PensionCase, mix, ratios: tuple[float, float]) -> dict[str, tuple[str, Policy]]:
    """{key: (name, rule)} of all rules, those that follow the funding ratio starting at `mix`."""
    followed = followers(case, mix, ratios)
    return {MIX: ("Constant mix", mix), **followed, **present_mixes(case)}


def _one_of(rules: dict[str, tuple[str, Policy]], key: str) -> OneOf:
    return OneOf([rule for _, rule in rules.values()], list(rules).index(key))


def reached(problem: Problem, totals: Totals) -> tuple[float, float]:
    """The range of funding ratios between today's and the middle 80 % of the paths' last ones."""
    now = float(problem.schedule.constants.assets / problem.schedule.constants.liability)
    low, high = np.quantile(totals["funding_ratio"], [0.1, 0.9])
    return min(now, float(low)), max(now, float(high))


def tuned(setup: Setup, policy: OneOf) -> OneOf:
    """The best of the rules along a run of training, as for the network."""
    rate = max(RATE, setup.training.learning_rate)
    training = replace(setup.training, learning_rate=rate)
    found = train(setup.problem, begin(policy, training), training, setup.engines.train)
    return found.best  # pyright: ignore[reportReturnType]


def _row(problem: Problem, key: str, name: str, totals, own) -> dict[str, Any]:
    objective, source = problem.objective, problem.sources.evaluation
    case = problem.simulator.case  # pyright: ignore[reportAttributeAccessIssue]
    value, mine = worth(objective, totals), worth(objective, own)
    row: dict[str, Any] = {"key": key, "name": name, "value": value}
    with np.errstate(invalid="ignore"):
        # Ruin in both is no difference that can be measured.
        spread = objective.influence(own) - objective.influence(totals)
        error = _error(spread, source)
    row |= {"difference": mine - value, "difference_error": error}
    ratio, best = equivalent(objective, value), equivalent(objective, mine)
    if ratio is not None and best is not None:
        years = case.steps * case.step
        # ln of a sure ratio per year moves by its slope over the ratio for one unit of utility.
        ours = objective.influence(own) * best.slope / best.ratio
        theirs = objective.influence(totals) * ratio.slope / ratio.ratio
        row["equivalent"] = ratio.ratio
        row["lead"] = math.log(best.ratio / ratio.ratio) / years
        row["lead_error"] = _error(ours - theirs, source) / years
    final = np.asarray(totals[yardstick(case).output])
    row |= {"median": float(np.median(final)), "p05": float(np.quantile(final, 0.05))}
    row["underfunded"] = float((final < 1).mean())
    row["pv_contribution"] = float(np.mean(totals["pv_contribution"]))
    return row


def _error(values: np.ndarray, source: Scenarios) -> float:
    """The standard error of a mean over independent groups of paths (antithetic pairs)."""
    return statistics.mean(values, source.groups(np.arange(values.size))).standard_error
