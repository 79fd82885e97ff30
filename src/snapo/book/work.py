"""The result of a job: a contract trained and valued, then valued under stresses.

The result depends on the job's bytes only. It is the same on every machine with the same versions
and a processor of the same kind. In one process, contracts of the same form share compiled code.
"""

import gc
import hashlib
import json
import os
import platform
import re
import resource
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from snapo.case.error import CaseError
from snapo.engine.native import forget_kernels
from snapo.engine.workers import OTHER
from snapo.lanes.machine import pipeline
from snapo.problem.form import form_of
from snapo.problem.inputs import Input
from snapo.problem.policy import Policy, load_policy
from snapo.problem.smooth import EXACT
from snapo.solver import statistics
from snapo.solver.derivatives.verdict import tested_by_bumps
from snapo.solver.evaluate import path_totals, value_of_groups
from snapo.solver.sensitivity import sensitivities
from snapo.solver.solution import Solution
from snapo.study import initial_policy
from snapo.study.chapters.profile import leaves
from snapo.study.domain import RunsCode
from snapo.study.prepare import return_memory, use_every_core
from snapo.study.study import Recalculated, Setup

from .contract import JobContract, sentence
from .job import (
    BATCHES,
    BookJob,
    BookPoint,
    Cost,
    Delta,
    Exposure,
    JobResult,
    OutputFigures,
    enclosed,
)
from .plan import kinds_of
from .stress import StressMove

EXPOSURE_PATHS, EXPOSURE_BLOCKS = 4096, 32
AT_ONCE = 2**20  # numbers of an output, of all paths and steps that are valued together
# MB at which a worker returns free memory; searches for cycles that hold more; drops its code too.
ROOMY, UNTIDY, LARGE = 500, 700, 1000


def compute(data: bytes) -> bytes:
    """The result of a job, with its cost. A mistake in a case is also a result."""
    job, started = BookJob.unpack(data), time.process_time()
    if not _same_bits(job):
        return OTHER
    use_every_core()
    with tempfile.TemporaryDirectory(prefix="snapo-book-") as folder:
        try:
            result = valuation(JobContract(job, Path(folder))).result()
        except (CaseError, ValueError, ArithmeticError) as error:
            failed = BookPoint.without_value("failed", sentence(error, folder))
            result = JobResult((failed,) * (len(job.stresses) + job.base))
    packed = result.pack()
    _keep_small()
    return enclosed(packed, _cost(time.process_time() - started))


def _same_bits(job: BookJob) -> bool:
    """Selects the processor for which code is compiled; returns whether this processor gives the
    bits that the book requires."""
    if pipeline.unavailable() is not None:
        return True
    if job.processor:
        return pipeline.use_processor(job.processor)
    return job.fingerprint in ("", pipeline.fingerprint())


def _cost(seconds: float) -> Cost:
    return Cost(seconds, _memory(), f"{platform.node()}:{os.getpid()}")


def _memory() -> float:
    """The peak memory of this process in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _keep_small() -> None:
    """Makes a worker that has grown return its free memory. A large worker first drops its compiled
    code, which is still on disk."""
    with suppress(OSError):
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        size = pages * resource.getpagesize() >> 20
        if size > LARGE:
            forget_kernels()
            jax.clear_caches()
        if size > UNTIDY:
            gc.collect()
        if size > ROOMY:
            return_memory()


def valuation(contract: JobContract) -> "_Decided | _Calculated":
    """The valuation of a contract; a stress may move its `inputs`.

    **Raises:** `ValueError` for a kind of case that a book does not value.
    """
    study = contract.study
    if study.setup is not None and study.setup_at is not None:
        return _Decided(contract, study.setup())
    if study.recalculated is not None:
        return _Calculated(contract, study.recalculated())
    raise ValueError(
        f'a case of kind "{study.kind}" has neither a policy nor a process that a book can value'
    )


class _Decided:
    """A contract whose value is that of a policy."""

    def __init__(self, contract: JobContract, setup: Setup):
        self.contract, self.job = contract, contract.job
        self.bump_paths = setup.evaluation.judge_paths
        self.setup = setup if self.job.judged else _held_alone(setup)
        self.inputs = setup.problem.inputs_by_name

    def result(self) -> JobResult:
        """The points of the job, and the policy where it was trained."""
        job, problem = self.job, self.setup.problem
        labels = _shape(self.setup), repr(problem.sources.evaluation.world(problem.simulator))
        if job.policy is not None:
            policy = _policy(job.policy)
            with_deltas = job.tasks.deltas == "all"
            base = [self._valued(self.setup, policy, {}, with_deltas)] if job.base else []
            return JobResult((*base, *self._stressed(policy)), None, *labels)
        if not job.base:
            return JobResult(tuple(self._stressed(None)), None, *labels)
        policy = self._adopted()
        if policy is not None:
            base = self._valued(self.setup, policy, {}, job.tasks.deltas != "none")
        else:
            solution = self._solved(self.setup)
            assert solution.policy is not None
            policy = solution.policy
            deltas = () if job.tasks.deltas == "none" else self._deltas(self.setup, solution)
            base = self._point(self.setup, solution.totals, {}, deltas)
        if job.tasks.exposure and base.status == "ok":
            base = base._replace(exposure=tuple(self._exposure(policy)))
        points = (base, *self._stressed(policy))
        return JobResult(points, _file(policy), *labels)

    def _solved(self, setup: Setup) -> Solution:
        """The trained and valued contract; a user's simulator is checked first."""
        return setup.solve(bar=False, check=isinstance(self.contract.domain, RunsCode))

    def _deltas(self, setup: Setup, solution: Solution) -> tuple[Delta, ...]:
        """The held derivatives; those with respect to the job's `bumped` inputs are tested."""
        table, policy, evaluation = solution.sensitivities, solution.policy, setup.evaluation
        if table is None or policy is None or not self.job.bumped:
            return Delta.of_table(table)
        held = {name: table.held[name] for name in self.job.bumped if name in table.held}
        _, verdicts = tested_by_bumps(
            setup.problem, policy, min(evaluation.sensitivity_paths, evaluation.paths), held,
            maximum=self.bump_paths, centre=solution.totals, engine=setup.engines.evaluate,
        )  # fmt: skip
        return Delta.of_table(table._replace(verdicts=verdicts))

    def _adopted(self) -> Policy | None:
        """The policy with the trained numbers of a similar contract; None if there is no such
        policy or it does not fit."""
        if self.job.adopted is None:
            return None
        file = self.contract.file.with_name("adopted.npz")
        file.write_bytes(self.job.adopted)
        supplied = initial_policy.read(file, self.contract.study.kind, file.parent, resume=False)
        try:
            return supplied.adopted_by(self.setup.policy)
        except CaseError:
            return None

    def _stressed(self, policy: Policy | None) -> Iterator[BookPoint]:
        """The points of the stresses; if the policy is None, each stress trains a policy."""
        return self.contract.stressed(lambda moves: self._under(moves, policy))

    def _under(self, moves: tuple[StressMove, ...], policy: Policy | None) -> BookPoint:
        """The value under a stress, with the value table and control variate of the stressed
        numbers."""
        case = self.contract.under(moves, self.inputs)
        setup = self.contract.setup_under(moves, case, self.setup)
        changes = dict(_changes(self.inputs, setup.problem.inputs_by_name))
        if policy is not None:
            check_held(self.setup.policy, setup.policy)
            return self._valued(setup, policy, changes, self.job.tasks.deltas == "all")
        solution = self._solved(setup if self.job.judged else _held_alone(setup))
        deltas = self._deltas(setup, solution) if self.job.tasks.deltas == "all" else ()
        return self._point(setup, solution.totals, changes, deltas)

    def _valued(
        self, setup: Setup, policy: Policy, changes: dict[str, np.ndarray], with_deltas: bool
    ) -> BookPoint:
        engine, tasks = setup.engines.evaluate, self.job.tasks
        totals = path_totals(setup.problem, policy, tasks.paths, engine=engine)
        deltas: tuple[Delta, ...] = ()
        if with_deltas:
            paths = setup.evaluation.sensitivity_paths
            deltas = Delta.of_table(
                sensitivities(setup.problem, policy, paths=paths, engine=engine)
            )
        return self._point(setup, totals, changes, deltas)

    def _exposure(self, policy: Policy) -> Iterator[Exposure]:
        """The mean of the outputs at every step, by block of paths."""
        problem, about = self.setup.problem, self.contract.study.about
        bound = self.setup.engines.evaluate.bind(problem, controls=False)
        source, means = problem.sources.evaluation, dict[str, list[np.ndarray]]()
        paths = source.available(min(self.job.tasks.paths, EXPOSURE_PATHS))
        horizon, blocks = problem.simulator.horizon, list(source.blocks(paths, EXPOSURE_BLOCKS))
        together = max(1, AT_ONCE // (len(blocks[0]) * horizon))
        for i in range(0, len(blocks), together):
            some = blocks[i : i + together]
            draws = source.draws(np.concatenate(some), problem.simulator)
            outputs = bound.values(policy, draws, EXACT, record=("outputs",)).record["outputs"]
            ends = np.cumsum([len(block) for block in some])[:-1]
            for name, values in leaves(outputs).items():
                numbers = np.asarray(values, np.float64)
                if numbers.ndim == 2:  # one number of a step and path
                    rows = (part.mean(1) for part in np.split(numbers, ends, axis=1))
                    means.setdefault(name, []).extend(rows)
        days = about.get("days") or [str(i + 1) for i in range(horizon)]
        for name, rows in means.items():
            if np.isfinite(rows).all() and np.any(rows):
                unit = about.get("units", {}).get(name, "")
                yield Exposure(name, unit, tuple(days[:horizon]), np.array(rows))

    def _point(
        self,
        setup: Setup,
        totals: Mapping[str, Any],
        changes: dict[str, np.ndarray],
        deltas: tuple[Delta, ...] = (),
    ) -> BookPoint:
        """The value of these totals [paths], by batch of paths."""
        problem = setup.problem
        controls = problem.simulator.control_variates()
        shares = value_of_groups(problem.objective, totals, problem.sources.evaluation, controls)
        if not np.isfinite(shares).all():
            return BookPoint.without_value("failed", "the values of too many paths are not finite")
        shares = batched(shares)
        result = statistics.of_shares(shares)
        groups = problem.sources.evaluation.groups(np.arange(len(next(iter(totals.values())))))
        units = self.contract.study.about.get("units", {})
        outputs = tuple(
            OutputFigures.of(name, units.get(name, ""), values, groups)
            for name, values in totals.items()
            if name not in controls
        )
        return BookPoint(
            "ok", "", result.value, result.standard_error, shares, changes, deltas, outputs
        )


def _held_alone(setup: Setup) -> Setup:
    """Removes everything that only the intervals of derivatives need, because a book reports held
    derivatives."""
    evaluation = replace(setup.evaluation, judge_paths=0, smooth_paths=0)
    return setup._replace(evaluation=evaluation)


def check_held(policy: Any, at_point: Any) -> None:
    """**Raises:** `ValueError` if the policy of a contract and its policy at a point differ in more
    than their numbers, for example in levels, moves or the order of modes. The policy of the
    contract would then fail at the point or read the wrong numbers."""
    if _text(form_of(policy)) != _text(form_of(at_point)):
        raise ValueError(
            "the policy of the unchanged contract does not fit this one, whose levels or decisions "
            'differ; train a policy for it: --train in a sweep, or policy = "stress" in a book'
        )


class _Calculated:
    """A process without a policy: the share of batches within all limits, and its attributes."""

    def __init__(self, contract: JobContract, calculation: Recalculated):
        self.contract, self.calculation = contract, calculation
        self.inputs = calculation.inputs_by_name

    def result(self) -> JobResult:
        """The points of the job."""
        job, contract = self.contract.job, self.contract
        base = [self._point(contract.case)] if job.base else []
        stressed = contract.stressed(lambda moves: self._point(contract.under(moves, self.inputs)))
        # Cases of one form draw the same batches.
        form = _hash(json.dumps(kinds_of(contract.tables), sort_keys=True, default=str))
        return JobResult((*base, *stressed), None, form, f"{form} {job.seed}")

    def _point(self, case: Any) -> BookPoint:
        _, table = next(self.calculation.stages(case))
        shares = batched(table["kept"])
        outputs = tuple(
            OutputFigures.of(x.name, x.unit, x.values, None, x.nominal, x.within)
            for x in table["outputs"]
        )
        return BookPoint(
            "ok", "", table["value"], table["standard_error"], shares, {}, outputs=outputs
        )


def _changes(
    base: Mapping[str, Input], moved: Mapping[str, Input]
) -> Iterator[tuple[str, np.ndarray]]:
    """(input, [n] its numbers minus those of the base) for the inputs that a stress moves; 0 for
    the labels, such as days, that the input no longer has."""
    for name, entry in moved.items():
        if name not in base:
            continue
        before, now = base[name].value.ravel(), entry.value.ravel()
        labels, after = base[name].names(), entry.names()
        if labels != after:
            numbers = dict(zip(after, now))
            now = np.array([numbers.get(label, x) for label, x in zip(labels, before)])
        if (change := now - before).any():
            yield name, change


def _shape(setup: Setup) -> str:
    """The hash of the form of simulator and policy, and of the engine that runs them."""
    form = (form_of(setup.problem.simulator), form_of(setup.policy), setup.engines.name)
    return _hash(_text(form))


def _text(form: Any) -> str:
    """A form without addresses of functions, which differ between processes."""
    return re.sub(r"0x[0-9a-f]+", "", repr(form))


def _hash(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=4).hexdigest()


def batched(shares: np.ndarray) -> np.ndarray:
    """[B] means of consecutive batches of equal size of the shares [groups]: as many batches as
    possible, at most 512."""
    count = next(n for n in range(min(BATCHES, len(shares)), 0, -1) if len(shares) % n == 0)
    return shares.reshape(count, -1).mean(1)


def _file(policy: Policy) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "policy.npz"
        policy.save(file)
        return file.read_bytes()


def _policy(data: bytes) -> Policy:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "policy.npz"
        file.write_bytes(data)
        return load_policy(file)
