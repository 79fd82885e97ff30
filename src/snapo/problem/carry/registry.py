"""The kinds and functions that a policy's file may name; nothing else is made from a file."""

from collections.abc import Callable
from functools import cache
from importlib import import_module

import jax
import jax.numpy as jnp

# {class: its module}. Domains' modules are loaded where a file names one of theirs.
KINDS = {
    **dict.fromkeys(
        ("MLP", "Residual", "Constant", "Linear", "BaseStock", "Threshold", "Network"),
        "snapo.problem.policy",
    ),
    **dict.fromkeys(
        ("Box", "Choice", "Product", "Simplex", "Stop", "Integers"), "snapo.problem.actions"
    ),
    "Frozen": "snapo.problem.inputs",
    "Stages": "snapo.problem.policies.stages",
    "StoragePolicy": "snapo.domains.gas_storage.policy.network",
    "PensionPolicy": "snapo.domains.pension.policies.network",
    "AllocationLimits": "snapo.domains.pension.policies.limits",
    "Cover": "snapo.domains.pension.policies.limits",
    "Feedback": "snapo.domains.pharma.control.policy",
}

_SIMPLE = (
    jax.nn.silu, jax.nn.tanh, jax.nn.relu, jax.nn.gelu, jax.nn.elu, jax.nn.selu, jax.nn.softplus,
    jax.nn.sigmoid, jax.nn.leaky_relu, jax.nn.celu, jax.nn.relu6, jax.nn.soft_sign, jnp.sin,
)  # fmt: skip


@cache
def functions() -> dict[str, Callable]:
    """{name: function}: the activations that a file may name."""
    return {item.__name__: item for item in _SIMPLE}


def name_of(function: Callable) -> str | None:
    """The name under which a function is known; None for any other."""
    available = functions()
    return next((name for name, item in available.items() if item is function), None) or (
        "tanh" if function is jnp.tanh else None
    )


@cache
def kind(name: str) -> type:
    """The class of a name in `KINDS`."""
    return getattr(import_module(KINDS[name]), name)
