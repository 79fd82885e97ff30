"""The file of a solution: arrays with names, and its sensitivities from them. It loads no JAX."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from snapo.problem.carry.arrays import read_arrays, write_arrays
from snapo.problem.record import Input

from ..statistics import Estimate
from .interval import Curvature, Reported, Verdict
from .table import Sensitivities


class CheckpointError(ValueError):
    """A checkpoint that belongs to another run, or that is damaged."""


def save_named(file: Path, arrays: Mapping[tuple[str, ...], Any], header: Mapping) -> None:
    """Writes the named arrays of several parts, with a JSON header."""
    names = [list(name) for name in arrays]
    numbered = {f"leaf_{i}": np.asarray(array) for i, array in enumerate(arrays.values())}
    write_arrays(file, numbered, {"names": names, "header": dict(header)})


def load_named(file: Path) -> tuple[dict[tuple[str, ...], np.ndarray], dict[str, Any]]:
    """The inverse of `save_named`."""
    stored, both = read_checked(file)
    names, header = entries(file, both, "names", "header")
    return {tuple(name): array for name, array in zip(names, stored.values())}, header


def entries(file: Path, both: Any, *keys: str) -> list[Any]:
    """Two entries that were stored with the arrays."""
    try:
        return [both[key] for key in keys]
    except (KeyError, TypeError, IndexError):
        raise CheckpointError(f"{file}: this file was not written by snapo.") from None


def read_checked(file: Path) -> tuple[dict[str, np.ndarray], Any]:
    """The arrays in their order and the header, whatever may be wrong with the file."""
    try:
        return read_arrays(file)
    except ValueError as error:
        raise CheckpointError(str(error)) from None


KINDS = ("held", "smooth")


def about_sensitivities(table: Sensitivities | None) -> dict[str, Any]:
    """All of a solution's sensitivities except arrays."""
    if table is None:
        nothing = dict.fromkeys(("policy_gradient", "verdicts", "reported"))
        return {"inputs": {}, "left_out": 0, **nothing}
    return {
        "inputs": {name: _metadata(values) for name, values in table.inputs.items()},
        "policy_gradient": table.policy_gradient,
        "left_out": table.dropped,
        "verdicts": table.verdicts,
        "reported": _about(table.reported),
    }


def _metadata(values: Input) -> dict[str, Any]:
    """All that is known of an input but its numbers."""
    return {
        item.name: getattr(values, item.name) for item in fields(values) if item.name != "value"
    }


def arrays_of(totals: Mapping[str, np.ndarray], sensitivities: Sensitivities | None) -> dict:
    """{(kind, name): array} of everything that is an array."""
    arrays = {("total", name): np.asarray(total) for name, total in totals.items()}
    if sensitivities is not None:
        arrays |= {("input", name): values.value for name, values in sensitivities.inputs.items()}
        for kind in KINDS:
            table = getattr(sensitivities, kind) or {}
            arrays |= {(kind, name): entry.blocks for name, entry in table.items()}
        arrays |= {
            ("moved", name): value.blocks for name, value in (sensitivities.moved or {}).items()
        }
        for name, item in (sensitivities.reported or {}).items():
            arrays |= {(key, name): getattr(item, part) for key, part in REPORTED.items()}
            arrays |= {("estimate", name): item.estimate.blocks}
            arrays |= {(part, name): getattr(item.curvature, part) for part in CURVATURE}
    return arrays


# {key in the file: attribute of a reported derivative}; "total" is the key of an output's totals.
REPORTED = {
    "by": "by", "complete": "total", "unseen": "unseen", "slopes": "slopes", "others": "others"
}  # fmt: skip
CURVATURE = ("inverse", "covariance")


def _about(result: Mapping[str, Reported] | None) -> dict[str, Any] | None:
    """All of the reported derivatives that is no array."""
    if result is None:
        return None
    return {name: [item.source, item.curvature.gap, item.sides] for name, item in result.items()}


def _reported(arrays: Mapping, stored: Mapping[str, Any] | None) -> dict[str, Reported] | None:
    """The inverse of `_about` and of the arrays stored with it."""
    if stored is None:
        return None
    table = {}
    for name, (source, gap, sides) in stored.items():
        parts = {part: arrays[key, name] for key, part in REPORTED.items()}
        curvature = Curvature(arrays["inverse", name], arrays["covariance", name], gap)
        estimate = Estimate(arrays["estimate", name])
        sides = sides and tuple(sides)
        table[name] = Reported(source, estimate, **parts, curvature=curvature, sides=sides)
    return table


def sensitivities_of(arrays: Mapping, header: Mapping[str, Any]) -> Sensitivities:
    """The inverse of `arrays_of` and `about_sensitivities`."""

    def table(kind: str) -> dict[str, Any]:
        return {name: array for (which, name), array in arrays.items() if which == kind}

    inputs = {
        name: Input(arrays["input", name], **metadata)
        for name, metadata in header["inputs"].items()
    }
    held, smooth = ({n: Estimate(x) for n, x in table(kind).items()} for kind in KINDS)
    gradient, verdicts = header["policy_gradient"], header["verdicts"]
    if verdicts is not None:
        verdicts = {name: Verdict.of(numbers) for name, numbers in verdicts.items()}
    drift = {name: Estimate(blocks) for name, blocks in table("moved").items()}
    return Sensitivities(
        inputs,
        held,
        smooth or None,
        drift or None,
        gradient and tuple(gradient),
        header["left_out"],
        verdicts,
        _reported(arrays, header["reported"]),
    )


def sensitivities_in(file: Path) -> Sensitivities | None:
    """The sensitivities in the file of a solution; None if it has none.

    **Raises:** `CheckpointError` for any defect of the file.
    """
    arrays, header = load_named(file)
    try:
        return sensitivities_of(arrays, header) if header["inputs"] else None
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise CheckpointError(f"{file}: this is not the file of a solution ({error}).") from None
