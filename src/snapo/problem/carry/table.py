"""`snapo.decision_table`: a policy's decisions over two of the numbers that it sees, as rows."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..code.version import of_policy, read_context
from ..policy import Policy
from ..smooth import Exact


class TableDecisions(NamedTuple):
    """`x` [n, 2], the two numbers that move, and `action` [n, size], the exact decision there."""

    x: Float[np.ndarray, "n 2"]
    action: Float[np.ndarray, "n size"]


def decision_table(
    policy: Policy,
    file: Path | str | None = None,
    *,
    x: tuple[int, Sequence[float]],
    y: tuple[int, Sequence[float]],
    at: Sequence[float],
    names: Sequence[str] | None = None,
    observe: Callable[[Any], Any] | None = None,
) -> TableDecisions:
    """The exact decision at every pair of values of two observed numbers, x slowest.

    **Arguments:**

    - `file`: a CSV to write, a row for each pair; None: the table is returned only.
    - `x`, `y`: which number moves, counted from 0, and its values.
    - `at`: all numbers of one observation; those of `x` and `y` in it do not matter.
    - `names`: of the columns: the two numbers, then those of the action.
    - `observe`: from raw numbers to one observation; `at`, `x` and `y` are then raw.

    >>> rule = snapo.Linear([[1.0, 10.0]])
    >>> snapo.decision_table(rule, x=(0, [0, 1]), y=(1, [2, 3]), at=[0, 0]).action.tolist()
    [[20.0], [30.0], [21.0], [31.0]]
    """
    (one, values), (two, others) = x, y
    if one == two or not all(0 <= item < len(at) for item in (one, two)):
        message = f"x and y name two different numbers of {len(at)}, 0 to {len(at) - 1}"
        raise ValueError(f"decision_table: {message}; got {one} and {two}.")
    pairs = np.array([(a, b) for a in values for b in others], np.float64).reshape(-1, 2)
    states = np.tile(np.asarray(at, np.float64), (len(pairs), 1))
    states[:, [one, two]] = pairs
    version = of_policy(policy, states, observe)
    with jax.enable_x64(True), read_context(version):
        action = np.asarray(_decided(policy, observe, jnp.asarray(states)), np.float64)
    table = TableDecisions(pairs, action)
    if file is not None:
        _write(Path(file), table, names or _names(one, two, action.shape[1]))
    return table


@eqx.filter_jit
def _decided(policy: Policy, observe: Any, states: Float[Array, "n features"]) -> Array:
    def one(raw: Array) -> Array:
        return policy(raw if observe is None else jnp.asarray(observe(raw)), Exact())

    return jax.vmap(one)(states)


def _names(one: int, two: int, size: int) -> list[str]:
    return [f"observation {one}", f"observation {two}", *(f"action {i}" for i in range(size))]


def _write(file: Path, table: TableDecisions, names: Sequence[str]) -> None:
    rows = np.concatenate([table.x, table.action], axis=1)
    if len(names) != rows.shape[1]:
        raise ValueError(f"decision_table: {len(names)} names for {rows.shape[1]} columns.")
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([repr(float(item)) for item in row] for row in rows)
