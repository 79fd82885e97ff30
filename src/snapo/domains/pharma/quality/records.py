"""The data of all studies of a process: parameters, attributes, uncertain numbers, experiments."""

from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Distribution:
    """The variation of a number from batch to batch, around its nominal value.

    - "normal": standard deviation `spread`; "lognormal": nominal times exp(spread z - spread^2/2),
      so that the mean is the nominal; "uniform": nominal plus or minus `spread`. The unit of
      `spread` is that of the number, a pure number for "lognormal".
    - "logarithm": nominal times exp(spread z), so that the median is the nominal; a number that was
      fitted to data as its logarithm. A case file cannot choose it.
    """

    kind: Literal["normal", "lognormal", "uniform", "logarithm"]
    spread: float


@dataclass(frozen=True)
class Parameter:
    """A process parameter as a regulatory filing lists it: one entry of one `CaseInput`.

    - `name`: the name in tables; `input`, `entry`: the `CaseInput`'s name and the position in its
      `values`.
    - `unit`: the case's unit, `scale`: the domain's unit per case's unit (a sensitivity per
      case's unit is `scale` times the raw one), `offset`: domain value = scale * case's + offset.
    - `low`, `high`: proven or studied range; `normal_low`, `normal_high`: normal operating range,
      both in the domain's unit.
    - `distribution`: its variation about the set point; None if it does not vary.
    - `control`: whether the designer may choose it; False for a material attribute.
    """

    name: str
    input: str
    entry: int
    unit: str
    scale: float
    offset: float
    low: float
    high: float
    normal_low: float
    normal_high: float
    distribution: Distribution | None
    control: bool
    source: str


@dataclass(frozen=True)
class Attribute:
    """A quality attribute: a measure of a unit and the limit that it must meet.

    - `measure`: "unit.measure", such as "dryer.solvent"; `unit`: the unit of the limits and of all
      tables; attribute = `scale` times the measure in the domain's unit.
    - `low`, `high`: limits in `unit`; None if there is none. `citation`: the source of the limit
      (guideline, version, table), or a note that the user set it; never empty if there is a limit.
    - `margin`: a small difference in `unit`, above 0: the width of smooth indicators.
    """

    name: str
    measure: str
    unit: str
    scale: float
    low: float | None
    high: float | None
    citation: str
    margin: float


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertain model parameters, jointly lognormal or normal, and disturbances.

    There are U numbers; each is one entry of one `CaseInput`, like a `Parameter`. The policy does
    not observe them.

    - `inputs`: [U] names of `CaseInput`s; `entries`: [U] positions; `distributions`: [U].
    - `correlation`: [U, U] of the underlying standard normals.
    - `between`: [U] True for a number that differs between batches (a feed), False for one unknown
      number (a rate constant); () if numbers vary only within batches.
    - `when`: [U] "batch" for one draw per batch (kinetics, feed); "step" for a new draw in every
      decision step (a temperature that is not held exactly).
    """

    inputs: tuple[str, ...]
    entries: tuple[int, ...]
    distributions: tuple[Distribution, ...]
    correlation: np.ndarray
    when: tuple[Literal["batch", "step"], ...]
    between: tuple[bool, ...] = ()


@dataclass(frozen=True)
class DesignSpace:
    """The map of the probability of meeting all limits.

    - `axes`: two or three names of `Parameter`s, over their `low` to `high`; `points`: per axis.
    - `samples`: draws of the uncertainty per point, the same at every point.
    - `levels`: contours, such as (0.85, 0.95, 0.99); `required`: the probability that is required
      in the space, the proven ranges and the largest box.
    """

    axes: tuple[str, ...]
    points: tuple[int, ...]
    samples: int
    levels: tuple[float, ...]
    required: float


@dataclass(frozen=True, eq=False)
class Experiment:
    """One measured batch: its settings, and its measurements with their times.

    - `settings`: ((`CaseInput` name, entry, value in the domain's unit), …) that differ from the
      case.
    - `units`: [n] the units of `value` in the case, with (scale, offset) of each in `scales`, as
      for a `Parameter`.
    - `time`: [n] s since the unit's start, `state`: [n] "unit.state" measured, `value`: [n] in the
      domain's unit, `error`: [n] standard deviation, above 0.
    """

    name: str
    settings: tuple[tuple[str, int, float], ...]
    time: np.ndarray
    state: tuple[str, ...]
    value: np.ndarray
    error: np.ndarray
    units: tuple[str, ...] = ()
    scales: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Estimation:
    """The numbers that are fitted, and the experiments to which they are fitted.

    - `inputs`, `entries`: [P] the fitted numbers; `logarithm`: [P] whether the logarithm is fitted.
    - `low`, `high`: [P] bounds in the domain's unit.
    - `level`: the level of the confidence intervals. `units`, `scales`: [P] units of the case and
      their conversion, see `Parameter`.
    - `held_out`: experiments that are predicted, and not fitted to.
    - `errors`: "known" if they are standard deviations, or "relative", up to a common factor.
    - `starts`: points from which the search begins, the case's first.
    """

    inputs: tuple[str, ...]
    entries: tuple[int, ...]
    logarithm: tuple[bool, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    experiments: tuple[Experiment, ...]
    level: float
    units: tuple[str, ...] = ()
    scales: tuple[tuple[float, float], ...] = ()
    held_out: tuple[Experiment, ...] = ()
    errors: Literal["known", "relative"] = "known"
    starts: int = 8
