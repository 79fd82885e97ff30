"""A unit over its time as an initial value problem, and how it is integrated."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float

from ..flowsheet.stream import LedgerFinish
from .profile import Profile

LATE = 1e-9  # of a unit's duration: round-off of a time that is asked for


@dataclass(frozen=True)
class Numerics:
    """The method that integrates over time.

    - `method`: "mesh", fixed steps between the breaks at events and profile nodes, or "adaptive",
      error-controlled to `tolerance` (relative; the absolute tolerance is for scaled states).
    - `steps`: fixed steps for each unit and interval between breaks; `open`: whether the number of
      steps is increased if the nominal batch needs more. `refine`: whether the run repeats value
      and gradient with twice as many steps and reports the difference.
    - `max_steps`: the maximum number of steps of the adaptive solver; if it is reached, the unit's
      status contains the time reached.
    - `along`: whether derivatives on the mesh are computed step by step, which is better for many
      batches in parallel, instead of for all steps at once, which is faster for one batch.
    - `own_steps`: whether a run whose held steps are refused gets separate steps in the same trace,
      which takes twice as long to compile.
    - `stiff`: on a mesh, which units without an event take Rosenbrock steps: "none", those for
      which explicit steps are "measured" to be too long or that need error control, or "all".
      `stiff_tolerance`: the tolerance of the choice of their steps at the nominal inputs.
    - `loop_tolerance`: largest relative change of a tear stream in one more iteration of its loop;
      `loop_rounds`: the maximum number of iterations of Newton's method, after which the run's
      status names the loop.
    - `held`: {unit: shares of its duration at which its Rosenbrock steps begin and end}.
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
        """The method with twice as many steps on the mesh, or with a tenth of the tolerance."""
        if self.method == "adaptive":
            return replace(self, tolerance=self.tolerance / 10, max_steps=2 * self.max_steps)
        held = {
            name: np.union1d(times, (times[:-1] + times[1:]) / 2)
            for name, times in self.held.items()
        }
        return replace(self, steps=2 * self.steps, held=held)


class Dynamics(NamedTuple):
    """y' = rate(y, drive(controls)) over `duration` s, y of order one.

    - `start`: [m]; `controls`: profiles and their values, in the order in which `drive` takes them:
      `drive(*values)` maps arrays of any shape to [..., D], outside the time loop.
    - `event`: share of the duration at which the solution has a kink, or None.
    - `states`: a function of y and the control values at one time that returns {state: value}.
    - `finish`: a function of y and the control values at the end.
    - `stiff`: whether an implicit solver is needed.
    - `to_dose`: a function of y that returns the m3 that are still to be dosed, at the flow that is
      the last of the controls.
    """

    start: Float[Array, " m"]
    rate: Callable[[Array, Array], Array]
    drive: Callable[..., Array]
    controls: tuple[tuple[Profile, Array], ...]
    duration: Float[Array, ""]
    event: Float[Array, ""] | None
    states: Callable[..., dict[str, Array]]
    finish: Callable[..., LedgerFinish]
    stiff: bool
    to_dose: Callable[[Array], Array] | None = None


class Track(NamedTuple):
    """A unit over its time: `time` [n + 1] s, `state` y [n + 1, m], `slope` y' per s, `controls`
    [n + 1, C]."""

    time: np.ndarray | Array
    state: np.ndarray | Array
    slope: np.ndarray | Array
    controls: np.ndarray | Array
