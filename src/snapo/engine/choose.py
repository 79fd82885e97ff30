"""Which engine runs a problem, and why."""

from typing import NamedTuple

import jax
import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Smooth

from .base import Engine
from .native import Native, unavailable, unsupported
from .xla import Xla

NAMES = ("auto", "xla", "native")


class Engines(NamedTuple):
    """The engine that trains (float32) and the one that evaluates (float64), and why these."""

    train: Engine
    evaluate: Engine
    name: str
    reason: str


def choose(name: str, simulator: Simulator, policy: Policy, schedule: Schedule) -> Engines:
    """The engine called `name`; "auto" takes the fastest that can run this simulator.

    **Raises:** `ValueError` for an unknown name, or when "native" cannot run this simulator, or
    nothing at all where llvmlite is not installed.
    """
    if name not in NAMES:
        raise ValueError(f"engine: got {name!r}; allowed is one of {', '.join(NAMES)}.")
    devices = tuple(jax.devices())
    kind = devices[0].platform
    if name == "xla":
        return _xla(devices, "it was asked for")
    if name == "auto" and kind != "cpu":
        return _xla(devices, f"there is a {kind.upper()}")
    missing = unavailable()
    if missing is not None:
        if name == "native":
            raise ValueError(f"engine: native cannot run here, as {missing}")
        return _xla(devices, missing)
    reason = unsupported(simulator, schedule, policy, Smooth(np.float32(0.1)))
    if reason is None:
        why = "it was asked for" if name == "native" else "it can compile this simulator"
        return Engines(Native("float32"), Native("float64"), "native", f"native, as {why}")
    if name == "native":
        raise ValueError(f"engine: native cannot run this simulator: {reason}")
    return _xla(devices, f"the native engine cannot run this simulator: {reason}")


def _xla(devices, why: str) -> Engines:
    kind = devices[0].platform.upper()
    reason = f"XLA on {len(devices)} {kind} device{'s' * (len(devices) > 1)}, as {why}"
    return Engines(Xla("float32", devices=devices), Xla("float64", devices=devices), "xla", reason)
