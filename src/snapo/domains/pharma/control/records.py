"""The closed loop as resolved data: who decides, on what readings, to which end."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Manipulated:
    """One thing that the policy decides: the profile or the number `input` of a unit.

    - `low`, `high`: the set, in the domain's unit. `ramp`: most change per second of a profile,
      None without limit.
    """

    input: str
    low: float
    high: float
    ramp: float | None


@dataclass(frozen=True)
class Measurement:
    """What the policy sees: "unit.state", with the standard deviation of the sensor's error.

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
      domain's unit; None: what the sensor shows in the nominal batch under the recipe.
    - `gain`: K, of what it moves per measured, both in the domain's units, and `integral`: Ti, s;
      None: by the rule's formula.
    """

    sensor: int
    setpoint: tuple[float, ...] | None
    gain: float | None
    integral: float | None


@dataclass(frozen=True)
class Cascade:
    """One loop: `outer` moves the `Manipulated` number `of`, or through `inner` its setpoint.

    `low`, `high`: of the setpoint that `outer` may ask of `inner`.
    """

    of: int
    outer: PI
    inner: PI | None
    low: float
    high: float


@dataclass(frozen=True)
class ControlRule:
    """A baseline for the policy: PI controllers about the recipe.

    `tuning`: of what is not given: "simc" (Skogestad 2003) or "ziegler-nichols" (1942).
    """

    name: str
    tuning: Literal["simc", "ziegler-nichols"]
    loops: tuple[Cascade, ...]


@dataclass(frozen=True)
class Control:
    """Closed loop: who decides what, how often and on what.

    - `steps`: decisions per unit, by name; a unit that is not named runs open loop on its own
      numbers. `substeps`: fixed integration steps within one decision, at most 64.
    - `solubility_margin`: most relative supersaturation allowed, as a path constraint; or None.
    - `rules`: controllers to compare with the policy, by the same batches.
    """

    manipulated: tuple[Manipulated, ...]
    measurements: tuple[Measurement, ...]
    steps: tuple[tuple[str, int], ...]
    substeps: int
    solubility_margin: float | None
    rules: tuple[ControlRule, ...] = ()


@dataclass(frozen=True)
class Goal:
    """What is maximised: by expectation, in the worst batches, or the probability to keep all
    limits.

    - `kind`: "mean" and "cvar" are of `attribute` (maximised, or minimised with `sense` -1) with
      limits as penalties; "probability" is of all limits together and needs no attribute.
    - `level`: of "cvar". `penalty`: lost per `Attribute.margin` of violation, in units of
      `attribute`'s margin.
    """

    kind: Literal["mean", "cvar", "probability"]
    attribute: str
    sense: Literal[-1, 1]
    level: float
    penalty: float
