"""The answer to an order: a contract trained and valued, then valued under stresses.

It is a function of the order's bytes alone: the same on every machine with the same versions and
vectors of the same size. What is compiled for one contract serves all of the same form in a process.
"""

import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.live.case.files import read_files
from snapo.live.case.places import InputPositions
from snapo.problem.inputs import Input
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, value_of_groups
from snapo.solver.solution import Solution
from snapo.solver.solve import solve
from snapo.study.assign import assigned
from snapo.study.domain import Domain, Options, find
from snapo.study.study import Setup, Study

from .file import Move
from .order import BATCHES, Answer, Delta, Order, Point


def answer(data: bytes) -> bytes:
    """The answer to an order. A mistake in a case, and numbers that are not finite, are answers."""
    order = Order.unpack(data)
    with tempfile.TemporaryDirectory(prefix="snapo-book-") as folder:
        try:
            return _Contract(order, Path(folder)).answer().pack()
        except (CaseError, ValueError, FloatingPointError, ArithmeticError) as error:
            failed = _failed(_sentence(error, folder))
            count = len(order.stresses) + (order.policy is None)
            return Answer((failed,) * count).pack()


def _failed(note: str) -> Point:
    return Point("failed", note, np.nan, np.nan, np.full(1, np.nan), {})


def _sentence(error: Exception, folder: str) -> str:
    return f"{type(error).__name__}: {error}".replace(folder, "").strip()[:500]


class _Contract:
    """The contract of an order, made ready."""

    def __init__(self, order: Order, folder: Path):
        self.order, self.paths = order, order.tasks.paths
        tables, _ = assigned(tomllib.loads(order.case), _settings(order))
        for name, content in order.files.items():
            (folder / name).write_bytes(content)
        self.file = folder / "case.toml"
        self.file.write_text(order.case, encoding="utf-8")
        self.domain: Domain = find(tables["kind"], self.file.name)
        self.case = self.domain.read(self.file, tables)
        self.study: Study = self.domain.study(self.case, Options())
        if self.study.setup is None or self.study.setup_at is None:
            raise ValueError(f'a case of kind "{self.study.kind}" has no policy that a book values')
        self.setup: Setup = self.study.setup()
        self.positions = InputPositions(
            self.domain.read,
            read_files(folder, tables),
            self.setup.problem.inputs_by_name,
            self.study.inputs,
            self.case,
        )

    def answer(self) -> Answer:
        """The points of the order, and what the base gives."""
        if self.order.policy is not None:
            policy = _policy(self.order.policy)
            return Answer(tuple(self._stressed(policy)))
        setup = self.setup
        solution = solve(
            setup.problem,
            policy=setup.policy if setup.recipe is None else setup.recipe,
            training=setup.training,
            evaluation=setup.evaluation,
            engine=setup.engines,
        )
        policy = solution.policy
        assert policy is not None
        base = _point(setup.problem, solution.totals, {})
        deltas = () if self.order.tasks.deltas == "none" else tuple(_deltas(solution))
        return Answer((base, *self._stressed(policy)), deltas, _file(policy))

    def _stressed(self, policy: Policy) -> Iterator[Point]:
        for moves in self.order.stresses:
            try:
                yield self._under(moves, policy)
            except (CaseError, ValueError) as error:
                yield _failed(_sentence(error, str(self.file.parent)))

    def _under(self, moves: tuple[Move, ...], policy: Policy) -> Point:
        """The value of the policy under a stress, with guide and control variate of its numbers."""
        inputs, values = self.setup.problem.inputs_by_name, {}
        for move in moves:
            name = _input(move.key, inputs)
            values[name] = _moved(inputs[name], values.get(name, inputs[name].value), move)
        assert self.study.setup_at is not None
        setup = self.study.setup_at(self.setup, self.positions.case_at(values).case)
        totals = path_totals(setup.problem, policy, self.paths, engine=setup.engines.evaluate)
        changes = {name: (x - inputs[name].value).ravel() for name, x in values.items()}
        return _point(setup.problem, totals, changes)


def _settings(order: Order) -> list[str]:
    """The settings of a case that the book decides."""
    judge = [] if order.judged else ["evaluation.judge_paths=0"]
    return [f"training.seed={order.seed}", f"evaluation.paths={order.tasks.paths}", *judge]


def _input(key: str, inputs: Mapping[str, Input]) -> str:
    """The input of a key of the case: "market.forward_curve" is `forward_curve`."""
    for name in (key, key.rpartition(".")[2]):
        if name in inputs:
            return name
    raise CaseError("stress", key, None, f"allowed is one of {', '.join(inputs)}")


def _moved(entry: Input, value: np.ndarray, move: Move) -> np.ndarray:
    """The numbers of an input under a stress; `when`: where its labels begin with a date within."""
    if move.when is None:
        return value * move.scale + move.shift
    first, last = (day.isoformat() for day in move.when)
    labels = np.array([str(label)[:10] for label in entry.names()])
    inside = np.array([first[: len(x)] <= x <= last[: len(x)] for x in labels]).reshape(value.shape)
    if not inside.any():
        raise CaseError("stress", move.key, None, f"none of its numbers lies in {first}/{last}")
    return np.where(inside, value * move.scale + move.shift, value)


def _point(problem: Problem, totals: Mapping[str, Any], changes: dict[str, np.ndarray]) -> Point:
    """The value of these totals [paths], by batch of paths."""
    controls = problem.simulator.control_variates()
    shares = value_of_groups(problem.objective, totals, problem.sources.evaluation, controls)
    if not np.isfinite(shares).all():
        return _failed("too many paths are not finite")
    result = statistics.of_shares(batched(shares))
    return Point("ok", "", result.value, result.standard_error, batched(shares), changes)


def batched(shares: np.ndarray) -> np.ndarray:
    """[B] means of equal batches of shares [groups] in order: of the most batches up to 512."""
    count = next(n for n in range(min(BATCHES, len(shares)), 0, -1) if len(shares) % n == 0)
    return shares.reshape(count, -1).mean(1)


def _deltas(solution: Solution) -> Iterator[Delta]:
    """The held derivatives of the base."""
    table = solution.sensitivities
    if table is None:
        return
    for name, estimate in table.held.items():
        blocks = estimate.blocks.reshape(len(estimate.blocks), -1)
        entry = table.inputs[name]
        yield Delta(name, tuple(map(str, entry.names())), entry.unit, blocks)


def _file(policy: Policy) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "policy.npz"
        policy.save(file)
        return file.read_bytes()


def _policy(data: bytes) -> Policy:
    from snapo.problem.carry.save import load_policy

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "policy.npz"
        file.write_bytes(data)
        return load_policy(file)
