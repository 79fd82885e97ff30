"""How time is integrated."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Numerics:
    """How time is integrated.

    - `method`: "mesh", fixed steps between the breaks that events and profile nodes set, or
      "adaptive", error-controlled to `tolerance` (relative; absolute is that of scaled states).
    - `steps`: fixed steps per unit and break interval; `open`: whether as many more are taken as
      the nominal batch needs. `refine`: whether the run repeats value and
      gradient with twice as many and reports the difference.
    - `max_steps`: of the adaptive solver, after which the unit's status contains the time reached.
    - `along`: whether derivatives on the mesh are computed with every step, which suits many
      batches in parallel, and not for all steps at once, which is fast for one.
    - `own_steps`: whether a run whose held steps are refused gets separate steps in the same
      trace, which takes twice as long to compile.
    - `stiff`: on a mesh, which units without an event take Rosenbrock steps: "none", those for
      which explicit steps are "measured" to be too long or that need error control, or "all".
      `stiff_tolerance`: of the choice of their steps at the nominal inputs.
    - `loop_tolerance`: most relative change of a torn stream in one more turn around its loop;
      `loop_rounds`: of Newton's method, after which the run's status names the loop.
    - `held`: {unit: shares of its duration at which those steps begin and end}.
    """

    method: Literal["mesh", "adaptive"]
    steps: int
    tolerance: float
    max_steps: int
    refine: bool
    along: bool = False
    own_steps: bool = False
    stiff: Literal["none", "measured", "all"] = "none"
    stiff_tolerance: float = 1e-8
    loop_tolerance: float = 1e-10
    loop_rounds: int = 50
    open: bool = False
    held: Mapping[str, np.ndarray] = field(default_factory=dict, hash=False)

    def finer(self) -> "Numerics":
        """Twice as many steps on the mesh; with error control, a tenth of the tolerance."""
        if self.method == "adaptive":
            return replace(self, tolerance=self.tolerance / 10, max_steps=2 * self.max_steps)
        held = {
            name: np.union1d(times, (times[:-1] + times[1:]) / 2)
            for name, times in self.held.items()
        }
        return replace(self, steps=2 * self.steps, held=held)
