"""Inputs: the numbers a user knows, with the name, unit and labels of a sensitivity table."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

RELATIVE_STEP = 1e-5  # of a number's size: the step of its finite difference
NOTHING = 1e-9  # of the largest entry: a smaller one is a zero with round-off


def _float64(value: Any) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise TypeError(
            f"Input: the value {value!r} is not a number. Dates, names and switches belong to the "
            "simulator."
        )
    return array.astype(np.float64)


class Input(eqx.Module):
    """One differentiable input: a float64 array of any shape.

    **Arguments:**

    - `value`: numbers, kept as float64 NumPy.
    - `unit`: of the value, such as "EUR/MWh"; a sensitivity is per this unit.
    - `labels`: one per entry, in C order (dates, tenors, species); numbered by default.
    - `bump`: the step of a finite difference that checks the gradient; by default a share of each
      number (see `step`).
    - `judge_bump`: the bump of every number with which its derivative is tested, the policy
      reacting; by default 1 % of each. Specify it where values change on a grid of the input.
    - `move`: the amount by which reports and sliders move it, in `unit`; None: a relative move.
    - `display_unit`, `display_factor`: the preferred unit, and the number of these in one `unit`: a
      rate of 1/year is 10,000 bp. By default `unit` itself.
    - `group`: the type of risk, such as "price", "volatility" or "contract".
    - `meaning`: a short description.

    A correlation matrix enters as its strict lower triangle.

    >>> curve = snapo.Input([30.0, 31.5], "EUR/MWh", labels=("2025-01", "2025-02"), move=1.0)
    >>> curve.names()
    ('2025-01', '2025-02')
    >>> snapo.Input([[1, 2], [3, 4]]).names()  # numbered in C order
    ('0,0', '0,1', '1,0', '1,1')
    """

    value: np.ndarray = eqx.field(converter=_float64)
    unit: str = eqx.field(static=True, default="")
    labels: tuple[str, ...] = eqx.field(
        static=True, default=(), converter=lambda x: tuple(map(str, x))
    )
    bump: float | None = eqx.field(static=True, default=None)
    judge_bump: float | None = eqx.field(static=True, default=None)
    move: float | None = eqx.field(static=True, default=None)
    display_unit: str = eqx.field(static=True, default="")
    display_factor: float = eqx.field(static=True, default=1.0)
    group: str = eqx.field(static=True, default="")
    meaning: str = eqx.field(static=True, default="")

    def __check_init__(self):
        if self.labels and len(self.labels) != self.value.size:
            raise ValueError(
                f"Input: {len(self.labels)} labels for {self.value.size} numbers; each needs one."
            )
        if not np.all(np.isfinite(self.value)):
            raise ValueError("Input: a value is NaN or infinite; it must be a finite number.")

    def names(self) -> tuple[str, ...]:
        """One label per entry in C order."""
        if self.labels:
            return self.labels
        if self.value.ndim == 0:
            return ("",)
        return tuple(",".join(map(str, index)) for index in np.ndindex(self.value.shape))

    def step(self) -> np.ndarray:
        """The step of a finite difference of every number, in the input's unit, shaped like it.

        `bump` if specified, else 1e-5 of the number. For a zero the largest entry counts; if all
        are zero, the step is a thousandth of `move`, or else 1e-5.
        """
        if self.bump is not None:
            return np.full(self.value.shape, float(self.bump))
        size = np.abs(self.value)
        largest = np.max(size, initial=0.0)
        if largest == 0:
            # A move is about 1 % of the number.
            minimum = 1e-5 if not self.move else 1e-3 * abs(self.move)
            return np.full(self.value.shape, minimum)
        return RELATIVE_STEP * np.where(size > NOTHING * largest, size, largest)


class Frozen(eqx.Module):
    """A table that a policy holds and that training does not change."""

    array: Any

    def __jax_array__(self):
        return jax.lax.stop_gradient(self.array)


class NamedInput(NamedTuple):
    """An input and its name in tables, such as `forward_curve` or `factors.0.volatility`."""

    name: str
    input: Input


def is_input(x: Any) -> bool:
    return isinstance(x, Input)


def plain(inputs: PyTree) -> PyTree:
    """The same module with plain arrays instead of every `Input`, as `prepare` receives it."""
    return jax.tree.map(lambda x: x.value if is_input(x) else x, inputs, is_leaf=is_input)


def unnamed(inputs: PyTree) -> PyTree:
    """The same module with inputs of numbers without labels and units, so that code compiled for it
    serves other ones too."""
    return jax.tree.map(lambda x: Input(x.value) if is_input(x) else x, inputs, is_leaf=is_input)


def named_inputs(inputs: PyTree) -> list[NamedInput]:
    """All inputs in tree order with their names."""
    result = jax.tree_util.tree_flatten_with_path(inputs, is_leaf=is_input)[0]
    return [NamedInput(name_of(path), leaf) for path, leaf in result if is_input(leaf)]


def values(inputs: PyTree) -> list[np.ndarray]:
    """The values of all inputs, in the order of `named_inputs`."""
    return [entry.input.value for entry in named_inputs(inputs)]


def replace(inputs: PyTree, new: Sequence[Any]) -> PyTree:
    """The plain module with `new` values instead of the inputs, in the order of `named_inputs`.

    Unlike `plain`, it takes traced values, so that `prepare` can be differentiated.
    """
    remaining = iter(new)
    return jax.tree.map(lambda x: next(remaining) if is_input(x) else x, inputs, is_leaf=is_input)


def name_of(path) -> str:
    """The name of the input at a path of JAX's in the tree of inputs."""
    parts = [
        getattr(key, "name", None) or str(getattr(key, "key", getattr(key, "idx", key)))
        for key in path
    ]
    return ".".join(parts) or "input"
