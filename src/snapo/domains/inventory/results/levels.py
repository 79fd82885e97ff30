"""The trained rule as a table: the order, and the level up to which it goes, by state."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact
from snapo.study.study import Part, Setup, StudyRun, Today

from ..item.records import InventoryCase
from ..setup import case_of

POINTS = 41  # of the stock
SHARES = (0.5, 1.0, 1.5)  # of the usual amount on its way


def work(run: StudyRun) -> dict[str, Any]:
    """ "levels": stock [n], and one entry per amount on its way (spread over the lead time): the
    orders [n], and the level up to which they go: stock, on its way and ordered together."""
    setup, case = run.setup, case_of(run.setup)
    now = at(setup.problem.schedule.steps, case.warm_up)
    stock = stocks(case, float(now["level"]))
    usual = np.asarray(now["mean"], np.float64)[1 : max(case.item.lead, 1)]
    curves, policy = [], run.solution.policy
    assert policy is not None
    for share in SHARES if len(usual) else (1.0,):
        coming = share * usual
        coming = np.round(coming) if case.item.whole else coming
        placed = orders(setup, policy, stock, coming)
        level = np.where(placed > 0, stock + coming.sum() + placed, np.nan)
        curves.append({"coming": coming.sum(), "orders": placed, "levels": level})
    return {"levels": {"stock": stock, "curves": curves}}


LEVELS = Part("order-up-to levels", work, needs=("training",))


def stocks(case: InventoryCase, level: float) -> np.ndarray:
    """Stocks from none, or from demand that waits, to somewhat above the level."""
    low = 0.0 if case.item.lost else -level / 2
    found = np.linspace(low, 1.2 * level, POINTS)
    return np.unique(np.round(found)) if case.item.whole else found


def orders(setup: Setup, policy: Policy, stock: np.ndarray, coming: np.ndarray) -> np.ndarray:
    """[n] exact orders of the rule at these stocks, in the first period that counts."""
    problem, case = setup.problem, case_of(setup)
    simulator, fixed = problem.simulator, case.item.fixed
    schedule = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), problem.schedule)
    now = at(schedule.steps, case.warm_up)

    @jax.jit
    def of(stock):
        state = {"stock": stock}
        if case.item.lead > 1:
            state["coming"] = jnp.asarray(coming, jnp.float32)
        seen = simulator.observe(schedule.constants, now, state)
        action = policy(seen, Exact())
        return action[1] * action[2] if fixed else action[0]

    return np.asarray(jax.vmap(of)(jnp.asarray(stock, jnp.float32)), np.float64)


def today(setup: Setup, policy: Policy) -> Today:
    """The order at the start."""
    case, constants = case_of(setup), setup.problem.schedule.constants
    stock, coming = float(constants["stock"]), np.asarray(constants["coming"], np.float64)
    order = float(orders(setup, policy, np.array([stock]), coming)[0])
    facts = [
        ("stock", stock, case.unit),
        ("on its way", float(coming.sum()), case.unit),
        ("order", order, case.unit),
    ]
    words = f"order {order:,.4g} {case.unit}s" if order > 0 else "order nothing"
    return Today(words, facts)
