"""Every stage of a simulator's compilation as text, or why it cannot be compiled."""

from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

import jax
import numpy as np

from snapo.lanes import Unsupported
from snapo.lanes.machine.pipeline import assembly, host
from snapo.problem.code.version import of_rollout
from snapo.problem.policy import MLP, Policy
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator, probe
from snapo.problem.smooth import Smooth

from ..base import TRAJECTORY, Window, uncontrolled
from .call import KEPT, NativeCall, unavailable
from .engine import Native
from .kernel.context import KernelStages
from .rollout import FunctionSetup


@dataclass(frozen=True)
class Explanation:
    """A simulator after each stage; prints as a text to read from top to bottom."""

    programs: tuple[tuple[str, str], ...]
    memory: str
    llvm: str
    target: str

    def __str__(self) -> str:
        parts = [f"== {title}\n{text}" for title, text in self.programs]
        parts.append(f"== memory, bytes for one block of paths\n{self.memory}")
        parts.append(f"== LLVM IR\n{self.llvm}")
        return "\n\n".join([*parts, f"== machine\n{self.target}"])

    def assembly(self) -> str:
        """The instructions that this processor runs: those of the code that engines load."""
        return assembly(self.llvm)


def explain(
    simulator: Simulator,
    schedule: Schedule | None = None,
    policy: Policy | None = None,
    smooth=None,
    precision: str = "float32",
) -> Explanation:
    """Every stage between a step function and machine code, for the value and its gradient.

    **Arguments:**

    - `schedule`: the result of `prepare`; by default that of `simulator.prepare(None)`.
    - `policy`: by default a small network.

    **Returns:** the programs (operations on one path; `v…` differs between paths, `s…` does not),
    the layout of memory, and LLVM IR. Raises `Unsupported` with the reason.
    """
    schedule = simulator.prepare(None) if schedule is None else schedule
    if policy is None:
        features = probe(simulator, schedule)[1].shape[0]
        policy = MLP(simulator.action, features, key=jax.random.key(0), hidden=(8,))
    stages: KernelStages = []
    smooth = smooth or Smooth(0.1)
    engine = Native(precision)
    with engine.numbers():
        call, setup = _whole(engine, simulator, schedule, policy, smooth)
        kernel = call.kernel(setup, None, stages)
    rows = [f"{name:16} {layout.stride}" for name, layout in kernel.layouts.items()]
    processor = host()
    target = (
        f"{processor.name}: registers of {processor.register} bytes, blocks of {kernel.lanes} paths"
    )
    # Emitted last, but everything that the paths share comes first in time.
    programs = sorted(stages, key=lambda stage: "computed once" not in stage[0])
    return Explanation(tuple(programs), "\n".join(rows), kernel.text, target)


def unsupported(
    simulator: Simulator,
    schedule: Schedule,
    policy: Policy,
    smooth,
    precision: str = "float32",
    quickly: bool = False,
) -> str | None:
    """The reason why a simulator cannot be compiled: the primitive and the line of user code.

    None if it can, including the gradient, every record, and clipping by `state_scale`.
    Nothing is compiled; tracing takes some tenths of a second, once for all simulators of one form.

    `quickly`: if there is no user-defined code, only the kernel of the derivatives is traced,
    which evaluation uses again.
    """
    if (missing := unavailable()) is not None:
        return missing
    engine, record, clip = Native(precision), TRAJECTORY, True
    if quickly and of_rollout(simulator, policy, schedule, smooth) is None:
        engine, record, clip = Native("float64"), (), False
        simulator = uncontrolled(simulator.on_paths(), ())
    with engine.numbers():
        call, setup = _whole(engine, simulator, schedule, policy, smooth, record, clip)
        key = call.key(setup, None)
        if key not in _reasons:
            _reasons[key] = _reason(call, setup)
            while len(_reasons) > KEPT:
                _reasons.popitem(last=False)
        return _reasons[key]


_reasons: OrderedDict[Hashable, str | None] = OrderedDict()


def _reason(call: NativeCall, setup: FunctionSetup) -> str | None:
    try:
        call.kernel(setup, None)
    except Unsupported as reason:
        return str(reason)
    return None


def _whole(
    engine: Native, simulator, schedule, policy, smooth, record=(), clip: bool = False
) -> tuple[NativeCall, FunctionSetup]:
    """The call of a whole adjoint, and its kernel's setup."""
    draws = Pseudo(0).draws(np.arange(2), simulator)
    window = Window(0, simulator.horizon)
    call = NativeCall(engine, simulator, policy, schedule, draws, smooth, None, window, None)
    wrt = ("policy", "schedule", "start")
    return call, FunctionSetup(
        engine.precision, True, record, False, False, True, clip, wrt, True, True, draws.before
    )
