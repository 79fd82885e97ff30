"""`policy.save(file)` and `snapo.load_policy(file)`: a policy in a file that describes itself."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from ..policy import Network, Policy
from ..smooth import Exact
from . import archive
from .tree import NotKnown, decoded, encoded

FORMAT = 1
MISTAKES = (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError)


class PolicyFileError(ValueError):
    """A policy that no file can describe, or a file that holds none."""


def save(policy: Policy, file: Path | str) -> None:
    """Writes a policy with its kinds, sizes, activations and weights; `load_policy` reads it.

    **Raises:** `PolicyFileError` for a policy of a class, or with a function, of one's own.
    """
    arrays: list[Any] = []
    try:
        metadata = encoded(policy, arrays)
    except NotKnown as error:
        raise PolicyFileError(
            f"policy.save: {error}, which is your own code, and a file holds no code. Give "
            "Solution.load(folder, like=policy) a policy made by your code in its place, "
            "or carry it away with snapo.to_onnx, which takes any policy."
        ) from None
    header = {"snapo policy": FORMAT, "features": features(policy), "policy": metadata}
    archive.write(Path(file), {f"leaf_{i}": array for i, array in enumerate(arrays)}, header)


def load_policy(file: Path | str) -> Policy:
    """The policy that `policy.save(file)` wrote; its shape need not be known, nothing is executed.

    **Raises:** `PolicyFileError` where the file is missing or damaged, holds something else, or
    weights whose sizes do not fit each other.
    """
    try:
        arrays, header = archive.read(Path(file))
    except ValueError as error:
        raise PolicyFileError(str(error)) from None
    if not isinstance(header, dict) or "snapo policy" not in header:
        raise PolicyFileError(f"{file}: this file holds no policy that policy.save wrote.")
    if header["snapo policy"] != FORMAT:
        message = f"is written in format {header['snapo policy']}, and this version reads {FORMAT}"
        raise PolicyFileError(f"{file}: it {message}.")
    try:
        policy = decoded(header["policy"], list(arrays.values()))
        if not isinstance(policy, Policy):
            raise ValueError("it holds no policy")
        if (count := header["features"]) is not None:
            jax.eval_shape(policy, jax.ShapeDtypeStruct((count,), jnp.float32), Exact())
    except MISTAKES as error:
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise PolicyFileError(f"{file}: this is no policy of this version ({text}).") from None
    return policy


def features(policy: Policy) -> int | None:
    """The number of features that a policy observes, where its weights tell; else None."""
    gain = getattr(policy, "gain", None)
    if gain is not None:
        return int(gain.shape[1])
    network = getattr(policy, "network", None)
    if not isinstance(network, Network):
        return None
    # A head of a domain takes the first numbers of the observation for itself.
    return int(network.weights[0].shape[1]) + getattr(policy, "head", 0)
