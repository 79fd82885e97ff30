"""Rows of a table that all paths share, read at positions that differ between paths."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.lanes.machine.pipeline import host
from snapo.lanes.program.flatten import flatten
from snapo.lanes.program.sweeps import plan

from ..compiled import run, text

ROWS = 40  # too many to be selected among


def table(columns: int, dtype: str) -> np.ndarray:
    return np.random.default_rng(columns).standard_normal((ROWS, columns)).astype(dtype)


def test_short_numbers_are_read_one_by_one():
    numbers = (100 * table(5, "float32")).astype(np.int16)
    rows = np.arange(host().lanes("float32")) % ROWS

    def function(row):
        return jnp.asarray(numbers)[row[0].astype(int)].astype("float32")

    (result,) = run(function, rows[:, None].astype(np.float32))
    np.testing.assert_array_equal(result, numbers[rows])


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("columns", [3, 4, 7, 16])
def test_a_row_of_every_path_is_copied_exactly(columns, dtype):
    numbers = table(columns, dtype)
    rows = np.random.default_rng(0).integers(0, ROWS, host().lanes(dtype))

    def function(row):
        return jnp.asarray(numbers)[row[0].astype(int)]

    with jax.enable_x64(True):
        (result,) = run(function, rows[:, None].astype(dtype))
        gathered = "masked.gather" in text(function, [(1,)], dtype)[0]
    np.testing.assert_array_equal(result, numbers[rows])
    assert gathered == (columns < 4)  # of few neighbours, each is gathered


def test_windows_begin_anywhere_in_a_row():
    numbers = table(90, "float32")
    lanes = host().lanes("float32")
    rows, first = np.random.default_rng(1).integers(0, [[ROWS], [86]], (2, lanes))

    def function(start):
        at = start.astype(jnp.int32)
        return jax.lax.dynamic_slice(jnp.asarray(numbers), (at[0], at[1]), (2, 5))

    (result,) = run(function, np.stack([rows, first], axis=1).astype(np.float32))
    at = np.minimum(rows, ROWS - 2)[:, None, None] + np.arange(2)[:, None]
    np.testing.assert_array_equal(
        result, numbers[at, np.minimum(first, 85)[:, None, None] + np.arange(5)]
    )


def test_rows_out_of_range_are_filled_as_by_xla():
    numbers = table(6, "float32")
    rows = np.arange(host().lanes("float32")) * 3.0 - 5

    def function(row):
        return (
            jnp.asarray(numbers)
            .at[row[0].astype(jnp.int32)]
            .get(mode="fill", fill_value=-1.0, wrap_negative_indices=False)
        )

    (result,) = run(function, rows[:, None].astype(np.float32))
    inside = (rows >= 0) & (rows < ROWS)
    known = numbers[np.clip(rows, 0, ROWS - 1).astype(int)]
    np.testing.assert_array_equal(result, np.where(inside[:, None], known, -1.0))


def stored(function, *shapes) -> list[tuple[int, ...]]:
    """Shapes on the tape, where the last argument is a cotangent."""
    closed = jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(s, "float32") for s in shapes))
    program = flatten(closed, [True] * len(shapes))
    division = plan(program, program.inputs[-1:], [], program.outputs, set())
    return [value.shape for value in division.tape]


def test_the_reverse_sweep_reads_a_shared_table_again_and_no_other():
    numbers = jnp.asarray(table(16, "float32"))

    def read(array, row):
        return jax.lax.dynamic_slice(array, (row[0].astype(jnp.int32), 0), (1, 16))

    assert stored(lambda row, back: back * read(numbers, row), (1,), (1, 16)) == [(1,)]
    own = stored(lambda array, row, back: back * read(array, row), (ROWS, 16), (1,), (1, 16))
    assert own == [(1, 16)]  # a row, and not the whole array of every path
