"""The choice of the reported policy, among those of a training and its initial rule.

The values of a training's history are compared on the same few paths again and again, so that the
highest is biased upwards. The final choice is made once, on fresh paths that are used for nothing
else, with paired differences and the control variates regressed out of them. The starting rule is
selected unless another is significantly better: training must not make a good rule worse. The paths
of the reported value are not used for this choice.

The module also contains the numbers of paths with which a policy is measured.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from snapo.engine import Engine
from snapo.problem.actions.sets import count
from snapo.problem.objective import Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import VALIDATE, Pseudo, Scenarios, Sobol, Sources, stream

from .. import statistics
from ..derivatives.rebuilt import LONG, fewer
from ..evaluate import of_groups, path_totals, shares_of, value_of

SCENARIOS = ("pseudo-random", "sobol")
SMALL = 4e6  # steps of paths, which take a second or so and are spent in any case
PURPOSES = 3  # the surface, its margin, the bumps
FEWEST = 512  # paths of a surface and of a margin
FEWEST_LONG = 128  # and of long paths: no more steps together than 512 paths of `LONG` have
BACK = 4  # paths valued in the time of one path that is gone back over
ROUND_OFF = 64 * np.finfo(np.float64).eps  # of a path's total
PAIR = 2  # coordinates that a surface has in any case


@dataclass(frozen=True)
class Evaluation:
    """The settings for the evaluation of a policy. With zero paths a result is omitted.

    - `paths`: fresh scenarios for the value.
    - `sensitivity_paths`: paths for the derivatives with decisions held fixed; `smooth_paths`:
      paths for the derivatives through the smooth policy; 0 also omits the change of held
      derivatives during training.
    - `judge_paths`: the maximum for bumps of every input, which test the held derivatives.
    - `search_paths`: the maximum for values around the policy, from which the policy's part of
      every interval is computed.
    - `selection_paths`: the maximum for the final choice between the policies of a training and its
      initial rule; never more than `paths`.
    - `scenarios`: "pseudo-random" (antithetic) or "sobol".
    """

    paths: int = 65536
    sensitivity_paths: int = 16384
    smooth_paths: int = 4096
    judge_paths: int = 16384
    search_paths: int = 16384
    selection_paths: int = 16384
    scenarios: str = "pseudo-random"

    def __post_init__(self):
        if self.scenarios not in SCENARIOS:
            allowed = " or ".join(map(repr, SCENARIOS))
            raise ValueError(f"Evaluation: scenarios is {self.scenarios!r}; it must be {allowed}.")
        for name in MINIMUM:
            count(f"Evaluation: {name}", getattr(self, name), MINIMUM[name])

    def sources(self, seed: int) -> Sources:
        """Fresh scenarios for every role, with the kind requested here for the evaluation."""
        fresh = Sources.of(None, seed)
        return replace(fresh, evaluation=Sobol(seed)) if self.scenarios == "sobol" else fresh

    def within(self, horizon: int) -> "Evaluation":
        """The same settings with `fewer` paths for everything except the value, if paths are
        long."""
        counts = {name: fewer(getattr(self, name), horizon) for name in MINIMUM if name != "paths"}
        return replace(self, **counts)


MINIMUM = {
    "paths": 2, "sensitivity_paths": 0, "smooth_paths": 0, "judge_paths": 0, "search_paths": 0,
    "selection_paths": 0,
}  # fmt: skip


class Effort(NamedTuple):
    """The number of paths that the derivatives of a policy may use in addition to its training.

    The unit is one path that is valued. A training has valued and differentiated `steps * paths` of
    them; the surface around the policy, its margin and the bumps each value a third as many paths,
    and more if a path is short. The numbers are chosen from the problem and the settings only,
    never from a clock, so that a repeated run has bit-identical results.

    - `work`: the number of paths that may be valued for one purpose; `maximum`: the largest number
      of paths of one measurement.
    - `fewest`: the smallest number of paths of one measurement. It is smaller if a path has more
      than three months by the hour, since such a path has as many days as several shorter paths.
    """

    work: float
    maximum: int
    fewest: int = FEWEST

    @classmethod
    def for_training(cls, trained: int, horizon: int, maximum: int) -> "Effort":
        """The effort of a training with this total number of paths and this horizon."""
        fewest = min(max(FEWEST * LONG // max(horizon, 1), FEWEST_LONG), FEWEST)
        return cls(trained / PURPOSES + SMALL / max(horizon, 1), maximum, fewest)

    def valued(self, times: int) -> int:
        """The number of paths that can be valued this number of times."""
        return self._within(self.work / max(times, 1))

    def gone_back(self, times: int) -> int:
        """The number of paths for this number of backward passes."""
        return self._within(self.work / (BACK * max(times, 1)))

    def _within(self, paths: float) -> int:
        return int(min(self.maximum, max(self.fewest, paths)))


SIGNIFICANT = 2.0  # standard errors above the starting rule
STAGES, PLAIN = (2048, 8192), 4.0  # paths that are enough for a gain of so many standard errors,
NOTHING = 2e-4  # and where not even this share of the value can be gained
FINAL = 1  # of the validation's streams
START, NEWEST, HIGHEST, TOP = "start", "newest", "highest", "top of the surface"


class Selection(NamedTuple):
    """The final choice.

    - `kind`: "start", "newest" (the average at the end of training), "highest" (of the validation)
      or "top of the surface" (see `derivatives.surface`); `policy`: the policy itself.
    - `gain`, `error`: the gain of the best candidate over the starting rule, paired, and its error;
      NaN if they were not compared.
    - `search`: the gain of the top of the surface over the newest policy, and its standard error.
    """

    kind: str
    policy: Policy
    gain: float = float("nan")
    error: float = float("nan")
    search: tuple[float, float] = (0.0, 0.0)

    @property
    def description(self) -> str:
        """One sentence for the report; empty if nothing was compared."""
        if not np.isfinite(self.gain):
            return ""
        half = statistics.half_width(self.error)
        if self.kind == START:
            side = "below" if self.gain < 0 else "above"
            amount = f"{statistics.with_error(abs(self.gain), half)} {side} it"
            return f"The starting rule was kept: on fresh paths the trained policy is {amount}."
        amount = statistics.with_error(self.gain, half)
        return f"Training gained {amount} over the rule that it began with, on fresh paths."


def select(
    problem: Problem,
    start: Policy,
    candidates: Mapping[str, Policy],
    paths: int,
    engine: Engine,
    top: Callable[[], Policy | None] = lambda: None,
    search: bool = False,
) -> Selection:
    """Chooses the start, unless the best candidate is above it by two standard errors. A few of the
    paths are sufficient if the choice is clear. A candidate that is clearly below another on these
    paths is dropped. If no candidate has a finite value, the first one is kept without a
    comparison.

    - `paths`: the maximum number of paths.
    - `top`: a further candidate, `TOP`, if the others may be above the start.
    - `search`: whether the gain of the top over the newest policy is needed in any case.
    """
    source = fresh(problem.sources.validation)
    paths = source.available(paths)
    stages = (FEWEST, *STAGES) if problem.simulator.horizon > LONG else STAGES
    available: dict[str, Totals] = {}
    added, gained = False, (0.0, 0.0)
    for few in (*(stage for stage in stages if 2 * stage <= paths), paths):
        on = source, few, engine, available
        result, level, left = _selected(problem, start, candidates, *on)
        nothing, compared, highest = _nothing(result, level), result, None
        if not added and (search or not nothing):
            added, highest = True, top()
        if highest is not None:
            candidates = {**candidates, TOP: highest}
            compared, level, of_all = _selected(problem, start, candidates, *on)
            result, left = (result, left) if nothing else (compared, of_all)
        if {TOP, NEWEST} <= candidates.keys():
            gained = compared.search
        if nothing or result.gain > PLAIN * result.error or _nothing(result, level):
            break
        candidates = {name: candidates[name] for name in left}
    return result._replace(search=gained)


def _nothing(result: Selection, level: float) -> bool:
    """Whether almost nothing can be gained over the start."""
    return result.gain + SIGNIFICANT * result.error <= NOTHING * abs(level)


def _selected(
    problem: Problem,
    start: Policy,
    candidates: Mapping[str, Policy],
    source: Scenarios,
    paths: int,
    engine: Engine,
    available: dict[str, Totals],
) -> tuple[Selection, float, list[str]]:
    """The choice on a number of paths, the value of the initial rule on them, and the candidates
    that are not clearly below the best one.

    `available`: {candidate: totals} on the first of these paths; returns those on all of them.
    """
    controls = problem.simulator.control_variates()
    names = list(candidates)

    def totals(name: str, policy: Policy) -> Totals:
        # The control variates are those of the initial rule.
        before, with_controls = available.get(name), name == START
        available[name] = path_totals(
            problem,
            policy,
            paths,
            engine=engine,
            source=source,
            controls=with_controls,
            before=before,
        )
        return available[name]

    base = totals(START, start)
    level = float(value_of(problem.objective, base))
    taken = [of_groups(problem.objective, base, source, base[name]) for name in controls]
    shares = {START: shares_of(problem.objective, base, source)}
    same: dict[str, Policy] = {START: start}
    for name, policy in candidates.items():
        twin = next((other for other in same if same[other] is policy), name)
        if twin == name:
            same[name] = policy
            shares[name] = shares_of(problem.objective, totals(name, policy), source)
        else:
            shares[name] = shares[twin]

    def above(mine: np.ndarray, other: np.ndarray) -> statistics.Sampled:
        return statistics.controlled(mine - other, taken)[2]

    finite = [name for name in names if np.isfinite(shares[name]).all()]
    if not finite:
        return Selection(names[0], candidates[names[0]]), level, names
    search = (0.0, 0.0)
    if TOP in finite and NEWEST in finite:
        difference = above(shares[TOP], shares[NEWEST])
        search = difference.value, _error(difference)
    if not np.isfinite(level):  # the starting rule ends in ruin
        best = max(finite, key=lambda name: float(np.mean(shares[name])))
        return Selection(best, candidates[best], search=search), level, finite
    # A history whose highest policy is the starting rule itself has no other one to offer.
    trained = [name for name in finite if not _same(shares[name], shares[START])]
    gains = {name: above(shares[name], shares[START]) for name in trained or finite}
    best = max(gains, key=lambda name: gains[name].value)
    gain, error = gains[best].value, _error(gains[best])
    below = {name: above(shares[best], shares[name]) for name in gains}
    left = [name for name, item in below.items() if item.value <= PLAIN * _error(item)]
    if gain > SIGNIFICANT * error:
        return Selection(best, candidates[best], gain, error, search), level, left
    return Selection(START, start, gain, error, search), level, left


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether shares are those of one policy: without control variates they may be rounded in
    another way."""
    return bool(np.max(np.abs(one - other)) <= ROUND_OFF * np.max(np.abs(other)))


def fresh(source: Scenarios) -> Scenarios:
    """Paths for the final choice, which are used for nothing else if there are enough."""
    if isinstance(source, Pseudo):
        return replace(source, stream=stream(VALIDATE, FINAL))
    return source


def _error(result: statistics.Sampled) -> float:
    """Its standard error; 0 if there is one path, as without noise."""
    return result.standard_error if np.isfinite(result.standard_error) else 0.0
