"""Arithmetic on numbers known while compiling: loop counters, static indices, masks, zeros.

Only small arrays are folded; every result must equal that of XLA.
"""

import math

import numpy as np

SMALL = 4096

_DIRECT = {
    "add": np.add,
    "add_any": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "max": np.maximum,
    "min": np.minimum,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.bitwise_not,
    "neg": np.negative,
    "abs": np.abs,
    "sign": np.sign,
}


def fold(name: str, params, inputs: list, avals) -> list[np.ndarray] | None:
    """The outputs, or None if something is unknown or cannot be folded."""
    if all(_size(a) == 0 for a in avals):
        return [np.zeros(a.shape, a.dtype) for a in avals]
    if any(i is None for i in inputs) or any(_size(a) > SMALL for a in avals):
        return None
    with np.errstate(all="ignore"):
        result = evaluated(name, params, inputs, avals[0])
    if result is None:
        return None
    results = result if isinstance(result, list) else [result]
    return [np.asarray(r, a.dtype).reshape(a.shape) for r, a in zip(results, avals)]


def _size(aval) -> int:
    return math.prod(aval.shape)


def evaluated(name, params, inputs, aval):
    """The output, or a list of the outputs; None if there is no rule."""
    if name in _DIRECT:
        return _DIRECT[name](*inputs)
    if name in ("empty", "empty2"):  # an array that is never read
        return np.zeros(aval.shape)
    if name == "convert_element_type":
        return inputs[0].astype(params["new_dtype"])
    if name == "broadcast_in_dim":
        return broadcast(inputs[0], params["shape"], params["broadcast_dimensions"])
    if name in ("reshape", "squeeze", "expand_dims"):
        return inputs[0].reshape(aval.shape)
    if name == "iota":
        shape, axis = params["shape"], params["dimension"]
        steps = np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
        return np.broadcast_to(steps, shape)
    if name == "select_n":
        return select(*inputs)
    if name == "clamp":
        return np.minimum(np.maximum(inputs[1], inputs[0]), inputs[2])
    if name in ("div", "rem") and inputs[0].dtype.kind in "iu" and np.all(inputs[1] != 0):
        quotient = (
            (np.abs(inputs[0]) // np.abs(inputs[1])) * np.sign(inputs[0]) * np.sign(inputs[1])
        )
        return quotient if name == "div" else inputs[0] - quotient * inputs[1]
    if name == "div" and inputs[0].dtype.kind == "f":
        return inputs[0] / inputs[1]
    if name == "concatenate":
        return np.concatenate(inputs, params["dimension"])
    if name == "stack":
        return np.stack(inputs, params["axis"])
    if name == "slice":
        return inputs[0][slices(params)]
    if name == "transpose":
        return inputs[0].transpose(params["permutation"])
    if name == "pad" and inputs[0].size == 0:
        return np.broadcast_to(inputs[1], aval.shape)
    if name in _OVER_NOTHING and inputs[0].size == 0:
        return np.broadcast_to(_OVER_NOTHING[name](aval.dtype), aval.shape)
    return None


def _lowest(dtype, sign: int = -1):
    """The least number of a type, or the largest."""
    if dtype.kind == "f":
        return sign * np.inf
    if dtype.kind == "b":
        return sign > 0
    return np.iinfo(dtype).min if sign < 0 else np.iinfo(dtype).max


# Reductions and products over no elements.
_OVER_NOTHING = {
    "reduce_sum": lambda dtype: 0,
    "reduce_prod": lambda dtype: 1,
    "reduce_max": _lowest,
    "reduce_min": lambda dtype: _lowest(dtype, 1),
    "reduce_and": lambda dtype: True,
    "reduce_or": lambda dtype: False,
    "reduce_xor": lambda dtype: False,
    "dot_general": lambda dtype: 0,
}


def select(which, *options):
    """`select_n`: the option with the number in `which`, position by position."""
    which = np.broadcast_to(which, options[0].shape).astype(np.int64)
    return np.take_along_axis(np.stack(options), which[None], 0)[0]


def broadcast(array, shape, dimensions):
    """`broadcast_in_dim`: input axis i becomes output axis dimensions[i]."""
    expanded = [1] * len(shape)
    for axis, size in zip(dimensions, array.shape):
        expanded[axis] = size
    return np.broadcast_to(array.reshape(expanded), shape)


def slices(params) -> tuple[slice, ...]:
    """The parameters of `slice` as Python slices."""
    strides = params["strides"] or (1,) * len(params["start_indices"])
    return tuple(map(slice, params["start_indices"], params["limit_indices"], strides))
