"""The answer to an order: a contract trained and valued, then valued under stresses.

It depends on nothing but the order's bytes: the same on every machine with the same versions and
processors of one kind. Code compiled for one contract serves all of the same form in a process.
"""

import gc
import hashlib
import os
import platform
import re
import resource
import tempfile
import time
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
import numpy as np

from snapo.case.error import CaseError
from snapo.engine.native import forget_kernels
from snapo.engine.workers import OTHER
from snapo.lanes.machine import pipeline
from snapo.live.files import read_files
from snapo.live.positions import InputPositions
from snapo.problem.form import form_of
from snapo.problem.inputs import Input
from snapo.problem.policy import Policy, load_policy
from snapo.solver import statistics
from snapo.solver.derivatives.interval import HELD
from snapo.solver.evaluate import path_totals, value_of_groups
from snapo.solver.sensitivity import Sensitivities, sensitivities
from snapo.study.assign import assigned
from snapo.study.domain import Domain, Options, find
from snapo.study.prepare import use_every_core
from snapo.study.study import Setup, Study

from .file import StressMove
from .order import BATCHES, BookOrder, BookPoint, Cost, Delta, OrderAnswer, enclosed

LARGE = 1 << 30  # bytes of memory at which a worker drops compiled code


def answer(data: bytes) -> bytes:
    """The answer to an order, with its cost. A mistake in a case is an answer too."""
    order, started = BookOrder.unpack(data), time.process_time()
    if not _same_bits(order):
        return OTHER
    use_every_core()
    with tempfile.TemporaryDirectory(prefix="snapo-book-") as folder:
        try:
            result = _Contract(order, Path(folder)).answer()
        except (CaseError, ValueError, ArithmeticError) as error:
            failed = BookPoint.without_value("failed", _sentence(error, folder))
            result = OrderAnswer((failed,) * (len(order.stresses) + order.base))
    packed = result.pack()
    _keep_small()
    return enclosed(packed, _cost(time.process_time() - started))


def _same_bits(order: BookOrder) -> bool:
    """Whether this processor gives the bits that the book asks for; its code is compiled for it."""
    if pipeline.unavailable() is not None:
        return True
    if order.processor:
        return pipeline.use_processor(order.processor)
    return order.fingerprint in ("", pipeline.fingerprint())


def _cost(seconds: float) -> Cost:
    return Cost(seconds, _memory(), f"{platform.node()}:{os.getpid()}")


def _memory() -> float:
    """MB that this process has had in memory at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _keep_small() -> None:
    """A worker that has grown large drops its compiled code, which the disk still has."""
    with suppress(OSError):
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        if pages * resource.getpagesize() > LARGE:
            forget_kernels()
            jax.clear_caches()
            gc.collect()


def _sentence(error: Exception, folder: str) -> str:
    return f"{type(error).__name__}: {error}".replace(folder, "").strip()[:500]


class _Contract:
    """The contract of an order, made ready."""

    def __init__(self, order: BookOrder, folder: Path):
        self.order, self.paths = order, order.tasks.paths
        self.file = folder / "case.toml"
        tables, _ = assigned(tomllib.loads(order.case), _settings(order))
        for name, content in order.files.items():
            (folder / name).write_bytes(content)
        self.file.write_text(order.case, encoding="utf-8")
        domain: Domain = find(tables["kind"], self.file.name)
        case = domain.read(self.file, tables)
        self.study: Study = domain.study(case, Options())
        if self.study.setup is None or self.study.setup_at is None:
            raise ValueError(f'a case of kind "{self.study.kind}" has no policy that a book values')
        self.setup: Setup = self.study.setup()
        self.inputs = self.setup.problem.inputs_by_name
        self.positions = InputPositions(
            domain.read, read_files(folder, tables), self.inputs, self.study.inputs, case
        )

    def answer(self) -> OrderAnswer:
        """The points of the order, and the policy where it was trained."""
        order, problem = self.order, self.setup.problem
        labels = _shape(self.setup), repr(problem.sources.evaluation.world(problem.simulator))
        if order.policy is not None:
            policy = _policy(order.policy)
            return OrderAnswer((*self._base(policy), *self._stressed(policy)), None, *labels)
        if not order.base:
            return OrderAnswer(tuple(self._stressed(None)), None, *labels)
        solution = self.setup.solve()
        assert solution.policy is not None
        deltas = () if order.tasks.deltas == "none" else _deltas(solution.sensitivities)
        base = _point(self.setup, solution.totals, {}, deltas)
        points = (base, *self._stressed(solution.policy))
        return OrderAnswer(points, _file(solution.policy), *labels)

    def _base(self, policy: Policy) -> Iterator[BookPoint]:
        if self.order.base:
            yield self._valued(self.setup, policy, {})

    def _stressed(self, policy: Policy | None) -> Iterator[BookPoint]:
        """The points of the stresses; None: each trains a policy."""
        for moves in self.order.stresses:
            try:
                yield self._under(moves, policy)
            except (CaseError, ValueError, ArithmeticError) as error:
                yield BookPoint.without_value("failed", _sentence(error, str(self.file.parent)))

    def _under(self, moves: tuple[StressMove, ...], policy: Policy | None) -> BookPoint:
        """The value under a stress, with guide and control variate of its numbers."""
        values = dict[str, np.ndarray]()
        for move in moves:
            name = _input(move.key, self.inputs)
            value = values.get(name, self.inputs[name].value)
            values[name] = _moved(self.inputs[name], value, move)
        assert self.study.setup_at is not None
        setup = self.study.setup_at(self.setup, self.positions.case_at(values).case)
        changes = {name: (x - self.inputs[name].value).ravel() for name, x in values.items()}
        if policy is not None:
            return self._valued(setup, policy, changes)
        solution = setup.solve()
        deltas = _deltas(solution.sensitivities) if self.order.tasks.deltas == "all" else ()
        return _point(setup, solution.totals, changes, deltas)

    def _valued(self, setup: Setup, policy: Policy, changes: dict[str, np.ndarray]) -> BookPoint:
        engine = setup.engines.evaluate
        totals = path_totals(setup.problem, policy, self.paths, engine=engine)
        deltas: tuple[Delta, ...] = ()
        if self.order.tasks.deltas == "all":
            paths = setup.evaluation.sensitivity_paths
            deltas = _deltas(sensitivities(setup.problem, policy, paths=paths, engine=engine))
        return _point(setup, totals, changes, deltas)


def _shape(setup: Setup) -> str:
    """The hash of the form of simulator and policy, and of the engine that runs them."""
    form = (form_of(setup.problem.simulator), form_of(setup.policy), setup.engines.name)
    text = re.sub(r"0x[0-9a-f]+", "", repr(form))
    return hashlib.blake2b(text.encode(), digest_size=4).hexdigest()


def _settings(order: BookOrder) -> list[str]:
    """The settings of a case that the book decides."""
    untested = [] if order.judged else ["evaluation.judge_paths=0"]
    return [f"training.seed={order.seed}", f"evaluation.paths={order.tasks.paths}", *untested]


def _input(key: str, inputs: Mapping[str, Input]) -> str:
    """The input of a key of the case: "market.forward_curve" is `forward_curve`."""
    for name in (key, key.rpartition(".")[2]):
        if name in inputs:
            return name
    raise CaseError("stress", key, None, f"allowed is one of {', '.join(inputs)}")


def _moved(entry: Input, value: np.ndarray, move: StressMove) -> np.ndarray:
    """The numbers of an input under a stress; `when`: where its labels begin with a date within."""
    if move.when is None:
        return value * move.scale + move.shift
    first, last = (day.isoformat() for day in move.when)
    labels = np.array([str(label)[:10] for label in entry.names()])
    inside = np.array([first[: len(x)] <= x <= last[: len(x)] for x in labels]).reshape(value.shape)
    if not inside.any():
        raise CaseError("stress", move.key, None, f"none of its numbers lies in {first}/{last}")
    return np.where(inside, value * move.scale + move.shift, value)


def _point(
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
        return BookPoint.without_value("failed", "too many paths are non-finite")
    shares = batched(shares)
    result = statistics.of_shares(shares)
    return BookPoint("ok", "", result.value, result.standard_error, shares, changes, deltas)


def batched(shares: np.ndarray) -> np.ndarray:
    """[B] means of equal batches of shares [groups] in order: of the most batches up to 512."""
    count = next(n for n in range(min(BATCHES, len(shares)), 0, -1) if len(shares) % n == 0)
    return shares.reshape(count, -1).mean(1)


def _deltas(table: Sensitivities | None) -> tuple[Delta, ...]:
    """The held derivatives of a table, none of none."""
    if table is None:
        return ()
    verdicts = table.verdicts or {}
    return tuple(
        Delta(
            name,
            tuple(map(str, table.inputs[name].names())),
            table.inputs[name].unit,
            estimate.blocks.reshape(len(estimate.blocks), -1),
            verdicts[name].source == HELD if name in verdicts else None,
        )
        for name, estimate in table.held.items()
    )


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
