"""Smooth Neural Adjoint Policy Optimization: decisions under uncertainty, with every gradient.

The public names. They are loaded when first used, so that `snapo --help` need not load JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .adjoint import Gradient as Gradient
    from .adjoint import value_and_gradient as value_and_gradient
    from .certificate import bump_check as bump_check
    from .certificate import feasibility as feasibility
    from .chain import Chain as Chain
    from .checker import check as check
    from .engine import Clip as Clip
    from .engine import Native as Native
    from .engine import Window as Window
    from .engine import Xla as Xla
    from .inputs import Frozen as Frozen
    from .inputs import Input as Input
    from .objective import CRRA as CRRA
    from .objective import CVaR as CVaR
    from .objective import Entropic as Entropic
    from .objective import ExpectedUtility as ExpectedUtility
    from .objective import Mean as Mean
    from .objective import MeanVariance as MeanVariance
    from .objective import Probability as Probability
    from .objective import Target as Target
    from .policy import MLP as MLP
    from .policy import BaseStock as BaseStock
    from .policy import Constant as Constant
    from .policy import Linear as Linear
    from .policy import Policy as Policy
    from .policy import Residual as Residual
    from .policy import Threshold as Threshold
    from .scenarios import Pseudo as Pseudo
    from .scenarios import Sobol as Sobol
    from .scenarios import Supplied as Supplied
    from .sensitivity import second_order as second_order
    from .sensitivity import sensitivities as sensitivities
    from .simulator import Box as Box
    from .simulator import Schedule as Schedule
    from .simulator import Simplex as Simplex
    from .simulator import Simulator as Simulator
    from .smooth import Exact as Exact
    from .smooth import Smooth as Smooth
    from .solution import Solution as Solution
    from .solution import load_policy as load_policy
    from .solver import Evaluation as Evaluation
    from .solver import solve as solve
    from .train import Training as Training

__version__ = "0.1.0"

_HOME = {
    "adjoint": ("Gradient", "value_and_gradient"),
    "certificate": ("bump_check", "feasibility"),
    "chain": ("Chain",),
    "checker": ("check",),
    "engine": ("Clip", "Native", "Window", "Xla"),
    "inputs": ("Frozen", "Input"),
    "objective": (
        "CRRA",
        "CVaR",
        "Entropic",
        "ExpectedUtility",
        "Mean",
        "MeanVariance",
        "Probability",
        "Target",
    ),
    "policy": ("MLP", "BaseStock", "Constant", "Linear", "Policy", "Residual", "Threshold"),
    "scenarios": ("Pseudo", "Sobol", "Supplied"),
    "sensitivity": ("second_order", "sensitivities"),
    "simulator": ("Box", "Schedule", "Simplex", "Simulator"),
    "smooth": ("Exact", "Smooth"),
    "solution": ("Solution", "load_policy"),
    "solver": ("Evaluation", "solve"),
    "train": ("Training",),
}
_MODULE = {name: module for module, names in _HOME.items() for name in names}
__all__ = ["__version__", *_MODULE]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module 'snapo' has no attribute {name!r}")
    return getattr(import_module(f".{_MODULE[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
