"""The controls over time that actions stand for: of a policy on many batches, or of a recipe."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from snapo.problem.inputs import Input

from ..flowsheet.case import PharmaCase
from .stages import Stage

LOW, HIGH = 0.1, 0.9  # quantiles over batches, of a band


def courses(
    case: PharmaCase, stages: Sequence[Stage], inputs: Mapping[str, Input], actions: np.ndarray
) -> list[dict[str, Any]]:
    """One row for each control: its values [T, N] after each decision, from actions [T, N, size].

    In the domain's units; `time` [T]: s since the unit's start, at the end of each decision. Ramps
    hold over the nominal duration.
    """
    assert case.control is not None
    found = []
    for stage in stages:
        seconds = None
        if stage.unit is not None:
            seconds = float(inputs[stage.unit.duration.name].value[0]) / stage.horizon
        for place, i in enumerate(stage.decided):
            item = case.control.manipulated[i]
            part = actions[stage.before : stage.before + stage.horizon, :, place]
            values = item.low + np.asarray(part, float) * (item.high - item.low)
            if item.ramp is not None and seconds is not None:
                values = _within(values, float(inputs[item.input].value[0]), item.ramp * seconds)
            ends = (np.arange(stage.horizon) + 1) * (seconds or 0.0)
            unit = inputs[item.input].unit
            found.append({"input": item.input, "unit": unit, "time": ends, "values": values})
    return found


def _within(values: np.ndarray, start: float, most: float) -> np.ndarray:
    """Values that move by at most `most` from one decision to the next."""
    found, last = np.empty_like(values), np.full(values.shape[1], start)
    for t, wanted in enumerate(values):
        found[t] = last = np.clip(wanted, last - most, last + most)
    return found


def side_by_side(policy: list, best: list, given: list) -> list[dict[str, Any]]:
    """Of each control the policy's median and band, and both recipes."""
    return [
        {
            "input": ours["input"],
            "unit": ours["unit"],
            "time": ours["time"],
            "policy": np.median(ours["values"], 1),
            "policy_low": np.quantile(ours["values"], LOW, 1),
            "policy_high": np.quantile(ours["values"], HIGH, 1),
            "values": fixed["values"][:, 0],
            "given": first["values"][:, 0],
        }
        for ours, fixed, first in zip(policy, best, given, strict=True)
    ]
