"""Further derivatives: by path through the flowsheet, over time, of second order.

By the chain rule a derivative is a sum over all paths through the flowsheet; the term of a path is
the product of the derivatives of its units. The sum must equal the result of the adjoint, which
checks both.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.report.drawing import draw
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Chart, Missing, Table
from snapo.report.quantity import number, with_unit
from snapo.study.chapter import Chapter, Floats, Number
from snapo.study.study import Part, StudyRun

from ..derivatives.jacobian import matrix, second
from ..derivatives.local import DerivativeBlock, Local, local
from ..flowsheet.case import PharmaCase
from ..flowsheet.process import PharmaProcess
from ..given import Entry
from ..quality import design_space
from ..quality.records import Attribute, Parameter
from ..shared import SOUND, process
from ..time.profile import Profile
from . import pictures
from .model import stated
from .sensitivities import MATRIX


class Path(NamedTuple):
    """A path through the flowsheet, from the unit in which the parameter acts to the unit in which
    the attribute is measured, and its contribution, in the case's units."""

    units: tuple[str, ...]
    value: float


class Split(NamedTuple):
    """`paths`: {(attribute, parameter): paths}; without an entry the two are not connected.

    `closure`: [Q, P] |sum of paths - matrix| divided by the largest entry of the matrix's row.
    """

    paths: dict[tuple[str, str], tuple[Path, ...]]
    closure: np.ndarray


def split(case: PharmaCase, blocks: Local, raw: np.ndarray) -> Split:
    """Every entry of `raw` [Q, P], in the case's units, as a sum over paths."""
    table: dict[tuple[str, str], tuple[Path, ...]] = {}
    total = np.zeros(raw.shape)
    for q, attribute in enumerate(case.attributes):
        for p, parameter in enumerate(case.parameters):
            every = _paths(blocks.units, attribute, parameter)
            ways = tuple(path for path in every if path.value != 0)
            if ways:
                table[attribute.name, parameter.name] = ways
                total[q, p] = sum(key_path.value for key_path in ways)
    largest = np.abs(raw).max(1, keepdims=True)
    closure = np.abs(total - raw) / np.where(largest > 0, largest, 1.0)
    return Split(table, closure)


def _paths(
    units: dict[str, DerivativeBlock], attribute: Attribute, parameter: Parameter
) -> Iterator[Path]:
    end = next(name for name, unit in units.items() if attribute.measure in unit.measures)
    row = units[end].measures.index(attribute.measure)
    entry: Entry = (parameter.input, parameter.entry)
    scale = attribute.scale * parameter.scale
    for start, block in units.items():
        if entry not in block.entries:
            continue
        column = block.entries.index(entry)
        if start == end:
            yield Path((start,), float(scale * block.measure_by_entry[row, column]))
        outlets = block.stream_by_entry[:, :, column]
        for path, value in _onward(units, start, outlets, end, row):
            yield Path((start, *path), float(scale * value))


def _onward(
    units: dict[str, DerivativeBlock], here: str, changes: np.ndarray, end: str, row: int
) -> Iterator[tuple[tuple[str, ...], float]]:
    """Ways from the outlets of `here`, which change by `changes` [outlets, K], to the measure."""
    for name, block in units.items():
        inlets = [
            (units[here].outlets.index(stream), i)
            for i, stream in enumerate(block.inlets)
            if stream in units[here].outlets
        ]
        if not inlets or not any(changes[outlet].any() for outlet, _ in inlets):
            continue
        if name == end:
            value = sum(block.measure[row, i] @ changes[outlet] for outlet, i in inlets)
            yield (name,), float(value)
        further = sum(block.stream[:, :, i] @ changes[outlet] for outlet, i in inlets)
        if np.any(further):
            for path, value in _onward(units, name, np.asarray(further), end, row):
                yield (name, *path), value


def by_unit(case: PharmaCase, result: Split) -> dict[tuple[str, str], float]:
    """The importance of every unit for every attribute: {(unit where parameters act, attribute):
    root of the sum of squares of the effects of these parameters over half their normal ranges}."""
    half = {item.name: (item.normal_high - item.normal_low) / 2 / item.scale
            for item in case.parameters}  # fmt: skip
    squares: dict[tuple[str, str], float] = {}
    for (attribute, parameter), ways in result.paths.items():
        for start in dict.fromkeys(path.units[0] for path in ways):
            value = sum(key_path.value for key_path in ways if key_path.units[0] == start)
            key = (start, attribute)
            squares[key] = squares.get(key, 0.0) + (value * half[parameter]) ** 2
    return {key: float(np.sqrt(value)) for key, value in squares.items()}


NODES = 61  # of a profile whose sensitivity over time is shown


def with_nodes(case: PharmaCase, name: str, count: int) -> PharmaCase:
    """The case with `count` evenly spaced nodes in the linear profile "unit.temperature".

    The profile is unchanged if its old nodes are among the new ones; otherwise it is interpolated.
    Parameters that are entries of the profile are omitted, since its nodes have changed.
    """
    user, _, field = name.partition(".")
    unit = next(item for item in case.units if item.name == user)
    profile = getattr(unit, field)
    if not isinstance(profile, Profile) or profile.kind != "linear":
        raise ValueError(f"with_nodes: {name} is not a piecewise linear profile.")
    share = np.linspace(0.0, 1.0, count)
    values = np.interp(share, profile.share, profile.value.used())
    labels = tuple(f"{entry:.4g}" for entry in share)
    inputs = CaseInput(profile.value.name, values, labels, profile.value.unit, np.arange(count))
    finer = replace(unit, **{field: replace(profile, share=share, value=inputs)})
    return replace(
        case,
        units=tuple(finer if value is unit else value for value in case.units),
        parameters=tuple(each for each in case.parameters if each.input != name),
        pairs=(),
        design_space=None,
        control=None,
    )


@dataclass(frozen=True)
class PathShare:
    """The effect of a parameter on an attribute along one path through the units."""

    attribute: str
    parameter: str
    units: tuple[str, ...]
    value: Number


@dataclass(frozen=True)
class UnitEffect:
    """The effect of the parameters of a unit on an attribute, over half their normal ranges."""

    unit: str
    attribute: str
    value: Number


@dataclass(frozen=True)
class Attributions:
    """Every sensitivity by path; `closure`: the gap between the sums of paths and the matrix."""

    closure: Number
    paths: tuple[PathShare, ...]
    by_unit: tuple[UnitEffect, ...]


def measure(run: StudyRun) -> Attributions:
    """Every sensitivity of the matrix by path, and the check that the paths add up."""
    complete, available = process(run), MATRIX.of(run)
    assert available is not None
    splits = split(complete.case, local(complete), available.raw)
    effects = by_unit(complete.case, splits)
    return Attributions(
        closure=float(splits.closure.max()),
        paths=tuple(
            PathShare(*names, path.units, path.value)
            for names, ways in splits.paths.items()
            for path in ways
        ),
        by_unit=tuple(UnitEffect(*names, value) for names, value in effects.items()),
    )


def show(run: RunFiles, result: Attributions) -> list[Block]:
    """The attributes that each unit affects, and every path."""
    if not result.paths:
        return [Missing("The attribution was not computed in this run.")]
    rows = [(x.attribute, x.parameter, " → ".join(x.units), number(x.value)) for x in result.paths]
    head = [("Attribute", ""), ("Parameter", ""), ("Path", ""), ("Contribution", "per unit")]
    caption = "The contributions of all paths add up to the entry of the sensitivity matrix"
    paths = Table(head, rows, caption, 3, folded="Every path")
    return [_by_unit(run, result), paths]


def _by_unit(run: RunFiles, result: Attributions) -> Table:
    units = list(dict.fromkeys(effect.unit for effect in result.by_unit))
    values = {(x.unit, x.attribute): x.value for x in result.by_unit}
    rows = [
        (
            with_unit(x.name, x.shown_unit),
            *(number(values.get((unit, x.name), 0.0)) for unit in units),
        )
        for x in stated(run).attributes
    ]
    caption = (
        "Effect of the parameters of every unit on every attribute: root of the sum of squares of "
        "the changes over half their normal ranges"
    )
    return Table([("Attribute", ""), *((unit, "") for unit in units)], rows, caption)


ATTRIBUTION = Chapter(
    "attribution", "Attribution by unit and path", Attributions, measure, show,
    needs=(SOUND, MATRIX.name), key="attribution"
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class ProfileSlopes:
    """Derivatives with respect to the temperature of a unit over time, per K for ten minutes.

    `time` in s; `slope`: {attribute that the temperature affects: values}.
    """

    unit: str
    time: Floats
    temperature: Floats
    slope: dict[str, Floats]


def profile_slopes(case: PharmaCase) -> tuple[ProfileSlopes, ...]:
    """One adjoint pass for each attribute.

    The profile is computed with many nodes; the derivative with respect to a node is divided by the
    time that the node represents.
    """
    rows = []
    for unit in case.units:
        name = f"{unit.name}.temperature"
        profile = next((x for x in unit.profiles if x.value.name == name), None)
        if unit.time is None or profile is None or profile.kind != "linear":
            continue
        fine = PharmaProcess(with_nodes(case, name, NODES))
        share = np.linspace(0, 1, NODES)
        duration = float(unit.time.values[0])
        weight = np.gradient(share) * duration
        weight[[0, -1]] /= 2
        slopes = matrix(fine, entries=tuple((name, i) for i in range(NODES))).jacobian
        rows.append(
            ProfileSlopes(
                unit=unit.name,
                time=share * duration,
                temperature=np.interp(share, profile.share, profile.value.used()),
                slope={x: s / weight * 600 for x, s in zip(fine.names, slopes) if s.any()},
            )
        )
    return tuple(rows)


def _profiles(run: RunFiles, result: tuple[ProfileSlopes, ...]) -> list[Block]:
    """Temperature over time, and the effect of one kelvin for ten minutes on each attribute."""
    if not result:
        text = "No unit has a temperature profile of several nodes, or this part was not computed."
        return [Missing(text)]
    return [_profile(run, slopes) for slopes in result]


def _profile(run: RunFiles, result: ProfileSlopes) -> Chart:
    minutes = result.time / 60
    units = {x.name: x.shown_unit for x in stated(run).attributes}

    def paint(top, *below):
        line = [("Temperature", result.temperature)]
        pictures.curves(top, minutes, line, f"Temperature of the {result.unit}, K")
        for axes, (name, values) in zip(below, result.slope.items()):
            unit = f"{name}: {units.get(name, '')} per K held for 10 min"
            pictures.curves(axes, minutes, [(name, values)], unit, zero=True)
        (below[-1] if below else top).set_xlabel("Time, min")

    count = len(result.slope)
    svg = draw(f"profile-{result.unit}", "Temperature profile, and the derivative of each "
               "attribute with respect to it at each time.", paint, 120 + 105 * count,
               [1.3, *[1.0] * count])  # fmt: skip
    caption = (
        "The effect on each attribute of raising the temperature by one kelvin for ten minutes "
        "around a time: one adjoint pass per attribute gives the whole curve."
    )
    return Chart(svg, caption)


PROFILES = Chapter(
    "profile sensitivities", "Profiles and their sensitivity over time", tuple[ProfileSlopes, ...],
    lambda run: profile_slopes(process(run).case), _profiles, "Profiles", needs=(SOUND,),
    key="profiles"
)  # fmt: skip


def second_derivatives(run: StudyRun) -> dict[str, Any]:
    """The second derivatives of every attribute for the pairs of parameters in the case's `pairs`,
    in the case's units."""
    complete, case = process(run), process(run).case
    pairs = [
        (design_space.parameter(case, a), design_space.parameter(case, b)) for a, b in case.pairs
    ]
    rows = second(complete, tuple(((a.input, a.entry), (b.input, b.entry)) for a, b in pairs))
    both = zip(case.pairs, pairs, rows)
    return {"second": [{"pair": n, "values": x * a.scale * b.scale} for n, (a, b), x in both]}


SECOND = Part("second derivatives", second_derivatives, (SOUND,))
