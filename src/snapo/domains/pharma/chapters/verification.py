"""The checks of the numbers: balances, convergence, adjoint against differences."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from snapo.report.folder import RunFiles
from snapo.report.page import Block, Mark, Missing, Section, Table, Text
from snapo.report.quantity import finite, number, power
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..derivatives.certify import certify
from ..derivatives.convergence import (
    Cells,
    Convergence,
    ConvergenceRow,
    convergence,
    on_finer_cells,
)
from ..flowsheet.flow import leaving, sources
from ..flowsheet.process import PharmaProcess
from ..flowsheet.stream import Ledger, Stream
from ..quality.design_space import in_case_unit
from ..shared import SOUND, open_loop, process
from .attribution import ATTRIBUTION
from .batch import ONE_BATCH
from .model import stated

CLOSED = 1e-10  # relative gap of a balance


@dataclass(frozen=True)
class Balance:
    """One balance of one batch.

    - `quantity`: "mass" in kg, or a species in kmol: `inflow` includes seed, and `made` is by
      reactions, negative if they use it (for mass, the error of rounded molar masses). "solvent" is
      in kg, with anti-solvent and wash liquid. "energy" is in J, the sensible heat above 0 K plus
      the latent heat of vapour; `inflow` includes the heat of reaction.
    - `accumulation`: includes material that has not entered the unit. This cannot be negative, so
      the balance of a unit that takes more than its feed does not close.
    - `relative`: (inflow + made - outflow - accumulation) divided by the largest of these; 0 if all
      are 0.
    """

    unit: str
    quantity: str
    inflow: Number
    made: Number
    outflow: Number
    accumulation: Number
    relative: Number


def balances(process: PharmaProcess, inputs=None) -> list[Balance]:
    """The balances of every unit except tests of the product, and of the whole flowsheet as
    "process"."""
    case, batch = process.case, process.run(inputs)
    streams, ledgers = batch.streams, batch.ledgers
    fed, results = sources(case.flowsheet), []
    for unit in case.units:
        out = [streams[f"{unit.name}.{port}"] for port in unit.outlets]
        if out:
            into = [streams[name] for name in fed[unit.name]]
            results += unit_balances(process, unit.name, into, out, [ledgers[unit.name]])
    into = [streams[feed.name] for feed in case.feeds]
    out = [streams[name] for name in leaving(case.flowsheet)]
    return results + unit_balances(process, "process", into, out, list(ledgers.values()))


def unit_balances(
    process: PharmaProcess, name: str, into, out, ledgers: list[Ledger]
) -> list[Balance]:
    """The balances of the units with these `ledgers`, between the streams into and out of them."""
    network = process.case.network
    made = np.sum([ledger.made for ledger in ledgers], axis=0)
    added = np.sum([item.added for item in ledgers], axis=0)
    held = np.sum([entry.held + np.maximum(entry.left, 0.0) for entry in ledgers], axis=0)
    liquid = sum(value.solvent_added for value in ledgers)
    selected = sum(max(float(each.solvent_left), 0.0) for each in ledgers)
    fed, left = _species(into) + added, _species(out)
    solvent_in, solvent_out = _solvent(into) + liquid, _solvent(out)
    results = [
        _balance(
            name,
            "mass",
            network.molar_mass @ fed + solvent_in,
            network.molar_mass @ left + solvent_out,
            network.molar_mass @ held + selected,
            network.molar_mass @ made,
        )
    ]
    for s, species in enumerate(network.species):
        results.append(_balance(name, species, fed[s], left[s], held[s], made[s]))
    results.append(_balance(name, "solvent", solvent_in, solvent_out, selected))
    if name != "process" and ledgers[0].energy is not None:
        results.append(_balance(name, "energy", *ledgers[0].energy))
    return results


def _balance(unit: str, quantity: str, inflow, outflow, accumulation, made=0.0) -> Balance:
    gap = inflow + made - outflow - accumulation
    size = max(map(abs, (inflow, made, outflow, accumulation)))
    relative = float(gap / size) if size != 0 else 0.0
    stays = float(accumulation)
    return Balance(unit, quantity, float(inflow), float(made), float(outflow), stays, relative)


def _species(streams: Iterable[Stream]) -> np.ndarray:
    """[S] kmol dissolved and in crystals."""
    return np.sum([stream.species + stream.solid for stream in streams], axis=0)


def _solvent(streams: Iterable[Stream]) -> float:
    return sum(float(stream.solvent + stream.antisolvent) for stream in streams)


@dataclass(frozen=True)
class CheckedPoint:
    """A point of operation: the largest gap of the adjoint, and the attribute and parameter of it.

    - `at`: values of the parameters. `kinks`: entries whose one-sided derivatives differ.
    """

    point: str
    at: tuple[Number, ...]
    worst: Number
    attribute: str
    parameter: str
    kinks: int
    passed: bool


def closed(balance: Balance) -> bool:
    """Whether a balance closes; a NaN does not close."""
    return balance.quantity == "energy" or abs(balance.relative) <= CLOSED


def largest_gap(row: ConvergenceRow) -> float:
    """The larger gap of a row; NaN counts as the largest."""
    gaps = (row.halving_gap, row.adaptive_gap)
    return max(math.inf if math.isnan(gap) else abs(gap) for gap in gaps)


def examine(run: StudyRun) -> Convergence:
    """The convergence in time, and on cells along a length and over sizes if there are any."""
    complete = process(run)
    return replace(convergence(complete), cells=on_finer_cells(complete))


def check_points(run: StudyRun) -> tuple[CheckedPoint, ...]:
    """The adjoint against differences."""
    complete, rows = process(run), []
    names = [attribute.name for attribute in complete.case.attributes]
    parameters = complete.case.parameters
    for i, checked in enumerate(certify(complete, open_loop(run).seed)):
        worst = np.unravel_index(int(checked.error.argmax()), checked.error.shape)
        rows.append(
            CheckedPoint(
                point="set point" if i == 0 else f"random point {i}",
                at=tuple(float(in_case_unit(p, x)) for p, x in zip(parameters, checked.point)),
                worst=float(checked.error.max()), attribute=names[int(worst[0])],
                parameter=parameters[int(worst[1])].name, kinks=int(checked.kink.sum()),
                passed=checked.passed,
            )
        )  # fmt: skip
    return tuple(rows)


def _balances(run: RunFiles, result: tuple[Balance, ...]) -> list[Block]:
    rows = [
        (
            x.unit, x.quantity, Mark(closed(x), "closes" if closed(x) else "open"),
            number(x.inflow), number(_made(x)), number(x.outflow), number(x.accumulation),
            power(abs(x.relative)),
        )
        for x in result
    ]  # fmt: skip
    names = ("Unit", "Balance of", "", "In", "Produced", "Out", "Left in unit", "Relative gap")
    caption = (
        "Balances of one batch: mass and solvent in kg, species in kmol, energy in J. “Produced” "
        "is by reactions, and below 0 if they consume a species; for mass it is the error of "
        "rounded molar masses"
    )
    return [Table([(name, "") for name in names], rows, caption, 3)]


def _made(balance: Balance) -> float:
    """The produced amount; round-off counts as zero."""
    through = max(abs(balance.inflow), abs(balance.outflow))
    return balance.made if abs(balance.made) > 1e-12 * through else 0.0


def _convergence(run: RunFiles, result: Convergence) -> list[Block]:
    rows, numerics = result.rows, stated(run).numerics
    if not rows:
        return [Missing("Convergence in time was not examined in this run.")]
    worst = max(finite(abs(row.halving_gap)) or 0.0 for row in rows)
    other = max(finite(abs(row.adaptive_gap)) or 0.0 for row in rows)
    cells = [
        (
            x.attribute, x.parameter, *map(number, (x.mesh, x.finer, x.adaptive)),
            power(x.halving_gap), power(x.adaptive_gap),
        )
        for x in rows
    ]  # fmt: skip
    controlled = numerics is not None and numerics.method == "adaptive"
    finer = "A tenth of the tolerance" if controlled else "Twice the steps"
    names = ("Attribute", "Parameter", "As in this run", finer, "Error-controlled", "Finer gap",
             "Adaptive gap")  # fmt: skip
    text = (
        f"With {finer.lower()} no value or derivative changes by more "
        f"than {power(worst)} (values relative to themselves, "
        "derivatives to the largest of their attribute); the "
        f"error-controlled solution differs by at most {power(other)}."
    )
    head = [(name, "") for name in names]
    caption = "Values and derivatives, computed in three ways"
    table = Table(head, cells, caption, 2, folded="Every number")
    return [Text(text), table, *_cells(result.cells)]


def _cells(cells: tuple[Cells, ...]) -> list[Block]:
    if not cells:
        return []
    rows = [
        (
            x.attribute, Mark(x.passed, "within its margin" if x.passed else "beyond it"),
            number(x.value), number(x.finer), number(x.margins),
        )
        for x in cells
    ]  # fmt: skip
    names = ("Attribute", "", "Value", "Twice the cells", "Change in margins")
    caption = "Attributes on twice as many cells along tubes and over the sizes of crystals"
    return [Table([(name, "") for name in names], rows, caption, 2)]


def _certificate(run: RunFiles, result: tuple[CheckedPoint, ...]) -> list[Block]:
    rows = [
        (
            x.point, Mark(x.passed, "agrees" if x.passed else "differs"),
            f"{x.attribute}, {x.parameter}", number(x.kinks, 0), power(x.worst),
        )
        for x in result
    ]  # fmt: skip
    names = ("Point", "", "Worst entry", "Kinks", "Gap")
    caption = (
        "Adjoint against fourth-order central differences, for every attribute and parameter. The "
        "gap is relative to the largest derivative of the attribute; at a kink the two one-sided "
        "derivatives differ"
    )
    return [Table([(name, "") for name in names], rows, caption, 3)]


BALANCES = Chapter(
    "balances", "Balances", tuple[Balance, ...], lambda run: tuple(balances(process(run))),
    _balances, needs=(SOUND,), key="balances"
)  # fmt: skip
CONVERGENCE = Chapter(
    "convergence", "Convergence", Convergence, examine, _convergence, needs=(SOUND,),
    key="convergence"
)  # fmt: skip
DIFFERENCES = Chapter(
    "certificate", "Certificate", tuple[CheckedPoint, ...], check_points, _certificate,
    needs=(SOUND,), key="certificate"
)  # fmt: skip


def verification(run: RunFiles) -> Section:
    """Every check of this run."""
    batch, attribution = ONE_BATCH.of(run), ATTRIBUTION.of(run)
    loops = [
        Text(
            f"The loop {x.loop} is at its steady state: after {x.rounds} rounds of Newton's "
            f"method, one more iteration changes its tear streams by {power(x.change)} of their "
            "size."
        )
        for x in (batch.loops if batch else ())
        if x.change is not None
    ]
    first, *others = (part(run).blocks for part in (BALANCES, CONVERGENCE, DIFFERENCES))
    blocks: list[Block] = [*first, *loops, *chain(*others)]
    if attribution is not None and finite(attribution.closure) is not None:
        blocks.append(
            Text(
                "Sensitivities assembled from the derivatives of the units along every path agree "
                "with those of the whole flowsheet to "
                f"{power(attribution.closure)} of the largest of their attribute."
            )
        )
    return Section("verification", "Verification", "Verification", blocks)
