"""Functions of `jax.numpy` evaluated by NumPy, without compiling: for schedules of tests.

JAX traces the function, and NumPy evaluates its equations one after another, in float64. The
results are those of XLA but for rounding. JAX evaluates an equation that has no rule here.
"""

from collections.abc import Callable, Sequence
from functools import wraps
from importlib import import_module
from typing import Any, ParamSpec

import jax
import numpy as np

from snapo.lanes import jax_private
from snapo.lanes.program import folding

P = ParamSpec("P")
ArrayRule = Callable[..., Any]  # from arrays to one array, or to a list of them


def in_numpy(function: Callable[P, Any]) -> Callable[P, Any]:
    """`function` of trees of arrays, with NumPy arrays as results.

    It is traced once for arguments of the same form, shapes and types.
    """
    programs: dict[Any, tuple[Callable, Any]] = {}

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> Any:
        leaves, form = jax.tree.flatten((args, kwargs))
        leaves = [_wide(leaf) for leaf in leaves]
        key = form, tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        with jax.enable_x64(True), np.errstate(all="ignore"):
            if key not in programs:
                programs[key] = _traced(function, leaves, form)
            program, result = programs[key]
            return jax.tree.unflatten(result, map(np.asarray, program(*leaves)))

    return call


def _wide(leaf: Any) -> np.ndarray:
    array = np.asarray(leaf)
    return array.astype(np.float64) if array.dtype.kind == "f" else array


def _traced(function: Callable, leaves: Sequence[np.ndarray], form: Any) -> tuple[Callable, Any]:
    def flat(*leaves: Any) -> Any:
        args, kwargs = jax.tree.unflatten(form, leaves)
        return function(*args, **kwargs)

    closed, result = jax.make_jaxpr(flat, return_shape=True)(*leaves)
    return _program(closed), jax.tree.structure(result)


def _program(closed: Any) -> ArrayRule:
    """A function of arrays from its equations, each with its rule."""
    jaxpr = getattr(closed, "jaxpr", closed)
    constants = dict(zip(jaxpr.constvars, map(np.asarray, getattr(closed, "consts", ()))))

    def key_of(atom: Any) -> Any:
        if not jax_private.is_literal(atom):
            return atom
        name = object()
        constants[name] = np.asarray(atom.val, atom.aval.dtype)  # pyright: ignore
        return name

    steps = [(_rule(eqn), [key_of(x) for x in eqn.invars], eqn.outvars) for eqn in jaxpr.eqns]
    results = [key_of(x) for x in jaxpr.outvars]
    last = {x: i for i, (_, inputs, outputs) in enumerate(steps) for x in (*inputs, *outputs)}
    free: list[list[Any]] = [[] for _ in steps]
    for name in last.keys() - constants.keys() - set(results):
        free[last[name]].append(name)

    def run(*arguments: np.ndarray) -> list[np.ndarray]:
        arrays = constants | dict(zip(jaxpr.invars, arguments))
        for (rule, inputs, outputs), unused in zip(steps, free):
            result = rule(*[arrays[x] for x in inputs])
            arrays.update(zip(outputs, result if isinstance(result, list) else [result]))
            for name in unused:
                del arrays[name]
        return [arrays[x] for x in results]

    return run


def _rule(eqn: Any) -> ArrayRule:
    """How an equation is evaluated."""
    name, params = eqn.primitive.name, eqn.params
    if name in _ALIKE:
        return _ALIKE[name]
    if name in _RULES:
        return _RULES[name](params)
    inner = params.get(jax_private.CALLS.get(name)) or jax_private.called(eqn)
    if inner is not None:
        return _program(inner)
    result = eqn.outvars[0].aval

    def evaluate(*arrays: np.ndarray) -> Any:
        value = folding.evaluated(name, params, arrays, result)
        if value is None:
            made = jax_private.apply(eqn, list(arrays), eqn.source_info.traceback)
            return [np.asarray(x) for x in made]
        return value

    return evaluate


def _select(which: np.ndarray, *options: np.ndarray) -> np.ndarray:
    if len(options) == 2:
        return np.where(which, options[1], options[0])
    return folding.select(which, *options)


def _special(name: str) -> ArrayRule:
    # Late: loading it takes longer than most that is evaluated here.
    return lambda x: getattr(import_module("scipy.special"), name)(x)


_ALIKE: dict[str, ArrayRule] = {
    "acos": np.arccos, "acosh": np.arccosh, "asin": np.arcsin, "asinh": np.arcsinh,
    "atan": np.arctan, "atan2": np.arctan2, "atanh": np.arctanh, "cbrt": np.cbrt, "ceil": np.ceil,
    "copy": np.asarray, "cos": np.cos, "cosh": np.cosh, "erf": _special("erf"),
    "erf_inv": _special("erfinv"), "erfc": _special("erfc"), "exp": np.exp, "exp2": np.exp2,
    "expm1": np.expm1, "floor": np.floor, "is_finite": np.isfinite, "lgamma": _special("gammaln"),
    "log": np.log, "log1p": np.log1p, "logistic": _special("expit"), "pow": np.power,
    "rsqrt": lambda x: 1 / np.sqrt(x), "select_n": _select, "sin": np.sin, "sinh": np.sinh,
    "sqrt": np.sqrt, "square": np.square, "tan": np.tan, "tanh": np.tanh,
}  # fmt: skip


def _reduced(of: Callable) -> Callable[[Any], ArrayRule]:
    return lambda params: lambda x: of(x, axis=tuple(params["axes"]))


def _position(of: Callable) -> Callable[[Any], ArrayRule]:
    return lambda params: lambda x: of(x, axis=params["axes"][0]).astype(params["index_dtype"])


def _running(of: np.ufunc) -> Callable[[Any], ArrayRule]:
    def made(params: Any) -> ArrayRule:
        axis = params["axis"]
        if not params["reverse"]:
            return lambda x: of.accumulate(x, axis)
        return lambda x: np.flip(of.accumulate(np.flip(x, axis), axis), axis)

    return made


def _dot(params: Any) -> ArrayRule:
    (left, right), (left_batch, right_batch) = params["dimension_numbers"]

    def dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        free_left = [i for i in range(x.ndim) if i not in (*left, *left_batch)]
        free_right = [i for i in range(y.ndim) if i not in (*right, *right_batch)]
        batch, inner = [x.shape[i] for i in left_batch], [x.shape[i] for i in left]
        rows, columns = [x.shape[i] for i in free_left], [y.shape[i] for i in free_right]
        length = int(np.prod(inner, dtype=int))
        x = x.transpose([*left_batch, *free_left, *left]).reshape(
            [*batch, int(np.prod(rows)), length]
        )
        y = y.transpose([*right_batch, *right, *free_right])
        y = y.reshape([*batch, length, int(np.prod(columns))])
        return np.matmul(x, y).reshape([*batch, *rows, *columns])

    return dot


def _positions(
    shape: Sequence[int], starts: np.ndarray, widths: Sequence[int], window: Sequence[int],
    absent: Sequence[int], to: Sequence[int], batches: tuple[Sequence[int], Sequence[int]],
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:  # fmt: skip
    """The indices into an array of this `shape` of all numbers that a gather reads or a scatter
    writes, and whether the slice of each is within the array.

    Axes `window` of the result run over slices of these `widths` along all axes but the `absent`;
    `to`: the axis of each start. `batches`: axes of the array and of `starts` that go together.
    """
    outer, count = starts.shape[:-1], starts.ndim - 1 + len(window)
    around = [axis for axis in range(count) if axis not in window]

    def across(index: np.ndarray, axes: Sequence[int]) -> np.ndarray:
        sizes = dict(zip(axes, index.shape))
        return index.reshape([sizes.get(axis, 1) for axis in range(count)])

    result = [np.zeros([1] * count, np.int64) for _ in shape]
    along = [axis for axis in range(len(shape)) if axis not in (*absent, *batches[0])]
    for axis, width, output in zip(along, widths, window, strict=True):
        result[axis] = across(np.arange(width), [output])
    for axis, position in zip(*batches, strict=True):
        result[axis] = across(np.arange(outer[position]), [around[position]])
    for number, axis in enumerate(to):
        result[axis] = result[axis] + across(starts[..., number].astype(np.int64), around)
    full = [0] * count
    for axes, sizes in ((around, outer), (window, widths)):
        for axis, size in zip(axes, sizes, strict=True):
            full[axis] = size
    within = np.ones([1] * count, bool)
    for index, size in zip(result, shape):
        within = within & (index >= 0) & (index < size)
    within = np.all(within, axis=tuple(window), keepdims=True)
    clipped = (np.clip(index, 0, size - 1) for index, size in zip(result, shape))
    return tuple(np.broadcast_to(x, full) for x in clipped), np.broadcast_to(within, full)


def _gather(params: Any) -> ArrayRule:
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    to, absent = numbers.start_index_map, numbers.collapsed_slice_dims
    batches = numbers.operand_batching_dims, numbers.start_indices_batching_dims
    widths = [x for i, x in enumerate(sizes) if i not in (*absent, *batches[0])]
    filled = params["mode"].name == "FILL_OR_DROP"

    def gather(x: np.ndarray, starts: np.ndarray) -> np.ndarray:
        if params["mode"].name == "CLIP":
            starts = np.clip(starts, 0, [x.shape[axis] - sizes[axis] for axis in to])
        window = numbers.offset_dims
        index, within = _positions(x.shape, starts, widths, window, absent, to, batches)
        if not filled or within.all():
            return x[index]
        fill = params["fill_value"]
        return np.where(within, x[index], _missing(x.dtype) if fill is None else fill)

    return gather


def _missing(dtype: np.dtype) -> Any:
    """What JAX reads outside of an array."""
    if dtype.kind in "iu":
        return np.array(np.iinfo(dtype).min if dtype.kind == "i" else np.iinfo(dtype).max, dtype)
    return np.array(True) if dtype.kind == "b" else np.array(np.nan, dtype)


def _scatter(adding: bool) -> Callable[[Any], ArrayRule]:
    def made(params: Any) -> ArrayRule:
        numbers = params["dimension_numbers"]
        to, absent = numbers.scatter_dims_to_operand_dims, numbers.inserted_window_dims
        batches = numbers.operand_batching_dims, numbers.scatter_indices_batching_dims
        window = numbers.update_window_dims

        def scatter(x: np.ndarray, starts: np.ndarray, updates: np.ndarray) -> np.ndarray:
            widths = [updates.shape[axis] for axis in window]
            if params["mode"].name == "CLIP":
                along = [i for i in range(x.ndim) if i not in (*absent, *batches[0])]
                width = dict(zip(along, widths))
                starts = np.clip(starts, 0, [x.shape[i] - width.get(i, 1) for i in to])
            index, within = _positions(x.shape, starts, widths, window, absent, to, batches)
            result, index = np.array(x), tuple(i[within] for i in index)
            if adding:
                np.add.at(result, index, updates[within])
            else:
                result[index] = updates[within]
            return result

        return scatter

    return made


def _starts(x: np.ndarray, positions: Sequence[np.ndarray], sizes: Sequence[int]) -> tuple:
    """The slice that begins at these positions, moved into the array."""
    starts = [int(np.clip(at, 0, n - s)) for at, n, s in zip(positions, x.shape, sizes)]
    return tuple(slice(at, at + size) for at, size in zip(starts, sizes))


def _update(x: np.ndarray, part: np.ndarray, *positions: np.ndarray) -> np.ndarray:
    result = np.array(x)
    result[_starts(x, positions, part.shape)] = part
    return result


def _pad(params: Any) -> ArrayRule:
    def pad(x: np.ndarray, value: np.ndarray) -> np.ndarray:
        shape, reads, writes = [], [], []
        for size, (low, high, inner) in zip(x.shape, params["padding_config"]):
            shape.append(low + high + size + max(size - 1, 0) * inner)
            at = low + np.arange(size) * (inner + 1)
            reads.append(np.flatnonzero((at >= 0) & (at < shape[-1])))
            writes.append(at[reads[-1]])
        result = np.full(shape, value, x.dtype)
        result[np.ix_(*writes)] = x[np.ix_(*reads)]
        return result

    return pad


def _split(params: Any) -> ArrayRule:
    cuts = np.cumsum(params["sizes"])[:-1]
    return lambda x: np.split(x, cuts, params["axis"])


def _round(params: Any) -> ArrayRule:
    if int(params["rounding_method"]) == 1:  # to the nearest even number
        return np.rint
    return lambda x: np.copysign(np.floor(np.abs(x) + 0.5), x)


def _cholesky(params: Any) -> ArrayRule:
    def cholesky(x: np.ndarray) -> np.ndarray:
        try:
            return np.linalg.cholesky(x)
        except np.linalg.LinAlgError:
            return np.full_like(x, np.nan)

    return cholesky


def _scan(params: Any) -> ArrayRule:
    body = _program(params["jaxpr"])
    fixed, carried = jax_private.arguments_of_scan(params)
    length, inner = params["length"], params["jaxpr"].out_avals[carried:]

    def scan(*arrays: np.ndarray) -> list[np.ndarray]:
        held, state = arrays[:fixed], list(arrays[fixed : fixed + carried])
        rows = arrays[fixed + carried :]
        results = [np.empty((length, *x.shape), x.dtype) for x in inner]
        for t in reversed(range(length)) if params["reverse"] else range(length):
            both = body(*held, *state, *(x[t] for x in rows))
            state = both[:carried]
            for result, row in zip(results, both[carried:]):
                result[t] = row
        return [*state, *results]

    return scan


def _while(params: Any) -> ArrayRule:
    ask, body = _program(params["cond_jaxpr"]), _program(params["body_jaxpr"])
    first, second = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]

    def loop(*arrays: np.ndarray) -> list[np.ndarray]:
        state = list(arrays[second:])
        while ask(*arrays[:first], *state)[0]:
            state = body(*arrays[first:second], *state)
        return state

    return loop


def _platform(params: Any) -> ArrayRule:
    """Which of the programs for several platforms: that of processors, or of all others."""
    ours = [i for i, names in enumerate(params["platforms"]) if names is None or "cpu" in names]
    return lambda: np.array(ours[0], np.int32)


def _cond(params: Any) -> ArrayRule:
    branches = [_program(branch) for branch in params["branches"]]
    return lambda which, *arrays: branches[int(np.clip(which, 0, len(branches) - 1))](*arrays)


_RULES: dict[str, Callable[[Any], ArrayRule]] = {
    "argmax": _position(np.argmax), "argmin": _position(np.argmin), "cholesky": _cholesky,
    "cond": _cond, "cummax": _running(np.maximum), "cummin": _running(np.minimum),
    "cumprod": _running(np.multiply), "cumsum": _running(np.add), "dot_general": _dot,
    "dynamic_slice": lambda params: lambda x, *at: x[_starts(x, at, params["slice_sizes"])],
    "dynamic_update_slice": lambda params: _update, "gather": _gather,
    "integer_pow": lambda params: lambda x: x ** params["y"], "pad": _pad,
    "platform_index": _platform, "reduce_and": _reduced(np.all), "reduce_max": _reduced(np.max),
    "reduce_min": _reduced(np.min), "reduce_or": _reduced(np.any), "reduce_prod": _reduced(np.prod),
    "reduce_sum": _reduced(np.sum), "rev": lambda of: lambda x: np.flip(x, of["dimensions"]),
    "round": _round, "scan": _scan, "scatter": _scatter(adding=False),
    "scatter-add": _scatter(adding=True), "split": _split,
    "tile": lambda params: lambda x: np.tile(x, params["reps"]), "while": _while,
}  # fmt: skip
