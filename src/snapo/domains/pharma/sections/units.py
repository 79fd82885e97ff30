"""Every unit operation: its measures, and its states where no other section draws them."""

from typing import Any

import numpy as np

from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Missing, Section, Table
from snapo.report.quantity import finite, number, power, unit_words

from . import pictures
from .model import place
from .run import Run

# States of reactors, crystallisers and dryers, which have sections of their own.
LARGE = 1e7
ELSEWHERE = ("supersaturation", "solvent")


def units(run: Run) -> Section:
    """All measures of one batch, and the course of the other units."""
    title, short = "Every unit: measures and courses", "Units"
    blocks: list[Block] = [_measures(run)]
    trajectories = run.get("run.trajectories", {})
    for each in run.get("units", []):
        course, states = trajectories.get(each["name"]), each.get("states", {})
        drawn = any(name in ELSEWHERE or name.startswith("concentration.") for name in states)
        if course and not drawn:
            blocks.append(_course(each["name"], states, course))
    return Section("units", title, short, blocks)


def _measures(run: Run) -> Table | Missing:
    found = run.get("run.measures", {})
    rows = [
        (
            each["name"],
            measure,
            "" if unit == "1" else unit_words(unit),
            _value(found.get(f"{each['name']}.{measure}"), unit),
        )
        for each in run.get("units", [])
        for measure, unit in each.get("measures", {}).items()
    ]
    if not rows or not found:
        return Missing("No batch was computed, so the units have no measures.")
    head = [("Unit", ""), ("Measure", ""), ("In", ""), ("Value", "")]
    return Table(head, rows, "At the end of each unit, in the units of the computation", 3)


def _value(value: Any, unit: str) -> str:
    """Four digits, of a large number too, "2.097 × 10⁸"; five of a temperature."""
    if unit == "K":
        return place(value)
    return power(value, 3) if abs(finite(value) or 0.0) >= LARGE else number(value)


def _course(name: str, states: dict[str, str], course: dict[str, Any]) -> Chart:
    """One panel for all states of the same unit of measure."""
    minutes = np.asarray(course["time"], float) / 60
    panels: dict[str, list[tuple[str, np.ndarray]]] = {}
    for state, unit in states.items():
        if state in course:
            panels.setdefault(unit, []).append((state, np.asarray(course[state], float)))

    def paint(*axes):
        for each, (unit, lines) in zip(axes, panels.items()):
            words = lines[0][0] if len(lines) == 1 else ""
            pictures.curves(
                each, minutes, lines, ", ".join(filter(None, (words, unit_words(unit))))
            )
        axes[-1].set_xlabel("Time, min")

    svg = draw(f"unit-{name}", f"States of {name} over time.", paint, 120 + 105 * len(panels),
               [1.0] * len(panels))  # fmt: skip
    return Chart(svg, f"{name}: its states over time, in the units of the computation.")
