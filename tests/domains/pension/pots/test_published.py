"""What is published of funds of pots with numbers: a fund's reserve, and the worth of its levy.

These are pieces. A worked example of the whole allocation (pots, returns and results by cohort)
was looked for and not found. The limits of the law are in `test_read.py`.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.pots.test_sharing import year

from snapo.domains.pension.pots.sharing import Reserve, closed, shared
from snapo.problem.smooth import Exact


def test_a_fund_that_publishes_its_reserve():
    """Heineken Pension Fund, "Pension scheme in the new pension system: solidarity reserve", 29
    October 2024 (heinekenpensioenfonds.nl/en): 7.5 % of the assets at the start; each year 20 % of it
    can supplement pensions up to the level of the year before, so that it lasts several bad years."""
    with jax.enable_x64(True):
        pots, reserve = jnp.array([60.0, 32.5]), 7.5
        for left, released in ((6.0, 1.5), (4.8, 1.2), (3.84, 0.96)):
            found = year(pots, reserve, -10.0, (0.0, 5.0))
            assert float(found.released) == pytest.approx(released, abs=1e-12)
            assert float(found.reserve) == pytest.approx(left, abs=1e-12)
            pots, reserve = found.pots, float(found.reserve)
        found = year(jnp.array([60.0, 32.5]), 7.5, -10.0, (0.0, 0.7))
        assert float(found.released) == pytest.approx(0.7)  # no more than that level needs


@pytest.mark.parametrize("interest", [0.0, 0.03])
def test_what_the_levy_on_excess_returns_is_worth(interest):
    """A year's levy of 10 % on a pot that is all in equity: the excess return is that over cash, so
    that it is 10 % of a call at the forward, exp(-r) E[(R - exp(r))+] = 2 Phi(sigma/2) - 1 under the
    pricing measure, whatever the interest r is. (Were interest part of the excess return, the 30 %
    below would be 35 % at an interest of 3 %.)

    With 20 % volatility (Committee Parameters 2022) and 45 years of work these levies take 30 % of
    the first contribution: "around 30 % of the pension savings of a young worker can subsequently be
    transferred to the solidarity reserve via a levy on future positive excess returns" (abstract of
    "Intergenerational Transfers in the New Dutch Pension Contract", De Economist 170, issue 1; its own
    assumptions are not in the abstract, so that this is a comparison of size and no reproduction)."""
    sigma, one, none = 0.2, jnp.ones(1), jnp.zeros(1)
    rules = Reserve(jnp.array(0.1), jnp.array(0.2), jnp.array(0.15))

    def levy(normal):
        earned, cash = jnp.expm1(interest + sigma * normal - sigma**2 / 2), jnp.expm1(interest)
        parts = shared(one, jnp.zeros(()), earned, none, cash, none, one, Exact())
        pots, reserve = one + parts.pots, parts.reserve
        end = closed(pots, reserve, parts.excess, lambda pots: 0 * pots, one, rules, Exact())
        return end.filled

    grid = np.linspace(-8, 8, 16001)
    with jax.enable_x64(True):
        levies = np.asarray(jax.jit(jax.vmap(levy))(jnp.asarray(grid)))
    density = np.exp(-(grid**2) / 2) / math.sqrt(2 * math.pi)
    worth = math.exp(-interest) * float(np.sum(levies * density) * (grid[1] - grid[0]))
    exact = 0.1 * math.erf(sigma / 2 / math.sqrt(2))
    assert worth == pytest.approx(exact, rel=1e-6)
    assert 1 - (1 - worth) ** 45 == pytest.approx(0.30, abs=0.005)
