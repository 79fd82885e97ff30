"""Expected payments of a case, with their times and discount factors."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from ..people.liability import paid_at
from ..people.lpi import limited, log_growth
from ..records.case import PensionCase
from ..results.figures.reconcile import payments


class Due(NamedTuple):
    """Expected payments `flow` [N], with the loading for their expenses, their `discount` factors
    and their times in `years`."""

    flow: np.ndarray
    discount: np.ndarray
    years: np.ndarray


def due(case: PensionCase, inputs: dict[str, Any]) -> Due:
    """Payments due on the basis of the case, or of its curve where scenarios are supplied; with the
    expected increases of a limited indexation."""
    case = replace(case, scenarios=None)

    def both(values):
        grown = log_growth(case, values) if limited(case) else None
        return *payments(case, values), grown

    with jax.enable_x64(True):
        flow, discount, growth = jax.tree.map(np.asarray, jax.jit(both)(inputs))
    steps = paid_at(case, np.arange(len(flow)))
    if growth is not None:
        grown = np.exp(growth[steps])
        flow, discount = flow * grown, discount / grown
    return Due(flow, discount, steps * case.step)
