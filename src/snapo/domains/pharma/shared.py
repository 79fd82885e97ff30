"""Objects that the parts of a run share: the process of the recipe, and the closed loop."""

from dataclasses import dataclass, field
from functools import cached_property

from snapo.study.study import Study, StudyRun

from .control.closed_loop import ClosedLoop
from .flowsheet.case import PharmaCase
from .flowsheet.process import PharmaProcess
from .quality.sampling import on_steps

BATCH, SOUND, MESH = "one batch", "integration", "mesh of statistics"  # names of parts


class OpenLoop:
    """The recipe of the case: a process that is compiled once, and its coarser mesh for
    statistics."""

    def __init__(self, case: PharmaCase):
        self.case, self.seed = case, case.training.seed
        self.coarse: PharmaProcess | None = None

    @cached_property
    def process(self) -> PharmaProcess:
        return PharmaProcess(self.case)


@dataclass(frozen=True, eq=False)
class PharmaStudy(Study):
    """A study with the objects that its parts share; `loop`: None if nothing is decided."""

    recipe: OpenLoop = field(kw_only=True)
    loop: ClosedLoop | None = field(default=None, kw_only=True)


def open_loop(run: StudyRun) -> OpenLoop:
    """The recipe of the run's case."""
    assert isinstance(run.study, PharmaStudy)
    return run.study.recipe


def closed_loop(run: StudyRun) -> ClosedLoop:
    """The closed loop of the run's case."""
    assert isinstance(run.study, PharmaStudy) and run.study.loop is not None
    return run.study.loop


def process(run: StudyRun) -> PharmaProcess:
    """The process on the mesh of the case."""
    return open_loop(run).process


def sampled(run: StudyRun) -> PharmaProcess:
    """The process for statistics, on a mesh that is accurate enough for them."""
    loop = open_loop(run)
    if loop.coarse is None:
        steps = int(run.get("sampling.steps", loop.process.case.numerics.steps))
        loop.coarse = on_steps(loop.process, steps)
    return loop.coarse
