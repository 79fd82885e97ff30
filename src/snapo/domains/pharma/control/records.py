"""The closed loop as resolved data: decisions, measurements, and the objective."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Manipulated:
    """One decision of the policy: the profile or the number `input` of a unit.

    - `low`, `high`: its bounds, in the domain's unit. `ramp`: maximum change per second of a
      profile, None without limit.
    """

    input: str
    low: float
    high: float
    ramp: float | None


@dataclass(frozen=True)
class Measurement:
    """A reading for the policy: "unit.state", with the standard deviation of the sensor's error.

    `centre` and `width` bring it to order one: (measured - centre) / width. `delay`: s by which
    the reading lags behind the state, such as an analyser's dead time.
    """

    state: str
    error: float
    centre: float
    width: float
    delay: float = 0.0


@dataclass(frozen=True)
class PI:
    """A controller that follows a setpoint of a sensor: K (e + 1/Ti times the integral of e).

    - `sensor`: number of the `Measurement`. `setpoint`: evenly spaced over the unit's time, in the
      domain's unit; None: the readings of the nominal batch under the recipe.
    - `gain`: K, control per reading, both in the domain's units, and `integral`: Ti, s; None: by
      the rule's formula.
    """

    sensor: int
    setpoint: tuple[float, ...] | None
    gain: float | None
    integral: float | None


@dataclass(frozen=True)
class Cascade:
    """One loop: `outer` moves the `Manipulated` number `of`; with `inner` it moves the setpoint of
    `inner`, which moves the number.

    `low`, `high`: bounds of the setpoint of `inner`.
    """

    of: int
    outer: PI
    inner: PI | None
    low: float
    high: float


@dataclass(frozen=True)
class ControlRule:
    """A baseline for the policy: PI controllers around the recipe.

    `tuning`: the formula for missing settings, "simc" (Skogestad 2003) or "ziegler-nichols" (1942).
    """

    name: str
    tuning: Literal["simc", "ziegler-nichols"]
    loops: tuple[Cascade, ...]


@dataclass(frozen=True)
class Control:
    """Closed loop: the decisions, their times and the measurements.

    - `steps`: decisions per unit, by name; other units run in open loop with the numbers of the
      case. `substeps`: fixed integration steps within one decision, at most 64.
    - `solubility_margin`: the maximum relative supersaturation as a path constraint, or None.
    - `rules`: controllers to compare with the policy, on the same batches.
    """

    manipulated: tuple[Manipulated, ...]
    measurements: tuple[Measurement, ...]
    steps: tuple[tuple[str, int], ...]
    substeps: int
    solubility_margin: float | None
    rules: tuple[ControlRule, ...] = ()


@dataclass(frozen=True)
class Goal:
    """The objective: a mean, the mean of the worst batches, or the probability of meeting all
    limits.

    - `kind`: "mean" and "cvar" are of `attribute` (maximised, or minimised with `sense` -1) with
      limits as penalties; "probability" is that of meeting all limits together, and needs no
      attribute.
    - `level`: the level of "cvar". `penalty`: the loss per `Attribute.margin` of violation, in
      units of `attribute`'s margin.
    """

    kind: Literal["mean", "cvar", "probability"]
    attribute: str
    sense: Literal[-1, 1]
    level: float
    penalty: float
