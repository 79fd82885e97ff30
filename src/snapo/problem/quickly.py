"""Programs that run a few times only: compiled in less time than XLA takes by itself."""

from collections.abc import Callable
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax

P = ParamSpec("P")
R = TypeVar("R")
JIT: Any = eqx.filter_jit  # hands on to jax.jit whatever it does not know itself
LEVEL, EMITTERS = "xla_backend_optimization_level", "xla_cpu_use_fusion_emitters"


def compiled_sooner(function: Callable[P, R]) -> Callable[P, R]:
    """`eqx.filter_jit` in two thirds of the time, for a program as fast: what a problem prepares.

    Nothing differs but the last bits. On other devices than processors it is `eqx.filter_jit`.
    """
    return _compiled(function, 1)


def compiled_at_once(function: Callable[P, R]) -> Callable[P, R]:
    """The same in a quarter of the time, and the program two to four times as slow: to run once."""
    return _compiled(function, 0)


def _compiled(function: Callable[P, R], level: int) -> Callable[P, R]:
    @cache
    def compiled():
        return JIT(function, compiler_options=_options(level))

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        return compiled()(*args, **kwargs)

    return call


@cache
def _options(level: int) -> dict | None:
    """The options that this XLA knows; None on another device."""
    if jax.default_backend() != "cpu":
        return None
    wanted = {LEVEL: level, EMITTERS: False}
    return {name: value for name, value in wanted.items() if _known(name, value)}


def _known(name: str, value: int | bool) -> bool:
    nothing = jax.jit(lambda: 0, compiler_options={name: value})
    try:
        nothing.lower().compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True
