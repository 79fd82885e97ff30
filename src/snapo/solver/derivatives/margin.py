"""The amount by which the error of the policy may move a derivative.

With M the change of a derivative along the coordinates and H the curvature of the value, a policy
whose value is short of the best by g has a derivative that is off by at most sqrt(2 g kappa), where
kappa = M (-H)^-1 M' (Cauchy and Schwarz). The coordinates are few: kappa is at least the squared
change of the derivative over twice the loss under random moves of ALL weights.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from snapo.engine import Engine
from snapo.problem.actions import Actions, Choice, Integers, Stop
from snapo.problem.actions.product import contains
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Sources
from snapo.problem.smooth import Exact

from ..evaluate import path_totals
from .bump import block_means
from .by_block import DerivativePass
from .interval import THROUGH, Curvature, Reported, one_percent
from .rebuilt import problems_at
from .surface import WIDEST, Surface, distance_factor, shifted_policy
from .verdict import spread_of

RANDOM = 6  # directions of all weights
FIRST, NARROWER = 0.02, 1.4  # how far they are followed
SMOOTH_FLOOR, HARD_FLOOR = 0.5, 1.0  # of a target: the gap that no search sees


class Margin(NamedTuple):
    """The change of held derivatives with the policy: {input: [n, *shape]} in the surface's
    coordinates, and {input: [K, *shape]} in random directions, divided by the root of twice the
    loss."""

    surface: Surface
    slopes: Mapping[str, np.ndarray]
    others: Mapping[str, np.ndarray]


def passes(surface: Surface) -> int:
    """The number of derivatives needed for a margin."""
    return 1 + 2 * _pairs(surface) + 1 + RANDOM


def _pairs(surface: Surface) -> int:
    return min((len(surface.points) - 1) // 2, surface.points.shape[1] + 2)


def margin_of(
    problem: Problem, policy: Policy, surface: Surface, paths: int, seed: int, engine: Engine
) -> Margin:
    """The margin of the held derivatives, near the reported policy, on the first `paths` of those
    of the surface."""
    on = _Derivatives(problem, surface, engine, paths)
    half, pairs = (len(surface.points) - 1) // 2, _pairs(surface)
    selected = [0, *range(1, 1 + pairs), *range(1 + half, 1 + half + pairs)]
    positions = surface.points[selected]
    design = np.concatenate([np.ones((len(positions), 1)), positions], axis=1)
    solve = np.linalg.pinv(design)[1:]
    held = [on.held(surface.at(position)) for position in positions]
    slopes = {
        name: np.tensordot(solve, np.stack([item[name] for item in held]), axes=1)
        for name in problem.inputs_by_name
    }
    return Margin(surface, slopes, _random(on, policy, surface, np.random.default_rng(seed)))


def floor_of(actions: Actions) -> float:
    """The minimum gap that is assumed, in units of the target loss; larger for discrete
    decisions."""
    hard = any(contains(actions, kind) for kind in (Choice, Integers, Stop))
    return HARD_FLOOR if hard else SMOOTH_FLOOR


def with_margin(
    problem: Problem,
    policy: Policy,
    table: Mapping[str, Reported],
    margin: Margin,
    gap: float,
    engine: Engine,
) -> dict[str, Reported]:
    """The reported derivatives with intervals that have room for the policy's gap."""
    surface = margin.surface
    curvature = Curvature(surface.inverse, surface.covariance, gap)
    on = _Derivatives(problem, surface, engine, surface.paths)
    entries = {}
    for name, item in table.items():
        slopes, others = margin.slopes[name], margin.others[name]
        if item.source == THROUGH:
            # The bump has its own: one number, divided as the change along the bump is.
            share = spread_of(item.estimate, item.by)
            shared = share if np.isfinite(share).all() else np.zeros(item.by.shape)
            slopes = np.multiply.outer(on.bumps(policy, name), shared)
            others = np.zeros((0, *item.by.shape))
        entries[name] = item._replace(slopes=slopes, others=others, curvature=curvature)
    return entries


class _Derivatives:
    """Derivatives of other policies, on the paths of the surface."""

    def __init__(self, problem: Problem, surface: Surface, engine: Engine, paths: int):
        sources, source = problem.sources, surface.source
        sources = Sources(sources.training, sources.validation, source)
        self.problem = replace(problem, sources=sources).prepared(problem.schedule)
        self.surface, self.engine = surface, engine
        self.bound_engine = engine.bind(self.problem, controls=False)
        self.paths = source.available(min(paths, surface.paths))
        self.blocks = source.blocks(self.paths)

    def held(self, policy: Policy) -> dict[str, np.ndarray]:
        """{input: the held derivative}."""
        path = DerivativePass(self.problem, self.bound_engine, policy, Exact(), held=True)
        inputs = path.derivatives([np.arange(self.paths)]).inputs
        return {name: item.value for name, item in inputs.items()}

    def bumps(self, policy: Policy, name: str) -> np.ndarray:
        """[n]: how the bump by one percent changes with every coordinate, per radius."""
        surface, value = self.surface, self.problem.inputs_by_name[name].value
        by = one_percent(self.problem.inputs_by_name[name])
        at_values = problems_at(self.problem)
        positions = [sign * one for one in np.eye(len(surface.radius)) for sign in (1.0, -1.0)]
        directions = surface.coordinates.directions
        moved = [shifted_policy(policy, (surface.radius * x) @ directions) for x in positions]
        side = at_values({name: value + by})
        high = np.array([self._value(side, item) for item in moved])
        side = at_values({name: value - by})
        del at_values  # and the tables of the other side
        bumps = (high - np.array([self._value(side, item) for item in moved])) / 2
        return (bumps[::2] - bumps[1::2]) / 2

    def value(self, policy: Policy) -> float:
        """The exact value."""
        return self._value(self.problem, policy)

    def _value(self, problem: Problem, policy: Policy) -> float:
        result = path_totals(problem, policy, self.paths, engine=self.engine, controls=False)
        return float(np.mean(block_means(problem.objective, result, self.blocks)))


def _random(
    on: _Derivatives, policy: Policy, surface: Surface, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """{input: [K, *shape]} changes of the held derivative over the root of twice the loss."""
    goal, top = surface.target / 2, on.value(policy)
    before, changes = on.held(policy), {name: [] for name in on.problem.inputs_by_name}
    length = FIRST
    for _ in range(RANDOM):
        direction = surface.coordinates._replace(policy=policy).random(rng)

        def loss(length: float, along: np.ndarray = direction) -> float:
            """The loss of both sides together: if the policy is not at the top, one of them
            gains."""
            sides = [on.value(shifted_policy(policy, s * length * along)) for s in (1, -1)]
            return top - sum(sides) / 2

        lost = loss(length)
        for _ in range(8):
            if not lost < goal or length >= WIDEST:
                break
            length = min(length * distance_factor(lost, goal), WIDEST)
            lost = loss(length)
        for _ in range(3):
            if lost < 4 * goal:
                break
            length /= NARROWER
            lost = loss(length)
        after = on.held(shifted_policy(policy, length * direction))
        for name, derivative in after.items():
            change = (derivative - before[name]) / np.sqrt(2 * max(lost, goal / 4))
            if np.isfinite(change).all():
                changes[name].append(change)
    return {
        name: np.reshape(item, (-1, *before[name].shape)) for name, item in changes.items()
    }  # fmt: skip
