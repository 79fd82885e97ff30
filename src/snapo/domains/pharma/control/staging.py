"""Which units of a process are stages of decisions, and all that these follow from."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

from ..flowsheet.case import Flowsheet, PharmaCase
from ..quality.records import Attribute
from ..units.operation import Timed, Unit, timed
from .records import Control, Manipulated
from .varied import Varied, varied


def staged(units: Iterable[Unit], control: Control) -> tuple[Timed, ...]:
    """The units over whose time something is decided or measured, in order."""
    by_name = {name for name, _ in control.steps}
    by_name |= {measurement.state.partition(".")[0] for measurement in control.measurements}
    by_name |= {item.input.partition(".")[0] for item in control.manipulated}
    return tuple(entry for entry in timed(units) if entry.name in by_name)


def decided(units: Iterable[Unit], control: Control, stage: str) -> tuple[int, ...]:
    """Numbers of the `Manipulated` that belong to a stage's unit, or ("") to all the others."""
    names = {entry.name for entry in staged(units, control)}

    def unit_of(item: Manipulated) -> str:
        name = item.input.partition(".")[0]
        return name if name in names else ""

    return tuple(i for i, m in enumerate(control.manipulated) if unit_of(m) == stage)


@dataclass(frozen=True, eq=False)
class LoopRecord:
    """All of a case that a closed loop follows from: what flows, who decides, what is to be kept,
    and how batches differ."""

    flowsheet: Flowsheet
    control: Control
    attributes: tuple[Attribute, ...]
    varied: Varied

    @classmethod
    def of(cls, case: PharmaCase) -> Self:
        """Without what only reports and rules ask for, and steps of units that have a stage."""
        assert case.control is not None
        local = [unit.name for unit in staged(case.units, case.control)]
        held = {name: x for name, x in case.numerics.held.items() if name not in local}
        return cls(
            replace(case.flowsheet, numerics=replace(case.numerics, held=held)),
            replace(case.control, rules=()),
            tuple(replace(attribute, unit="", citation="") for attribute in case.attributes),
            varied(case),
        )
