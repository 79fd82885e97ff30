"""One batch at the set point: attributes, measures, and the trajectory of every unit."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from snapo.report.drawing import draw
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Chart, Missing, Table
from snapo.report.quantity import finite, number, power, unit_words
from snapo.study.chapter import Chapter, Floats, Number
from snapo.study.study import StudyRun

from ..flowsheet.case import PharmaCase
from ..flowsheet.process import ProcessRun
from ..quality.batches import AttributeLimits
from ..setpoints import HEADER, setpoints
from ..shared import BATCH, open_loop
from . import pictures
from .model import UnitStatement, location, stated

SHOWN = 240  # points of a trajectory that a report shows
LARGE = 1e7
# States of reactors, crystallisers and dryers, which have separate sections.
ELSEWHERE = ("supersaturation", "solvent")
Course = dict[str, np.ndarray]  # of a unit: "time", and its states by name
PROFILE, SETPOINTS = "profile.csv", "setpoints.csv"


@dataclass(frozen=True)
class TornLoop:
    """A recycle: the relative `change` of its tear streams in iteration `rounds` + 1 of the
    loop."""

    loop: str
    change: float | None
    rounds: int


@dataclass(frozen=True, eq=False)
class BatchResult:
    """One batch; `status`: "ok", or why there is no batch.

    - `attributes`: values by name; `holds`, `distance` [Q]: whether each is within its limits, and
      its distance to them, NaN without limits. `errors`: the largest error of a step in every unit
      with stiff steps.
    - `trajectories`: {unit: {"time" or a state: values}}; `solubility`: the solubility of every
      crystalliser.
    """

    status: str
    steps: int
    errors: dict[str, Number]
    loops: tuple[TornLoop, ...]
    attributes: dict[str, Number]
    holds: tuple[bool, ...]
    distance: Floats
    measures: dict[str, Number]
    trajectories: dict[str, dict[str, Floats]]
    solubility: dict[str, dict[str, Floats]]


def measure(run: StudyRun) -> BatchResult:
    """The batch, with its setpoints and its trajectory as separate tables."""
    loop = open_loop(run)
    batch = loop.process.run()
    result = one_batch(loop.process.case, batch)
    run.write_csv(SETPOINTS, HEADER, setpoints(loop.case))
    if batch.status == "ok":
        header = ("unit", "time_s", "state", "value", "state_unit")
        run.write_csv(PROFILE, header, _profile_rows(loop.case, result))
    return result


def one_batch(case: PharmaCase, batch: ProcessRun) -> BatchResult:
    """Attributes with their limits, measures, and thinned trajectories."""
    limits = AttributeLimits.of(case)
    values = np.array([batch.attributes.get(x.name, np.nan) for x in case.attributes])
    room = limits.distance(values)
    return BatchResult(
        status=batch.status, steps=case.numerics.steps, errors=dict(batch.errors),
        loops=tuple(TornLoop(name, *entries) for name, entries in batch.loops.items()),
        attributes={x.name: value for x, value in zip(case.attributes, values.tolist())},
        holds=tuple(limits.hold(values).tolist()),
        distance=np.where(np.isfinite(room), room, np.nan), measures=dict(batch.measures),
        trajectories={unit: _thin(table) for unit, table in batch.trajectories.items()},
        solubility=_solubility(case, batch),
    )  # fmt: skip


def _thin(table: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Points evenly spread over time; the mesh itself crowds around events."""
    time = np.asarray(table["time"], np.float64)
    even = np.linspace(time[0], time[-1], min(SHOWN, len(time)))
    return {"time": even} | {
        name: np.interp(even, time, np.asarray(column, np.float64))
        for name, column in table.items()
        if name != "time"
    }


def _solubility(case: PharmaCase, batch: ProcessRun) -> dict[str, dict[str, np.ndarray]]:
    """{unit: temperatures and c* on them}, from the states that were recorded."""
    curves = {}
    for unit in case.units:
        table = batch.trajectories.get(unit.name)
        if table is not None and {"concentration", "supersaturation"} <= set(table):
            c, s = np.asarray(table["concentration"]), np.asarray(table["supersaturation"])
            order = np.argsort(np.asarray(table["temperature"]), kind="stable")
            rows = order[:: max(1, len(order) // SHOWN)]
            curves[unit.name] = {
                "temperature": np.asarray(table["temperature"])[rows],
                "solubility": (c / (1 + s))[rows],
            }
    return curves


def _profile_rows(case: PharmaCase, result: BatchResult) -> Iterable[tuple]:
    """unit, time, state, value and its unit: trajectories in long form."""
    for unit in case.units:
        table = result.trajectories.get(unit.name, {})
        for state, state_unit in unit.states(case.network.species).items():
            for time, value in zip(table.get("time", ()), table.get(state, ())):
                yield unit.name, float(time), state, float(value), state_unit


def units(run: RunFiles, result: BatchResult) -> list[Block]:
    """All measures of one batch, and the trajectories of units that no other section shows."""
    case = stated(run)
    rows = [
        (unit.name, name, "" if of == "1" else unit_words(of),
         _value(result.measures.get(f"{unit.name}.{name}"), of))
        for unit in case.units
        for name, of in unit.measures.items()
    ]  # fmt: skip
    if not rows or not result.measures:
        return [Missing("No batch was computed, so the units have no measures.")]
    head = [("Unit", ""), ("Measure", ""), ("In", ""), ("Value", "")]
    caption = "Measures at the end of each unit, in the units of the computation"
    blocks: list[Block] = [Table(head, rows, caption, 3)]
    for unit in case.units:
        table = result.trajectories.get(unit.name)
        drawn = any(name in ELSEWHERE or name.startswith("concentration.") for name in unit.states)
        if table and not drawn:
            blocks.append(_states(unit, table))
    return blocks


def _value(value: float | None, unit: str) -> str:
    """Four significant digits, as in "2.097 × 10⁸" for a large number; five for a temperature."""
    if unit == "K":
        return location(value)
    return power(value, 3) if abs(finite(value) or 0.0) >= LARGE else number(value)


def _states(unit: UnitStatement, table: dict[str, np.ndarray]) -> Chart:
    """One panel for all states of the same unit of measure."""
    name, minutes = unit.name, table["time"] / 60
    panels: dict[str, list[tuple[str, np.ndarray]]] = {}
    for state, state_unit in unit.states.items():
        if state in table:
            panels.setdefault(state_unit, []).append((state, table[state]))

    def paint(*panel_axes):
        for axes, (state_unit, lines) in zip(panel_axes, panels.items()):
            state = lines[0][0] if len(lines) == 1 else ""
            label = ", ".join(filter(None, (state, unit_words(state_unit))))
            pictures.curves(axes, minutes, lines, label)
        panel_axes[-1].set_xlabel("Time, min")

    svg = draw(f"unit-{name}", f"States of {name} over time.", paint, 120 + 105 * len(panels),
               [1.0] * len(panels))  # fmt: skip
    return Chart(svg, f"{name}: its states over time, in the units of the computation.")


ONE_BATCH = Chapter(
    BATCH, "Every unit: results and profiles", BatchResult, measure, units, "Units", needs=(),
    key="run"
)  # fmt: skip


Charts = Callable[[str, Course, Course | None], list[Chart]]


def _over_time(charts: Charts, unit: str) -> Callable[[RunFiles, BatchResult], list[Block]]:
    """Charts of every unit: of its name, trajectory and solubility."""

    def show(run: RunFiles, result: BatchResult) -> list[Block]:
        blocks: list[Block] = []
        for name, trajectory in result.trajectories.items():
            blocks += charts(name, trajectory, result.solubility.get(name))
        return blocks or [Missing(f"This run has no trajectory of a {unit}.")]

    return show


def _reaction(unit: str, trajectory: Course, curve: Course | None) -> list[Chart]:
    """Concentrations over time, if the unit records them."""
    names = [name for name in trajectory if name.startswith("concentration.")]
    lines = [(name.partition(".")[2], trajectory[name]) for name in names]
    if not lines:
        return []

    def paint(axes):
        pictures.curves(axes, trajectory["time"] / 60, lines, "Concentration, mol/L")
        axes.set_xlabel("Time, min")

    svg = draw(f"reaction-{unit}", "Concentration of every species over time.", paint)
    return [Chart(svg, f"{unit}: every species over time.")]


def _crystals(unit: str, trajectory: Course, curve: Course | None) -> list[Chart]:
    """Crystallisation in the c-T plane, and supersaturation over time."""
    if curve is None:
        return []
    minutes, line = trajectory["time"] / 60, (curve["temperature"], curve["solubility"])

    def paint(axes):
        pictures.plane(axes, trajectory["temperature"], trajectory["concentration"], line)

    def paint_below(upper, lower):
        lines = [("S", trajectory["supersaturation"])]
        pictures.curves(upper, minutes, lines, "Supersaturation", True)
        names = [name for name in ("d43", "d32", "d10", "d50", "d90") if name in trajectory]
        sizes = [(name, 1e6 * trajectory[name]) for name in names]
        pictures.curves(lower, minutes, sizes, "Size, µm")
        pictures.minutes_below(upper, lower)

    alt = "Concentration over temperature above the solubility curve."
    svg = draw(f"plane-{unit}", alt, paint)
    caption = f"{unit}: the batch starts at the right and is cooled to the left."
    alt = "Supersaturation and size over time."
    below = draw(f"time-{unit}", alt, paint_below, 340, (1.0, 1.0))
    text = f"{unit}: supersaturation (c − c*)/c*, and mean sizes of all crystals"
    text += " with the quantiles d10, d50 and d90 by volume." if "d50" in trajectory else "."
    return [Chart(svg, caption), Chart(below, text)]


def _drying(unit: str, trajectory: Course, curve: Course | None) -> list[Chart]:
    """Moisture of the cake over time, and its temperature if it has a heat balance."""
    if "solvent" not in trajectory:
        return []
    minutes = trajectory["time"] / 60

    def paint(upper, lower):
        moisture = [("Solvent", 100 * trajectory["solvent"])]
        pictures.curves(upper, minutes, moisture, "Solvent, % of the crystals", True)
        lines = [("Cake", trajectory["temperature"])]
        lines += [("Shelf", trajectory["shelf"])] if "shelf" in trajectory else []
        pictures.curves(lower, minutes, lines, "Temperature, K")
        pictures.minutes_below(upper, lower)

    alt = "Moisture and temperature of the cake over time."
    svg = draw(f"drying-{unit}", alt, paint, 340, (1.0, 1.0))
    text = f"{unit}: mass of solvent per mass of crystals, and the temperature of the cake."
    return [Chart(svg, text)]


reactor = ONE_BATCH.section(
    "reaction", "Reaction over time", "Reaction", _over_time(_reaction, "reactor")
)
plane = ONE_BATCH.section(
    "plane", "Crystallisation in the c–T plane", "c–T plane", _over_time(_crystals, "crystalliser")
)
drying = ONE_BATCH.section("drying", "Drying over time", "Drying", _over_time(_drying, "dryer"))
