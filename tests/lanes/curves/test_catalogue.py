"""Curves against higher precision, in units of the last place, and at every special value."""

import ctypes

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from snapo.lanes.curves import CURVES
from snapo.lanes.emit.code import Code
from snapo.lanes.emit.module import Module
from snapo.lanes.machine.linked import KernelMemory, Linked
from snapo.lanes.machine.pipeline import host, object_code

REFERENCE = {
    "exp": np.exp, "expm1": np.expm1, "log": np.log, "log1p": np.log1p, "tanh": np.tanh,
    "logistic": lambda x: 1 / (1 + np.exp(-x)), "erf": special.erf, "atan2": np.arctan2,
    "sin": np.sin, "cos": np.cos, "pow": np.power,
}  # fmt: skip
# In units of the last place; where it is more than 2, the docstring of the curve says so.
BOUND = {"tanh": 3, "logistic": 3, "erf": 3, "pow": 3, "atan2": 3}


def bound(name: str, dtype: str) -> int:
    return 6 if (name, dtype) == ("tanh", "float32") else BOUND.get(name, 2)


SPECIAL = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 0.5, -0.5]


def build(name: str, dtype: str):
    """A function of arrays from one curve."""
    curve, lanes = CURVES[name], host().lanes(dtype)
    module = Module(lanes, host().register)
    code = Code(lanes, module)
    size = lanes * np.dtype(dtype).itemsize
    with code.loop("%n") as loop:
        offset = code.index(f"mul nsw i64 {loop.i}, {size}")
        inputs = [
            code.load(code.pointer(f"%x{i}", offset), dtype, lanes)
            for i in range(CURVES[name].arguments)
        ]
        code.store(code.apply(curve, *inputs), code.pointer("%y", offset), lanes)
    code.do("ret void")
    arguments = ", ".join(f"ptr %x{i}" for i in range(CURVES[name].arguments))
    code.define(f"define void @run(i64 %n, {arguments}, ptr %y) nounwind")
    machine = Linked(object_code(module.text()), {"run": 2})
    kind = ctypes.CFUNCTYPE(None, ctypes.c_int64, *[ctypes.c_void_p] * (CURVES[name].arguments + 1))
    function = kind(machine.addresses["run"])

    def call(*arrays):
        assert machine is not None  # the code lives as long as this function
        count = -(-arrays[0].size // lanes)
        memory = KernelMemory({k: count * size for k in ("x0", "x1", "y")})
        for k, array in enumerate(arrays):
            padded = memory[f"x{k}"].view(dtype)
            padded[: array.size], padded[array.size :] = array, 1
        given = [memory.where[f"x{k}"] for k in range(len(arrays))]
        function(count, *given, memory.where["y"])
        out = memory["y"].view(dtype)
        return out[: arrays[0].size].copy()

    return call


_built: dict = {}


def curve(name: str, dtype: str):
    if (name, dtype) not in _built:
        _built[name, dtype] = build(name, dtype)
    return _built[name, dtype]


def exact(name: str, dtype: str, arrays) -> np.ndarray:
    """The reference in extended precision (float64 suffices for float32, and for erf SciPy's)."""
    wide = np.float64 if dtype == "float32" or name == "erf" else np.longdouble
    with np.errstate(all="ignore"):
        return REFERENCE[name](*(a.astype(wide) for a in arrays))


def errors(found: np.ndarray, expected: np.ndarray, dtype: str) -> np.ndarray:
    """In units of the last place of the exact answer; not finite ones must agree.

    Kernels count denormals as zeros, as XLA does, so that zero is right where the answer is one.
    """
    with np.errstate(all="ignore"):
        rounded = expected.astype(dtype)
        vanished = (found == 0) & (np.abs(rounded) < np.finfo(dtype).tiny)
        usual = np.isfinite(rounded) & np.isfinite(found)
        ulp = np.spacing(np.maximum(np.abs(rounded), np.finfo(dtype).tiny)).astype(expected.dtype)
        gap = np.abs(found.astype(expected.dtype) - expected) / ulp
    same = (found == rounded) | (np.isnan(found) & np.isnan(rounded))
    return np.where(vanished, 0, np.where(usual, gap, np.where(same, 0, np.inf)))


def samples(name: str, dtype: str, count: int, seed: int = 0) -> list[np.ndarray]:
    """Numbers of every size, and dense ones where the curve bends."""
    rng = np.random.default_rng(seed)
    info = np.finfo(dtype)
    arrays = []
    for _ in range(CURVES[name].arguments):
        bits = rng.integers(0, 2 ** (8 * np.dtype(dtype).itemsize), count // 2, np.uint64)
        every = bits.astype(f"u{np.dtype(dtype).itemsize}").view(dtype)
        near = rng.normal(size=count // 4) * 3
        wide = rng.normal(size=count - count // 2 - count // 4) * 60
        x = np.concatenate([every, near.astype(dtype), wide.astype(dtype)])
        x = np.concatenate(
            [x, np.array([*SPECIAL, info.max, -info.max, info.tiny, info.tiny / 8], dtype)]
        )
        arrays.append(x)
    return arrays


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", sorted(CURVES))
def test_within_two_units_in_the_last_place(name, dtype):
    arrays = samples(name, dtype, 200_000)
    expected = exact(name, dtype, arrays)
    found = curve(name, dtype)(*arrays)
    error = errors(found, expected, dtype)
    worst = int(np.argmax(error))
    assert error[worst] <= bound(name, dtype), [a[worst] for a in arrays]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", sorted(CURVES))
def test_signed_zero(name, dtype):
    zeros = np.array([0.0, -0.0, 0.0, -0.0], dtype)
    arrays = [zeros, np.array([1.0, 1.0, -0.0, -0.0], dtype)][: CURVES[name].arguments]
    with np.errstate(all="ignore"):
        expected = exact(name, dtype, arrays).astype(dtype)
    found = curve(name, dtype)(*arrays)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(expected))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", sorted(n for n, c in CURVES.items() if c.arguments == 2))
def test_every_pair_of_special_values(name, dtype):
    pairs = np.meshgrid(np.array(SPECIAL, dtype), np.array(SPECIAL, dtype))
    arrays = [a.ravel() for a in pairs]
    found, expected = curve(name, dtype)(*arrays), exact(name, dtype, arrays)
    assert errors(found, expected, dtype).max() <= bound(name, dtype)


@settings(deadline=None, max_examples=200)
@given(st.data())
def test_any_float32(data):
    name = data.draw(st.sampled_from(sorted(CURVES)))
    numbers = st.floats(width=32)
    arrays = [np.array([data.draw(numbers)], np.float32) for _ in range(CURVES[name].arguments)]
    error = errors(curve(name, "float32")(*arrays), exact(name, "float32", arrays), "float32")
    assert error.max() <= bound(name, "float32")
