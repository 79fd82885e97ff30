"""Why believe the number: the adjoint against bumps, limits kept, the gap between smooth and exact."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from . import inputs as inputs_
from .adjoint import float64, prepare, pull_back
from .engine import Engine, Xla
from .objective import Objective
from .policy import Policy
from .scenarios import Scenarios
from .simulator import Simulator
from .smooth import Exact

TOLERANCE = 1e-6  # of the family's largest derivative
ROUND_OFF = 64 * np.finfo(np.float64).eps  # of the value, divided by the step


class Bump(NamedTuple):
    """One derivative by the adjoint and by differences on the same paths.

    - `direction`: the label bumped, or "random direction" over all of the input's entries.
    - `adjoint`; `central`, `up`, `down`: the derivative and three differences.
    - `allowed`: 1e-6 of the family's scale, plus the round-off of a difference.
    - `kink`: the two one-sided differences disagree, and the adjoint is one of them.
    """

    input: str
    direction: str
    adjoint: float
    central: float
    up: float
    down: float
    allowed: float
    kink: bool

    @property
    def error(self) -> float:
        """The distance to the central difference, at a kink to the nearer one-sided one."""
        sides = (self.up, self.down) if self.kink else (self.central,)
        return min(abs(self.adjoint - side) for side in sides)

    @property
    def passed(self) -> bool:
        return self.error <= self.allowed


class Feasibility(NamedTuple):
    """The smallest slack of one limit over all paths and steps, and where it was."""

    limit: str
    worst: float
    path: int
    step: int


def bump_check(
    simulator: Simulator,
    inputs: PyTree,
    policy: Policy,
    objective: Objective,
    scenarios: Scenarios,
    paths: int = 512,
    *,
    smooth: Any = None,
    every: bool = False,
    engine: Engine | None = None,
) -> list[Bump]:
    """The adjoint against differences in float64, on the same paths.

    With `smooth` the policy reacts; without, the exact simulator replays its recorded decisions.
    Every input is bumped along one random direction of signs, or with `every` entry by entry.
    Path weights are held, as the adjoint holds them.
    """
    engine = engine or Xla(precision="float64")
    schedule = prepare(simulator, inputs)
    draws = scenarios.draws(np.arange(paths), simulator)
    held = smooth is None
    smooth = Exact() if held else smooth
    first = engine.values(
        simulator, policy, schedule, draws, smooth, record=("action",) if held else ()
    )
    actions = first.record.get("action")
    decider = None if held else policy
    weights = objective.weights(float64(first.totals))
    given = (simulator, decider, schedule, draws, smooth)
    passed = engine.adjoint(*given, weights, actions=actions, wrt=("schedule",))
    gradient = {n: g[0] for n, g in pull_back(simulator, inputs, [passed.schedule]).items()}

    def value(bumped: list) -> float:
        moved = _with_values(inputs, bumped)
        schedule = prepare(simulator, moved)
        rolled = engine.values(simulator, decider, schedule, draws, smooth, actions=actions)
        totals = float64(rolled.totals)
        return float(sum(np.sum(w * totals[name]) for name, w in weights.items()))

    base = inputs_.values(inputs)
    centre, random = value(base), np.random.default_rng(1)
    found = []
    for index, (name, given) in enumerate(inputs_.named(inputs)):
        directions = _directions(given, every, random)
        scale = max(float(np.abs(np.sum(gradient[name] * d))) for _, d in directions)
        if not every:
            scale = float(np.sum(np.abs(gradient[name])))
        for label, direction in directions:
            step = given.step()
            high, low = (
                value([v + s * step * direction if i == index else v for i, v in enumerate(base)])
                for s in (1, -1)
            )
            found.append(
                _compare(name, label, gradient[name], direction, (low, centre, high), step, scale)
            )
    return found


def _directions(given: inputs_.Input, every: bool, random) -> list[tuple[str, np.ndarray]]:
    shape = given.value.shape
    if not every and given.value.size > 1:
        return [("random direction", random.choice([-1.0, 1.0], shape))]
    units = np.eye(given.value.size).reshape(-1, *shape)
    return list(zip(given.names(), units))


def _compare(name, label, gradient, direction, values, step, scale) -> Bump:
    low, centre, high = values
    adjoint = float(np.sum(gradient * direction))
    up, down, central = (high - centre) / step, (centre - low) / step, (high - low) / (2 * step)
    allowed = TOLERANCE * max(scale, abs(adjoint)) + ROUND_OFF * max(map(abs, values)) / step
    one_sided = min(abs(adjoint - up), abs(adjoint - down)) < abs(adjoint - central)
    kink = abs(adjoint - central) > allowed and one_sided
    return Bump(name, label, adjoint, central, up, down, allowed, kink)


def _with_values(inputs: PyTree, values: list) -> PyTree:
    """The same inputs with other values."""
    remaining = iter(values)

    def put(leaf):
        if not inputs_.is_input(leaf):
            return leaf
        return eqx.tree_at(lambda i: i.value, leaf, np.asarray(next(remaining), np.float64))

    return jax.tree.map(put, inputs, is_leaf=inputs_.is_input)


def feasibility(
    simulator: Simulator,
    schedule,
    policy: Policy,
    scenarios: Scenarios,
    paths: int = 4096,
    engine: Engine | None = None,
) -> list[Feasibility]:
    """The smallest slack of every limit that the simulator declares, in the exact simulator."""
    engine = engine or Xla(precision="float64")
    worst: dict[str, Feasibility] = {}
    for block in scenarios.blocks(paths):
        draws = scenarios.draws(block, simulator)
        rolled = engine.values(simulator, policy, schedule, draws, Exact(), record=("slack",))
        for name, slack in rolled.record["slack"].items():
            slack = np.asarray(slack)
            step, path = np.unravel_index(np.argmin(slack), slack.shape)
            entry = Feasibility(name, float(slack[step, path]), int(block[path]), int(step))
            if name not in worst or entry.worst < worst[name].worst:
                worst[name] = entry
    return list(worst.values())
