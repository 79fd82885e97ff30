"""Objectives: what an objective is (`base`), and those that there are (`measures`)."""

from .base import Objective as Objective
from .base import Totals as Totals
from .base import Weighted as Weighted
from .base import Weights as Weights
from .measures import CRRA as CRRA
from .measures import CVaR as CVaR
from .measures import Entropic as Entropic
from .measures import ExpectedUtility as ExpectedUtility
from .measures import Mean as Mean
from .measures import MeanVariance as MeanVariance
from .measures import OfCost as OfCost
from .measures import Probability as Probability
from .measures import Target as Target
