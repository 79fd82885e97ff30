"""The return and the reserve of a fund of pots, shared out by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from snapo.domains.pension.pots.sharing import Reserve, closed, shared
from snapo.problem.smooth import Exact

POTS = jnp.array([60.0, 40.0])
EXPOSURE = jnp.array([1.5, 0.5])
CASH = jnp.array(0.02)


MONEY = st.just(0.0) | st.floats(1e-6, 1e3)
SHARE = st.floats(0.0, 2.0, allow_subnormal=False)


def three(each):
    return st.tuples(each, each, each).map(np.array)


# Of three pots, their reserve, and the rules for them; what they earned on annuities and cash.
RULES = {
    "pots": three(MONEY),
    "reserve": MONEY,
    "protection": three(SHARE),
    "exposure": three(SHARE),
    "cash": st.floats(-0.05, 0.3),
}


def year(pots, reserve, gained, lack=(0.0, 0.0), **changes):
    rules = {"fill_return": 0.1, "release": 0.2, "largest": 0.15} | changes
    return closed(
        pots, jnp.array(reserve), jnp.array(gained), lambda pots: jnp.array(lack), EXPOSURE,
        Reserve(**{k: jnp.array(v) for k, v in rules.items()}), Exact(),
    )  # fmt: skip


def test_protection_comes_first_and_the_rest_goes_by_exposure():
    """Annuities earn 5 % and 10 %, cash 2 %: protection 60 x (0.2 x 5 % + 0.8 x 2 %) = 1.56 and
    40 x 10 % = 4, of the reserve 10 x 2 % = 0.2; of a return of 16.06 there is an excess of 10.3, in
    parts of 90 : 20 : 10 to the pots and the reserve."""
    found = shared(
        POTS, jnp.array(10.0), jnp.array(16.06), jnp.array([0.05, 0.1]), CASH,
        jnp.array([0.2, 1.0]), EXPOSURE, Exact(),
    )  # fmt: skip
    assert float(found.excess) == pytest.approx(10.3)
    assert np.asarray(found.pots) == pytest.approx([1.56 + 10.3 * 0.75, 4 + 10.3 / 6])
    assert float(found.reserve) == pytest.approx(0.2 + 10.3 / 12)


@settings(deadline=None)
@given(**RULES)
def test_nothing_is_redistributed_where_all_earns_cash(pots, reserve, protection, exposure, cash):
    """DNB's condition, see `sharing`: without risk no pot and no reserve has anything of another's,
    whatever their rules are."""
    with jax.enable_x64(True):
        money, earned = pots.sum() + reserve, cash * (pots.sum() + reserve)
        found = shared(
            jnp.array(pots), jnp.array(reserve), jnp.array(earned), jnp.full(3, cash),
            jnp.array(cash), jnp.array(protection), jnp.array(exposure), Exact(),
        )  # fmt: skip
        close = {"rel": 1e-12, "abs": 1e-12 * (money + 1)}
        assert np.asarray(found.pots) == pytest.approx(cash * pots, **close)
        assert float(found.reserve) == pytest.approx(cash * reserve, **close)
        assert float(found.excess) == pytest.approx(0.0, abs=close["abs"])


@settings(deadline=None)
@given(returned=three(st.floats(-0.5, 0.5)), rate=st.floats(-2.0, 2.0), **RULES)
def test_all_that_was_earned_is_shared_and_no_more(
    pots, reserve, protection, exposure, cash, returned, rate
):
    earned = rate * (pots.sum() + reserve)
    with jax.enable_x64(True):
        found = shared(
            jnp.array(pots), jnp.array(reserve), jnp.array(earned), jnp.array(returned),
            jnp.array(cash), jnp.array(protection), jnp.array(exposure), Exact(),
        )  # fmt: skip
        size = 1e-12 * (pots.sum() + reserve + abs(earned) + 1)
        total = float(found.pots.sum() + found.reserve)
        # Without any pot there is nobody beside the reserve who could bear a loss.
        if pots.any() or rate >= -1:
            assert total == pytest.approx(earned, abs=size)
        assert float(found.reserve) >= -reserve - size


def test_a_loss_that_the_reserve_cannot_bear_falls_on_the_pots():
    """Of an excess loss of 111 a reserve of 1, which earned 2 % in cash, bears 1.02."""
    none = jnp.zeros(2)
    found = shared(
        POTS, jnp.array(1.0), jnp.array(2.02 - 111), none, CASH, none, jnp.array([0.5, 0.0]),
        Exact(),
    )  # fmt: skip
    assert float(found.reserve) == pytest.approx(-1.0)
    assert np.asarray(found.pots) == pytest.approx([1.2 - 111 + 1.02, 0.8])


def test_without_exposures_pots_share_what_no_protection_takes():
    none = jnp.zeros(2)
    nothing = jnp.array(0.0)
    found = shared(POTS, nothing, jnp.array(10.0), none, nothing, none, none, Exact())
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
