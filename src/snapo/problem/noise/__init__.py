"""Noise: the engines' normals, and distributions as functions of them (`snapo.noise`)."""

from .base import Noise as Noise
from .base import draw as draw
from .base import prepare as prepare
from .base import size as size
from .base import uniform as uniform
from .chains import Correlated as Correlated
from .chains import Empirical as Empirical
from .chains import Markov as Markov
from .continuous import Exponential as Exponential
from .continuous import Gamma as Gamma
from .continuous import LogNormal as LogNormal
from .continuous import Normal as Normal
from .continuous import Student as Student
from .continuous import Uniform as Uniform
from .counter import Counter as Counter
from .counter import Draws as Draws
from .counter import Stored as Stored
from .counter import noise_of_steps as noise_of_steps
from .counts import Binomial as Binomial
from .counts import Counts as Counts
from .counts import NegativeBinomial as NegativeBinomial
from .counts import Poisson as Poisson

__all__ = [
    "Binomial", "Correlated", "Counts", "Empirical", "Exponential", "Gamma", "LogNormal", "Markov",
    "NegativeBinomial", "Noise", "Normal", "Poisson", "Student", "Uniform", "draw", "prepare",
    "size", "uniform",
]  # fmt: skip
