"""Noise: the engines' normals, and distributions as functions of them (`snapo.noise`)."""

from .base import Noise as Noise
from .base import draw as draw
from .base import prepare as prepare
from .base import size as size
from .base import uniform as uniform
from .continuous import Exponential as Exponential
from .continuous import LogNormal as LogNormal
from .continuous import Normal as Normal
from .continuous import Uniform as Uniform
from .counter import Counter as Counter
from .counter import Draws as Draws
from .counter import Stored as Stored
from .counts import Binomial as Binomial
from .counts import Counts as Counts
from .counts import NegativeBinomial as NegativeBinomial
from .counts import Poisson as Poisson
from .gamma import Gamma as Gamma
from .gamma import Student as Student
from .history import Empirical as Empirical
from .joint import Correlated as Correlated
from .regimes import Markov as Markov

__all__ = [
    "Binomial", "Correlated", "Counts", "Empirical", "Exponential", "Gamma", "LogNormal", "Markov",
    "NegativeBinomial", "Noise", "Normal", "Poisson", "Student", "Uniform", "draw", "prepare",
    "size", "uniform",
]  # fmt: skip
