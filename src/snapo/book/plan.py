"""The plan of a book: the jobs that its contracts need, and their sequence.

The base of a contract is computed first; its policy is part of the jobs of the contract's stresses.
Similar contracts come one after the other, so that a worker already has their compiled code.

With `policy = "shape"` the first four of similar contracts train their policies. The second to the
fourth are also valued, on the same paths, with the trained numbers of the first. If none of these
three loses more than 0.5 % of its value, all other contracts use these numbers, with their own
value table, scales and limits. Otherwise every contract trains its own policy.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from snapo.solver import statistics

from .axes import WITH_UNIT
from .file import Book, BookContract
from .job import STRESSES, BookJob, BookPoint, JobResult, name_of

MIN_JUDGED = 3  # of similar contracts
TESTED = 3  # contracts that train a policy of their own, to compare with the first one's
MAX_LOSS = 0.005  # of the value of a tested contract

# The result of the job of this name; None if there is none.
ResultReader = Callable[[str], JobResult | None]


def similarity_key(contract: BookContract) -> str:
    """A key that is equal for contracts that differ only in numbers, and therefore probably share
    compiled code.

    The key only affects the sequence of jobs; the shape of a result is that of its compiled code.
    """
    term = contract.tables.get("contract", {})
    days = "start" in term and "end" in term and _days(term["start"], term["end"])
    lines = {name: content.count(b"\n") for name, content in sorted(contract.files.items())}
    return json.dumps([kinds_of(contract.tables), str(days), lines], sort_keys=True)


def _days(start: Any, end: Any) -> Any:
    try:
        return (end - start).days
    except (TypeError, AttributeError):
        return None


def kinds_of(table: Any) -> Any:
    """The tables of a case with each number replaced by its type."""
    if isinstance(table, Mapping):
        return {key: kinds_of(value) for key, value in table.items() if key != "title"}
    if isinstance(table, list):
        return [kinds_of(value) for value in table]
    if isinstance(table, str) and (quantity := WITH_UNIT.fullmatch(table)):
        return f"a number in {quantity[2]}"
    return table if isinstance(table, str | bool) else type(table).__name__


class PolicyLoss(NamedTuple):
    """The loss of a tested contract with the policy of the first contract.

    - `value`: the value with its own policy; `loss`, `loss_error`: this value minus the value with
      the shared policy on common paths, and the standard error of the difference.
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
    """The policy of the first of similar contracts, and the losses of the tested contracts with it.

    - `policy`: its file; None if every contract trains its own policy.
    """

    leader: str
    contracts: int
    losses: tuple[PolicyLoss, ...]
    policy: bytes | None


def tested(similar: Sequence[BookContract]) -> Sequence[BookContract]:
    """The contracts that are tested, the second to the fourth; none if there are no further
    contracts."""
    return similar[1 : 1 + TESTED] if len(similar) > 1 + TESTED else ()


def test_job(base: BookJob, policy: bytes) -> BookJob:
    """The job of a tested contract with the policy of the first contract."""
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
    """The loss is not a number if one of the two has no value: then no policy is shared."""
    if own.status != "ok" or shared.status != "ok":
        return PolicyLoss(name, own.value, np.nan, np.nan)
    loss = statistics.of_shares(own.shares - shared.shares)
    return PolicyLoss(name, own.value, loss.value, loss.standard_error)


@dataclass(frozen=True)
class BookPlan:
    """The jobs of a book; `fingerprint`: that of the processors that may compute them."""

    book: Book
    fingerprint: str = ""

    @cached_property
    def first_of_case(self) -> dict[str, BookContract]:
        """{name of a contract: the first contract with the same case}."""
        first, table = dict[str, BookContract](), dict[str, BookContract]()
        for contract in self.book.contracts:
            case = name_of(self._base(contract, False).pack())
            table[contract.name] = first.setdefault(case, contract)
        return table

    @property
    def distinct(self) -> Iterator[tuple[BookContract, BookJob]]:
        """The contracts with different cases, each with one of its jobs."""
        for contract in self.book.contracts:
            if self.first_of_case[contract.name] is contract:
                yield contract, self._base(contract, False)

    @cached_property
    def similar(self) -> dict[str, list[BookContract]]:
        """{similarity key: contracts}, where equal cases count once."""
        groups = dict[str, list[BookContract]]()
        for contract in self.book.contracts:
            if self.first_of_case[contract.name] is contract:
                groups.setdefault(self.similarity_keys[contract.name], []).append(contract)
        return groups

    @cached_property
    def similarity_keys(self) -> dict[str, str]:
        """{name of a contract: its similarity key}."""
        return {contract.name: similarity_key(contract) for contract in self.book.contracts}

    @cached_property
    def judged(self) -> set[str]:
        """The names of the contracts whose derivatives are always tested by bumps."""
        share, names = self.book.tasks.judge, set[str]()
        for contracts in self.similar.values():
            count = max(math.ceil(share * len(contracts)), MIN_JUDGED) if share else 0
            names |= {contract.name for contract in contracts[:count]}
        return names

    @cached_property
    def tested(self) -> dict[str, Sequence[BookContract]]:
        """{similarity key: the contracts that are also valued with the policy of the first
        contract}, if contracts share policies."""
        groups = self.similar.items() if self.book.tasks.policy == "shape" else ()
        return {kind: some for kind, group in groups if (some := tested(group))}

    @cached_property
    def awaited(self) -> set[str]:
        """The names of the contracts whose results are needed by similar contracts."""
        names = {
            x.name for kind, some in self.tested.items() for x in (self.similar[kind][0], *some)
        }
        return self.judged | names

    @cached_property
    def adopting(self) -> set[str]:
        """The names of the contracts that use the policy of a similar contract, unless a test of
        this policy fails or a derivative is refuted."""
        return {x.name for kind in self.tested for x in self.similar[kind]} - self.awaited

    @property
    def size(self) -> int:
        """The number of jobs of the complete book, where equal cases count once."""
        stresses = len(self.book.stresses)
        by_contract = max(1, math.ceil(stresses / STRESSES))
        if self.book.tasks.policy == "stress":
            by_contract = 1 + stresses
        tests = sum(map(len, self.tested.values()))
        return by_contract * sum(map(len, self.similar.values())) + tests

    def needed(self, contracts: Sequence[BookContract]) -> list[BookContract]:
        """All contracts whose jobs are needed, where equal cases count once; those for which
        similar contracts wait come first."""
        first_of_case = {self.first_of_case[contract.name].name for contract in contracts}
        kinds = {self.similarity_keys[name] for name in first_of_case}
        groups = [
            x for kind, similar in sorted(self.similar.items()) if kind in kinds for x in similar
        ]
        return [x for x in groups if x.name in self.awaited] + [
            x for x in groups if x.name in first_of_case and x.name not in self.awaited
        ]

    def base(self, contract: BookContract, read: ResultReader) -> BookJob | None:
        """The first job of a contract; None while it waits for similar contracts.

        If a bump refuted a derivative of one of the similar contracts, bumps test the derivatives
        with respect to this input in all of them, and each trains its own policy.
        """
        first = self.first_of_case[contract.name]
        kind = self.similarity_keys[first.name]
        if first.name in self.awaited:
            return self._first_base(first)
        refuted = self._refuted(kind, read) if self.judged else ()
        if refuted is None:
            return None
        job = replace(self._base(first, False), bumped=refuted)
        if refuted or first.name not in self.adopting:
            return job
        shared = self.shared_policy(kind, read)
        return None if shared is None else replace(job, adopted=shared.policy)

    def shared_policy(self, kind: str, read: ResultReader) -> SharedPolicy | None:
        """The policy of similar contracts; None while a required result is missing."""
        if kind not in self._shared:
            result = shared_policy(self.similar[kind], self._first_base, read)
            if result is None:
                return None
            self._shared[kind] = result
        return self._shared[kind]

    def shared_policies(self, read: ResultReader) -> Iterator[SharedPolicy]:
        """The shared policies of similar contracts whose results are complete."""
        for kind in self.tested:
            if (result := self.shared_policy(kind, read)) is not None:
                yield result

    def tests(self, leader: BookContract, result: JobResult) -> Iterator[BookJob]:
        """The jobs of the tested contracts with the policy of `leader`; none if it is not the first
        of similar contracts, or has no policy. `result`: the result of its first job."""
        kind = self.similarity_keys[leader.name]
        if leader is self.similar[kind][0] and result.policy is not None:
            for contract in self.tested.get(kind, ()):
                yield test_job(self._first_base(contract), result.policy)

    def _first_base(self, contract: BookContract) -> BookJob:
        """The first job of a contract that waits for no other contract."""
        return self._base(contract, contract.name in self.judged)

    @cached_property
    def _shared(self) -> dict[str, SharedPolicy]:
        return {}

    def _refuted(self, kind: str, read: ResultReader) -> tuple[str, ...] | None:
        """The inputs whose derivatives a bump refuted in a judged contract; None while a required
        result is missing."""
        if kind not in self._verdicts:
            judged = [x for x in self.similar[kind] if x.name in self.judged]
            results = [read(name_of(self._base(x, True).pack())) for x in judged]
            complete = [result for result in results if result is not None]
            if len(complete) < len(judged):
                return None
            deltas = [delta for result in complete for delta in result.points[0].deltas]
            refuted = {delta.input for delta in deltas if delta.trusted is False}
            self._verdicts[kind] = tuple(sorted(refuted))
        return self._verdicts[kind]

    @cached_property
    def _verdicts(self) -> dict[str, tuple[str, ...]]:
        return {}

    def _base(self, contract: BookContract, judged: bool) -> BookJob:
        book = self.book
        job = BookJob.of(
            contract,
            book.tasks,
            book.run.seed,
            judged=judged,
            processor=book.run.processor,
            fingerprint="" if book.run.processor else self.fingerprint,
        )
        if book.tasks.policy == "stress":
            return job
        return replace(job, stresses=tuple(x.moves for x in book.stresses[:STRESSES]))

    def further(self, base: BookJob, result: JobResult) -> Iterator[BookJob]:
        """The jobs of a contract after the base, in the sequence of the stresses; none if the base
        failed. `result`: the result of the job `base`."""
        if result.points[0].status != "ok":
            return
        moves = [stress.moves for stress in self.book.stresses]
        if self.book.tasks.policy == "stress":
            for one in moves:
                yield replace(base, base=False, stresses=(one,), policy=None)
            return
        for i in range(STRESSES, len(moves), STRESSES):
            stresses = tuple(moves[i : i + STRESSES])
            further = replace(base, base=False, judged=False, bumped=())
            yield replace(further, stresses=stresses, policy=result.policy)
