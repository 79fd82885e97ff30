"""One step of the market: the generator's, or that of a file of ready-made scenarios."""

from typing import Any

import numpy as np
from jaxtyping import Array

from ..records.case import PensionModel
from .generated import generated_move, generated_schedule
from .shocks import slots
from .state import Market, MarketSteps, MarketTerms, Move
from .supplied import supplied_move, supplied_schedule


def noise_size(case: PensionModel) -> int:
    """Numbers that a step needs: normals, or the columns of a scenario file."""
    return slots(case).size if case.scenarios is None else len(case.scenarios.columns)


def market_schedule(
    case: PensionModel, inputs: dict[str, Any], nodes: np.ndarray
) -> tuple[MarketTerms, MarketSteps, Array]:
    """Terms, steps and the nodes' `shape` [T+1, J]; `nodes` [J] whole steps to a payment."""
    if case.scenarios is not None:
        return supplied_schedule(case, case.scenarios, inputs, nodes)
    return generated_schedule(case, inputs, nodes)


def move(
    case: PensionModel, terms: MarketTerms, now: MarketSteps, market: Market, noise: Array
) -> Move:
    """The market over one step."""
    if case.scenarios is not None:
        return supplied_move(case, terms, market, noise)
    return generated_move(case, terms, now, market, noise)
