"""The methods of a simulator with arguments to call them with, and their lines of code."""

import linecache
import os
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax._src import source_info_util
from jaxtyping import PyTree

from snapo.problem import inputs as inputs_
from snapo.problem.simulator import Schedule, Simulator, at
from snapo.problem.smooth import Exact

from .findings import short

_SNAPO = os.path.dirname(os.path.dirname(__file__))
# Code that a user's line calls: its caller is named.
_OWN = tuple(os.path.join(_SNAPO, part, "") for part in ("problem", "checker", "engine", "solver"))
_LIBRARIES = f"{os.sep}site-packages{os.sep}"


class Method(NamedTuple):
    """A method as a function of `arguments`, by name, in the order of the method."""

    name: str
    function: Callable[..., Any]
    arguments: dict[str, Any]

    def traced(self):
        """Its program."""
        return jax.make_jaxpr(self.function)(*self.arguments.values())

    def labels(self) -> list[str]:
        """The names of its arrays, in the order in which JAX takes them."""
        return [
            name + jax.tree_util.keystr(path)
            for name, tree in self.arguments.items()
            for path, _ in jax.tree_util.tree_flatten_with_path(tree)[0]
        ]


def methods(
    simulator: Simulator, schedule: Schedule, smooth: Any = None, dtype: Any = np.float64
) -> list[Method]:
    """`initial`, `observe`, `step` and `terminal` at the first step, in a precision."""
    smooth = Exact() if smooth is None else smooth

    def cast(x):
        floating = jnp.issubdtype(np.asarray(x).dtype, np.floating)
        return jnp.asarray(x, dtype) if floating else jnp.asarray(x)

    def zeros(size):
        return jax.ShapeDtypeStruct((size,), dtype)

    constants, now = jax.tree.map(cast, (schedule.constants, at(schedule.steps, 0)))
    start = zeros(simulator.initial_noise_size)
    state = jax.eval_shape(simulator.initial, constants, start)
    moment = {"constants": constants, "now": now, "state": state}
    decided = {"action": zeros(simulator.action.size), "noise": zeros(simulator.noise_size)}
    return [
        Method(
            "initial",
            lambda c, z: simulator.initial(c, z),
            {"constants": constants, "noise": start},
        ),
        Method("observe", lambda c, n, s: simulator.observe(c, n, s), moment),
        Method(
            "step", lambda c, n, s, a, z: simulator.step(c, n, s, a, z, smooth), moment | decided
        ),
        Method(
            "terminal",
            lambda c, s: simulator.terminal(c, s, smooth),
            {"constants": constants, "state": state},
        ),
    ]


def preparation(simulator: Simulator, inputs: PyTree) -> Method:
    """`prepare` as a function of the inputs' values, by their names."""
    by_name = inputs_.named_inputs(inputs)
    values = inputs_.values(inputs)
    if len(by_name) != len(values):
        return Method(
            "prepare",
            lambda v: simulator.prepare(inputs_.replace(inputs, v)),
            {"inputs": values},
        )
    return Method(
        "prepare",
        lambda *v: simulator.prepare(inputs_.replace(inputs, list(v))),
        {entry.name: value for entry, value in zip(by_name, values)},
    )


class CodeLine(NamedTuple):
    """A line of code; `internal`: whether it is one of snapo's, and not the user's."""

    file: str
    number: int
    text: str
    internal: bool

    def __str__(self) -> str:
        return f"{short(self.file)}:{self.number}"


def line_of(eqn) -> CodeLine | None:
    """The line that an equation came from."""
    frames = source_info_util.user_frames(eqn.source_info.traceback)
    return line_among([(frame.file_name, frame.start_line) for frame in frames])


def said_by_user(eqn) -> bool:
    """Whether a read is `x.at[index].get(mode=…)`, which defines reads outside of `x`.

    With mode="clip", JAX's program is that of x[index].
    """
    traceback = eqn.source_info.traceback
    codes = traceback.raw_frames()[0] if traceback else []
    return any(code.co_name == "get" and "jax" in code.co_filename for code in codes)


def line_among(frames: list[tuple[str, int]]) -> CodeLine | None:
    """The innermost frame of the user's code; if there is none, the first one of snapo."""
    frames = [(file, number) for file, number in frames if _LIBRARIES not in file]
    users = [frame for frame in frames if not frame[0].startswith(_OWN)]
    if not frames:
        return None
    file, number = (users or frames)[0]
    local = frames[0][0].startswith(_OWN)
    return CodeLine(file, number, linecache.getline(file, number).strip(), local)
