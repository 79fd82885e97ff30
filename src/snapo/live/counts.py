"""How many paths the page takes for each of its figures."""

import math
from typing import NamedTuple

from snapo.solver.solution import Solution
from snapo.solver.solve import Evaluation

FEWEST, MAXIMUM = 1024, 12288  # paths of the value: as many as its error needs
ENOUGH = 0.0012  # standard error over value; at moved inputs it may be a little larger
DELTA_PATHS, FAN_PATHS = 1024, 1024
MAX_NUMBERS = 40_000_000  # of all paths' courses: of a long and wide one there are fewer paths


class PathCounts(NamedTuple):
    """Paths: of the value, of the derivatives, of the fans; the first is the greatest."""

    value: int = MAXIMUM
    deltas: int = DELTA_PATHS
    fans: int = FAN_PATHS

    @classmethod
    def of(cls, paths: int, deltas: int | None = None) -> "PathCounts":
        """So many paths for the value, and no more for anything else."""
        return cls(paths, min(DELTA_PATHS, deltas or paths, paths), min(FAN_PATHS, paths))

    @classmethod
    def enough(cls, solution: Solution, evaluation: Evaluation, numbers: int = 1) -> "PathCounts":
        """As many paths as a run's own error says that the value needs, and no more than it had.

        `numbers`: of the course of one path; a wide one has fewer paths, so that an answer comes
        in time.
        """
        share = solution.standard_error / max(abs(solution.value), 1e-300) / ENOUGH
        needed = min(MAXIMUM, max(FEWEST, evaluation.paths * min(share, 1e3) ** 2))
        needed = min(needed, max(FEWEST, 512 * (MAX_NUMBERS // numbers // 512)))
        paths = min(evaluation.paths, 512 * math.ceil(needed / 512))
        return cls.of(paths, evaluation.sensitivity_paths)
