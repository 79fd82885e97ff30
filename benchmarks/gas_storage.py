"""The cost of a value with all its derivatives, relative to the value, for 12 to 3650 inputs.

A storage contract of one year with the same paths and the same policy. Only the number of inputs
changes: 12 (monthly prices), 365, or 3650 (ten numbers a day). Both computations start from the
inputs: the value is `prepare` and one forward sweep; with derivatives, the adjoint pass and the
transpose of `prepare` are added.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.case.load import load
from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.contract.simulator import StorageSimulator
from snapo.domains.gas_storage.policy.network import StoragePolicy
from snapo.domains.gas_storage.policy.value_table import ValueTable
from snapo.domains.gas_storage.references.marginal import marginal_values
from snapo.domains.gas_storage.setup import OUTPUT, bare_problem, factors
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.inputs import Input
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import float64, pull_back

CASE = Path(str(DOMAIN.templates["flagship"]))
COUNTS = (12, 365, 3650)
PATHS, RUNS = 4096, 7
PER_DAY = (
    "forward",
    "gas_discount",
    "injection_cost",
    "withdrawal_cost",
    "injection_cost_discount",
    "withdrawal_cost_discount",
    "withdrawal_fuel",
    "next_high",
    "inventory_loss",
    "inventory_cost",
)


class Year(StorageSimulator):
    """A year of storage; its inputs are `counts` factors on the numbers of the schedule."""

    fixed: dict = eqx.field(default_factory=dict)

    def prepare(self, inputs):
        schedule = super().prepare(self.fixed)
        factors, days = inputs["factors"], self.horizon
        if factors.size < len(PER_DAY) * days:
            # Month by month, or about day by day: on the forward curve alone.
            month = np.arange(days) * factors.size // days
            steps = schedule.steps._replace(forward=schedule.steps.forward * factors[month])
            return type(schedule)(schedule.constants, steps)
        steps, columns = schedule.steps, factors.reshape(len(PER_DAY), -1)
        for name, column in zip(PER_DAY, columns):
            leaf = getattr(steps, name)
            scale = column[:days].reshape(-1, *(1,) * (leaf.ndim - 1))
            steps = steps._replace(**{name: leaf * scale})
        return type(schedule)(schedule.constants, steps)


class Row(NamedTuple):
    """Median seconds with `PATHS` paths; `ratio`: the median of the ratios of alternating runs."""

    engine: str
    derivative: str
    inputs: int
    value: float
    gradient: float
    ratio: float


def problem(count: int) -> tuple[Problem, StoragePolicy]:
    """The problem with this number of inputs, and a policy."""
    case = DOMAIN.read(*load(CASE))
    bare = bare_problem(case)
    found = marginal_values(bare.schedule, factors(bare), case.contract.ratchets.interpolation)
    fixed = {name: entry.value for name, entry in bare.inputs_by_name.items()}
    year = replace(Year.of(case, ValueTable.of(found)), fixed=fixed)
    inputs = {"factors": Input(np.ones(count))}
    policy = StoragePolicy(bare.features, key=jax.random.key(0))
    return Problem(year, inputs, bare.objective), policy


def measure(engine, count: int) -> Iterator[Row]:
    """The cost of smooth derivatives through the policy, and of those with decisions held fixed."""
    given, policy = problem(count)
    draws = Pseudo(1).draws(np.arange(PATHS), given.simulator)
    weights = {OUTPUT: np.full(PATHS, 1 / PATHS)}
    smooth = Smooth(jnp.asarray(0.01))

    def prepared():
        """The same problem before its `prepare`: both computations start from the inputs."""
        return replace(given)

    def value(constraints):
        bound = engine.bind(prepared())
        return float64(bound.values(policy, draws, constraints).totals)[OUTPUT].mean()

    def through():
        passed = engine.bind(prepared()).adjoint(policy, draws, smooth, weights)
        return pull_back(given.simulator, given.inputs, [passed.schedule])

    def held():
        bound, exact = engine.bind(prepared()), Exact()
        kept = bound.values(policy, draws, exact, record=("action",)).record["action"]
        passed = bound.adjoint(None, draws, exact, weights, actions=kept, wrt=("schedule",))
        return pull_back(given.simulator, given.inputs, [passed.schedule])

    name = type(engine).__name__
    yield Row(name, "smooth", count, *alternate(lambda: value(smooth), through))
    yield Row(name, "held", count, *alternate(lambda: value(Exact()), held))


def alternate(one: Callable, other: Callable) -> tuple[float, float, float]:
    """Median seconds of both calls in alternating runs, and the median of their ratios."""
    one(), other()
    pairs = [(timed(one), timed(other)) for _ in range(RUNS)]
    ratios = [second / first for first, second in pairs]
    return median(p[0] for p in pairs), median(p[1] for p in pairs), median(ratios)


def timed(call: Callable) -> float:
    started = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - started


def table() -> Iterator[str]:
    """The lines of the table, each as soon as it is known."""
    yield f"{PATHS} paths of a year in float64, medians of {RUNS} alternating runs"
    yield f"{'engine':<8}{'derivative':<12}{'inputs':>8}{'value':>10}{'with all':>10}{'ratio':>8}"
    for engine in (Native("float64"), Xla("float64")):
        for count in COUNTS:
            for row in measure(engine, count):
                yield (
                    f"{row.engine:<8}{row.derivative:<12}{row.inputs:>8}"
                    f"{row.value:>9.3f}s{row.gradient:>9.3f}s{row.ratio:>8.2f}"
                )
