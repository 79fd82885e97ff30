"""Limits of the swaps in money: the unit of their shares, and notionals from places."""

import jax
import numpy as np

from snapo.problem.problem import prepare

from ..records.case import PensionCase
from ..records.inputs import pension_inputs
from .books import balance, opening
from .simulator import PensionSimulator


def notionals(case: PensionCase, positions: np.ndarray, values: np.ndarray) -> np.ndarray:
    """[b] notionals where the policy puts them, from their `positions` in the ranges, 0 to 1.

    `values`: [b] the money to which limits refer (see `limit_unit`).
    """
    overlay = case.overlay
    if overlay is None:
        return np.zeros(0)
    shares = overlay.low + positions * (overlay.high - overlay.low)
    requested = shares * values
    assets = float(case.assets.amount.used())
    total, maximum = np.abs(requested).sum() / assets, float(overlay.leverage.used())
    return requested * min(1.0, maximum / total) if total > 0 else requested


def limit_unit(case: PensionCase) -> np.ndarray:
    """[b] money that the limits of the swaps are shares of today: all assets, or the liability
    payments nearest to each bucket."""
    if case.overlay is None or case.overlay.unit == "assets":
        return np.full(case.buckets, float(case.assets.amount.used()))
    simulator = PensionSimulator.of(case)
    schedule = prepare(simulator, pension_inputs(case))
    terms, steps = schedule.constants, schedule.steps
    people = jax.tree.map(lambda rows: rows[0], steps.people)
    with jax.enable_x64(True):
        books = balance(simulator.model, terms, people, steps.shape[0], opening(terms))
        return np.asarray(terms.swaps.nearest @ books.by_node)
