"""Markets as resolved data; conventions as in `records.case`."""

from typing import Any, Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record import TreeRecord, field


def as_tuple(values: Any) -> tuple:
    """An array as a static field."""
    return tuple(np.asarray(values).tolist())


class MarketCurve(TreeRecord):
    """Nominal zero curve, or break-evens in the same form, whose rates are inflation rates.

    - `tenors`: [n] nodes in years, strictly rising, above zero.
    - `rate`: [n], index [n], continuous, unit "1/year", labels "10y". Quote "zero": zero rates,
      linear between nodes, flat before the first. Quote "forward": the forward rate of the
      interval that ends at the node, constant in it. Quote "swap": rates of par swaps that pay
      once a year, tenors in whole years.
    - `extrapolation`: beyond the last node "flat-forward" keeps the last forward rate; "ultimate"
      moves the forward rate to `ultimate` by exp(-speed * (years beyond the node)); "smith-wilson"
      is this method for all terms, with `speed`, or if it is None with the smallest speed at which
      the forward rate has converged to `ultimate` at `convergence` years.
    - `ultimate`: the forward rate at very long terms, continuous, index []; not used with
      "flat-forward".
    """

    tenors: tuple[float, ...] = field(static=True, converter=as_tuple)
    rate: CaseInput
    quote: Literal["zero", "forward", "swap"] = field(static=True)
    extrapolation: Literal["flat-forward", "ultimate", "smith-wilson"] = field(static=True)
    ultimate: CaseInput
    speed: float | None = field(static=True, default=0.1)
    convergence: float = field(static=True, default=60.0)

    @property
    def tenor(self) -> np.ndarray:
        """`tenors` as an array [n]."""
        return np.array(self.tenors, float)


class Inflation(TreeRecord):
    """Expected inflation p + phi_p(t) fitted to break-evens, realised prices, and wages.

    dp = -k p dt + s(t) (dW + lambda dt); d ln I = (phi_p + p) dt + s_I(t) (dW_I + lambda_I dt); d
    ln W = d ln I + real_wage dt + s_W dW_W. Prices of risk are used under "P" only.

    - `break_even`: zero-coupon break-even curve.
    - `mean_reversion`, `price_of_risk`, `index_price_of_risk`, `real_wage_growth`,
      `wage_volatility`: index []. `volatility`, `index_volatility`: index [T].
    """

    break_even: MarketCurve
    mean_reversion: CaseInput
    volatility: CaseInput
    price_of_risk: CaseInput
    index_volatility: CaseInput
    index_price_of_risk: CaseInput
    real_wage_growth: CaseInput
    wage_volatility: CaseInput


class Credit(TreeRecord):
    """Spreads by rating; R is the number of ratings (0 allowed). u = ln(s / mean) is an OU process.

    - `names`: [R]. `spread` (now), `mean_spread` (both above 0), `mean_reversion`, `volatility`
      (of ln s), `default_loss` (share of a holding lost per year at the mean spread, in proportion
      to the spread): index [R]. Carry and loss are used under "P" only.
    """

    names: tuple[str, ...] = field(static=True)
    spread: CaseInput
    mean_spread: CaseInput
    mean_reversion: CaseInput
    volatility: CaseInput
    default_loss: CaseInput


class Currencies(TreeRecord):
    """Foreign currencies; X is their number (0 allowed).

    - `volatility`, `premium` (return over the difference of rates; under "P" only), `hedge_ratio`
      (0 to 1, the share of the exposure that is hedged), `hedge_cost` (share of the hedged amount
      per year): index [X]. `emerging`: [X] whether its market is an emerging one.
    """

    names: tuple[str, ...] = field(static=True)
    volatility: CaseInput
    premium: CaseInput
    hedge_ratio: CaseInput
    hedge_cost: CaseInput
    emerging: tuple[bool, ...] = field(static=True, default=())


class Correlation(TreeRecord):
    """Instantaneous correlations. They are positive definite, if necessary after a repair.

    - `names`: [k] the names of the correlated quantities: "rate", "rate 2", "inflation", "price
      index", "wage", ratings, currencies, and classes with a separate shock. All other quantities,
      and mortality, are independent.
    - `lower`: strict lower triangle, row by row, index [k (k - 1) / 2]; labels "equity, rate".
    - `repaired`: the largest change of an entry, 0 if nothing was repaired.
    """

    names: tuple[str, ...] = field(static=True)
    lower: CaseInput
    repaired: float = 0.0


class SuppliedScenarios(TreeRecord):
    """Ready-made scenarios instead of the models: two different sets of paths.

    - `training`, `evaluation`: [paths, T, K], the returns and growth over step t, and the zero
      rates at its end.
    - `columns`: [K] "return CLASS" for every class (simple return of the step), then "inflation"
      and "wage" (log growth of the step), then "zero TENOR" (continuous) for each of `tenors`.
    - `tenors`: [k] years, rising; zero rates are linear between them and flat outside.
    """

    training: np.ndarray
    evaluation: np.ndarray
    columns: tuple[str, ...] = field(static=True)
    tenors: tuple[float, ...] = field(static=True, converter=as_tuple)

    @property
    def tenor(self) -> np.ndarray:
        """[k] the same as an array."""
        return np.array(self.tenors, float)
