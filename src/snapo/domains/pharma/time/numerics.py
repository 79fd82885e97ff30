"""How time is integrated."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Numerics:
    """How time is integrated.

    - `method`: "mesh", fixed steps between the breaks that events and profile nodes set, or
      "adaptive", error-controlled to `tolerance` (relative; absolute is that of scaled states).
    - `steps`: fixed steps per unit and break interval; `refine`: whether the run repeats value and
      gradient with twice as many and reports the difference.
    - `max_steps`: of the adaptive solver, after which the unit's status says where it stopped.
    - `along`: whether derivatives on the mesh are taken along with every step, as suits many
      batches side by side, and not of all steps at once, as is fast for one.
    """

    method: Literal["mesh", "adaptive"]
    steps: int
    tolerance: float
    max_steps: int
    refine: bool
    along: bool = False
