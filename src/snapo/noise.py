"""Distributions as functions of the engines' normals: `from snapo.noise import Poisson`."""

from .problem.noise import *  # noqa: F403
from .problem.noise import __all__ as __all__
