"""All private names of JAX that the compiler uses, and the releases they were tested with.

JAX promises nothing about them: each release may rename or change one. If the release is not among
those tested, or if a name is missing, `unavailable` gives the reason and nothing is compiled.
"""

import re
from importlib import import_module
from typing import Any

import jax

# The first tested release, and the first that was not tested.
TESTED = (0, 10), (0, 13)

# Calls are primitives whose names and parameters are JAX's affair: name -> parameter.
CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "checkpoint": "jaxpr",
    "remat": "jaxpr",
    "remat2": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "custom_vjp_call_jaxpr": "fun_jaxpr",
}
# The function inside `jnp.searchsorted`, or its own class, which is compiled as one operation.
_SEARCHES = ("_searchsorted_scan_impl", "SearchSorted")
# A primitive of a separate class, with a list of its parts.
_OWN_CLASS = "call_hi_primitive"
# Modules, and the names that are used of each.
_NAMES = {
    "jax.extend.core": ("Literal",),
    "jax._src.source_info_util": ("summarize", "user_frame", "user_context"),
}

_found: dict[str, Any] = {}
_missing: list[str] = []
for _module, _names in _NAMES.items():
    for _name in _names:
        try:
            _found[_name] = getattr(import_module(_module), _name)
        except (ImportError, AttributeError):
            _missing.append(f"{_module}.{_name}")


def unavailable(version: str = jax.__version__) -> str | None:
    """The reason why this release of JAX cannot be compiled from; None if it can."""
    first, end = TESTED
    release = tuple(int(part) for part in re.findall(r"\d+", version)[:2])
    if not first <= release < end:
        low, high = (".".join(map(str, item)) for item in TESTED)
        return f"jax {version} is not among the releases it was tested with ({low} to below {high})"
    if _missing:
        return f"jax {version} has no {', '.join(_missing)}"
    return None


def is_literal(atom) -> bool:
    """Whether an input of an equation is a number, not a variable."""
    return isinstance(atom, _found["Literal"])


def line_of(eqn) -> str:
    """The line of user code that an equation came from, as file:line:column and function."""
    return _found["summarize"](eqn.source_info)


def traceback_of(eqn, caller=None) -> Any:
    """An equation's traceback, or the caller's if it contains no line of user code."""
    traceback = eqn.source_info.traceback
    return caller if _found["user_frame"](traceback) is None else traceback


def called(eqn) -> Any:
    """The jaxpr of an equation that only calls it; None for every other equation."""
    name, params = eqn.primitive.name, eqn.params
    if searched_side(eqn) is not None:
        return None
    if name in CALLS:
        return params[CALLS[name]]
    if name == _OWN_CLASS:
        inputs = [v.aval for v in eqn.invars]
        return jax.make_jaxpr(lambda *values: eqn.primitive.to_lojax(*values, **params))(*inputs)
    return None


def searched_side(eqn) -> str | None:
    """ "left" or "right" for a `jnp.searchsorted` in one table; None for every other equation."""
    local = eqn.params.get("_prim")
    name = eqn.params.get("name") if local is None else type(local).__name__
    if name not in _SEARCHES or eqn.invars[0].aval.ndim != 1:
        return None
    if local is not None:
        return local.side
    # It asks whether query < entry, or query <= entry.
    return "right" if "lt_to" in str(eqn.params["jaxpr"].jaxpr) else "left"


def arguments_of_scan(params) -> tuple[int, int]:
    """The number of a `scan`'s arguments that are the same in all rounds, and of those carried."""
    if "ft_in" in params:
        fixed, carried, _ = params["ft_in"].unpack()
        return len(list(fixed)), len(list(carried))
    return params["num_consts"], params["num_carry"]


def apply(eqn, inputs: list, traceback) -> list:
    """Applies an equation, under the line of user code that it came from."""
    params = eqn.primitive.get_bind_params(eqn.params)
    with _found["user_context"](traceback), eqn.ctx.manager:
        outputs = eqn.primitive.bind(*inputs, **params)
    return outputs if eqn.primitive.multiple_results else [outputs]
