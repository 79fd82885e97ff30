"""The checkpoint of a run: one file, written atomically, and never executed."""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import PyTree

from snapo.problem.carry.save import (
    PolicyFileError,
    described,
    filled,
    leaves_of,
    read_arrays,
    write_arrays,
)
from snapo.problem.inputs import Input

from .derivatives.interval import Curvature, Reported
from .derivatives.verdict import Verdict
from .learning.conditioning import Growth
from .learning.features import FeatureScale
from .learning.progress import Progress, Record, Round
from .learning.windows import blank
from .limits import Dual
from .sensitivity import Sensitivities
from .statistics import Estimate

POLICIES = ("policy", "halfway")  # their settings are those of all policies of a training
_TREES = ("policy", "average", "best", "halfway", "recent", "optimiser", "critic")


class CheckpointError(ValueError):
    """A checkpoint that belongs to another run, or that is damaged."""


PLAIN = ("step", "best_value", "stale", "status", "clip", "keep", "since", "window")


def save(progress: Progress, file: Path, mark: str = "") -> None:
    """Writes the complete state of training; `mark` is that of the run that it belongs to."""
    state = {
        "step": progress.step,
        "best_value": progress.best_value,
        "stale": progress.stale,
        "status": progress.status,
        "clip": progress.clip,
        "keep": progress.keep,
        "since": progress.since,
        "window": progress.window,
        "growth": progress.growth,
        "dual": progress.dual,
        "raced": progress.raced,
        "slowed": progress.slowed,
        "redrawn": progress.redrawn,
        "unchanged": progress.unchanged,
        "scale": progress.scale,
        "features": None if progress.critic is None else progress.critic.critic.features,
        "history": [list(record) for record in progress.history],
        "mark": mark,
    }
    save_arrays(file, {name: getattr(progress, name) for name in _TREES}, state)


def load(file: Path, like: Progress, mark: str = "") -> Progress:
    """The state of training in `file`, for a policy and an optimiser shaped as in `like`.

    **Raises:** `CheckpointError` if the file is damaged, or belongs to another policy or run.
    """
    like = _with_critic(file, like)
    trees, state = load_arrays(file, {name: getattr(like, name) for name in _TREES})
    try:
        if mark and state["mark"] != mark:
            raise CheckpointError(f"{file}: this file belongs to another run.")
        plain = {name: state[name] for name in PLAIN}
        history = tuple(Record(*record) for record in state["history"])
        growth, dual = Growth.read(state["growth"]), Dual.read(state["dual"])
        raced = tuple(map(Round.read, state.get("raced", ())))
        steps = {name: tuple(map(int, state.get(name, ()))) for name in ("slowed", "redrawn")}
        scale = FeatureScale.read(state.get("scale"))
    except CheckpointError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError):
        raise CheckpointError(f"{file}: this is not a file of this kind.") from None
    summary = {"history": history, "growth": growth, "dual": dual, "raced": raced}
    summary |= {**steps, "unchanged": int(state.get("unchanged", 0))}
    return replace(like, **trees, **plain, **summary, scale=scale)


def _with_critic(file: Path, like: Progress) -> Progress:
    """With a critic where training chose windows, which a beginning does not know."""
    try:
        features = _load(file)[1]["header"]["features"]
    except (KeyError, TypeError):
        return like  # a fault of the file shows where it is read
    if like.critic is not None or not isinstance(features, int):
        return like
    return replace(like, critic=blank(features))


def save_arrays(file: Path, tree: PyTree, header: Mapping[str, Any]) -> None:
    """All array leaves of a tree with a JSON header, through a temporary file next to the
    target."""
    arrays = {f"leaf_{i}": leaf for i, leaf in enumerate(leaves_of(tree))}
    _save(file, arrays, {"header": header, "described": described(_policies(tree))})


def load_arrays(file: Path, like: PyTree) -> tuple[PyTree, dict[str, Any]]:
    """The tree again, shaped like `like`, and the header. Nothing is unpickled.

    **Raises:** `CheckpointError` if the file is damaged, or holds policies that differ from
    those of `like` in shape, activation or any other setting.
    """
    stored, both = _load(file)
    header, text = _two(file, both, "header", "described")
    try:
        return filled(file, list(stored.values()), text, like, _policies(like)), header
    except PolicyFileError as error:
        raise CheckpointError(str(error)) from None


def save_named(file: Path, arrays: Mapping[tuple[str, ...], Any], header: Mapping) -> None:
    """Arrays with names of several parts, with a JSON header."""
    names = [list(name) for name in arrays]
    numbered = {f"leaf_{i}": np.asarray(array) for i, array in enumerate(arrays.values())}
    _save(file, numbered, {"names": names, "header": dict(header)})


def load_named(file: Path) -> tuple[dict[tuple[str, ...], np.ndarray], dict[str, Any]]:
    """The inverse of `save_named`."""
    stored, both = _load(file)
    names, header = _two(file, both, "names", "header")
    return {tuple(name): array for name, array in zip(names, stored.values())}, header


def _policies(tree: PyTree) -> PyTree:
    """A tree without the optimiser, whose settings are those of the training."""
    return {k: v for k, v in tree.items() if k in POLICIES} if isinstance(tree, dict) else tree


def _two(file: Path, both: Any, *keys: str) -> list[Any]:
    """Two entries that were stored with the arrays."""
    try:
        return [both[key] for key in keys]
    except (KeyError, TypeError, IndexError):
        raise CheckpointError(f"{file}: this is not a file of this kind.") from None


def _save(file: Path, arrays: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> None:
    write_arrays(file, arrays, header)


def _load(file: Path) -> tuple[dict[str, np.ndarray], Any]:
    """The arrays in their order and the header, whatever may be wrong with the file."""
    try:
        return read_arrays(file)
    except ValueError as error:
        raise CheckpointError(str(error)) from None


KINDS = ("held", "smooth")


def about_sensitivities(table: Sensitivities | None) -> dict[str, Any]:
    """All of a solution's sensitivities that is no array."""
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
