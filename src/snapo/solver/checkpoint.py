"""The checkpoint of a run: one file, written atomically, and never executed."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxtyping import PyTree

from snapo.problem.carry.arrays import write_arrays
from snapo.problem.carry.save import PolicyFileError, described, filled, leaves_of

from .derivatives.solution_file import CheckpointError, entries, read_checked
from .learning.conditioning import Growth
from .learning.features import FeatureScale
from .learning.progress import Progress, Record, Round
from .learning.windows import blank
from .limits import Dual

POLICIES = ("policy", "halfway")  # their settings are those of all policies of a training
_TREES = ("policy", "average", "best", "halfway", "recent", "optimiser", "critic")


PLAIN = ("step", "best_value", "stale", "status", "clip", "keep", "since", "window")


def save(progress: Progress, file: Path, mark: str = "") -> None:
    """Writes the complete state of training; `mark` identifies the run that it belongs to."""
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
    """The state of training in `file`, for a policy and an optimiser of the shapes in `like`.

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
        raise CheckpointError(f"{file}: this is not the checkpoint of a training.") from None
    summary = {"history": history, "growth": growth, "dual": dual, "raced": raced}
    summary |= {**steps, "unchanged": int(state.get("unchanged", 0))}
    return replace(like, **trees, **plain, **summary, scale=scale)


def _with_critic(file: Path, like: Progress) -> Progress:
    """The state with a critic if training has chosen windows, which a state before the first step
    does not know."""
    try:
        features = read_checked(file)[1]["header"]["features"]
    except (KeyError, TypeError):
        return like  # a fault of the file shows where it is read
    if like.critic is not None or not isinstance(features, int):
        return like
    return replace(like, critic=blank(features))


def save_arrays(file: Path, tree: PyTree, header: Mapping[str, Any]) -> None:
    """All array leaves of a tree with a JSON header, through a temporary file next to the
    target."""
    arrays = {f"leaf_{i}": leaf for i, leaf in enumerate(leaves_of(tree))}
    write_arrays(file, arrays, {"header": header, "described": described(_policies(tree))})


def load_arrays(file: Path, like: PyTree) -> tuple[PyTree, dict[str, Any]]:
    """The saved tree, with the shapes of `like`, and the header. Nothing is unpickled.

    **Raises:** `CheckpointError` if the file is damaged, or holds policies that differ from
    those of `like` in shape, activation or any other setting.
    """
    stored, both = read_checked(file)
    header, text = entries(file, both, "header", "described")
    try:
        return filled(file, list(stored.values()), text, like, _policies(like)), header
    except PolicyFileError as error:
        raise CheckpointError(str(error)) from None


def _policies(tree: PyTree) -> PyTree:
    """A tree without the optimiser, whose settings are those of the training."""
    return {k: v for k, v in tree.items() if k in POLICIES} if isinstance(tree, dict) else tree
