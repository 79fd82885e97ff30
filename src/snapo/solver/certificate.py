"""Evidence for a value: adjoints compared with bumps on the same paths, and every limit met."""

from collections.abc import Callable, Collection, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from snapo.engine import TRAJECTORY, Engine, Xla
from snapo.problem import inputs as inputs_
from snapo.problem.meant import takes_problem
from snapo.problem.noise import Draws
from snapo.problem.objective import Weights
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import EXACT, Exact, Smooth

from .adjoint import float64, pull_back
from .derivatives.bump import SIGNIFICANT
from .derivatives.interval import HELD, UNKNOWN, Verdict, one_percent

TOLERANCE = 1e-6  # of the family's largest derivative
ROUND_OFF = 64 * np.finfo(np.float64).eps  # of the value, divided by the step
CROWDED = 0.5  # share of paths at a kink above which the others are no evidence
NUDGE = 1e-3  # of each number: larger than any step, small against the number itself


class Bump(NamedTuple):
    """One derivative from the adjoint and from finite differences on the same paths.

    - `direction`: the label of the bumped number, or "random direction" over all of the input's
      entries.
    - `adjoint`; `central`, `up`, `down`: the derivative and three differences.
    - `allowed`: 1e-6 of the input's largest derivative, or along a direction of the sum of the
      sizes of its terms, plus the round-off of a difference.
    - `kink`: whether the two one-sided differences disagree, and the adjoint equals one of them.
    - `crossing`: the share of paths with a kink within the step; if the adjoint equals neither
      side, it and the differences are those of the other paths only. If all paths have a kink, the
      adjoint has to lie between the sides.
    - `judged`: whether the comparison counts. If paths have several kinks at once, a correct
      adjoint may lie outside of both sides; the same derivative at a nearby point counts then.
    """

    input: str
    direction: str
    adjoint: float
    central: float
    up: float
    down: float
    allowed: float
    kink: bool
    crossing: float = 0.0
    judged: bool = True

    @property
    def error(self) -> float:
        """The distance from the central difference; at a kink, from the nearer one-sided
        difference."""
        if self.crossing == 1.0:
            low, high = sorted((self.up, self.down))
            return max(low - self.adjoint, self.adjoint - high, 0.0)
        sides = (self.up, self.down) if self.kink else (self.central,)
        return min(abs(self.adjoint - side) for side in sides)

    @property
    def passed(self) -> bool:
        return not self.judged or self.error <= self.allowed

    def row(self) -> dict[str, Any]:
        """The bump as a row of a table."""
        return {
            "family": self.input,
            "inputs": self.direction,
            "worst_error": self.error,
            "allowed": self.allowed,
            "passed": self.passed if self.judged else None,
            "kink": self.kink,
            "crossing": self.crossing,
        }


class Feasibility(NamedTuple):
    """The smallest slack of one limit over all paths and steps, and its position."""

    limit: str
    worst: float
    path: int
    step: int

    def row(self, round_off: float) -> dict[str, Any]:
        """The limit as a row of a table; violations up to round-off count as met."""
        return self._asdict() | {"passed": self.worst > -round_off}


def nudged(problem: Problem, seed: int = 0) -> Problem:
    """The problem with each number of its inputs moved by a random relative amount of at most
    0.001.

    Round numbers lead to ties: a store that is filled in exactly eight days is on a kink of its
    limits, where every path has two derivatives. At a nearby point hardly any path is on a kink. A
    number that is zero is moved upwards, by up to its input's `move`; without one it stays zero.
    """
    random, moved = np.random.default_rng(seed), []
    for entry in problem.inputs_by_name.values():
        size = np.where(entry.value == 0, entry.move or 0.0, NUDGE * entry.value)
        low = np.where(entry.value == 0, 0.5, -1.0)
        moved.append(entry.value + size * random.uniform(low, 1.0, entry.value.shape))
    return problem.with_inputs(moved)


@takes_problem
def certify_derivatives(
    problem: Problem,
    policy: Policy,
    *,
    paths: int = 512,
    engine: Engine | None = None,
    near: Callable[[Problem], Problem] = nudged,
) -> list[Bump]:
    """`bump_check` at the reported inputs; if most paths have a kink there, also near them.

    Inputs that fail while some paths are on a kink are also checked nearby. Kinks of one path at
    the same point may cancel: both sides then have the same slope. An adjoint that takes a mean at
    every tie misses this slope, and no second difference shows the kinks. For these inputs the
    nearby check counts. The inputs of `Problem.in_mean` are not included (see `in_the_mean`).
    """
    pathwise = set(problem.inputs_by_name) - set(problem.in_mean)
    results = bump_check(problem, policy, paths=paths, only=pathwise, engine=engine)
    crowded = {
        bump.input
        for bump in results
        if bump.crossing > CROWDED or (bump.crossing > 0 and not bump.passed)
    }
    if not crowded:
        return results
    repeated = bump_check(near(problem), policy, paths=paths, only=crowded, engine=engine)
    decided = {bump.input for bump in repeated if bump.crossing < 1.0}
    results = [bump._replace(judged=bump.passed or bump.input not in decided) for bump in results]
    return results + [
        bump._replace(direction=f"{bump.direction} nearby".strip()) for bump in repeated
    ]


def in_the_mean(problem: Problem, verdicts: Mapping[str, Verdict]) -> list[dict[str, Any]]:
    """Rows like those of `Bump`, for the inputs of `Problem.in_mean`: the reported derivative
    compared with a move of all their numbers by 1 %, within four standard errors of the difference.

    If a bump has refuted the held derivative, the bump itself is reported, and the difference is
    zero."""
    results = []
    for name in problem.in_mean:
        if (verdict := verdicts.get(name)) is None:
            continue
        step = float(np.max(np.abs(one_percent(problem.inputs_by_name[name]))))
        error, allowed = abs(verdict.reaction[0]), SIGNIFICANT * verdict.reaction[1]
        if verdict.source != HELD:
            error = 0.0
        results.append(
            {
                "family": name,
                "inputs": "all numbers by 1 %, on average",
                "worst_error": error / step,
                "allowed": allowed / step,
                "passed": verdict.source != UNKNOWN,
                "kink": verdict.corner == "kink",
                "crossing": 0.0,
            }
        )
    return results


@takes_problem
def bump_check(
    problem: Problem,
    policy: Policy,
    *,
    paths: int = 512,
    smooth: Smooth | Exact = EXACT,
    engine: Engine | None = None,
    every: bool = False,
    only: Collection[str] | None = None,
) -> list[Bump]:
    """The adjoint against finite differences in float64, on the same paths.

    It uses the first `paths` paths of the problem's evaluation. With `Smooth(temperature)` the
    policy reacts; without, the exact simulator replays its recorded decisions. Every input, or
    those named by `only`, is bumped along one direction of random signs, or with `every` entry by
    entry. Path weights are held fixed, as in the adjoint. At a kink an adjoint equals one of the
    one-sided differences. If paths lie on different sides of their kinks, it equals neither; then
    only the paths without a kink within the step are compared (see `Bump.crossing`).
    """
    source = problem.sources.evaluation
    draws = source.draws(np.arange(source.available(paths)), problem.simulator)
    replay = _Replay.of(engine or Xla(precision="float64"), problem, policy, draws, smooth)
    gradient, random = replay.gradient(), np.random.default_rng(1)
    centre = replay.paths({})
    results = []
    for name, values in problem.inputs_by_name.items():
        directions = _directions(values, every, random)
        if only is not None and name not in only:
            continue
        scale = float(np.max(np.abs(gradient[name]), initial=0.0))
        for label, direction in directions:
            # Each number moves by its own step; `part` is relative to the largest of them.
            moved = values.step() * direction
            step = float(np.max(np.abs(moved)))
            part = moved / step
            if not every:
                scale = float(np.sum(np.abs(gradient[name] * part)))
            along = _Along(replay, name, part, step, centre)
            results.append(along.compare(label, gradient, scale))
    return results


class _Replay(NamedTuple):
    """The paths of one check: same noise, same weights, and same decisions or same policy."""

    engine: Engine
    problem: Problem
    policy: Policy | None
    draws: Draws
    smooth: Smooth | Exact
    actions: Any
    weights: Weights

    @classmethod
    def of(cls, engine: Engine, problem: Problem, policy, draws, smooth):
        held = isinstance(smooth, Exact)
        record = ("action",) if held else ()
        first = engine.bind(problem, controls=False).values(policy, draws, smooth, record=record)
        decider, actions = (None, first.record["action"]) if held else (policy, None)
        weights = problem.objective.weights(float64(first.totals))
        return cls(engine, problem, decider, draws, smooth, actions, weights)

    def paths(self, bumps: dict[str, np.ndarray]) -> np.ndarray:
        """The share of each path in the weighted value, [paths], with these inputs shifted."""
        by_name = self.problem.inputs_by_name
        moved = self.problem.at({name: by_name[name].value + bump for name, bump in bumps.items()})
        bound = self.engine.bind(moved, controls=False)
        result = bound.values(self.policy, self.draws, self.smooth, actions=self.actions)
        totals = float64(result.totals)
        return np.sum([w * totals[name] for name, w in self.weights.items()], axis=0)

    def gradient(self, keep: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """The adjoint with respect to every input, of all paths or of those to `keep`."""
        bound = self.engine.bind(self.problem, controls=False)
        weights = {n: w if keep is None else w * keep for n, w in self.weights.items()}
        values = (self.policy, self.draws, self.smooth, weights)
        passed = bound.adjoint(*values, actions=self.actions, wrt=("schedule",))
        moved = pull_back(self.problem.simulator, self.problem.inputs, [passed.schedule])
        return {name: result[0] for name, result in moved.items()}


class _Along:
    """One input bumped along one direction, path by path."""

    def __init__(self, replay: _Replay, name: str, direction, step: float, centre: np.ndarray):
        self.replay, self.name, self.direction = replay, name, direction
        self.step, self.centre = step, centre
        self.low, self.high = self._at(-step), self._at(step)

    @cached_property
    def half(self) -> tuple[np.ndarray, np.ndarray]:
        """The paths at half a step to either side."""
        return self._at(-self.step / 2), self._at(self.step / 2)

    def _at(self, step: float) -> np.ndarray:
        return self.replay.paths({self.name: step * self.direction})

    def compare(self, label: str, gradient: dict[str, np.ndarray], scale: float) -> Bump:
        every = np.ones(len(self.centre), bool)
        result = self._bump(label, gradient, scale, every)
        if result.passed:
            return result
        smooth = ~self._crossing(scale)
        if not smooth.any():
            return result._replace(crossing=1.0, kink=True)
        if not smooth.all():
            gradient = self.replay.gradient(smooth)
        rest = self._bump(label, gradient, scale, smooth, extrapolated=True)
        return rest._replace(crossing=float(np.mean(~smooth)))

    def _bump(
        self, label: str, gradient, scale: float, keep: np.ndarray, extrapolated: bool = False
    ) -> Bump:
        """The bump on the paths to `keep`; extrapolated to a step of zero from the step and half of
        it, since the curvature of a state that grows daily exceeds the tolerance within a step."""
        low, centre, high = (float(x[keep].sum()) for x in (self.low, self.centre, self.high))
        adjoint = float(np.sum(gradient[self.name] * self.direction))
        step = self.step
        up, down, central = (high - centre) / step, (centre - low) / step, (high - low) / (2 * step)
        if extrapolated:
            left, right = (float(x[keep].sum()) for x in self.half)
            central = (4 * (right - left) / step - central) / 3
        size = max(float(np.abs(x[keep]).sum()) for x in (self.low, self.centre, self.high))
        allowed = TOLERANCE * max(scale, abs(adjoint)) + ROUND_OFF * size / step
        # Differences of a smooth function disagree by its curvature; the adjoint is then central.
        one_sided = min(abs(adjoint - up), abs(adjoint - down)) <= allowed
        kink = abs(adjoint - central) > allowed and one_sided
        return Bump(self.name, label, adjoint, central, up, down, allowed, kink)

    def _crossing(self, scale: float) -> np.ndarray:
        """The paths with a kink within the step: [paths] booleans.

        A second difference shrinks by four when the step is halved, and at a kink it does not.
        """
        half = self.half
        wide = self.high - 2 * self.centre + self.low
        narrow = half[1] - 2 * self.centre + half[0]
        # Kinks below this limit on every path add up to well below the allowed error.
        noise = ROUND_OFF * np.abs(self.centre)
        limit = 0.01 * TOLERANCE * scale * self.step / len(self.centre) + noise
        return np.abs(wide - 4 * narrow) > limit


def _directions(values: inputs_.Input, every: bool, random) -> list[tuple[str, np.ndarray]]:
    shape = values.value.shape
    if not every and values.value.size > 1:
        return [("random direction", random.choice([-1.0, 1.0], shape))]
    units = np.eye(values.value.size).reshape(-1, *shape)
    return list(zip(values.names(), units))


@takes_problem(objective=False)
def feasibility(
    problem: Problem, policy: Policy, *, paths: int = 4096, engine: Engine | None = None
) -> list[Feasibility]:
    """The smallest slack of every limit that the simulator declares, in the exact simulator."""
    bound = (engine or Xla(precision="float64")).bind(problem, controls=False)
    source = problem.sources.evaluation
    worst: dict[str, Feasibility] = {}
    for block in source.blocks(source.available(paths)):
        draws = source.draws(block, problem.simulator)
        rollout = bound.values(policy, draws, Exact(), record=TRAJECTORY)
        for name, slack in rollout.record["slack"].items():
            slack = np.asarray(slack)
            step, path = np.unravel_index(np.argmin(slack), slack.shape)
            entry = Feasibility(name, float(slack[step, path]), int(block[path]), int(step))
            if name not in worst or entry.worst < worst[name].worst:
                worst[name] = entry
    return list(worst.values())
