"""The version of a user's code: a number for everything it reads, such as globals and closures.

A program that was compiled for a simulator can be used as long as its code reads the same objects.
Every call of such a program is therefore within `following(version)`: JAX then does not reuse a
trace of another version, in functions that the user compiles too. snapo's code has no version.

Programs are compared as text: two traces that read the same objects have the same text.
"""

import re
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from functools import wraps
from hashlib import blake2b
from itertools import count
from threading import RLock
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .. import inputs as inputs_
from ..smooth import Exact, Smooth
from .walk import ARRAYS, Walk

ProgramText = tuple[str, tuple[bytes, ...]]


def text(function: Callable[..., Any], *arguments: Any) -> ProgramText:
    """A function's program as text without memory addresses, and digests of its constants.
    `function` must be a new object, since JAX keeps the traces of earlier ones.
    """
    closed = jax.make_jaxpr(function)(*arguments)
    constants = tuple(blake2b(np.asarray(const).tobytes()).digest() for const in closed.consts)
    return re.sub(r"0x[0-9a-f]+", "", str(closed.jaxpr)), constants


def preparation(simulator: Any, inputs: PyTree) -> ProgramText:
    """The program of `prepare`."""
    return text(lambda v: simulator.prepare(inputs_.replace(inputs, v)), inputs_.values(inputs))


def path(simulator: Any, policy: Any) -> Callable[..., Any]:
    """One path's start, step and end, exact and smooth."""

    def step(constants, now, initial, noise, action) -> Any:
        state = simulator.initial(constants, initial)
        made = [state, simulator.state_scale(constants)]
        for smooth in (Exact(), Smooth(0.1)):
            observed = simulator.observe(constants, now, state)
            decided = action if policy is None else policy(observed, smooth)
            after, outputs = simulator.step(constants, now, state, decided, noise, smooth)
            made += [observed, after, outputs, simulator.terminal(constants, state, smooth)]
            made.append(dict(simulator.slack(constants, now, after, outputs)))
        return eqx.filter(made, eqx.is_array)

    return step


def rollout(simulator: Any, policy: Any, schedule: Any) -> Any:
    """The program of one step and of the end, exact and smooth, with all declarations."""
    sizes = simulator.initial_noise_size, simulator.noise_size, simulator.action.size
    now = jax.tree.map(lambda leaf: jnp.asarray(leaf)[0], schedule.steps)
    vectors = [jnp.zeros(size) for size in sizes]
    made = text(
        path(simulator, policy), jax.tree.map(jnp.asarray, schedule.constants), now, *vectors
    )
    return made, sizes, dict(simulator.totals()), simulator.control_variates()


KEPT = 512  # versions; one that returns after this number of others is recompiled
Version = int | None
P = ParamSpec("P")
R = TypeVar("R")

read_context: Callable[[Hashable], AbstractContextManager] = jax.make_user_context(None)
_held: ContextVar[dict | None] = ContextVar("held", default=None)


@contextmanager
def reading_once() -> Iterator[None]:
    """All code is read once, on first use: it does not change within the context."""
    if _held.get() is not None:
        yield
        return
    token = _held.set({})
    try:
        yield
    finally:
        _held.reset(token)


def followed(function: Callable[P, R], version: Version) -> Callable[P, R]:
    """A compiled function, every call of which follows this version."""

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        with read_context(version):
            return function(*args, **kwargs)

    return call


def of_preparation(simulator: Any, inputs: PyTree) -> Version:
    """The version of the code that makes schedules."""
    return of((simulator, inputs), lambda: preparation(simulator, inputs))


def of_rollout(simulator: Any, policy: Any, schedule: Any, smooth: Any = None) -> Version:
    """The version of the code that simulates paths."""
    trees = simulator, policy, schedule, smooth
    return of(trees, lambda: rollout(simulator, policy, schedule))


def of_policy(policy: Any, observed: Any, observe: Any = None) -> Version:
    """The version of the code that decides at [N, k] numbers: `observe`, if any, and a policy."""

    def decided(item: Any) -> Any:
        return policy(item if observe is None else jnp.asarray(observe(item)), Exact())

    return of((policy, observe), lambda: text(decided, observed[0]))


def of_formula(objective: Any, totals: Any) -> Version:
    """The version of the code of an objective."""
    return of((objective,), lambda: text(lambda item: objective.formula(item), totals))


def of(trees: tuple[PyTree, ...], trace: Callable[[], Any]) -> Version:
    """The version of all code in some trees; None if none of the code is the user's. Parts that may
    have changed in place, or cannot be inspected, are compared by the program that `trace` returns.
    """
    leaves, structure = jax.tree.flatten(trees)
    held, met = _held.get(), (structure, tuple(map(_kind, leaves)))
    if not _is_hashable(met):
        return _read(trees, leaves, trace)
    if _without_user_code.has(met):
        return None
    if held is not None and met in held:
        return held[met]
    version = _read(trees, leaves, trace)
    if held is not None:
        held[met] = version
    if version is None:  # all of it is in packages, which do not change
        _without_user_code.of(met, lambda: None)
    return version


def _read(trees: tuple[PyTree, ...], leaves: list, trace: Callable[[], Any]) -> Version:
    walk = Walk(trees)
    if not walk.user_code:
        return None
    available: Hashable = tuple(walk.fixed)
    if walk.moving or walk.unseen:
        shapes = tuple(_kind(leaf) for leaf in leaves if _is_array(leaf))
        content = available, tuple(walk.moving), shapes
        available = (
            available,
            _programs.of(content, lambda: _digest(trace, content), read_again=walk.unseen),
        )
    return _versions.of(available, lambda: next(_next))


class _Kept:
    """The latest results by their keys; thread-safe."""

    def __init__(self):
        self._found: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = RLock()  # a trace may ask for another version

    def of(self, key: Hashable, make: Callable[[], Any], read_again: bool = False) -> Any:
        with self._lock:
            if read_again or key not in self._found:
                self._found[key] = make()
            self._found.move_to_end(key)
            while len(self._found) > KEPT:
                self._found.popitem(last=False)
            return self._found[key]

    def has(self, key: Hashable) -> bool:
        with self._lock:
            return key in self._found


_next = count(1)
_versions, _programs, _without_user_code = _Kept(), _Kept(), _Kept()


def _digest(trace: Callable[[], Any], content: tuple) -> bytes:
    """A digest of the program that is traced now."""
    try:
        with read_context(object()), jax.enable_x64(True):
            made = repr(trace())
    except Exception as error:  # the call itself will report it
        made = type(error).__name__
    # The printed program does not show the values that hand-written derivatives read.
    read = repr(content) if "custom_" in made else ""
    return blake2b((made + read).encode()).digest()


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, ARRAYS)


def _kind(leaf: Any) -> Hashable:
    """Shape and dtype of an array, which is an argument; any other leaf itself."""
    return (leaf.shape, leaf.dtype) if _is_array(leaf) else (type(leaf), leaf)


def _is_hashable(x: Any) -> bool:
    try:
        hash(x)
    except TypeError:
        return False
    return True
