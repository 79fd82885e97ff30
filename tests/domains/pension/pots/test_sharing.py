"""The return and the reserve of a fund of pots, shared out by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from snapo.domains.pension.pots.sharing import Reserve, closed, shared
from snapo.problem.smooth import Exact

POTS = jnp.array([60.0, 40.0])
EXPOSURE = jnp.array([1.5, 0.5])


def year(pots, reserve, gained, lack=(0.0, 0.0), **changes):
    rules = {"fill_return": 0.1, "release": 0.2, "largest": 0.15} | changes
    return closed(
        pots, jnp.array(reserve), jnp.array(gained), lambda pots: jnp.array(lack), EXPOSURE,
        Reserve(**{k: jnp.array(v) for k, v in rules.items()}), Exact(),
    )  # fmt: skip


def test_protection_comes_first_and_the_rest_goes_by_exposure():
    """Annuities rise by 5 % and 10 %: protection 0.2 x 60 x 5 % = 0.6 and 1 x 40 x 10 % = 4; of a
    return of 14.9 there is an excess of 10.3, in parts of 90 : 20 : 10 to the pots and the reserve."""
    found = shared(
        POTS, jnp.array(10.0), jnp.array(14.9), jnp.array([0.05, 0.1]), jnp.array([0.2, 1.0]),
        EXPOSURE, Exact(),
    )  # fmt: skip
    assert float(found.excess) == pytest.approx(10.3)
    assert np.asarray(found.pots) == pytest.approx([0.6 + 10.3 * 0.75, 4 + 10.3 / 6])
    assert float(found.reserve) == pytest.approx(10.3 / 12)


def test_a_loss_that_the_reserve_cannot_bear_falls_on_the_pots():
    none = jnp.zeros(2)
    found = shared(
        POTS, jnp.array(1.0), jnp.array(-111.0), none, none, jnp.array([0.5, 0.0]), Exact()
    )
    assert float(found.reserve) == -1.0
    assert np.asarray(found.pots) == pytest.approx([-110.0, 0.0])


def test_without_exposures_pots_share_what_no_protection_takes():
    none = jnp.zeros(2)
    found = shared(POTS, jnp.array(0.0), jnp.array(10.0), none, none, none, Exact())
    assert np.asarray(found.pots) == pytest.approx([6.0, 4.0])


def test_the_reserve_takes_its_share_of_a_year_with_gains():
    found = year(POTS, 5.0, 20.0)
    assert float(found.filled) == pytest.approx(2.0)
    assert np.asarray(found.pots) == pytest.approx([60 - 2 * 90 / 110, 40 - 2 * 20 / 110])
    assert float(found.reserve) == pytest.approx(7.0)
    assert float(year(POTS, 5.0, -20.0).filled) == 0.0


def test_it_never_holds_more_than_the_law_allows_and_gives_back_the_rest():
    assert float(year(POTS, 17.0, 20.0).reserve) == pytest.approx(0.15 * 117)
    found = year(POTS, 25.0, 20.0)
    assert float(found.reserve) == pytest.approx(0.15 * 125)
    assert float(found.filled) == pytest.approx(0.15 * 125 - 25)
    assert np.asarray(found.pots).sum() == pytest.approx(100 - float(found.filled))


def test_it_restores_pensions_with_no_more_than_a_share_of_itself():
    found = year(POTS, 10.0, 0.0, (0.0, 1.5))
    assert np.asarray(found.pots) == pytest.approx([60.0, 41.5])
    assert float(found.released) == pytest.approx(1.5)
    found = year(POTS, 10.0, 0.0, (3.0, 1.0))
    assert float(found.released) == pytest.approx(2.0)
    assert np.asarray(found.pots) == pytest.approx([61.5, 40.5])
    assert float(found.reserve) == pytest.approx(8.0)
