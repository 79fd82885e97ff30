"""The end of a training, as a keyword, and reasons to distrust its result.

"trained" only means that all steps were taken. Here the policy is compared with the untrained one,
with the one at half of training and with constant decisions on the same paths, in kernels that are
compiled already. "converged" needs evidence: without it, the keyword is "too short to tell".
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from snapo.engine import Engine
from snapo.problem.noise import Draws
from snapo.problem.objective import Totals
from snapo.problem.policies.memory import GRU, LastObservations
from snapo.problem.policy import MLP, Policy, parameters
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact

from .. import statistics
from ..adjoint import finite, float64
from ..derivatives.rebuilt import LONG, fewer
from ..evaluate import DECIDED, chunks, in_a_row, value_of
from ..learning.settings import TrainingPlan
from ..limits import NEARLY
from ..train import Progress
from .constant import (
    at_limit,
    constant_baselines,
    constant_decisions,
    describe,
    equal_on_all_paths,
    idle_advice,
    never_taken,
    numbers_text,
)
from .further import Further, compared_step, ends_for_good, restless, times_of, too_short

CONVERGED, IMPROVING, SHORT = "converged", "still improving", "too short to tell"
SATURATED, CONSTANT = "saturated", "constant"
UNMOVED, AS_BEGUN = "barely moved", "as good as its start"
UNDECIDED = (IMPROVING, SHORT, UNMOVED, AS_BEGUN)  # verdicts that a bound may make CONVERGED
NETWORKS = (MLP, GRU, LastObservations)  # policies that do not begin as a rule if they are drawn
SIGNIFICANT = 2.0  # standard errors of a gain
OFFSET = 10  # times the total gain: a larger value has a part that no decision affects
ENOUGH = 2048  # paths on which two rules are compared
TRY_OTHERS = (
    "try several starts (starts = 4), features of mean 0 and deviation 1, wider starting states, "
    "or a higher temperature_start"
)


STILL, TELLS_NOT, NOTHING = "Still improving: ", "Too short to tell ", "Training gained nothing "


class Ending(NamedTuple):
    """The keyword, and sentences on the limits of the value and on remedies."""

    word: str
    notes: tuple[str, ...] = ()


class Gain(NamedTuple):
    """The advantage of the objective over that of another rule on the same paths."""

    value: float
    error: float

    @property
    def is_significant(self) -> bool:
        # One randomised net has no error that could be known.
        return self.value > (SIGNIFICANT * self.error if np.isfinite(self.error) else 0.0)

    @property
    def surely_below(self) -> bool:
        """Whether the other rule is better."""
        return Gain(-self.value, self.error).is_significant

    def __str__(self) -> str:
        return f"{statistics.rounded(self.value, 3)} {statistics.plus_minus(self.error)}"


NONE = Gain(0.0, 0.0)  # over itself


def ending(
    problem: Problem,
    untrained: Policy,
    progress: Progress,
    training: TrainingPlan,
    exact: Totals,
    held_paths: int,
    decisions: np.ndarray | None,
    engine: Engine,
    gradient: tuple[float, float] | None = None,
    drawn: bool = False,
) -> Ending:
    """How training ended, by the exact simulator on paths of the evaluation; a training that was
    aborted has notes but no keyword.

    A rule that violates a limit of the problem by more than the trained policy is not a baseline.

    - `progress`: its `best` is the reported policy; `training`: the settings, with "auto" resolved.
    - `exact`: {output: [paths]} of that policy on the evaluation's paths.
    - `held_paths`: the number of paths for the held derivatives; 0 leaves out the checks that need
      decisions.
    - `decisions` [T, held_paths, A]: the decisions of that policy on these paths, if they were
      recorded before.
    - `gradient`: the norm of the policy's gradient and the norm of its noise, if known.
    - `drawn`: whether the networks of `untrained` were drawn at random for this training.
    """
    if not np.isfinite(value_of(problem.objective, exact)):
        return Ending("")
    does_nothing = equal_on_all_paths(problem, exact)
    selected = untrained is progress.best
    over_start = NONE if selected else _over(problem, untrained, exact, engine)
    notes = [idle_advice(value_of(problem.objective, exact))] if does_nothing else []
    still, of, over_constant = [], len(problem.action.together()), None
    if held_paths:
        taken = _decisions(problem, progress.best, held_paths, decisions, engine)
        still = constant_decisions(problem.action, taken.actions)
        constant, over_constant = _over_constants(problem, exact, taken, engine)
        if still:
            notes.append(f"{describe(still, of)}: if that is not intended, {TRY_OTHERS}.")
        if len(still) < of and not over_constant.is_significant:
            notes.append(_as_well(problem, constant, over_constant))
        if unused := never_taken(problem.action, taken.actions):
            notes.append(f"{unused}. If one of these options should be taken, {TRY_OTHERS}.")
    if progress.status == "diverged":
        return Ending("", tuple(notes))
    all_still = len(still) == of
    if does_nothing:
        word = CONSTANT
    elif not over_start.is_significant:
        at_random = drawn and isinstance(untrained, NETWORKS)
        if at_random:
            notes.append(UNMOVED_ADVICE)
        word = UNMOVED if at_random else AS_BEGUN
    elif all_still and at_limit(still):
        word = SATURATED
    else:
        more = _further(problem, progress, training, exact, over_start, engine)
        as_good = over_constant is not None and not over_constant.is_significant
        below = over_constant is not None and over_constant.surely_below
        if all_still or (as_good and not below):
            word = CONSTANT
        elif more.improving:
            word = IMPROVING
            notes.append(_improving(progress, training, more))
        elif as_good:
            word = CONSTANT
        elif short := _short(progress, training, more, gradient):
            word = SHORT
            notes.append(f"{TELLS_NOT}whether more steps would help: {short}.")
        else:
            word = CONVERGED
    return Ending(word, tuple(notes))


def without_advice(notes: Iterable[str]) -> list[str]:
    """The sentences that do not suggest longer training."""
    return [note for note in notes if not note.startswith((STILL, TELLS_NOT, NOTHING))]


UNMOVED_ADVICE = (
    f"{NOTHING}over the network that was drawn at random: try more steps, another "
    "learning_rate, wider starting states or features that distinguish states."
)


def _further(
    problem: Problem,
    progress: Progress,
    training: TrainingPlan,
    exact: Totals,
    over_start: "Gain",
    engine: Engine,
) -> Further:
    """The gain over the policy of halfway, on more paths until they are significant, and its
    meaning.

    With limits the gain includes their prices, so that a policy that violates one can be compared.
    """
    rated = problem.priced(progress.dual.prices or [0.0] * len(problem.constraints))
    available = exact[problem.objective.outputs[0]]
    best, spread = value_of(problem.objective, exact), float(np.nanstd(available))
    size = min(OFFSET * abs(over_start.value), max(abs(best), spread))
    times = times_of(progress, training)
    paths, maximum = ENOUGH, len(available)
    while True:
        late = _over(rated, progress.halfway, exact, engine, paths)
        result = Further(late.value, late.error, times, size)
        if result.improving or result.is_small or paths >= maximum:
            return result
        paths *= 4


def _improving(progress: Progress, training: TrainingPlan, more: Further) -> str:
    return (
        f"{STILL}the steps after {compared_step(progress, training)} of "
        f"{progress.step} gained {Gain(more.late, more.late_error)}, and the same number of "
        f"further steps would gain about {statistics.rounded(more.more, 2)}; try "
        f"steps={2 * progress.step}."
    )


def _short(
    progress: Progress,
    training: TrainingPlan,
    more: Further,
    gradient: tuple[float, float] | None,
) -> str:
    """The reason why it is unknown whether a training has converged; empty if it has."""
    if too_short(training, progress.step):
        return f"{min(training.warmup, progress.step)} of its {progress.step} steps are the warm-up"
    if not more.is_small:
        return (
            f"the steps after {compared_step(progress, training)} gained "
            f"{Gain(more.late, more.late_error)}"
        )
    moved = parameters(progress.best) - parameters(progress.halfway)
    path = float(np.linalg.norm(moved))
    if gradient is not None and restless(*gradient, path, more.size):
        return f"the gradient is {gradient[0] / gradient[1]:.2g} times its noise"
    return ""


def _as_well(problem: Problem, constant: np.ndarray, gain: "Gain") -> str:
    """The sentence on a constant decision that is as good as the trained rule, or better."""
    attempt = TRY_OTHERS
    if ends_for_good(problem):
        attempt = f"write a decision on when to stop as a snapo.Stop, or {attempt}"
    if gain.surely_below:
        return (
            f"A constant decision ({numbers_text(constant)}) does better, by "
            f"{Gain(-gain.value, gain.error)}: {attempt}."
        )
    return (
        f"A constant decision ({numbers_text(constant)}) does as well (the trained rule gains "
        f"{gain}), so the policy gains nothing from the observation. If it should, {attempt}."
    )


def _over(
    problem: Problem, other: Policy, exact: Totals, engine: Engine, enough: int = ENOUGH
) -> Gain:
    """On the first chunks of the evaluation, for which kernels exist."""
    source, bound = problem.sources.evaluation, engine.bind(_unpriced(problem))
    paths, horizon = len(exact[problem.objective.outputs[0]]), problem.simulator.horizon
    if horizon > LONG:
        paths = min(paths, fewer(enough, horizon))
    blocks = _first(chunks(source, paths, problem.simulator), enough)
    totals = [
        bound.values(other, source.draws(block, problem.simulator), Exact()).totals
        for block in blocks
    ]
    return _gain(problem, exact, [float64(item) for item in totals], np.concatenate(blocks))


def _decisions(
    problem: Problem,
    policy: Policy,
    held_paths: int,
    recorded: np.ndarray | None,
    engine: Engine,
) -> "_Decisions":
    """The decisions on the first blocks of the paths of the held derivatives."""
    bound, source = engine.bind(problem), problem.sources.evaluation
    blocks = _first(source.blocks(source.available(held_paths)))
    if recorded is None:
        draws = [source.draws(block, problem.simulator) for block in blocks]
        rolled = [bound.values(policy, part, Exact(), record=DECIDED) for part in draws]
        actions = [np.asarray(rollout.record["action"]) for rollout in rolled]
    else:
        actions = [recorded[:, in_a_row(block)] for block in blocks]
    paths, sizes = np.concatenate(blocks), [len(block) for block in blocks]
    draws = source.draws(paths, problem.simulator)
    return _Decisions(paths, sizes, draws, np.concatenate(actions, axis=1))


class _Decisions(NamedTuple):
    """Paths, how many of them are in each block, their scenarios, and actions [T, paths, size]."""

    paths: np.ndarray
    sizes: list[int]
    draws: Draws
    actions: np.ndarray


def _over_constants(
    problem: Problem, exact: Totals, taken: _Decisions, engine: Engine
) -> tuple[np.ndarray, Gain]:
    """The best constant decision [size] of some, and the gain over it: see `constant_baselines`."""
    unpriced = _unpriced(problem)
    bound, outputs = engine.bind(unpriced, controls=False), unpriced.objective.outputs
    paths, sizes, draws, actions = taken
    weights = dict.fromkeys(outputs, np.full(len(paths), 1 / len(paths)))
    pairs = []
    for constant in constant_baselines(problem.action, actions):
        same = np.broadcast_to(constant.astype(actions.dtype), actions.shape)
        # The held derivatives have this kernel compiled already.
        passed = bound.adjoints(
            None, draws, Exact(), weights, sizes, actions=same, wrt=("schedule",)
        )
        pairs.append((constant, _gain(problem, exact, [float64(passed.totals)], paths)))
    return min(pairs, key=lambda pair: pair[1].value)


def _first(blocks: list[np.ndarray], enough: int = ENOUGH) -> list[np.ndarray]:
    """The first blocks that have enough paths together, or all."""
    sizes = np.cumsum([len(block) for block in blocks])
    return blocks[: int(np.searchsorted(sizes, enough)) + 1]


def _gain(problem: Problem, exact: Totals, parts: list[Totals], paths: np.ndarray) -> Gain:
    """The difference of the objective, with the standard error of paired paths."""
    objective = problem.objective
    mine = {name: np.asarray(total)[paths] for name, total in exact.items()}
    other = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    valid = finite(mine, objective.outputs) & finite(other, objective.outputs)
    if not valid.any():
        return Gain(np.inf, 0.0)
    mine, other = ({n: total[valid] for n, total in item.items()} for item in (mine, other))
    paths = paths[valid]
    with np.errstate(invalid="ignore"):
        value = objective.value(mine) - objective.value(other)
        spread = objective.influence(mine) - objective.influence(other)
    groups = np.unique(problem.sources.evaluation.groups(paths), return_inverse=True)[1]
    if not np.isfinite(value) or _breaks_a_limit(problem, mine, other, groups):  # or is ruined
        return Gain(np.inf, 0.0)
    return Gain(float(value), float(statistics.mean(spread, groups).standard_error))


def _unpriced(problem: Problem) -> Problem:
    """The problem with the outputs of its limits in addition to those of its objective, as in
    kernels."""
    return problem.priced([0.0] * len(problem.constraints))


def _breaks_a_limit(problem: Problem, mine: Totals, other: Totals, groups: np.ndarray) -> bool:
    """Whether the other rule surely violates a limit by more than mine does."""
    for limit in problem.constraints:
        influence = limit.measure.influence(other)
        error = statistics.mean(influence, groups).standard_error
        outside = limit.excess(other) - max(limit.excess(mine), 0.0)
        if outside > max(
            SIGNIFICANT * error if np.isfinite(error) else 0.0, NEARLY * influence.std()
        ):
            return True
    return False
