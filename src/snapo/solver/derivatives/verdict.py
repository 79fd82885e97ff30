"""The derivative that is reported: the held one, unless a bump refutes it.

All inputs of a run are tested together: separate tests of twenty inputs at 5 % would falsely refute
one per run. Holm's procedure (1979) falsely refutes any of them in at most 1 % of all runs. A
refuted held derivative is replaced by the bump. A derivative that is not refuted may still be
slightly wrong: the reaction is then added as far as it exceeds its own error (James and Stein's
shrinkage) or reduces noise (a control variate), and the interval includes the rest.
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from snapo.problem.policies.memory import Memory
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem

from ..statistics import Estimate
from .bump import Reaction, reactions
from .interval import (
    AGREE,
    HELD,
    RANGE,
    SHARE_UNSEEN,
    THROUGH,
    UNKNOWN,
    Reported,
    Verdict,
    blocks_along,
    one_percent,
    plain,
)

LEVEL = 0.01  # the probability that any right held derivative of a run is refuted
COLUMNS = (
    "input", "source", "held", "held_error", "bump", "bump_error", "reaction", "reaction_error",
    "more", "less", "probability",
)  # fmt: skip


def tested_by_bumps(
    problem: Problem, policy: Policy, paths: int, held: Mapping[str, Estimate], **options: Any
) -> tuple[dict[str, Reaction], dict[str, Verdict]]:
    """{input: reaction} and {input: verdict} of the held derivatives on `paths`; `options`: those
    of `reactions`."""
    bumped = reactions(problem, policy, paths, held, **options)
    return bumped, verdicts(bumped, reacting=isinstance(policy, Memory), lost=problem.lost)


def verdicts(
    reactions: Mapping[str, Reaction],
    *,
    reacting: bool = False,
    lost: Collection[str] = (),
) -> dict[str, Verdict]:
    """{input: verdict}.

    - `reacting`: whether the policy does not observe the whole state. Held derivatives are then
      wrong in principle, and inputs to which decisions react are reported with the policy's
      reaction.
    - `lost`: inputs whose derivative the adjoint misses, since it is lost in a rounding
      (`Problem.lost`): the bump is reported.
    """
    probabilities = {name: item.probability() for name, item in reactions.items()}
    refuted = holm(probabilities)
    table = {}
    for name, reaction in reactions.items():
        source = HELD
        if reaction.corner == "jump" or not np.isfinite(reaction.reaction).all():
            source = UNKNOWN
        elif reaction.corner == "kink":
            source = RANGE
        elif name in refuted or name in lost or (reacting and reaction.tested):
            source = THROUGH
        held, bump = (_pair(blocks) for blocks in (reaction.held, reaction.bump))
        table[name] = Verdict(
            source,
            held,
            (bump[0], float(np.hypot(bump[1], reaction.extra))),
            reaction.estimate,
            reaction.up,
            reaction.down,
            reaction.side_error,
            probabilities[name],
            reaction.tested,
            reaction.corner,
        )
    return table


def holm(probabilities: Mapping[str, float], level: float = LEVEL) -> set[str]:
    """The names whose hypothesis is refuted; any true one is refuted with probability at most
    `level`."""
    refuted = set()
    ordered = sorted(probabilities, key=lambda name: probabilities[name])
    for number, name in enumerate(ordered):
        if not probabilities[name] < level / (len(ordered) - number):
            break
        refuted.add(name)
    return refuted


def reported(
    problem: Problem,
    held: Mapping[str, Estimate],
    smooth: Mapping[str, Estimate] | None,
    reactions: Mapping[str, Reaction],
    results: Mapping[str, Verdict],
) -> dict[str, Reported]:
    """{input: the reported derivative}, with only the sampling error."""
    result = {}
    for name, values in problem.inputs_by_name.items():
        by = one_percent(values)
        if name not in results:
            result[name] = plain(held[name], by)
            continue
        soft = None if smooth is None else smooth[name]
        result[name] = _of(results[name], reactions[name], held[name], soft, by)
    return result


def held_alone(problem: Problem, held: Mapping[str, Estimate]) -> dict[str, Reported]:
    """{input: the held derivative}, if nothing was bumped."""
    return {name: plain(held[name], one_percent(x)) for name, x in problem.inputs_by_name.items()}


def spread_of(estimate: Estimate, by: np.ndarray) -> np.ndarray:
    """Shares of the numbers of an input in a change along `by`, per unit of each number.

    Their sum times `by` is one; numbers with a larger effect on the value have larger shares.
    """
    size = np.abs(estimate.value * by)
    if not size.sum() > 0:
        size = np.where(by != 0, 1.0, 0.0)
    return size / max(float(size.sum()), 1e-300) / np.where(by != 0, by, 1.0)


def _of(
    verdict: Verdict, reaction: Reaction, held: Estimate, smooth: Estimate | None, by: np.ndarray
) -> Reported:
    base = plain(held, by, verdict.source)
    share = spread_of(held, by)
    if verdict.source == UNKNOWN:
        nan = np.full(np.shape(held.blocks), np.nan)
        # Of a jump the change of the value is no derivative; elsewhere nothing is finite.
        return base._replace(estimate=Estimate(nan), total=np.full(len(nan), np.nan))
    if verdict.source == THROUGH:
        return _through(base, reaction, smooth, share)
    if verdict.source == RANGE:
        return _range(base, verdict, reaction, share)
    value, error = verdict.reaction
    if not verdict.tested or not error > 0:
        return base
    weight = _weight(reaction) if reaction.complete and len(reaction.held) > 1 else 0.0
    complete = reaction.held
    estimate = held
    if weight:
        complete = reaction.held + weight * reaction.reaction
        moves = weight * reaction.reaction.reshape(-1, *(1,) * by.ndim)
        estimate = Estimate(held.blocks + moves * share)
    left = (1 - weight) * (error if weight else max(error, abs(value)))
    return base._replace(estimate=estimate, total=complete, unseen=left * np.abs(share))


def _range(base: Reported, verdict: Verdict, reaction: Reaction, share: np.ndarray) -> Reported:
    """A derivative between both one-sided ones; a held derivative outside of them is replaced."""
    less, more = sorted((verdict.down, verdict.up))
    result = base._replace(
        sides=(verdict.down, verdict.up), unseen=verdict.side_error / SHARE_UNSEEN * np.abs(share)
    )
    if less <= verdict.held[0] <= more:
        return result
    return result._replace(total=reaction.bump, estimate=_spread(reaction.bump, share))


def _spread(complete: np.ndarray, share: np.ndarray) -> Estimate:
    """A change along a bump [b], divided among the numbers of the input."""
    return Estimate(complete.reshape(-1, *(1,) * share.ndim) * share)


def _through(
    base: Reported, reaction: Reaction, smooth: Estimate | None, share: np.ndarray
) -> Reported:
    """The bump. For an input with many numbers: the smooth derivatives, scaled to the bump, if
    their sum agrees with it."""
    complete = reaction.held.mean() - reaction.held[: len(reaction.reaction)].mean() + reaction.bump
    value, error = _pair(complete)
    error = float(np.hypot(error, reaction.extra))
    extra = np.abs(share) * (reaction.extra / SHARE_UNSEEN)
    if base.by.size == 1:
        return base._replace(estimate=_spread(complete, share), total=complete, unseen=extra)
    nan = np.full((len(complete), *base.by.shape), np.nan)
    result = base._replace(estimate=Estimate(nan), total=complete, unseen=extra)
    if smooth is None:
        return result
    soft, soft_error = _pair(blocks_along(smooth, base.by))
    if not abs(soft - value) < AGREE * np.hypot(soft_error, error) or not soft:
        return result
    return result._replace(estimate=Estimate(smooth.blocks * (value / soft)))


def _weight(reaction: Reaction) -> float:
    """The share of the reaction that is added to the held derivative."""
    value, error = reaction.estimate
    shrunk = max(0.0, 1 - (error / value) ** 2) if value else 0.0
    if reaction.extra > error / 2:  # curvature, not noise
        return shrunk
    together = np.cov(reaction.held, reaction.reaction)
    control = float(np.clip(-together[0, 1] / together[1, 1], 0.0, 1.0)) if together[1, 1] else 0.0
    return max(control, shrunk)


def _pair(blocks: np.ndarray) -> tuple[float, float]:
    estimate = Estimate(blocks)
    return float(estimate.value), float(estimate.standard_error) if len(blocks) > 1 else 0.0
