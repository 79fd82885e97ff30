"""Memory grows with the days of a contract, not with their square."""

import jax
import numpy as np

from snapo.domains.gas_storage.policy.network import curve_ahead

YEARS = 15 * 365


def largest(closed) -> int:
    """The most numbers in one array of a program, those of its inner programs and constants too."""
    jaxpr = closed.jaxpr
    sizes = [v.aval.size for eqn in jaxpr.eqns for v in eqn.outvars]
    sizes += [np.size(each) for each in closed.consts]
    for eqn in jaxpr.eqns:
        sizes += [largest(x) for x in eqn.params.values() if hasattr(x, "consts")]
    return max(sizes, default=0)


def test_the_curve_ahead_of_fifteen_years():
    """Masks of T x T numbers, a quarter of a gigabyte each, killed a 15-year contract."""
    closed = jax.make_jaxpr(lambda f: curve_ahead(f, 16.0))(np.ones(YEARS))
    assert largest(closed) <= 16 * YEARS


def test_the_curve_ahead_is_that_of_its_definition():
    with jax.enable_x64(True):
        forward = 16 + np.random.default_rng(0).normal(size=200)
        found = np.asarray(curve_ahead(forward, 8.0))
    for day in (0, 50, 100, 170, 198, 199):
        ahead = forward[day + 1 :] if day < 199 else forward[-1:]
        rest = forward[day:]
        means = [ahead[:30].mean(), ahead[:120].mean(), ahead.mean()]
        expected = 2 * (np.array([*means, rest.max(), rest.min()]) - forward[day]) / 8
        np.testing.assert_allclose(found[day], expected, atol=1e-13)
