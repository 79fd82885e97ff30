"""One batch over time: profiles with the sensitivity to them, and the c-T plane."""

from typing import Any

import numpy as np

from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Missing, Section

from . import pictures
from .run import Run


def profiles(run: Run) -> Section:
    """Temperature over time, and the effect of one kelvin for ten minutes on each attribute."""
    title, short = "Profiles and their sensitivity over time", "Profiles"
    found = run.get("profiles")
    if not found:
        text = "No unit has a temperature profile of several nodes, or it was not differentiated."
        return Section("profiles", title, short, [Missing(text)])
    blocks: list[Block] = [_profile(run, each) for each in found]
    return Section("profiles", title, short, blocks)


def _profile(run: Run, found: dict[str, Any]) -> Chart:
    minutes = np.asarray(found["time"]) / 60
    units = {each["name"]: each["unit"] for each in run.attributes}
    slopes = {name: np.asarray(values, float) for name, values in found["slope"].items()}

    def paint(top, *below):
        line = [("Temperature", np.asarray(found["temperature"]))]
        pictures.curves(top, minutes, line, f"Temperature of the {found['unit']}, K")
        for axes, (name, values) in zip(below, slopes.items()):
            unit = f"{name}: {units.get(name, '')} per K held for 10 min"
            pictures.curves(axes, minutes, [(name, values)], unit, zero=True)
        (below[-1] if below else top).set_xlabel("Time, min")

    rows = [1.3, *[1.0] * len(slopes)]
    svg = draw(f"profile-{found['unit']}", "Temperature profile, and the derivative of each "
               "attribute by the temperature at each time.", paint, 120 + 105 * len(slopes),
               rows)  # fmt: skip
    caption = (
        "What raising the temperature by one kelvin for ten minutes around a time does to each "
        "attribute: one adjoint pass per attribute gives the whole curve."
    )
    return Chart(svg, caption)


def plane(run: Run) -> Section:
    """Crystallisation in the c-T plane, and supersaturation over time."""
    title, short = "Crystallisation in the c–T plane", "c–T plane"
    curves = run.get("run.solubility")
    if not curves:
        text = "No crystalliser's trajectory is in this run."
        return Section("plane", title, short, [Missing(text)])
    blocks: list[Block] = []
    for unit, curve in curves.items():
        path = {k: np.asarray(v, float) for k, v in run.get(f"run.trajectories.{unit}").items()}
        line = (np.asarray(curve["temperature"]), np.asarray(curve["solubility"]))

        def paint(axes, path=path, line=line):
            pictures.plane(axes, path["temperature"], path["concentration"], line)

        svg = draw(f"plane-{unit}", "Concentration over temperature above the solubility curve.",
                   paint)  # fmt: skip
        caption = f"{unit}: the batch starts at the right and is cooled to the left."
        blocks += [Chart(svg, caption), _over_time(unit, path)]
    return Section("plane", title, short, blocks)


def _over_time(unit: str, path: dict[str, np.ndarray]) -> Chart:
    minutes = path["time"] / 60

    def paint(upper, lower):
        pictures.curves(upper, minutes, [("S", path["supersaturation"])], "Supersaturation", True)
        names = [name for name in ("d43", "d32", "d10", "d50", "d90") if name in path]
        sizes = [(name, 1e6 * path[name]) for name in names]
        pictures.curves(lower, minutes, sizes, "Size, µm")
        pictures.minutes_below(upper, lower)

    svg = draw(f"time-{unit}", "Supersaturation and size over time.", paint, 340, (1.0, 1.0))
    text = f"{unit}: supersaturation (c − c*)/c* and sizes of all crystals"
    return Chart(svg, text + ("; d10, d50 and d90 by volume." if "d50" in path else "."))


def drying(run: Run) -> Section:
    """Moisture of the cake over time, and its temperature where that has a balance of its own."""
    title, short = "Drying over time", "Drying"
    blocks: list[Block] = []
    for unit, table in (run.get("run.trajectories") or {}).items():
        if "solvent" in table:
            path = {name: np.asarray(values, float) for name, values in table.items()}
            blocks.append(_drying(unit, path))
    if not blocks:
        blocks.append(Missing("No dryer's trajectory is in this run."))
    return Section("drying", title, short, blocks)


def _drying(unit: str, path: dict[str, np.ndarray]) -> Chart:
    minutes, tray = path["time"] / 60, "shelf" in path

    def paint(upper, lower):
        moisture = [("Solvent", 100 * path["solvent"])]
        pictures.curves(upper, minutes, moisture, "Solvent, % of the crystals", True)
        lines = [("Cake", path["temperature"])] + ([("Shelf", path["shelf"])] if tray else [])
        pictures.curves(lower, minutes, lines, "Temperature, K")
        pictures.minutes_below(upper, lower)

    svg = draw(f"drying-{unit}", "Moisture and temperature of the cake over time.", paint, 340,
               (1.0, 1.0))  # fmt: skip
    return Chart(svg, f"{unit}: solvent per crystals, by mass, and the temperature of the cake.")


def reactor(run: Run) -> Section:
    """Concentrations over time in every unit that records them."""
    title, short = "Reaction over time", "Reaction"
    blocks: list[Block] = []
    for unit, table in (run.get("run.trajectories") or {}).items():
        names = [name for name in table if name.startswith("concentration.")]
        if not names:
            continue
        minutes = np.asarray(table["time"], float) / 60
        lines = [(n.partition(".")[2], np.asarray(table[n], float)) for n in names]

        def paint(axes, minutes=minutes, lines=lines):
            pictures.curves(axes, minutes, lines, "Concentration, mol/L")
            axes.set_xlabel("Time, min")

        svg = draw(f"reaction-{unit}", "Concentration of every species over time.", paint)
        blocks.append(Chart(svg, f"{unit}: every species over time."))
    if not blocks:
        blocks.append(Missing("No reactor's trajectory is in this run."))
    return Section("reaction", title, short, blocks)
