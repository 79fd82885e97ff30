"""Makes the objective that training maximises from the `[objective]` table of a case."""

from snapo.problem import objective as core

from .settings import ObjectiveTable


def make_objective(table: ObjectiveTable, output: str) -> core.Objective:
    """The objective that `table` describes, for the totals of `output` over the paths."""
    aversion = table.risk_aversion or 0.0
    match table.kind:
        case "mean":
            return core.Mean(output)
        case "cvar":
            return core.CVaR(output, table.level or 0.95)
        case "mean-variance":
            return core.MeanVariance(output, aversion)
        case "entropic":
            return core.Entropic(output, aversion)
        case "crra":
            return core.ExpectedUtility(output, core.CRRA(aversion, table.wealth or 0.0))
        case "target":
            return core.Target(output, table.target or 0.0)
