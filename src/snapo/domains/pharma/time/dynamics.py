"""A unit over its time as the integrator sees it: an initial value problem."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ..flowsheet.ledger import LedgerFinish
from .profile import Profile


class Dynamics(NamedTuple):
    """y' = rate(y, drive(controls)) over `duration` s, y of order one.

    - `start`: [m]; `controls`: profiles and their values, in the order in which `drive` takes
      them: `drive(*values)` maps arrays of any shape to [..., D], outside the time loop.
    - `event`: share of the duration at which the solution has a kink, or None.
    - `states`: from y and the control values at one time to {state: value}.
    - `finish`: from y and the control values at the end.
    - `stiff`: whether an implicit solver is due.
    - `to_dose`: from y to m3 that wait to be dosed, at the flow that is the last of the controls.
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
