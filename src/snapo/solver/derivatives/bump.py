"""Bumps: the exact value with one input moved up and down, paired with the held derivative.

The bump B = [V(x + h) - V(x - h)] / 2h, with the policy reacting, and the held derivative C, with
the decisions replayed, have the same noise. Their difference block by block, the reaction R = B -
C, is therefore far more accurate than either: if the policy is optimal it is zero. Everything that
a domain builds from the inputs (value table, hedge, tables of a rule) is built again for the moved
input (`Problem.moved`); with the old table a good policy would look bad.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from snapo.engine import Engine
from snapo.lanes.machine.threads import cores
from snapo.problem.objective import Objective, Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import BLOCKS

from ..adjoint import DROPPED, finite
from ..evaluate import path_totals, value_of
from ..statistics import Estimate
from .interval import blocks_along, one_percent
from .rebuilt import forget, on_line, problems_at, rebuilt_once

WIDE = 3.0  # times that: the second size, with less noise and more curvature
FEW = 16  # a share of the paths, one in 16, is enough where the reaction is plainly nothing
FEWEST = 4  # blocks in any case
COARSE = 0.03  # of the held derivative: a standard error at which a reaction may be nothing
PRECISE = 0.0025  # that at which it needs no more paths, if there is time for them
NEGLIGIBLE = 2e-5  # of the value: a smaller reaction to one percent of an input is not looked at
CURVED = 3.0  # standard errors between both sizes, above which the difference is curvature
THIRD = WIDE**2 - 1.0  # of the third-order term, between both sizes
MATERIAL = 0.01  # of the derivative: a smaller difference of the sides is not looked at
SIGNIFICANT = 4.0  # standard errors between the sides: no false alarm among twenty inputs
# Of the gap between the sides, at half the move: a kink leaves 1/2, a bend 1/4, a jump all of it.
CORNER, JUMP = 0.375, 0.75
REBUILT = 2  # problems that are rebuilt at once: each has its own tables
ROUND_OFF = 64 * np.finfo(np.float64).eps  # of a value


class Reaction(NamedTuple):
    """One input bumped: the change of the value along `by`, a move of one percent.

    - `held`: [B] the held derivative along `by`, by block; `reaction`: [b] bump minus held on the
      first b blocks, to first order; `extra`: the error that is due to removing the curvature.
    - `up`, `down`: the value after the bump minus that before it, and the value before minus that
      after the opposite bump, with their standard error `side_error`.
    - `tested`: whether the bump differs from the held derivative by more than round-off: an input
      that only affects costs changes no decision.
    - `corner`: "kink" or "jump", if both sides differ and half the move shows the same; else "".
    """

    held: np.ndarray
    reaction: np.ndarray
    extra: float
    up: float
    down: float
    side_error: float
    tested: bool
    corner: str = ""

    @property
    def estimate(self) -> tuple[float, float]:
        """The reaction and its standard error."""
        estimate = Estimate(self.reaction)
        error = float(estimate.standard_error) if len(self.reaction) > 1 else 0.0
        return float(estimate.value), float(np.hypot(error, self.extra))

    @property
    def bump(self) -> np.ndarray:
        """[b] the bump to first order, by block."""
        return self.held[: len(self.reaction)] + self.reaction

    @property
    def complete(self) -> bool:
        """Whether all blocks were bumped."""
        return len(self.reaction) == len(self.held)

    def probability(self) -> float:
        """The p-value of the reaction (Student's t)."""
        value, error = self.estimate
        if not self.tested or not np.isfinite(value):
            return 1.0
        if not error:
            return 0.0
        degrees = len(self.reaction) - 1 or np.inf
        return float(2 * special.stdtr(degrees, -abs(value) / error))


def block_means(objective: Objective, totals: Totals, blocks: list[np.ndarray]) -> np.ndarray:
    """[B] the objective by block of paths; if blocks are equal, their mean is the objective.
    Non-finite paths are left out; all results are NaN if more than a few paths are non-finite.
    """
    valid = finite(totals, objective.outputs)
    if np.sum(~valid) > DROPPED * valid.size:
        return np.full(len(blocks), np.nan)
    shares = np.full(valid.size, np.nan)
    with np.errstate(invalid="ignore"):
        shares[valid] = objective.influence({name: x[valid] for name, x in totals.items()})
    return np.array([np.nanmean(shares[block]) for block in blocks])


def reactions(
    problem: Problem,
    policy: Policy,
    paths: int,
    held: Mapping[str, Estimate],
    *,
    maximum: int | None = None,
    rollouts: float = np.inf,
    centre: Totals | None = None,
    engine: Engine | None = None,
) -> dict[str, Reaction]:
    """{input: reaction} of the inputs in `held`, on the same `paths` as the held derivatives, or on
    their first blocks with `maximum` paths in total.

    Every input is bumped on a few of the blocks. If the reaction is inaccurate, all blocks and a
    wider move follow, the least certain input first, until about `rollouts` paths were valued.
    `centre`: the totals of these paths, and possibly of more, if they are known.

    An input whose numbers are all zero moves by its own `move`; without one it has no reaction. No
    input has a reaction if the value is non-finite, as after a ruin. A held derivative that is NaN,
    such as one that is lost in a rounding, counts as zero: the reaction is the whole bump.
    """
    count = max((len(item.blocks) for item in held.values()), default=BLOCKS)
    bumper = _Bumper(problem, policy, paths, count, maximum, centre, engine)
    if not np.isfinite(bumper.value):
        return {}
    moves = {
        name: by
        for name, values in problem.inputs_by_name.items()
        if name in held and (by := one_percent(values)).any()
    }
    along = {name: np.nan_to_num(blocks_along(held[name], by)) for name, by in moves.items()}
    table = bumper.screened(moves, along)
    for name in sorted(table, key=lambda name: _uncertainty(table[name]), reverse=True):
        if not settled(table[name], PRECISE) and bumper.spent < rollouts:
            refined = bumper.refined(name, moves[name], table[name])
            table[name] = refined if np.isfinite(refined.estimate[0]) else table[name]
    return {name: bumper.cornered(name, moves[name], entry) for name, entry in table.items()}


def settled(reaction: Reaction, precise: float, negligible: float = 0.0) -> bool:
    """Whether no more paths are needed: the reaction is insignificant and known to a share
    `precise` of the held derivative, or certainly less than `negligible`."""
    if not reaction.tested or not np.isfinite(reaction.reaction).all():
        return True
    value, error = reaction.estimate
    if len(reaction.reaction) < 2:
        return False
    if abs(value) + 2 * error <= negligible:
        return True
    return abs(value) <= 2 * error <= 2 * precise * abs(float(np.mean(reaction.held)))


def _uncertainty(reaction: Reaction) -> float:
    """The error of the reaction relative to the held derivative; above 1 if that derivative is
    surely wrong, so that the bump will be reported."""
    value, error = reaction.estimate
    if not np.isfinite(value):
        return 0.0
    size = max(abs(float(np.mean(reaction.held))), abs(value), np.finfo(float).tiny)
    return error / size + (1.0 if abs(value) > SIGNIFICANT * error else 0.0)


class _Bumper:
    """A policy on fixed paths, to be valued at moved inputs."""

    def __init__(
        self,
        problem: Problem,
        policy: Policy,
        paths: int,
        count: int,
        maximum: int | None,
        centre: Totals | None,
        engine: Engine | None,
    ):
        source = problem.sources.evaluation
        self.problem, self.policy, self.engine = problem, policy, engine
        self.at_values = problems_at(problem)
        blocks = source.blocks(source.available(paths), count)
        # Interleaved blocks, as those of Sobol points are, can only be taken together.
        apart = np.array_equal(np.concatenate(blocks), np.arange(sum(map(len, blocks))))
        endpoints = np.cumsum([len(block) for block in blocks])
        fitting = len(blocks) if maximum is None else max(2, int(np.sum(endpoints <= maximum)))
        self.blocks = blocks[:fitting] if apart else blocks
        minimum = max(FEWEST, len(blocks) // FEW)
        self.few = min(len(self.blocks), minimum) if apart else len(blocks)
        self.spent = 0  # paths valued so far
        self.centre = self._totals(problem, len(self.blocks)) if centre is None else centre
        self.value = value_of(problem.objective, self.centre)

    def screened(
        self, moves: Mapping[str, np.ndarray], held: Mapping[str, np.ndarray]
    ) -> dict[str, Reaction]:
        """Every input moved by itself, on few paths.

        Objects built from the inputs are first held fixed, which is fast. If there is no reaction,
        then with a near-optimal policy there is none to first order with rebuilt objects either.
        Problems are rebuilt in two threads, while other inputs are valued; in one thread if paths
        are long, since their tables are large.
        """
        problem, table = self.problem, {}
        waiting: list[tuple[str, Future[Problem]]] = []

        def value_first() -> None:
            name, rebuilt = waiting.pop(0)
            by, more = moves[name], [rebuilt.result()]
            del rebuilt  # so that its memory is free after its last use
            table[name] = self._moved(name, by, held[name], self.few, mirrored=True, more=more)

        threads = 1 if rebuilt_once(problem) else min(REBUILT, cores())
        pool = ThreadPoolExecutor(threads, "rebuild")
        try:
            for name, by in moves.items():
                fixed = None if problem.rebuild is None else problem.at
                table[name] = still = self._moved(name, by, held[name], self.few, fixed)
                if fixed is None or self._without_reaction(still):
                    continue
                values = {name: problem.inputs_by_name[name].value + by}
                if waiting and rebuilt_once(problem):  # long: two at once would take much memory
                    value_first()
                waiting.append((name, pool.submit(copy_context().run, problem.at_values, values)))
                if len(waiting) > threads:
                    value_first()
            while waiting:
                value_first()
        finally:
            pool.shutdown(cancel_futures=True)
        return table

    def _without_reaction(self, still: Reaction) -> bool:
        """Whether an input has no significant reaction on either side."""
        negligible = NEGLIGIBLE * abs(self.value)
        return settled(still, COARSE, negligible) and not self._two_sided(still)

    def refined(self, name: str, by: np.ndarray, result: Reaction) -> Reaction:
        """The same with all paths and, if that is not enough, with a wider move. For an input that
        hardly changes the value the first move is enough."""
        held, count = result.held, len(self.blocks)
        if len(result.reaction) < count:
            result = self._moved(name, by, held, count)
        if settled(result, PRECISE) or self._tiny(result):
            return result
        return _joined(result, self._moved(name, WIDE * by, WIDE * held, count))

    def _tiny(self, reaction: Reaction) -> bool:
        """Whether the whole change of the value is surely negligible, such as the effect of a rate
        of zero over a week."""
        value, error = reaction.estimate
        size = abs(float(np.mean(reaction.held))) + abs(value) + 2 * error
        return size <= NEGLIGIBLE * abs(self.value)

    def _moved(
        self,
        name: str,
        by: np.ndarray,
        held: np.ndarray,
        count: int,
        at_values: Callable[[dict[str, Any]], Problem] | None = None,
        mirrored: bool = False,
        more: list[Problem] | None = None,
        final: bool = False,
    ) -> Reaction:
        """Both bumps on the first `count` blocks.

        `at_values` by default rebuilds the problem; `mirrored`: for one side only, see `on_line`.
        `more`: the problem at more of the input, if it is known; it is taken from the list.
        `final`: no other move of the input follows, so that its memory is free.
        """
        blocks, objective = self.blocks[:count], self.problem.objective
        value = self.problem.inputs_by_name[name].value
        at_values = at_values or self.at_values
        side = more.pop() if more else at_values({name: value + by})
        high = block_means(objective, self._totals(side, count), blocks)
        side = on_line(self.problem, side, {name: value - by}, -1.0) if mirrored else None
        side = side or at_values({name: value - by})
        if final:
            forget(at_values)
        low = block_means(objective, self._totals(side, count), blocks)
        size = sum(map(len, blocks))
        base = {name: total[:size] for name, total in self.centre.items()}
        middle = block_means(objective, base, blocks)
        if not np.isfinite([low, middle, high]).all():
            unknown = np.full(count, np.nan)
            return Reaction(held, unknown, 0.0, np.nan, np.nan, np.nan, True)
        up, down = Estimate(high - middle), Estimate(middle - low)
        reaction = (high - low) / 2 - held[:count]
        scale = np.abs(high) + np.abs(low) + np.abs(held[:count])
        error = 0.0
        if count > 1:
            error = float(Estimate(high + low - 2 * middle).standard_error)
        return Reaction(
            held,
            reaction,
            float(ROUND_OFF * np.mean(scale)),
            float(up.value),
            float(down.value),
            float(np.hypot(error, ROUND_OFF * np.mean(scale))),
            bool(np.any(np.abs(reaction) > ROUND_OFF * scale * np.sqrt(size))),
        )

    def _two_sided(self, reaction: Reaction) -> bool:
        """Whether the changes for more and for less of the input differ much."""
        size = max(abs(reaction.up), abs(reaction.down))
        minimum = max(MATERIAL * size, NEGLIGIBLE * abs(self.value))
        return abs(reaction.up - reaction.down) > max(SIGNIFICANT * reaction.side_error, minimum)

    def cornered(self, name: str, by: np.ndarray, reaction: Reaction) -> Reaction:
        """The reaction with the kind of its corner, if both sides differ by much."""
        if not self._two_sided(reaction):
            return reaction
        gap = abs(reaction.up - reaction.down)
        held, count = reaction.held / 2, len(reaction.reaction)
        half = self._moved(name, by / 2, held, count, final=True)
        left = abs(half.up - half.down)
        if left <= max(CORNER * gap, SIGNIFICANT * half.side_error):
            return reaction
        return reaction._replace(corner="kink" if left < JUMP * gap else "jump")

    def _totals(self, problem: Problem, count: int) -> dict[str, np.ndarray]:
        paths = sum(map(len, self.blocks[:count]))
        self.spent += paths
        # No difference here uses control variates; those of the centre are round-off away.
        return path_totals(problem, self.policy, paths, engine=self.engine, controls=False)


def _joined(near: Reaction, wide: Reaction) -> Reaction:
    """The reaction to first order from bumps of both sizes, per move of the first."""
    scaled = wide._replace(reaction=wide.reaction / WIDE, extra=wide.extra / WIDE)
    (one, error), (three, other) = near.estimate, scaled.estimate
    if not np.isfinite(three):
        return near
    if len(near.reaction) < 2 or abs(one - three) > CURVED * np.hypot(error, other):
        # Without noise, or where the third order is seen: it is taken out, and may be off by half.
        third = (scaled.reaction - near.reaction) / THIRD
        off = abs(float(np.mean(third))) / (2 if len(near.reaction) > 1 else 1)
        return near._replace(reaction=near.reaction - third, extra=float(np.hypot(near.extra, off)))
    return near._replace(reaction=scaled.reaction, extra=scaled.extra) if other < error else near
