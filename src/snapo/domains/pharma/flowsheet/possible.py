"""Impossible values of a measure, which result if the assumptions of an equation fail."""

import math

from .case import PharmaCase

AT_LARGEST = 0.01  # of the crystals' volume in the largest cell, out of which none can grow
ROUND_OFF = 1e-9  # in the domain's unit: round-off that makes a zero negative


def smallest(measure: str) -> float:
    """The smallest possible value of a measure, in the domain's unit.

    Amounts, times, sizes and shares are not below 0; a supersaturation (c - c*)/c* not below -1.
    New crystals are the crystals minus the seed, of which some may have dissolved.
    """
    unit, _, name = measure.partition(".")
    if unit == "process":
        return -math.inf
    return (-1.0 if name == "supersaturation" else 0.0) - ROUND_OFF


def impossible(case: PharmaCase, measures: dict[str, float]) -> str:
    """A sentence on the first measure with an impossible value; "" if there is none."""
    units = {
        f"{unit.name}.{name}": measured
        for unit in case.units
        for name, measured in unit.measures(case.network.species).items()
    }
    for name, value in measures.items():
        if not math.isfinite(value):
            return f"{name} is not a number"
        if value < smallest(name):
            local = units.get(name, "1")
            metadata = f"{value:.6g}" + ("" if local == "1" else f" {local}")
            hint = HINTS.get(name.partition(".")[2], "")
            return f"{name} is {metadata}, which is impossible{hint}"
        if name.endswith(".at_largest") and value > AT_LARGEST:
            return (
                f"{name} is {value:.3g}: the grid of sizes ends too early; at most a share of "
                f"{AT_LARGEST:g} of the crystals' volume may be in its last cell; increase "
                "`largest`"
            )
    return ""


HINTS = {
    "time": ": the voids of the cake hold more than the liquid of the slurry",
    "supersaturation": ": the solubility there is below 0",
}
