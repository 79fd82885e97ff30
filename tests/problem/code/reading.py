"""A simulator that reads a number in every way there is, and what changes each of them."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np

import snapo

HORIZON = 5
INPUTS = {"price": snapo.Input(1.0, "EUR")}
GLOBAL = 1.0
TABLE = np.array([1.0, 7.0])
LISTED = [1.0]
OTHER: ModuleType  # see `written`


@dataclass
class Config:
    """Settings that may change in place."""

    factor: float = 1.0


CONFIG = Config()


def closed(number: float) -> Callable[[], float]:
    def read():
        return number

    return read


CLOSURE = closed(1.0)


def defaulted(number: float = 1.0) -> float:
    return number


def carried(total, x):
    """The body of a loop, whose program JAX keeps by the function."""
    return total + GLOBAL * x, None


@jax.jit
def compiled(x):
    """A function that the user compiles: JAX keeps its program as well."""
    return GLOBAL * x


def written(folder: Path, number: float) -> None:
    """The module that `OTHER` is, in a folder, with this number in it."""
    (folder / "read_by_step.py").write_text(
        f"FACTOR = {number!r}\ndef given(): return {number!r}\n"
    )
    importlib.invalidate_caches()


class Reading(snapo.Simulator):
    """The state stays 1; every output is the number that one way of reading gives."""

    horizon: int = HORIZON
    action: snapo.Box = snapo.Box(-np.inf, np.inf)
    noise_size: int = 0

    factor = 1.0  # of the class, no field

    def prepare(self, inputs):
        return snapo.Schedule({"price": GLOBAL * inputs["price"]}, {})

    def initial(self, constants, noise):
        return {"x": jnp.ones(())}

    def observe(self, constants, now, state):
        return state["x"][None]

    def patched(self):
        return 1.0

    def step(self, constants, now, state, action, noise, smooth):
        x = state["x"]
        return state, {
            "global": GLOBAL * x,
            "closure": CLOSURE() * x,
            "default": defaulted() * x,
            "class attribute": self.factor * x,
            "patched method": self.patched() * x,
            "module reload": OTHER.FACTOR * x,
            "function of another module": OTHER.given() * x,
            "field of a config": CONFIG.factor * x,
            "array in place": TABLE[0] * x,
            "list in place": LISTED[0] * x,
            "body of a loop": jax.lax.scan(carried, 0.0, x[None])[0],
            "compiled by the user": compiled(x),
            "schedule": constants["price"] * x,
        }


WAYS = (
    *("global", "closure", "default", "class attribute", "patched method", "module reload"),
    *("function of another module", "field of a config", "array in place", "list in place"),
)
ALSO = {  # what else is read from the same place
    "global": ("body of a loop", "compiled by the user", "schedule"),
    "module reload": ("function of another module",),
}


def change(way: str, number: float, folder: Path) -> None:
    """Changes the number that is read in this way."""
    here = globals()
    if way == "global":
        here["GLOBAL"] = number
    elif way == "closure":
        here["CLOSURE"] = closed(number)
    elif way == "default":
        defaulted.__defaults__ = (number,)
    elif way == "class attribute":
        Reading.factor = number
    elif way == "patched method":
        setattr(Reading, "patched", lambda self: number)  # noqa: B010
    elif way == "module reload":
        written(folder, number)
        importlib.reload(OTHER)
    elif way == "function of another module":
        setattr(OTHER, "given", lambda: number)  # noqa: B010
    elif way == "field of a config":
        CONFIG.factor = number
    elif way == "array in place":
        TABLE[0] = number
    else:
        LISTED[0] = number
