"""Quality by design as tables of plain data: capability, design space, ranges, estimation."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..derivatives import sensitivities
from ..flowsheet.case import PharmaCase
from ..flowsheet.process import Process
from ..given import every_given
from ..quality import batches, design_space, estimation, pairs, ranges, validation
from ..quality.capability import capability
from ..quality.limits import Limits
from ..quality.records import Parameter
from ..read.entries import Numbers
from ..recipe import optimise

if TYPE_CHECKING:
    from ..flowsheet.process import Process

DRAWS, LEVELS = 64, (0.05, 0.95)


class Criticality(NamedTuple):
    """[Q, P]: half the `change` of an attribute as a parameter goes from the lower to the upper end
    of its normal range, by the nominal model, in the attribute's unit.

    - `low`, `high`: 5 % and 95 % of it over the variation that the case states.
    - `share`, `share_low`, `share_high`: of the room to the nearest limit at the set point, the
      size of the change; NaN without a limit, infinite on or beyond it.
    """

    change: np.ndarray
    low: np.ndarray
    high: np.ndarray
    share: np.ndarray
    share_low: np.ndarray
    share_high: np.ndarray


def criticality(process: "Process", seed: int, draws: int = DRAWS) -> Criticality:
    """Every parameter moved over its normal range: the nominal batch, and the same drawn ones."""
    case = process.case
    entries = batches.varied(case)
    here = batches.nominally(process, {})
    base = np.concatenate([here, batches.drawn(process, {}, draws, seed)])
    rows = []
    for each in case.parameters:
        column = entries.index((each.input, each.entry))
        for end in (each.normal_low, each.normal_high):
            moved = base.copy()
            moved[:, column] += end - here[0, column]
            rows.append(moved)
    values = batches.attributes(process, np.concatenate([here, *rows]))
    room = Limits.of(case).distance(values[0])[:, None]
    ends = values[1:].reshape(len(case.parameters), 2, 1 + draws, -1)
    half = (ends[:, 1] - ends[:, 0]).transpose(1, 2, 0) / 2  # draws, attributes, parameters
    low, high = np.nanquantile(half[1:], LEVELS, axis=0)
    sizes = np.stack([np.abs(half[0]), *np.nanquantile(np.abs(half[1:]), LEVELS, axis=0)])
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(room > 0, sizes / room, np.where(sizes > 0, np.inf, 0.0))
    shares = np.where(Limits.of(case).any()[:, None], shares, np.nan)
    return Criticality(half[0], low, high, *shares)


BATCHES, RANGE_SAMPLES = 4096, 128


def capability_rows(process: Process, seed: int) -> dict[str, Any]:
    """Spread, Cpk and shares out of specification, over fresh batches."""
    count = min(process.case.evaluation.paths, BATCHES)
    return capability(process, count, seed)._asdict()


def criticality_rows(process: Process, seed: int) -> dict[str, Any]:
    """Which parameter moves which attribute, by how much of its room, with intervals."""
    return criticality(process, seed)._asdict() | {"draws": DRAWS}


def spread_rows(case: PharmaCase, matrix: dict[str, Any]) -> dict[str, Any]:
    """Where the spread comes from, to first order, to stand beside the drawn batches."""
    return sensitivities.spread(case, np.asarray(matrix["varied"]))._asdict()


def best_recipe(process: Process, sampled: Process, seed: int) -> dict[str, Any]:
    """The recipe that `[optimise]` asks for; `sampled` measures its chance to keep all limits."""
    return optimise.table(sampled, optimise.optimise(process, seed), seed + 2)


def map_tables(process: Process, seed: int) -> dict[str, Any]:
    """The map, its sampling error and binding attribute, and the largest box inside."""
    case = process.case
    found = design_space.probability_map(process, seed)
    space = case.design_space
    assert space is not None
    chosen = [design_space.parameter(case, name) for name in space.axes]
    here = [float(design_space.owners(p, ranges.set_point(process, p))) for p in chosen]
    box = design_space.largest_box(found, here, space.required)
    return {
        "axes": list(found.axes),
        "units": [each.unit for each in chosen],
        "grid": list(found.grid),
        **found.at._asdict(),
        "samples": found.samples,
        "levels": list(space.levels),
        "required": space.required,
        "nominal": here,
        "normal": [
            [design_space.owners(p, p.normal_low), design_space.owners(p, p.normal_high)]
            for p in chosen
        ],
        "box": None if box is None else box._asdict(),
        "ends": [each._asdict() for each in found.ends],
    }


def range_rows(process: Process, seed: int) -> list[dict[str, Any]]:
    """Both proven ranges of every parameter that the designer may choose."""
    space = process.case.design_space
    assert space is not None
    found = ranges.proven_ranges(process, space.required, RANGE_SAMPLES, seed)
    return [
        {
            "parameter": each.parameter, "unit": each.unit, "required": space.required,
            "samples": RANGE_SAMPLES, "nominal": each.nominal._asdict(),
            "probable": each.probable._asdict(),
        }
        for each in found
    ]  # fmt: skip


def pair_rows(process: Process, found: Sequence[dict[str, Any]], seed: int) -> list[dict[str, Any]]:
    """The proven ranges of every two parameters at once; `found`: the rows of `range_rows`."""
    space = process.case.design_space
    assert space is not None
    own = {each.name: each for each in process.case.parameters}

    def ends(which: str) -> dict[str, tuple[float, float] | None]:
        return {each["parameter"]: _domain(own[each["parameter"]], each[which]) for each in found}

    rows = pairs.pairs(
        process, ends("nominal"), ends("probable"), space.required, RANGE_SAMPLES, seed
    )
    return [
        each._asdict() | {
            "nominal": None if each.nominal is None else each.nominal._asdict(),
            "probable": None if each.probable is None else each.probable._asdict(),
        }
        for each in rows
    ]  # fmt: skip


def _domain(parameter: Parameter, found: dict[str, Any]) -> tuple[float, float] | None:
    """The ends of a range in the domain's unit; None where the set point itself fails."""
    if found["low"] is None:
        return None
    low, high = (parameter.scale * found[end] + parameter.offset for end in ("low", "high"))
    return low, high


def estimation_rows(process: Process) -> dict[str, Any]:
    given = process.case.estimation
    assert given is not None
    found = estimation.fit(process, given)
    start = [process.inputs[name][entry] for name, entry in zip(given.inputs, given.entries)]
    scales = np.array([scale for each in given.experiments for scale in each.scales])
    own = {
        f"{key}_own": (np.asarray(x) - scales[:, 1]) / scales[:, 0]
        for key, x in (("measured", found.measured), ("fitted", found.fitted))
    }
    checked = validation.validate(process, given, found)
    seen = None
    if checked is not None:
        seen = checked._asdict() | {"batches": [each._asdict() for each in checked.batches]}
    return {
        **found._asdict(), **own, "start": start, "level": given.level,
        "validation": seen, "errors": given.errors,
        "units": list(given.units), "scales": [list(each) for each in given.scales],
        "state": [state for each in given.experiments for state in each.state],
        "state_unit": [unit for each in given.experiments for unit in each.units],
        "time": np.concatenate([each.time for each in given.experiments]),
        "experiment": [each.name for each in given.experiments for _ in each.time],
    }  # fmt: skip


def not_handed_on(found: dict[str, Any]) -> list[str]:
    """Why the numbers of a fit are not handed on with their covariance, in sentences."""
    said = [] if found["converged"] else [f"The fit did not converge: {found['message']}."]
    said += [f"{each[:1].upper()}{each[1:]}." for each in found["unidentified"]]
    for name, bound in zip(found["names"], found["at_bound"]):
        if bound:
            end = "lower" if bound == "low" else "upper"
            said.append(
                f"{name} is at its {end} bound, and chi² would fall beyond it; its interval is "
                "one-sided, and those of the others hold it there."
            )
    for numbers, size in zip(found["minima"], found["minima_chi2"]):
        each = ", ".join(f"{name} {x:.6g}" for name, x in zip(found["names"], numbers))
        said.append(
            f"Other numbers, far from the fitted ones, fit as well (chi² {size:.4g}): {each}, in "
            "the units of the domain; bounds that leave one of them out, or data that differ, tell."
        )
    return said


def fitted_rows(case: PharmaCase, found: dict[str, Any]) -> list[tuple]:
    """Rows of `fitted.csv`, which a case may name under `fitted`; none where the fit is not one."""
    given = case.estimation
    if given is None or not_handed_on(found):
        return []
    known = every_given((case.network, case.feeds, case.units))
    numbers = Numbers({each.name: each for each in known}, case.network)
    deviation = np.sqrt(np.diag(np.asarray(found["covariance"], float)))
    rows = []
    for i, entry in enumerate(zip(given.inputs, given.entries)):
        unit = numbers.unit(*entry)
        own = "" if unit == "1" else f" {unit}"
        log = given.logarithm[i]
        size = f"{float(deviation[i])!r}{'' if log else own}"
        correlation = " ".join(repr(float(x)) for x in found["correlation"][i])
        value = f"{float(found['values'][i])!r}{own}"
        rows.append((found["names"][i], value, "true" if log else "false", size, correlation))
    return rows


def space_rows(
    found: dict[str, Any], attributes: Sequence[str]
) -> tuple[tuple[str, ...], Iterable[tuple]]:
    """Header and rows of `design_space.csv`: one row per point of the map."""
    grid = [x.ravel() for x in np.meshgrid(*found["grid"], indexing="ij")]
    names = tuple(f"{name} [{unit}]" for name, unit in zip(found["axes"], found["units"]))
    numbers = ("probability", "error", "low", "high")
    every = (*map(_places, grid), *(np.ravel(found[key]) for key in numbers))
    columns = [each.tolist() for each in every]
    which = [attributes[i] if i >= 0 else "" for i in np.ravel(found["binding"]).tolist()]
    header = (*names, "probability", "standard_error", "low", "high", "binding")
    return header, zip(*columns, which)


def _places(values) -> np.ndarray:
    """Places on the axes of the map to ten significant digits, which leaves out round-off."""
    return np.array([float(f"{x:.10g}") for x in values])


def boundary_rows(
    found: dict[str, Any], attributes: Sequence[str]
) -> tuple[tuple[str, ...], Iterable[tuple]]:
    """Header and rows of `design_space_boundary.csv`: one row for every end of the space."""
    names = [f"{name} [{unit}]" for name, unit in zip(found["axes"], found["units"])]
    rows = []
    for end in found["ends"]:
        at = [grid[i] if i >= 0 else end["place"] for grid, i in zip(found["grid"], end["at"])]
        side = "above" if end["side"] > 0 else "below"
        number = (end["place"], end["inner"], end["outer"])
        at, number = _places(at).tolist(), _places(number).tolist()
        rows.append((*at, names[end["axis"]], side, *number, attributes[end["binding"]]))
    return (*names, "along", "ends", "boundary", "inner", "outer", "binding"), rows
