"""The sweeps of one phase.

In an adjoint kernel both come from one joint program: its primal part, with the tape,
is the forward sweep; the rest, with all that is computed again, is the reverse sweep.
"""

import numpy as np

from snapo.lanes.gradients.plan import plan as plan_gradients
from snapo.lanes.program import joint
from snapo.lanes.program.passes import optimize
from snapo.lanes.program.sweeps import dependents, plan

from ..rollout import Phase
from .context import Build
from .forward import forward
from .reverse import Transposed, reverse


def emit(build: Build, phase: Phase) -> None:
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
    bound = build.traced.bound if phase.name == "step" else None
    both = joint.joint(path, moving, _avals(phase), active, bound)
    program = optimize(both.program)
    build.show(f"{phase.name}: one path and its transpose", program)
    count, slots = both.outputs, both.read_slots
    outputs, reads = program.outputs[:count], program.outputs[count : count + len(slots)]
    back = program.outputs[count + len(slots) :]
    cotangents = program.inputs[len(path.reads) + len(phase.inputs) :]
    gradients = plan_gradients(program, [path.reads[s] for s in slots], reads)
    transposed = Transposed(program, gradients, moving, cotangents, active, back)
    kept = gradients.kept(dependents(program, cotangents))
    division = plan(program, cotangents, outputs, transposed.wanted(), kept)
    forward(build, phase, program, division.forward, outputs, division.tape)
    reverse(build, phase, transposed, division)
