"""A pharmaceutical process as resolved data: what is asked of it; the units: records_units.

Conventions for every record. Numbers are in the domain's own units, to which reading converts:
K, s, m, m3, kg, kmol/m3 (the same number as mol/L), kg/m3, Pa, J/mol, W, and "1" for a pure
number; shares are fractions, but attributes are in the unit that their measure states. A `Given`
named "unit.field" becomes an input with a sensitivity under that name; where it is used it is
`given.values[given.index]`. Plain NumPy arrays, floats, integers and names have no gradient.
S is the number of species, R of reactions.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from snapo.case.given import Given
from snapo.case.settings import EvaluationTable, TrainingTable

from .records_optimise import Optimise
from .records_units import Feed, Unit


@dataclass(frozen=True, eq=False)
class Network:
    """Mass-action reactions: r_i = k_i exp(-E_i / (R T)) prod_s c_s^order_is, in kmol/m3/s.

    With a reference temperature the rate constant is k_i exp(-E_i / R (1/T - 1/T_ref)), so that
    k_i is the constant at T_ref. R = 8.314 J/mol/K, as the published kinetics use it.

    - `species`, `reactions`: [S], [R] names. `molar_mass`: [S] kg/kmol (the same as g/mol).
    - `stoichiometry`: [R, S], negative for what is used; `molar_mass` times a row adds up to zero.
    - `order`: [R, S] exponents, not negative; those of the reactants unless the case says else.
    - `prefactor`: "kinetics.prefactor", index [R], labels are the reactions, (m3/kmol)^(n-1)/s
      with n the reaction's total order; `activation`: "kinetics.activation", [R], J/mol.
    - `heat`: "kinetics.heat", [R], J/mol of reaction extent, negative where heat is released.
    - `reference`: T_ref in K; None for plain Arrhenius.
    """

    species: tuple[str, ...]
    molar_mass: np.ndarray
    reactions: tuple[str, ...]
    stoichiometry: np.ndarray
    order: np.ndarray
    prefactor: Given
    activation: Given
    heat: Given
    reference: float | None


@dataclass(frozen=True)
class Connection:
    """One outlet feeds one inlet: names of a feed or unit, and of their ports ("" for a feed)."""

    source: str
    outlet: str
    target: str
    inlet: str


@dataclass(frozen=True)
class Distribution:
    """How a number varies from batch to batch, about its nominal value.

    - "normal": standard deviation `spread`; "lognormal": nominal times exp(spread z - spread^2/2),
      so that the mean is the nominal; "uniform": nominal plus or minus `spread`. The unit of
      `spread` is that of the number, a pure number for "lognormal".
    """

    kind: Literal["normal", "lognormal", "uniform"]
    spread: float


@dataclass(frozen=True)
class Parameter:
    """A process parameter, as a filing lists it: one entry of one `Given`.

    - `name`: in tables; `input`, `entry`: the `Given`'s name and the position in its `values`.
    - `unit`: the owner's unit, `scale`: the domain's unit per owner's unit (a sensitivity per
      owner's unit is `scale` times the raw one), `offset`: domain value = scale * owner's + offset.
    - `low`, `high`: proven or studied range; `normal_low`, `normal_high`: normal operating range,
      both in the domain's unit.
    - `distribution`: its variation about the set point; None where it holds exactly.
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
    """A quality attribute: a measure of a unit and the limit that it must keep.

    - `measure`: "unit.measure", such as "dryer.solvent"; `unit`: of the limits and of all tables;
      attribute = `scale` times the measure in the domain's unit.
    - `low`, `high`: limits in `unit`; None where there is none. `citation`: where the limit stands
      (guideline, version, table), or that it is the owner's own; never empty where one is set.
    - `margin`: what counts as a small difference in `unit`, above 0: smooth indicators' width.
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
    """Model parameters that are not known exactly, jointly lognormal or normal, and disturbances.

    U numbers; each is one entry of one `Given`, like a `Parameter`. The policy does not see them.

    - `inputs`: [U] names of `Given`s; `entries`: [U] positions; `distributions`: [U].
    - `correlation`: [U, U] of the underlying standard normals.
    - `when`: [U] "batch" for one draw per batch (kinetics, feed); "step" for a new draw in every
      decision step (a temperature that is not held exactly).
    """

    inputs: tuple[str, ...]
    entries: tuple[int, ...]
    distributions: tuple[Distribution, ...]
    correlation: np.ndarray
    when: tuple[Literal["batch", "step"], ...]


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

    `centre` and `width` bring it to order one: (measured - centre) / width.
    """

    state: str
    error: float
    centre: float
    width: float


@dataclass(frozen=True)
class Control:
    """Closed loop: who decides what, how often and on what.

    - `steps`: decisions per unit, by name; a unit that is not named runs open loop on its own
      numbers. `substeps`: fixed integration steps within one decision, at most 64.
    - `solubility_margin`: most relative supersaturation allowed, as a path constraint; or None.
    """

    manipulated: tuple[Manipulated, ...]
    measurements: tuple[Measurement, ...]
    steps: tuple[tuple[str, int], ...]
    substeps: int
    solubility_margin: float | None


@dataclass(frozen=True)
class Goal:
    """What is made large: by expectation, in the worst batches, or the chance to keep all limits.

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


@dataclass(frozen=True)
class DesignSpace:
    """Where the probability of keeping all limits is mapped.

    - `axes`: two or three names of `Parameter`s, over their `low` to `high`; `points`: per axis.
    - `samples`: draws of the uncertainty per point, the same at every point.
    - `levels`: contours, such as (0.85, 0.95, 0.99); `required`: the probability that the space,
      the proven ranges and the largest box must keep.
    """

    axes: tuple[str, ...]
    points: tuple[int, ...]
    samples: int
    levels: tuple[float, ...]
    required: float


@dataclass(frozen=True, eq=False)
class Experiment:
    """One measured batch: its settings, and what was measured when.

    - `settings`: ((`Given` name, entry, value in the domain's unit), …) other than the case's.
    - `time`: [n] s since the unit's start, `state`: [n] "unit.state" measured, `value`: [n] in the
      domain's unit, `error`: [n] standard deviation, above 0.
    """

    name: str
    settings: tuple[tuple[str, int, float], ...]
    time: np.ndarray
    state: tuple[str, ...]
    value: np.ndarray
    error: np.ndarray


@dataclass(frozen=True)
class Estimation:
    """Which numbers are fitted to which experiments.

    - `inputs`, `entries`: [P] the fitted numbers; `logarithm`: [P] fitted as their logarithm.
    - `low`, `high`: [P] bounds in the domain's unit.
    - `level`: of the confidence intervals.
    """

    inputs: tuple[str, ...]
    entries: tuple[int, ...]
    logarithm: tuple[bool, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    experiments: tuple[Experiment, ...]
    level: float


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


@dataclass(frozen=True, eq=False)
class PharmaCase:
    """A whole case; `units` stand in the order in which material flows.

    - `purpose`: a sentence for the report. `assumptions`: the owner's, beside those of the units.
    - `pairs`: pairs of parameter names for second derivatives of every attribute.
    - `held`: names of `Given`s that are no inputs.
    - `control`, `design_space`, `estimation`, `optimise`: None where it does not ask for them.
    """

    file: Path
    title: str
    purpose: str
    network: Network
    feeds: tuple[Feed, ...]
    units: tuple[Unit, ...]
    connections: tuple[Connection, ...]
    parameters: tuple[Parameter, ...]
    attributes: tuple[Attribute, ...]
    uncertainty: Uncertainty
    control: Control | None
    goal: Goal
    design_space: DesignSpace | None
    estimation: Estimation | None
    pairs: tuple[tuple[str, str], ...]
    held: frozenset[str]
    numerics: Numerics
    training: TrainingTable
    evaluation: EvaluationTable
    assumptions: tuple[str, ...]
    notes: tuple[str, ...]
    optimise: Optimise | None = None

    kind = "pharma"
