"""Objectives: the base class (`base`), and the usual measures (`measures`)."""

from .base import AtLeast as AtLeast
from .base import AtMost as AtMost
from .base import Limit as Limit
from .base import Mean as Mean
from .base import Objective as Objective
from .base import Totals as Totals
from .base import Weighted as Weighted
from .base import Weights as Weights
from .base import as_constraints as as_constraints
from .base import as_objective as as_objective
from .base import priced as priced
from .measures import CRRA as CRRA
from .measures import CVaR as CVaR
from .measures import Entropic as Entropic
from .measures import ExpectedUtility as ExpectedUtility
from .measures import MeanVariance as MeanVariance
from .measures import OfCost as OfCost
from .measures import Probability as Probability
from .measures import Target as Target
