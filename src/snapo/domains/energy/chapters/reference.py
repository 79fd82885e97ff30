"""The exact value, and the value at today's forward prices."""

from dataclasses import dataclass

from snapo.problem.problem import Problem
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..core.intraday import IntradaySimulator, without_trades
from ..core.simulator import simulator_of
from ..methods.intrinsic import intrinsic_value
from ..methods.lattice import refined
from ..setup import factors_of


@dataclass(frozen=True)
class Intrinsic:
    """The best value at forward prices, with all decisions fixed today."""

    intrinsic: Number


@dataclass(frozen=True)
class ExactValue:
    """The exact value, and the remaining change of this value on finer grids; both are None without
    an exact value."""

    dynamic_programming: float | None = None
    dynamic_programming_error: float | None = None


def measure_intrinsic(run: StudyRun) -> Intrinsic:
    """See `intrinsic_value`."""
    problem = run.setup.problem
    return Intrinsic(intrinsic_value(simulator_of(problem).layout, problem.schedule))


def measure(run: StudyRun) -> ExactValue:
    """The value on a lattice in one or two price factors, if the process has no others and no
    schedule is part of the state. The values are None otherwise."""
    problem = run.setup.problem
    factors = factors_of(problem)
    if factors is None or not factors.exact or isinstance(problem.simulator, IntradaySimulator):
        return ExactValue()
    if factors.index is not None and not factors.index.one_factor:
        return ExactValue()
    return ExactValue(*refined(simulator_of(problem).layout, problem.schedule, factors))


def around(problem: Problem) -> tuple[float, float] | None:
    """Two exact values, one below and one above the value of a contract with schedules and trades:
    the value if schedules are always kept, and the value without auctions. None for other
    contracts."""
    if not isinstance(problem.simulator, IntradaySimulator):
        return None
    layout = problem.simulator.layout
    both = [without_trades(problem, scheduled) for scheduled in (True, False)]
    try:
        low, high = (refined(layout, x.schedule, factors_of(x)).value for x in both)
    except ValueError:  # too many levels or price factors for a lattice
        return None
    return low, high


INTRINSIC = Chapter("intrinsic value", "Intrinsic value", Intrinsic, measure_intrinsic,
                    lambda run, result: [], needs=())  # fmt: skip
REFERENCE = Chapter("dynamic programming", "Dynamic programming", ExactValue, measure,
                    lambda run, result: [], needs=())  # fmt: skip
