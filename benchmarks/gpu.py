"""The XLA engine on a GPU: whether it agrees with the processor, and the time of a gradient.

    python -m benchmarks.gpu [PATHS …]

The problems are the flagship store, the medium fund and two tanks, each with an untrained policy.
The XLA engine on the GPU and the native engine on this machine's processor compute the value of the
paths, and in one pass its gradient with respect to policy and inputs. Times are medians of
alternating runs, without compiling and everything else before the first timed call. If there is no
GPU that JAX can use, the program ends with one message.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from snapo.case.load import load
from snapo.domains.control import DOMAIN as CONTROL
from snapo.domains.control import study as control
from snapo.domains.gas_storage import DOMAIN as GAS
from snapo.domains.gas_storage import setup as gas
from snapo.domains.pension import DOMAIN as PENSION
from snapo.domains.pension.read.case import read_case
from snapo.domains.pension.results import setup as pension
from snapo.engine import Engine, Xla
from snapo.engine.native import Native
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Smooth

from .gas_storage import alternate
from .machine import machine

PATHS = (512, 65536)
CLOSE = {"float32": 1e-4, "float64": 1e-10}  # of two devices' sums of the same paths


class Workload(NamedTuple):
    """A problem with a policy, and the output that is valued and differentiated."""

    name: str
    problem: Problem
    policy: Policy
    output: str


def workloads() -> Iterator[Workload]:
    """The three problems as `snapo solve --engine xla` sets them up."""
    store, fund, tanks = (Path(str(place)) for place in (
        GAS.templates["flagship"], PENSION.templates["medium"], CONTROL.templates["two-tanks"]
    ))  # fmt: skip
    setups = (
        ("store", gas.make_setup(GAS.read(*load(store)), "xla"), gas.OUTPUT),
        ("fund", pension.make_setup(read_case(fund), "xla"), "funding_ratio"),
        ("two tanks", control.make_setup(CONTROL.read(*load(tanks)), "xla"), "reward"),
    )
    for name, setup, output in setups:
        yield Workload(name, setup.problem, setup.policy, output)


def passes(work: Workload, engine: Engine, paths: int) -> tuple[Callable, Callable]:
    """Two calls: the mean of the output, and its gradient with respect to policy and schedule."""
    bound = engine.bind(work.problem)
    draws = Pseudo(1).draws(np.arange(paths), work.problem.simulator)
    weights = {work.output: np.full(paths, 1 / paths)}
    given = work.policy, draws, Smooth(0.01)
    return (
        lambda: float(np.mean(np.asarray(bound.values(*given).totals[work.output]))),
        lambda: jax.block_until_ready(bound.adjoint(*given, weights).policy),
    )


def rows(paths: Sequence[int]) -> Iterator[str]:
    """One line for each workload, precision and number of paths."""
    gpu, processor = jax.devices("gpu")[0], jax.devices("cpu")[0]
    yield f"{gpu.device_kind} beside {machine()}"
    yield (
        f"{'problem':<10}{'precision':<10}{'paths':>8}{'GPU value':>11}{'gradient':>10}"
        f"{'processor':>11}{'gradient':>10}{'ratio':>8}{'apart':>9}"
    )
    for work in workloads():
        for precision in CLOSE:
            for count in paths:
                yield row(work, precision, count, gpu, processor)


def row(work: Workload, precision: str, paths: int, gpu, processor) -> str:
    """Milliseconds; `ratio`: the time of the processor's gradient divided by that of the GPU's;
    `apart`: the largest difference of both gradients, relative to the largest entry."""

    def there(call: Callable) -> Callable:
        def on_processor():
            with jax.default_device(processor):
                return call()

        return on_processor

    value, gradient = passes(work, Xla(precision, devices=(gpu,)), paths)
    with jax.default_device(processor):
        theirs = passes(work, Native(precision), paths)
    apart = distance(gradient(), there(theirs[1])())
    if not apart < CLOSE[precision]:
        raise SystemExit(f"{work.name}, {precision}: gradients differ by {apart:.1e}")
    seconds = [alternate(one, there(other)) for one, other in zip((value, gradient), theirs)]
    (ours, cpu, _), (ours_back, cpu_back, ratio) = seconds
    widths = zip((ours, ours_back, cpu, cpu_back), (9, 8, 9, 8))
    times = "".join(f"{1e3 * seconds:>{width}.1f}ms" for seconds, width in widths)
    return f"{work.name:<10}{precision:<10}{paths:>8}{times}{ratio:>8.2f}{apart:>9.0e}"


def distance(one, other) -> float:
    """The largest difference of two gradients, relative to the largest entry."""
    pairs = list(zip(jax.tree.leaves(one), jax.tree.leaves(other)))
    pairs = [(np.asarray(a, np.float64), np.asarray(b, np.float64)) for a, b in pairs]
    largest = max(np.abs(b).max(initial=0) for _, b in pairs)
    return max(np.abs(a - b).max(initial=0) for a, b in pairs) / largest


def main(arguments: Sequence[str]) -> None:
    try:
        jax.devices("gpu")
    except RuntimeError as error:
        sys.exit(f"no GPU that JAX can use: {error}")
    for line in rows([int(each) for each in arguments] or PATHS):
        print(line, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
