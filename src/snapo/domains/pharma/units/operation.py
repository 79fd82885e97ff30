"""A unit operation: one object with all of its behaviour, from its table to its report.

A new unit is one file with one class, and a line in `registry`. Every `CaseInput` of a unit
is named "unit.field" ("reactor.temperature"), the unit being the object's `name`; labels say
which node, species or coefficient an entry is.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from math import inf
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.table import doc
from snapo.problem.record.arrays import Array, Float, jnp

from ..flowsheet.feed import Feed
from ..flowsheet.network import FlowNetwork
from ..flowsheet.stream import Grid, LedgerFinish, Sizes, Stream
from ..read.declared import TableOf, values
from ..read.reader import Reader
from ..time.dynamics import Dynamics, Numerics, Track
from ..time.integrate import ended, integrate, too_long
from ..time.profile import Profile


class Inlet(NamedTuple):
    """A port that must be fed, by exactly one connection.

    - `crystals`: "refused" if the unit takes only liquids; "needed"; "counted" if they are needed
      with their numbers on a grid; else "allowed". `grid`: the grid on which crystals must be
      counted.
    - `dosed`: the shape over time of the flow into the unit; None if all material enters at the
      start or evenly.
    - `lasting`: whether the unit runs continuously, over the duration of its feed.
    """

    name: str
    crystals: Literal["refused", "allowed", "needed", "counted"]
    grid: Grid | None = None
    dosed: Profile | None = None
    lasting: bool = False


class Outcome(NamedTuple):
    """The results of a unit. `duration`: its time in s, and `reached`: the time to which it was
    integrated, equal to `duration` if all went well; both are 0 for a unit without time. Its
    `track`, and `states`: the function from rows of the track to states; `error` as in `Solved`;
    `rough`: the time in s from which the steps of a mesh were too long, None if that was not
    examined."""

    finish: LedgerFinish
    duration: Float[Array, ""]
    reached: Float[Array, ""]
    track: Track | None
    states: Callable[..., dict[str, Array]] | None
    error: Float[Array, ""] | None = None
    rough: Float[Array, ""] | None = None


@dataclass(frozen=True, eq=False)
class Unit(ABC):
    """The interface of a unit operation for reading, flowsheet, balances and report.

    - `type`: the value of `type` in the file; `variant`: its `kind`, if the kind selects a class of
      the type, else "". `title`: its name in the report.
    - `table`: the table `[units.NAME]`, made of its declared fields and `more_keys`. `reacts`:
      whether it reads the case's reactions.
    - `symbols`: the symbols of the equations, each with its meaning; `assumptions`: sentences for
      the report.
    """

    name: str

    type: ClassVar[str]
    variant: ClassVar[str]
    title: ClassVar[str]
    table = TableOf()
    more_keys: ClassVar[dict[str, Any]] = {}
    reacts: ClassVar[bool]
    symbols: ClassVar[tuple[tuple[str, str], ...]]
    assumptions: ClassVar[tuple[str, ...]]

    def __init_subclass__(cls):
        super().__init_subclass__()
        if "type" in vars(cls):
            kind = getattr(cls, "variant", "")
            cls.heading = f'`type = "{cls.type}"`' + (f', `kind = "{kind}"`' if kind else "")
            cls.more_keys = {"type": (Literal[cls.type], doc("type of the unit"))} | vars(cls).get(
                "more_keys", {}
            )

    @classmethod
    def read(cls, read: Reader, species: tuple[str, ...]) -> Self:
        """The unit from its table; mistakes are `CaseError`s."""
        return cls(name=read.name, **values(cls, read, species))

    @property
    @abstractmethod
    def inlets(self) -> tuple[Inlet, ...]:
        """The ports that are fed."""

    @property
    @abstractmethod
    def outlets(self) -> tuple[str, ...]:
        """Names of the ports that may feed another unit, at most one unit each; all other streams
        are waste."""

    @property
    @abstractmethod
    def time(self) -> CaseInput | None:
        """s over which the unit's profiles run; None for a unit without time."""

    @abstractmethod
    def sizes(self, inlets: tuple[Sizes, ...]) -> tuple[Sizes, ...]:
        """The grid on which crystals are counted at each outlet, from the grids at the inlets."""

    def lasts(self, inlets: tuple[float, ...]) -> tuple[float, ...]:
        """The nominal time in s over which every outlet flows, from the times of the inlets; 0 for
        a batch."""
        return (0.0,) * len(self.outlets)

    @abstractmethod
    def measures(self, species: tuple[str, ...]) -> dict[str, str]:
        """{measure: its unit in the domain} at the end; attributes refer to it as
        "unit.measure"."""

    @abstractmethod
    def states(self, species: tuple[str, ...]) -> dict[str, str]:
        """{state: its unit in the domain} over time; states can be recorded, measured for a policy,
        and fitted."""

    @abstractmethod
    def equations(self) -> list[str]:
        """The equations of the model, one in each line."""

    @abstractmethod
    def operate(
        self,
        network: FlowNetwork,
        numerics: Numerics,
        inlets: tuple[Stream, ...],
        inputs: dict[str, Any],
        record: bool = False,
        end: Float[Array, " m"] | None = None,
    ) -> Outcome:
        """Runs the unit; with `record`, its track is kept. `end`: its final y, if known."""

    def finer(self) -> Self:
        """The unit with twice as many cells along its length or over sizes; the same unit if it has
        no cells."""
        return self

    def unsound(self, track: dict[str, np.ndarray], inputs: dict[str, Any]) -> str:
        """A sentence if the states of a run over time violate the assumptions of the unit's model;
        otherwise ""."""
        return ""

    @property
    def profiles(self) -> tuple[Profile, ...]:
        """All profiles of the unit and of its parts."""
        return tuple(_profiles(self))


@dataclass(frozen=True, eq=False)
class Timed(Unit):
    """A unit that is integrated over `duration` s, index []."""

    duration: CaseInput

    @property
    def time(self) -> CaseInput:
        return self.duration

    @property
    @abstractmethod
    def error_controlled(self) -> bool:
        """Whether the mesh may be too coarse: the unit is stiff, or limited by its cells."""

    @property
    def steps_transfer(self) -> bool:
        """Whether all batches can use the steps that error control chooses for the nominal batch.
        This requires few states and no event. Otherwise each batch chooses its own steps."""
        return False

    def fastest(self, network: FlowNetwork, feeds: tuple[Feed, ...]) -> float:
        """A bound in 1/s on the rates at which its states respond, from the numbers of the case
        only, if nothing but `feeds` enters; infinite if there is no bound."""
        return inf

    @abstractmethod
    def dynamics(
        self, network: FlowNetwork, inlets: tuple[Stream, ...], inputs: dict[str, Any]
    ) -> Dynamics:
        """The unit with its inlets, as an initial value problem."""

    def operate(self, network, numerics, inlets, inputs, record=False, end=None) -> Outcome:
        problem = self.dynamics(network, inlets, inputs)
        if end is None:
            solved = integrate(problem, numerics, record, numerics.held.get(self.name))
        else:
            solved = ended(problem, end)
        finish = problem.finish(solved.final, *solved.controls)
        rough = None
        if solved.track is not None and solved.error is None and numerics.method == "mesh":
            rough = too_long(problem, numerics, solved.track)
        reached, states = solved.reached, problem.states
        return Outcome(finish, problem.duration, reached, solved.track, states, solved.error, rough)


@dataclass(frozen=True, eq=False)
class Instant(Unit):
    """A unit whose outlets follow from its inlets by algebra."""

    @property
    def time(self) -> None:
        return None

    def states(self, species: tuple[str, ...]) -> dict[str, str]:
        return {}

    @abstractmethod
    def deliver(
        self, network: FlowNetwork, inlets: tuple[Stream, ...], inputs: dict[str, Any]
    ) -> LedgerFinish:
        """Outlets, measures and ledger from the inlets."""

    def operate(self, network, numerics, inlets, inputs, record=False, end=None) -> Outcome:
        zero = jnp.zeros(())
        return Outcome(self.deliver(network, inlets, inputs), zero, zero, None, None)


def timed(units: Iterable[Unit]) -> tuple[Timed, ...]:
    """The units that are integrated over time, in order."""
    return tuple(unit for unit in units if isinstance(unit, Timed))


def _profiles(record: Any) -> Iterator[Profile]:
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, Profile):
            yield value
        elif is_dataclass(value):
            yield from _profiles(value)
