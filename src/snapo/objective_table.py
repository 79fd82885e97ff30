"""From the `[objective]` table of a case to the objective that the core makes large."""

from .case import Objective as ObjectiveTable
from .objective import CRRA, CVaR, Entropic, ExpectedUtility, Mean, MeanVariance, Objective, Target


def make_objective(table: ObjectiveTable, output: str) -> Objective:
    """The objective that `table` names, of the paths' totals of `output`."""
    aversion = table.risk_aversion or 0.0
    match table.kind:
        case "cvar":
            return CVaR(output, table.level or 0.95)
        case "mean-variance":
            return MeanVariance(output, aversion)
        case "entropic":
            return Entropic(output, aversion)
        case "crra":
            return ExpectedUtility(output, CRRA(aversion, table.wealth or 0.0))
        case "target":
            return Target(output, table.target or 0.0)
        case _:
            return Mean(output)
