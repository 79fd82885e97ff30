"""Exceptions of a simulator's own code, each in one sentence with its line."""

import inspect
import os
import traceback
from typing import Any

import jax

from snapo.problem.actions import Product


def explained(error: BaseException, simulator: Any, method: str) -> tuple[str, str, str]:
    """The place of an exception with file:line, the mistake, and how to fix it."""
    message, fix = _sentence(error)
    fix = _guess(str(error), simulator, method) or fix
    frame = _own_frame(error, simulator)
    if frame is None:
        return method, message, fix
    where = f"{method}, {short(frame.filename)}:{frame.lineno}"
    return where, f"{message} In: {frame.line}" if frame.line else message, fix


def _sentence(error: BaseException) -> tuple[str, str]:
    for kind, subject, fix in _READABLE:
        if isinstance(error, kind):
            return subject, fix
    message = (str(error).strip().splitlines() or [""])[0]
    return f"{type(error).__name__}: {message}", "Correct this line; nothing after it was examined."


def _guess(message: str, simulator: Any, method: str) -> str:
    """The likely cause of an index that JAX refuses; empty where there is none."""
    size = {"initial": "initial_noise_size", "step": "noise_size"}.get(method, "")
    if "out of bounds for axis 0 with size 0" in message and getattr(simulator, size, None) == 0:
        return f"Where this is its noise: {size} is 0; make it the number of normals that it reads."
    if "string indexing" in message and isinstance(getattr(simulator, "action", None), Product):
        return "Where this is an action: self.action.parts(action) holds its parts by name."
    return ""


def _own_frame(error: BaseException, simulator: Any) -> traceback.FrameSummary | None:
    """The deepest frame in the simulator's own file, or else outside of the libraries."""
    frames = traceback.extract_tb(error.__traceback__)
    try:
        home = inspect.getsourcefile(type(simulator))
    except TypeError:
        home = None
    local = [f for f in frames if f.filename == home]
    libraries = (
        f"{os.sep}site-packages{os.sep}",
        os.path.dirname(__file__),
        "<frozen",
        "contextlib",
    )
    other = [f for f in frames if not any(part in f.filename for part in libraries)]
    # The caller of `check` stands first in the traceback; user code lies deeper.
    return local[-1] if local else (other[-1] if other else None)


def short(file: str | None) -> str:
    """A path relative to the working folder."""
    return os.path.relpath(file) if file and os.path.exists(file) else str(file)


_READABLE = [
    (
        jax.errors.TracerArrayConversionError,
        "NumPy was called on a number that JAX is tracing.",
        "Call jax.numpy (jnp) in place of numpy; NumPy is for fixed tables only.",
    ),
    (
        jax.errors.TracerBoolConversionError,
        "Python decides here (if, while, and, or, min, max) on a number that differs by path.",
        "Write jnp.where, or smooth.indicator, smooth.minimum, smooth.choose for a limit.",
    ),
    (
        jax.errors.TracerIntegerConversionError,
        "Python needs a whole number here (an index, a range), and it is one that JAX is tracing.",
        "Index a jax.numpy array with it (jnp.asarray(table)[i]), or make it static.",
    ),
    (
        jax.errors.NonConcreteBooleanIndexError,
        "A mask selects a number of entries that differs by path.",
        "Keep the shape: jnp.where(mask, x, 0.0).",
    ),
    (
        jax.errors.ConcretizationTypeError,
        "Python needs the value here (float(), int(), a shape), and it is one that JAX is tracing.",
        "Leave it an array: drop the float() or int(); shapes must not depend on numbers.",
    ),
    (
        jax.errors.UnexpectedTracerError,
        "A traced number was kept outside of the call (in a list, a global, an attribute).",
        "Carry it in the state that step returns.",
    ),
]
