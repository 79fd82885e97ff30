"""From traced phases to one LLVM module.

prepare   everything that the paths share: once per call, then once per step
run       a range of blocks of paths, each through all steps and back
finish    the transposes of `prepare`, on sums over all paths
"""

from dataclasses import dataclass

import numpy as np

from snapo.lanes.gradients.plan import plan as plan_gradients
from snapo.lanes.machine.processor import Processor
from snapo.lanes.program import joint
from snapo.lanes.program.passes import optimize
from snapo.lanes.program.sweeps import dependents, plan

from ..rollout import Phase, Traced
from . import driver, shared
from .context import Build, KernelStages
from .forward import forward
from .layouts import Layouts
from .reverse import Transposed, reverse


def emit_phase(build: Build, phase: Phase) -> None:
    """Writes the phase's functions: the forward sweep, and in an adjoint kernel the reverse one."""
    if build.adjoint:
        _both(build, phase)
        return
    program = optimize(joint.forward(phase.cut.path, _avals(phase)))
    build.show(f"{phase.name}: one path", program)
    forward(build, phase, program, program.ops, program.outputs, [])


def _avals(phase: Phase) -> list:
    return [aval for _, aval in phase.inputs]


def _both(build: Build, phase: Phase) -> None:
    """The joint program, its division, and both sweeps."""
    path = phase.cut.path
    moving = [
        i for i, (key, aval) in enumerate(phase.outputs)
        if key[0] in ("state", "total", "final") and np.issubdtype(aval.dtype, np.floating)
    ]  # fmt: skip
    active = [
        i for i, (key, aval) in enumerate(phase.inputs)
        if key not in ("noise", "action") and np.issubdtype(aval.dtype, np.floating)
    ]  # fmt: skip
    bound = build.traced.clip if phase.name == "step" else None
    both = joint.joint(path, moving, _avals(phase), active, bound)
    program = optimize(both.program)
    build.show(f"{phase.name}: one path and its transpose", program)
    count, slots = both.outputs, both.read_slots
    outputs, reads = program.outputs[:count], program.outputs[count : count + len(slots)]
    back = program.outputs[count + len(slots) :]
    cotangents = program.inputs[len(path.reads) + len(phase.inputs) :]
    gradients = plan_gradients(program, [path.reads[s] for s in slots], reads)
    transposed = Transposed(program, gradients, moving, cotangents, active, back)
    selected = gradients.stored(dependents(program, cotangents))
    division = plan(program, cotangents, outputs, transposed.required(), selected)
    forward(build, phase, program, division.forward, outputs, division.tape)
    reverse(build, phase, transposed, division)


@dataclass(eq=False)
class Kernel:
    """The text of a module, and how memory is laid out for it."""

    text: str
    lanes: int
    traced: Traced
    layouts: Layouts
    sizes: dict[str, int]

    @property
    def entries(self) -> dict[str, int]:
        """The functions that are called from outside, with the number of their integers."""
        both = {"prepare": 0, "run": 2}
        return both | {"finish": 0} if self.traced.setup.adjoint else both


def emit(traced: Traced, processor: Processor, stages: KernelStages | None = None) -> Kernel:
    """Writes every function of a kernel, and tells `stages` of the programs on the way."""
    build = Build.start(traced, processor, stages)
    for name in ("initial", "step", "final"):
        emit_phase(build, traced.phases[name])
    shared.prepare(build)
    if build.adjoint:
        shared.finish(build)
    driver.run(build)
    sizes = {"work": build.work, "chunk": build.chunk}
    return Kernel(build.module.text(), build.module.lanes, traced, build.layouts, sizes)
