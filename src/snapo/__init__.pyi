"""The public names of snapo, listed here once: type checkers and `__init__.py` read this file."""

from snapo.checker.check import check as check
from snapo.engine import Clip as Clip
from snapo.engine import Native as Native
from snapo.engine import Window as Window
from snapo.engine import Xla as Xla
from snapo.problem.actions import Box as Box
from snapo.problem.actions import Simplex as Simplex
from snapo.problem.chain import Chain as Chain
from snapo.problem.inputs import Frozen as Frozen
from snapo.problem.inputs import Input as Input
from snapo.problem.objective import CRRA as CRRA
from snapo.problem.objective import CVaR as CVaR
from snapo.problem.objective import Entropic as Entropic
from snapo.problem.objective import ExpectedUtility as ExpectedUtility
from snapo.problem.objective import Mean as Mean
from snapo.problem.objective import MeanVariance as MeanVariance
from snapo.problem.objective import Probability as Probability
from snapo.problem.objective import Target as Target
from snapo.problem.policy import MLP as MLP
from snapo.problem.policy import BaseStock as BaseStock
from snapo.problem.policy import Constant as Constant
from snapo.problem.policy import Linear as Linear
from snapo.problem.policy import Policy as Policy
from snapo.problem.policy import Residual as Residual
from snapo.problem.policy import Threshold as Threshold
from snapo.problem.scenarios import Pseudo as Pseudo
from snapo.problem.scenarios import Sobol as Sobol
from snapo.problem.scenarios import Supplied as Supplied
from snapo.problem.simulator import Schedule as Schedule
from snapo.problem.simulator import Simulator as Simulator
from snapo.problem.smooth import Exact as Exact
from snapo.problem.smooth import Smooth as Smooth
from snapo.solver.adjoint import Gradient as Gradient
from snapo.solver.adjoint import value_and_gradient as value_and_gradient
from snapo.solver.certificate import bump_check as bump_check
from snapo.solver.certificate import feasibility as feasibility
from snapo.solver.sensitivity import second_order as second_order
from snapo.solver.sensitivity import sensitivities as sensitivities
from snapo.solver.solution import Solution as Solution
from snapo.solver.solution import load_policy as load_policy
from snapo.solver.solve import Evaluation as Evaluation
from snapo.solver.solve import solve as solve
from snapo.solver.train import Training as Training

__version__: str
