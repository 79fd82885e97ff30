"""From traced phases to one LLVM module.

prepare   everything that the paths share: once per call, then once per step
run       a range of blocks of paths, each through all steps and back
finish    the transposes of `prepare`, on sums over all paths
"""

from dataclasses import dataclass

from snapo.lanes.machine.processor import Processor

from ..rollout import Traced
from . import driver, phases, shared
from .context import Build, Stages
from .layouts import Layouts


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


def emit(traced: Traced, processor: Processor, stages: Stages | None = None) -> Kernel:
    """Writes every function of a kernel, and tells `stages` of the programs on the way."""
    build = Build.begin(traced, processor, stages)
    for name in ("initial", "step", "final"):
        phases.emit(build, traced.phases[name])
    shared.prepare(build)
    if build.adjoint:
        shared.finish(build)
    driver.run(build)
    sizes = {"work": build.work, "chunk": build.chunk}
    return Kernel(build.module.text(), build.module.lanes, traced, build.layouts, sizes)
