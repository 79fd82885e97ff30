"""A third factor of the short rate is one class: everything else follows from its names."""

from typing import ClassVar

import numpy as np
import pytest
from tests.domains.pension.market_cases import full, given, steady

from snapo.domains.pension.market.correlation import brownians
from snapo.domains.pension.market.factors import factors, moments, nominal, shape, slope
from snapo.domains.pension.market.rates import short_rate
from snapo.domains.pension.market.rates.short_rate import ShortRate, register
from snapo.domains.pension.market.registry import MODELS
from snapo.domains.pension.market.shocks import covariance
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy


class G3(ShortRate):
    """Three factors."""

    kind: ClassVar[str] = "g3++"
    factors: ClassVar[tuple[str, ...]] = ("rate", "rate 2", "rate 3")
    description: ClassVar[str] = "G3++, three factors"


A, S = (0.05, 0.4, 1.2), (0.009, 0.006, 0.004)


def test_a_model_is_known_by_its_word_once(monkeypatch):
    monkeypatch.setattr(short_rate, "MODELS", dict(MODELS))
    register(G3)
    assert short_rate.MODELS["g3++"] is G3
    with pytest.raises(TypeError, match="'g3\\+\\+' already"):
        register(G3)
    with pytest.raises(TypeError, match="needs kind, factors, description"):
        register(type("Nameless", (ShortRate,), {}))


@pytest.mark.prove
def test_three_independent_factors_add_their_convexities():
    """ln P(t, t + u) at factors of zero: half the sum of V(u) - V(t + u) + V(t) of each factor."""
    steps = 12
    model = G3(
        given("rate_mean_reversion", A),
        steady("rate_volatility", S, steps),
        given("rate_price_of_risk", np.zeros(3)),
    )
    one = full(steps, rates=model)
    assert brownians(one)[:4] == ("rate", "rate 2", "rate 3", "inflation")

    def v(u, a, s):
        tail = 2 * np.exp(-a * u) / a - np.exp(-2 * a * u) / (2 * a) - 1.5 / a
        return (s / a) ** 2 * (u + tail)

    inputs = plain(pension_inputs(one)) | {"correlation": np.zeros(28)}
    years, t = np.array([0.5, 10.0, 30.0]), 1.0

    @with_numpy
    def at_zero():
        both, bond = factors(one, inputs), nominal(one)
        made = moments(one, both, bond, covariance(one, inputs))
        return shape(slope(both, bond, years), made)

    found = at_zero()[12]
    want = sum((v(years, a, s) - v(t + years, a, s) + v(t, a, s)) / 2 for a, s in zip(A, S))
    assert found == pytest.approx(want, abs=1e-14)
