"""The units of a process that are stages of decisions, and the numbers that differ from batch to
batch, with their draws."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from snapo.problem.record.arrays import Array, jax, jnp

from ..flowsheet.case import Flowsheet, PharmaCase
from ..quality.records import Attribute, Distribution
from ..units.operation import Timed, Unit, timed
from .records import Control, Manipulated


@dataclass(frozen=True, eq=False)
class Varied:
    """[V] the differences from batch to batch: the uncertain numbers, and after them the process
    parameters that vary; `correlated`: [V, V] Cholesky factor of their normals."""

    inputs: tuple[str, ...]
    entries: tuple[int, ...]
    distributions: tuple[Distribution, ...]
    when: tuple[str, ...]
    correlated: np.ndarray


def varied(case: PharmaCase) -> Varied:
    """The numbers of `draws.all_entries` with their distributions."""
    available, moving = (
        case.uncertainty,
        [parameter for parameter in case.parameters if parameter.distribution],
    )
    size = len(available.inputs)
    factor = np.eye(size + len(moving))
    if size:
        factor[:size, :size] = np.linalg.cholesky(available.correlation)
    return Varied(
        available.inputs + tuple(item.input for item in moving),
        available.entries + tuple(entry.entry for entry in moving),
        available.distributions
        + tuple(value.distribution for value in moving if value.distribution),
        available.when + ("batch",) * len(moving),
        factor,
    )


def drawn(distribution: Distribution, centre, z) -> Array:
    """The value of a number for a standard normal draw; the formulas are those of
    `Distribution`."""
    if distribution.kind == "normal":
        return centre + distribution.spread * z
    if distribution.kind == "lognormal":
        return centre * jnp.exp(distribution.spread * z - distribution.spread**2 / 2)
    if distribution.kind == "logarithm":
        return centre * jnp.exp(distribution.spread * z)
    return centre + distribution.spread * (2 * jax.scipy.special.ndtr(z) - 1)


def staged(units: Iterable[Unit], control: Control) -> tuple[Timed, ...]:
    """The units in which something is decided or measured over time, in order."""
    by_name = {name for name, _ in control.steps}
    by_name |= {measurement.state.partition(".")[0] for measurement in control.measurements}
    by_name |= {item.input.partition(".")[0] for item in control.manipulated}
    return tuple(entry for entry in timed(units) if entry.name in by_name)


def decided(units: Iterable[Unit], control: Control, stage: str) -> tuple[int, ...]:
    """Indices of the `Manipulated` of a stage's unit, or (for "") of all other units."""
    names = {entry.name for entry in staged(units, control)}

    def unit_of(item: Manipulated) -> str:
        name = item.input.partition(".")[0]
        return name if name in names else ""

    return tuple(i for i, m in enumerate(control.manipulated) if unit_of(m) == stage)


@dataclass(frozen=True, eq=False)
class LoopRecord:
    """The part of a case that determines a closed loop: the flowsheet, the decisions, the limits,
    and how batches differ."""

    flowsheet: Flowsheet
    control: Control
    attributes: tuple[Attribute, ...]
    varied: Varied

    @classmethod
    def of(cls, case: PharmaCase) -> Self:
        """The record of a case, without data that only reports and rules need, and without the
        steps of units that have a stage."""
        assert case.control is not None
        local = [unit.name for unit in staged(case.units, case.control)]
        held = {name: x for name, x in case.numerics.held.items() if name not in local}
        return cls(
            replace(case.flowsheet, numerics=replace(case.numerics, held=held)),
            replace(case.control, rules=()),
            tuple(replace(attribute, unit="", citation="") for attribute in case.attributes),
            varied(case),
        )
