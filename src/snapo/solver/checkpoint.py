"""What a killed run resumes from: one file, written whole or not at all, and never executed."""

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .train import Progress, Record

DIGEST = "inputs"  # the entry of a fingerprint that stands for all numbers of the schedule
_TREES = ("policy", "average", "best", "halfway", "optimiser")


class CheckpointError(ValueError):
    """A checkpoint that belongs to another run, or that is damaged."""


def save(progress: Progress, file: Path, fingerprint: Mapping[str, Any]) -> None:
    """Writes the whole state of training; `fingerprint` says which run it belongs to."""
    state = {
        "fingerprint": dict(fingerprint),
        "step": progress.step,
        "best_value": progress.best_value,
        "stale": progress.stale,
        "status": progress.status,
        "history": [list(record) for record in progress.history],
    }
    save_arrays(file, {name: getattr(progress, name) for name in _TREES}, state)


def load(file: Path, like: Progress, fingerprint: Mapping[str, Any]) -> Progress:
    """The state of training in `file`, for the run that `like` and `fingerprint` describe.

    **Raises:** `CheckpointError` when anything that decides the numbers has changed since.
    """
    trees, state = load_arrays(file, {name: getattr(like, name) for name in _TREES})
    # Through JSON, so that tuples and lists compare equal.
    now = json.loads(json.dumps(dict(fingerprint)))
    for key, value in now.items():
        before = state["fingerprint"].get(key)
        if before != value:
            changed = f"{key} = {before!r}, and now it is {value!r}"
            if key == DIGEST:
                changed = "other inputs: contract, market or model have changed"
            raise CheckpointError(
                f"{file}: this run was started with {changed}; resume with the same, or solve "
                "afresh into another folder."
            )
    history = tuple(Record(*record) for record in state["history"])
    return replace(
        like,
        **trees,
        step=state["step"],
        best_value=state["best_value"],
        stale=state["stale"],
        status=state["status"],
        history=history,
    )


def save_arrays(file: Path, tree: PyTree, header: Mapping[str, Any]) -> None:
    """All array leaves of a tree with a JSON header, through a temporary file beside the target."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_array))
    arrays = {f"leaf_{i}": np.asarray(leaf) for i, leaf in enumerate(leaves)}
    text = np.frombuffer(json.dumps(header).encode(), np.uint8)
    partial = file.with_name(file.name + ".partial")
    with partial.open("wb") as stream:
        np.savez(stream, header=text, **arrays)  # pyright: ignore[reportArgumentType]
        stream.flush()
        os.fsync(stream.fileno())
    partial.replace(file)


def load_arrays(file: Path, like: PyTree) -> tuple[PyTree, dict[str, Any]]:
    """The tree again, shaped like `like`, and the header. Nothing is unpickled."""
    moving, fixed = eqx.partition(like, eqx.is_array)
    leaves, structure = jax.tree.flatten(moving)
    try:
        with np.load(file, allow_pickle=False) as stored:
            header = json.loads(stored["header"].tobytes().decode())
            found = [stored[f"leaf_{i}"] for i in range(len(stored.files) - 1)]
    except (OSError, ValueError, KeyError) as error:
        raise CheckpointError(f"{file}: this file cannot be read ({error}).") from None
    shapes = [leaf.shape for leaf in leaves], [leaf.shape for leaf in found]
    if shapes[0] != shapes[1]:
        raise CheckpointError(f"{file}: this file holds a policy of another shape.")
    # Tables in NumPy keep their precision, which JAX might not have.
    kept = [
        np.asarray(new, old.dtype) if isinstance(old, np.ndarray) else jnp.asarray(new, old.dtype)
        for new, old in zip(found, leaves)
    ]
    return eqx.combine(structure.unflatten(kept), fixed), header
