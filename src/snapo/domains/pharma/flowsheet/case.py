"""A pharmaceutical process as resolved data: its flowsheet, and the requested studies.

Conventions for every record. Numbers are in the domain's units, to which reading converts:
K, s, m, m3, kg, kmol/m3 (the same number as mol/L), kg/m3, Pa, J/mol, W, and "1" for a pure
number; shares are fractions, but attributes are in the unit that their measure states. A
`CaseInput` named "unit.field" becomes an input with a sensitivity under that name; where it is used
it is `given.values[given.index]`. Plain NumPy arrays, floats, integers and names have no gradient.
S is the number of species, R of reactions.
"""

from dataclasses import dataclass
from pathlib import Path

from snapo.case.settings import EvaluationTable, TrainingTable

from ..control.records import Control, Goal
from ..given import Entry
from ..quality.records import Attribute, DesignSpace, Estimation, Parameter, Uncertainty
from ..recipe.records import Optimise
from ..time.dynamics import Numerics
from ..units.operation import Unit
from .feed import Feed
from .network import FlowNetwork


@dataclass(frozen=True)
class Connection:
    """One outlet feeds one inlet: names of a feed or unit, and of their ports ("" for a feed)."""

    source: str
    outlet: str
    target: str
    inlet: str

    @property
    def stream(self) -> str:
        """The name of the stream: "unit.outlet", or that of a feed."""
        return f"{self.source}.{self.outlet}" if self.outlet else self.source


@dataclass(frozen=True, eq=False)
class Flowsheet:
    """The flowsheet, and the integration over time.

    - `units`: in the order in which material flows. `measures`: the names of the requested
      measures.
    """

    network: FlowNetwork
    feeds: tuple[Feed, ...]
    units: tuple[Unit, ...]
    connections: tuple[Connection, ...]
    numerics: Numerics
    measures: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class PharmaCase:
    """A whole case; `units` are in the order in which material flows.

    - `purpose`: a sentence for the report. `assumptions`: sentences of the user, in addition to
      those of the units.
    - `pairs`: pairs of parameter names for second derivatives of every attribute.
    - `held`: names of `CaseInput`s that are not inputs.
    - `parts`: names of the parts of a run that are requested, () for all.
    - `control`, `design_space`, `estimation`, `optimise`: None if the case does not ask for them.
    """

    file: Path
    title: str
    purpose: str
    network: FlowNetwork
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
    parts: tuple[str, ...] = ()

    kind = "pharma"

    @property
    def flowsheet(self) -> Flowsheet:
        """The case with the measures that attributes and an optimisation refer to."""
        terms = () if self.optimise is None else self.optimise.terms + self.optimise.per
        names = [attribute.measure for attribute in self.attributes]
        names += [term.of for term in terms if term.entry is None]
        parts = self.network, self.feeds, self.units, self.connections, self.numerics
        return Flowsheet(*parts, tuple(dict.fromkeys(names)))


def process_entries(case: PharmaCase) -> tuple[Entry, ...]:
    """(input, entry) of the process parameters that vary about their set point."""
    return tuple(
        (parameter.input, parameter.entry)
        for parameter in case.parameters
        if parameter.distribution
    )
