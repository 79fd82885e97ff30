"""An upper bound: the penalised earnings of the best decisions with perfect foresight, path by
path.

    value of every policy <= value of the best <= E[max over decisions of (earnings - penalty)]

for every penalty whose mean is zero under every policy that does not see the future (Rogers 2002;
Haugh and Kogan 2004; Brown, Smith and Sun, Operations Research 58, 2010). A penalty charges each
decision with the innovation that it profits from: V(next state) - E[V(next state) | now], for some
V. The bound is valid for any V; with the exact value function it is the exact value on every path.

The same penalty along the policy's path has mean zero, so it is taken from the policy's earnings as
a control variate, and the gap of a path, perfect foresight minus policy, is never negative.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from snapo.engine import TRAJECTORY, Engine, Rollout, Xla
from snapo.problem.meant import takes_problem
from snapo.problem.noise import Draws
from snapo.problem.objective import Objective
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, Scenarios, stream
from snapo.problem.smooth import Exact

from .adjoint import float64
from .relaxations.stop import Relaxation, relaxation_of
from .statistics import (
    critical,
    independent,
    mean,
    plus_minus,
    rounded,
    skewed_mean,
    with_error,
)
from .tables import paragraph, table

Penalty = Literal["none", "value", "trained"]
CHUNK = 1024  # paths in one call of an engine and of the inner problem
TRAINED, BOUND = 256, 257  # streams: of the paths that train a penalty, and of the bound's
MAX_GAP, MAX_ERROR = 0.02, 0.005  # of the value: above, a bound is too wide
SWEEPS, STEP = 2, 0.1  # of the descent: how often each scale moves, and how far it looks


class Between(NamedTuple):
    """A mean, its standard error and its 95 % interval (Student, independent groups of paths)."""

    value: float
    standard_error: float
    low: float
    high: float

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        return with_error(self.value, self.half_width)

    @property
    def half_width(self) -> float:
        """Half of the interval."""
        return (self.high - self.low) / 2


@dataclass(frozen=True)
class Bound:
    """A value between two bounds, all on the same paths of the exact simulator.

    - `lower`: the policy's value; `upper`: an upper bound on the value of any policy.
    - `gap`: upper minus lower, paired path by path.
    - `penalty`, `words`: kind and meaning of the penalty; `scale`: the scale of its parts.
    - `sure`: the certainty equivalents of `lower` and `upper`, if the objective is a utility.
    - `few`: whether a few paths that gain much by foresight dominate the gap; the interval of the
      gap is then wider.
    """

    lower: Between
    upper: Between
    gap: Between
    penalty: Penalty
    words: str
    scale: tuple[float, ...]
    paths: int
    sure: tuple[float | None, float | None] = (None, None)
    few: bool = False

    @property
    def says_little(self) -> str:
        """The reason why the bound is not informative about the policy; empty if it is."""
        value = abs(self.lower.value)
        gap, error = self.gap.value, self.upper.standard_error
        if gap <= MAX_GAP * value and error <= MAX_ERROR * value:
            return ""
        summary = f"a gap of {rounded(gap, 3)} {plus_minus(error)}"
        share = f" ({gap / value:.2%} of the value)" if value else ""
        few = (
            ", most of which comes from a few paths that gain much by foresight" if self.few else ""
        )
        return f"says little: {summary}{share}{few}"

    def above(self, value: float, error: float, objective: Objective) -> "Bound":
        """The upper bound for a policy whose value is known from more paths: that value plus the
        gap. The upper bound on the few paths of this bound may be below that value because of
        sampling error.
        """
        if not np.isfinite(error):
            return self
        half = critical() * error
        lower = Between(value, error, value - half, value + half)
        gap, top = self.gap, value + self.gap.value
        wide = float(independent(error, gap.standard_error))
        low = top - float(independent(gap.value - gap.low, half))
        high = top + float(independent(gap.high - gap.value, half))
        upper = Between(top, wide, low, high)
        certain = objective.certainty_equivalent(value), objective.certainty_equivalent(top)
        return replace(self, lower=lower, upper=upper, sure=certain)

    def row(self) -> dict[str, Any]:
        """The bound as plain data."""
        result = asdict(self) | {"says_little": self.says_little}
        for name in ("lower", "upper", "gap"):
            result[name] = getattr(self, name)._asdict()
        return result

    def _repr_html_(self) -> str:
        """The same in a notebook."""
        rows = [
            (name, f"{item.value:,.7g}", f"± {item.half_width:,.3g}", f"{item.low:,.7g}",
             f"{item.high:,.7g}")
            for name, item in self._named().items()
        ]  # fmt: skip
        small = f"It {self.says_little}. " if self.says_little else ""
        below = paragraph(f"{small}{self.paths} paths; penalty: {self.words}")
        return table(("", "value", "", "95 % from", "to"), rows) + below

    def _named(self) -> dict[str, Between]:
        return {"lower (policy)": self.lower, "upper (bound)": self.upper, "gap": self.gap}

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        lines = [
            f"{name:<16}{item.value:>16,.7g} ± {item.half_width:<10.3g}"
            f"95 %: {item.low:,.7g} to {item.high:,.7g}"
            for name, item in self._named().items()
        ]
        if None not in self.sure:
            lines.append(
                "certainty equivalents of both bounds: {:,.7g} to {:,.7g}".format(*self.sure)
            )
        if self.says_little:
            lines.append(f"this bound {self.says_little}")
        return "\n".join([*lines, f"{self.paths} paths; penalty: {self.words}"])


@takes_problem
def bound(
    problem: Problem,
    policy: Policy,
    *,
    paths: int = 1024,
    engine: Engine | None = None,
    relaxation: Relaxation | None = None,
    penalty: Penalty = "value",
    source: Scenarios | None = None,
    training_paths: int = 256,
) -> Bound:
    """The lower and the upper bound of the value of the best policy, on fresh paths.

    **Arguments:**

    - `relaxation`: the inner problem (see `Relaxation`); by default that of the simulator, or that
      of stopping if `Stop` is the only decision.
    - `penalty`: "none" is perfect foresight; "value" the approximate value function itself;
      "trained" scales its parts by descent on the bound, on `training_paths` other paths.
    - `source`: scenarios, by default fresh ones that nothing else uses.

    **Raises:** `ValueError` if the objective is not a mean over paths, if no relaxation is
    available, or if the inner problem earns less than the policy on some path, so that it is not
    valid.
    """
    if not problem.objective.by_path:
        kind = type(problem.objective).__name__
        message = "there is an upper bound only for a mean over paths"
        raise ValueError(f"bound: the objective is {kind}; {message}.")
    if relaxation is None:
        relaxation = relaxation_of(problem)
    fresh = _Paths(problem, policy, relaxation, engine or Xla(precision="float64"))
    seed = getattr(problem.sources.evaluation, "seed", 0)
    source = source or _fresh(problem, seed, BOUND)
    scale = np.full(relaxation.terms, 0.0 if penalty == "none" else 1.0)
    if penalty == "trained" and relaxation.terms:
        learning = _fresh(problem, seed, TRAINED)
        sample = fresh.sample(learning, learning.available(training_paths))
        scale = _descended(lambda item: float(np.mean(fresh.best(sample, item))), scale)
    paths = source.available(paths)
    sample = fresh.sample(source, paths)
    upper, lower = fresh.best(sample, scale), fresh.policy(sample, scale)
    _check(upper - lower, np.abs(lower).max(initial=1.0))
    order = np.argsort(np.concatenate([block for block, _, _ in sample]))
    groups = source.groups(np.arange(paths))
    below, above = _between(lower[order], groups), _between(upper[order], groups)
    gap = skewed_mean((upper - lower)[order], groups)
    text = relaxation.description if scale.any() else "none: perfect foresight on each path"
    used: Penalty = penalty
    if not scale.any():
        used = "none"
    certain = (
        problem.objective.certainty_equivalent(below.value),
        problem.objective.certainty_equivalent(above.value),
    )
    between = Between(gap.value, gap.standard_error, max(gap.low, 0.0), gap.high)
    return Bound(below, above, between, used, text, tuple(scale.tolist()), paths, certain, gap.few)


def nested_mean(
    value: Callable[[np.ndarray], np.ndarray],
    size: int,
    paths: int,
    draws: int,
    seed: int | Sequence[int],
) -> np.ndarray:
    """[paths] the mean of `value` over nested draws, for an expectation without a closed form.

    `value` takes standard normals [size, paths] and returns [..., paths]. Each path has separate
    draws, in antithetic pairs. The estimate is unbiased, so a penalty computed with it still has
    mean zero; its noise only widens the bound (Andersen and Broadie 2004).

    A bound is computed in blocks of paths. `seed` must differ between blocks and steps, for example
    `(t, int(draws.paths[0]))` with the `draws` of a block: with equal seeds the paths of all blocks
    would have the same nested draws, and standard errors would be too small.
    """
    random = np.random.default_rng(seed)
    total = 0.0
    for _ in range(max(draws // 2, 1)):
        noise = random.standard_normal((size, paths))
        total = total + value(noise) + value(-noise)
    return np.asarray(total / (2 * max(draws // 2, 1)))


Sample = list[tuple[np.ndarray, Draws, Rollout]]


class _Paths:
    """The policy's paths, with the earnings of the policy and the bound of each path."""

    def __init__(self, problem: Problem, policy: Policy, relaxation: Relaxation, engine: Engine):
        self.problem, self.policy_, self.relaxation = problem, policy, relaxation
        self.bound_engine = engine.bind(problem)

    def sample(self, source: Scenarios, paths: int) -> Sample:
        rows: Sample = []
        for block in source.blocks(paths, max(1, -(-paths // CHUNK))):
            draws = source.draws(block, self.problem.simulator)
            rollout = self.bound_engine.values(self.policy_, draws, Exact(), record=TRAJECTORY)
            rows.append((block, draws, rollout))
        return rows

    def best(self, sample: Sample, scale: np.ndarray) -> np.ndarray:
        return np.concatenate([self.relaxation.best(r, d, scale) for _, d, r in sample])

    def policy(self, sample: Sample, scale: np.ndarray) -> np.ndarray:
        objective = self.problem.objective
        earned = np.concatenate([objective.influence(float64(r.totals)) for _, _, r in sample])
        return earned - np.concatenate([self.relaxation.charged(r, d, scale) for _, d, r in sample])


def _fresh(problem: Problem, seed: int, use: int) -> Scenarios:
    """Paths that no other part uses, where they can be drawn; else those of the validation or of
    the evaluation."""
    if problem.is_random and isinstance(problem.sources.training, Pseudo):
        return Pseudo(seed, stream=stream(EVALUATE, use))
    return problem.sources.validation if use == TRAINED else problem.sources.evaluation


def _descended(value: Callable[[np.ndarray], float], scale: np.ndarray) -> np.ndarray:
    """Scales at which the bound, which is convex in them, is lower: one scale at a time, by
    parabolas."""
    minimum = value(scale)
    for sweep in range(SWEEPS):
        width = STEP / 2**sweep
        for i in range(len(scale)):
            left, right = (value(_moved(scale, i, side * width)) for side in (-1, 1))
            bend = left - 2 * minimum + right
            move = 0.5 * width * (left - right) / bend if bend > 0 else 0.0
            bumped = _moved(scale, i, float(np.clip(move, -2 * width, 2 * width)))
            if (result := value(bumped)) < minimum:
                scale, minimum = bumped, result
    return scale


def _moved(scale: np.ndarray, i: int, by: float) -> np.ndarray:
    moved = scale.copy()
    moved[i] += by
    return moved


def _check(gap: np.ndarray, size: float) -> None:
    if not np.all(np.isfinite(gap)):
        raise ValueError(f"bound: path {int(np.argmin(np.isfinite(gap)))} is non-finite.")
    if gap.min() < -1e-6 * size:
        path = int(np.argmin(gap))
        message = "the inner problem earns less than the policy"
        raise ValueError(
            f"bound: on path {path} {message} ({gap[path]:.6g}), so it is not a valid relaxation."
        )


def _between(values: np.ndarray, groups: np.ndarray) -> Between:
    result = mean(values, groups)
    return Between(result.value, result.standard_error, *result.interval())
