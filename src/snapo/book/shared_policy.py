"""One trained policy for similar contracts, `policy = "shape"`, and the loss that this causes.

The first of similar contracts trains its policy, and so do the next three, which are also valued on
the same paths with the trained numbers of the first one. If the first one's numbers lose at most
0.5 % of the value of any of the three, all others take them, with their own value table, scales and
limits; otherwise each trains its own.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from snapo.solver import statistics

from .file import BookContract
from .job import BookJob, BookPoint, JobResult, name_of

TESTED = 3  # contracts that train a policy of their own, to compare with the first one's
MAX_LOSS = 0.005  # of the value of a tested contract

# The result of the job of this name; None if there is none.
ResultReader = Callable[[str], JobResult | None]


class PolicyLoss(NamedTuple):
    """The loss of a tested contract with the policy of the first one.

    - `value`: the value with its own policy; `loss`, `loss_error`: this value minus that with the
      shared policy, on common paths, and the standard error.
    """

    case: str
    value: float
    loss: float
    loss_error: float

    @property
    def share(self) -> float:
        """The loss as a share of the value; NaN without a value."""
        return self.loss / abs(self.value) if self.value else math.nan


class SharedPolicy(NamedTuple):
    """The policy of the first of similar contracts, and its loss in the tested ones.

    - `policy`: its file; None if each contract trains its own.
    """

    leader: str
    contracts: int
    losses: tuple[PolicyLoss, ...]
    policy: bytes | None


def tested(similar: Sequence[BookContract]) -> Sequence[BookContract]:
    """The contracts that are tested, the second to the fourth; none if no others would gain."""
    return similar[1 : 1 + TESTED] if len(similar) > 1 + TESTED else ()


def test_job(base: BookJob, policy: bytes) -> BookJob:
    """The job of a tested contract, with the policy of the first one."""
    tasks = base.tasks.model_copy(update={"deltas": "none", "exposure": False})
    return replace(base, stresses=(), judged=False, bumped=(), tasks=tasks, adopted=policy)


def shared_policy(
    similar: Sequence[BookContract],
    base: Callable[[BookContract], BookJob],
    read: ResultReader,
) -> SharedPolicy | None:
    """The policy of similar contracts; None while a required result is missing."""
    first, *_ = similar
    leader = read(name_of(base(first).pack()))
    if leader is None:
        return None
    if leader.policy is None:
        return SharedPolicy(first.name, len(similar), (), None)
    losses = list[PolicyLoss]()
    for contract in tested(similar):
        job = base(contract)
        both = [read(name_of(x.pack())) for x in (job, test_job(job, leader.policy))]
        if None in both:
            return None
        own, shared = (result.points[0] for result in both if result is not None)
        losses.append(_loss(contract.name, own, shared))
    is_good = all(loss.share <= MAX_LOSS for loss in losses)
    policy = leader.policy if is_good else None
    return SharedPolicy(first.name, len(similar), tuple(losses), policy)


def _loss(name: str, own: BookPoint, shared: BookPoint) -> PolicyLoss:
    """Not a number where one of the two has no value: then nothing is shared."""
    if own.status != "ok" or shared.status != "ok":
        return PolicyLoss(name, own.value, np.nan, np.nan)
    loss = statistics.of_shares(own.shares - shared.shares)
    return PolicyLoss(name, own.value, loss.value, loss.standard_error)
