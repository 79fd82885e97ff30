"""Chooses the engine that runs a problem, with the reason."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import Smooth

from .base import Engine
from .native import Distributed, Native, unavailable, unsupported
from .workers import Workers
from .xla import Xla

NAMES = ("auto", "xla", "native")


class Engines(NamedTuple):
    """The engines of training (float32) and evaluation (float64), and the reason for the choice."""

    train: Engine
    evaluate: Engine
    name: str
    reason: str

    def over(self, workers: Workers) -> "Engines":
        """These engines, with workers that compute groups of paths if that saves time.

        **Raises:** `ValueError` for engines other than the native one.
        """
        train, evaluate = self.train, self.evaluate
        if not (isinstance(train, Native) and isinstance(evaluate, Native)):
            raise ValueError(f"only the native engine uses workers, but this is {self.reason}")
        return self._replace(
            train=replace(train, distributed=Distributed(workers)),
            evaluate=replace(evaluate, distributed=Distributed(workers)),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """The reason why workers were not used in training; empty if they were, or if there are
        none."""
        distributed = self.train.distributed if isinstance(self.train, Native) else None
        return (distributed.note,) if distributed is not None and distributed.note else ()


EngineName = str | Engine | Engines


def choose(requested: EngineName, problem: Problem, policy: Policy) -> Engines:
    """The requested engines, which may be a name, one engine, or a pair that was chosen before.

    "auto" takes the native engine if it can run this problem, even if there is a GPU: its gradient
    of 512 paths takes a tenth of the time that a GPU takes, and a GPU is faster only from about
    20,000 paths (`python -m benchmarks.gpu`). An engine that is passed as an object trains in
    float32 and evaluates in float64, whatever its precision.

    **Raises:** `ValueError` for an unknown name, or if "native" cannot run this problem, or cannot
    run at all because llvmlite is missing.
    """
    if isinstance(requested, Engines):
        return requested
    if isinstance(requested, Engine):
        train, evaluate = (replace(requested, precision=item) for item in ("float32", "float64"))
        name = type(requested).__name__.lower()
        return Engines(train, evaluate, name, f"{requested}, as requested")
    if requested not in NAMES:
        allowed = ", ".join(NAMES)
        raise ValueError(f"engine: got {requested!r}; it must be an engine, or one of {allowed}.")
    devices = tuple(jax.devices())
    if requested == "xla":
        return _xla(devices, "it was asked for")
    missing = unavailable()
    if missing is not None:
        if requested == "native":
            raise ValueError(f"engine: native cannot run here, because {missing}")
        return _xla(devices, missing)
    trees = problem.simulator, problem.schedule, policy, Smooth(np.float32(0.1))
    reason = unsupported(*trees, quickly=True)
    if reason is None:
        why = "it was asked for" if requested == "native" else "it can compile this simulator"
        return Engines(Native("float32"), Native("float64"), "native", f"native, because {why}")
    if requested == "native":
        raise ValueError(f"engine: native cannot run this simulator: {reason}")
    return _xla(devices, f"the native engine cannot run this simulator: {reason}")


def _xla(devices, why: str) -> Engines:
    kind = devices[0].platform.upper()
    reason = f"XLA on {len(devices)} {kind} device{'s' * (len(devices) > 1)}, because {why}"
    return Engines(Xla("float32", devices=devices), Xla("float64", devices=devices), "xla", reason)
