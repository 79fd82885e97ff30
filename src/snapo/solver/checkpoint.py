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

_TREES = ("policy", "average", "best", "halfway", "recent", "optimiser")


class CheckpointError(ValueError):
    """A checkpoint that belongs to another run, or that is damaged."""


PLAIN = ("step", "best_value", "stale", "status", "clip", "since")


def save(progress: Progress, file: Path) -> None:
    """Writes the whole state of training."""
    state = {
        "step": progress.step,
        "best_value": progress.best_value,
        "stale": progress.stale,
        "status": progress.status,
        "clip": progress.clip,
        "since": progress.since,
        "history": [list(record) for record in progress.history],
    }
    save_arrays(file, {name: getattr(progress, name) for name in _TREES}, state)


def load(file: Path, like: Progress) -> Progress:
    """The state of training in `file`, for a policy and an optimiser shaped as in `like`.

    **Raises:** `CheckpointError` where the file is damaged, or belongs to another policy.
    """
    trees, state = load_arrays(file, {name: getattr(like, name) for name in _TREES})
    try:
        plain = {name: state[name] for name in PLAIN}
        history = tuple(Record(*record) for record in state["history"])
    except (KeyError, TypeError, AttributeError):
        raise CheckpointError(f"{file}: this is another kind of file.") from None
    return replace(like, **trees, **plain, history=history)


def save_arrays(file: Path, tree: PyTree, header: Mapping[str, Any]) -> None:
    """All array leaves of a tree with a JSON header, through a temporary file beside the target."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_array))
    _save(file, {f"leaf_{i}": np.asarray(leaf) for i, leaf in enumerate(leaves)}, header)


def load_arrays(file: Path, like: PyTree) -> tuple[PyTree, dict[str, Any]]:
    """The tree again, shaped like `like`, and the header. Nothing is unpickled."""
    moving, fixed = eqx.partition(like, eqx.is_array)
    leaves, structure = jax.tree.flatten(moving)
    stored, header = _load(file)
    found = list(stored.values())
    shapes = [leaf.shape for leaf in leaves], [leaf.shape for leaf in found]
    if shapes[0] != shapes[1]:
        raise CheckpointError(f"{file}: this file holds a policy of another shape.")
    # Tables in NumPy keep their precision, which JAX might not have.
    kept = [
        np.asarray(new, old.dtype) if isinstance(old, np.ndarray) else jnp.asarray(new, old.dtype)
        for new, old in zip(found, leaves)
    ]
    return eqx.combine(structure.unflatten(kept), fixed), header


def save_named(file: Path, arrays: Mapping[tuple[str, ...], Any], header: Mapping) -> None:
    """Arrays under names of several words, with a JSON header."""
    names = [list(name) for name in arrays]
    numbered = {f"leaf_{i}": np.asarray(array) for i, array in enumerate(arrays.values())}
    _save(file, numbered, {"names": names, "header": dict(header)})


def load_named(file: Path) -> tuple[dict[tuple[str, ...], np.ndarray], dict[str, Any]]:
    """The inverse of `save_named`."""
    stored, header = _load(file)
    try:
        names, header = header["names"], header["header"]
    except (KeyError, TypeError):
        raise CheckpointError(f"{file}: this is another kind of file.") from None
    return {tuple(name): array for name, array in zip(names, stored.values())}, header


def _save(file: Path, arrays: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> None:
    text = np.frombuffer(json.dumps(header).encode(), np.uint8)
    partial = file.with_name(file.name + ".partial")
    with partial.open("wb") as stream:
        np.savez(stream, header=text, **arrays)  # pyright: ignore[reportArgumentType]
        stream.flush()
        os.fsync(stream.fileno())
    partial.replace(file)


def _load(file: Path) -> tuple[dict[str, np.ndarray], Any]:
    """The arrays in their order and the header, whatever may be wrong with the file."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            header = json.loads(stored["header"].tobytes().decode())
            names = [f"leaf_{i}" for i in range(len(stored.files) - 1)]
            return {name: stored[name] for name in names}, header
    except Exception as error:  # a damaged byte can be a compression, a key or a size as well
        what = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"{file}: this file cannot be read ({what}).") from None
