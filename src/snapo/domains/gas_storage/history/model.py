"""Gaussian price models of `[model]`: a hidden state, and prices that are linear in it.

With X = ln(S + h), or S itself for normal prices, X(T) = chi + xi + g(T):

    d chi = -a chi dt + s dW          the short-term factor, with mean zero
    d xi  = m dt + l dZ               the long-term level, dW dZ = rho dt; constant for one factor
    g(T)  = sum_k c_k cos(2 pi k T) + d_k sin(2 pi k T)    a season of the year of delivery

Under the pricing measure chi has the drift -a chi - p and xi the drift n, so that a forward price
delivered in tau years is X_F = exp(-a tau) chi + xi + A(tau) + g, with

    A = n tau - (1 - exp(-a tau)) p / a + V(tau) / 2,    V the variance of X after tau;

normal prices have no V. Source: Schwartz and Smith (2000), "Short-term variations and long-term
dynamics in commodity prices", Management Science 46, equations 5 and 9.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.process import integral

LIMIT = 25.0  # of a logarithm: the variable of a parameter that runs to zero
POSITIVE, CORRELATION, RATE, LEVEL, SHAPE = "positive", "correlation", "rate", "level", "season"


class HistoryParameter(NamedTuple):
    """A parameter: its name, and its role, which determines its scale and the test by which it
    counts as unknown.

    `role`: "positive" is estimated as a logarithm, "correlation" as an inverse hyperbolic tangent;
    "rate" is a drift per year, "level" a mean, "season" an amplitude.
    """

    name: str
    role: str


@dataclass(frozen=True)
class HistoryModel:
    """A Gaussian model, and the parameters that a history can determine.

    - `kind`: as in `[model]`; `factors`: 1 or 2; `normal`: whether X is the price itself.
    - `shift`: h; `harmonics`: the harmonics of the season.
    - `quoted`: whether there are forward prices; only these depend on the pricing measure.
    - `columns`: the names of the observed series; `exact`: the series without a measurement error.
    - `unit`: the typical size of a move of X: 1 for logarithms, an amount of money for normal
      prices.
    """

    kind: str
    factors: int
    normal: bool = False
    shift: float = 0.0
    harmonics: int = 0
    quoted: bool = False
    columns: tuple[str, ...] = ("spot",)
    exact: tuple[str, ...] = ("spot",)
    unit: float = 1.0

    @property
    def parameters(self) -> tuple[HistoryParameter, ...]:
        """All parameters, in their order."""
        season = [f"season_{part}_{k}" for k in range(1, self.harmonics + 1) for part in PARTS]
        deviations = [f"deviation_{name}" for name in self.columns if name not in self.exact]
        return tuple(
            HistoryParameter(*item)
            for item in (
                *(TWO if self.factors == 2 else ONE),
                *((PRICED_TWO if self.factors == 2 else PRICED) if self.quoted else ()),
                *((name, SHAPE) for name in season),
                *((name, POSITIVE) for name in deviations),
            )
        )

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    def units(self) -> np.ndarray:
        """[P] the scale of each parameter; parameters in units of X have the scale `unit`."""
        pure = ("mean_reversion", "correlation")
        return np.array([1.0 if name in pure else self.unit for name in self.names])

    def numbers(self, variables: Float[Array, " P"]) -> Float[Array, " P"]:
        """The parameters that belong to unbounded variables."""
        roles = [parameter.role for parameter in self.parameters]
        positive = np.array([role == POSITIVE for role in roles])
        bounded = np.array([role == CORRELATION for role in roles])
        clipped = jnp.clip(jnp.where(positive | bounded, variables, 0.0), -LIMIT, LIMIT)
        plain = jnp.where(positive | bounded, 0.0, variables)
        numbers = jnp.where(positive, jnp.exp(clipped), plain)
        return jnp.where(bounded, jnp.tanh(clipped), numbers * self.units())

    def variables(self, numbers: np.ndarray) -> np.ndarray:
        """The unbounded variables that belong to parameters."""
        table = {POSITIVE: np.log, CORRELATION: np.arctanh}
        scaled = np.asarray(numbers, np.float64) / self.units()
        return np.array([
            table[parameter.role](value) if parameter.role in table else value
            for parameter, value in zip(self.parameters, scaled)
        ])  # fmt: skip

    def by_name(self, numbers) -> dict[str, Any]:
        """{name: number}, with 0 for a parameter that the model does not have."""
        table = dict(zip(self.names, numbers))
        names = [name for name, _ in (*TWO, *PRICED_TWO, *ONE, *PRICED)]
        return {name: table.get(name, 0.0) for name in (*names, *self.names)}

    def deviations(self, numbers) -> Float[Array, " columns"]:
        """The standard deviation of the measurement error of each series; exactly 0 for the series
        in `exact`."""
        table = self.by_name(numbers)
        return jnp.stack([jnp.asarray(table.get(f"deviation_{x}", 0.0)) for x in self.columns])

    def transition(self, numbers, gap) -> tuple[Array, Array, Array]:
        """The decay [F], drift [F] and covariance [F, F] of the state over a time in years."""
        p = self.by_name(numbers)
        decay, covariance = jnp.exp(-p["mean_reversion"] * gap), self.covariance(p, gap)
        if self.factors == 1:
            return decay[None], jnp.zeros(1), covariance[:1, :1]
        return jnp.stack([decay, 1.0]), jnp.stack([0.0, p["drift"] * gap]), covariance

    def covariance(self, p: dict[str, Any], time) -> Float[Array, "2 2"]:
        """The covariance of both factors after a time, if they are known at its start."""
        speed = p["mean_reversion"]
        short = p["volatility"] ** 2 * integral(2 * speed, time)
        both = p["correlation"] * p["volatility"] * p["long_volatility"] * integral(speed, time)
        return jnp.array([[short, both], [both, p["long_volatility"] ** 2 * time]])

    def observed(self, numbers, years, phase) -> tuple[Array, Array]:
        """The constant and the loadings [F] of the price for delivery in `years`; `phase`: the time
        of delivery as a share of its year.

        A spot price has `years` 0.
        """
        p = self.by_name(numbers)
        premium = p["premium"] * integral(p["mean_reversion"], years)
        constant = p["level"] + p["priced_drift"] * years - premium
        if not self.normal:
            # Forward from now: the variance under the pricing measure is the same.
            decayed = self.covariance(p, years)
            constant = constant + jnp.sum(decayed) / 2
        for k in range(1, self.harmonics + 1):
            angle = 2 * np.pi * k * phase
            constant = constant + p[f"season_cosine_{k}"] * jnp.cos(angle)
            constant = constant + p[f"season_sine_{k}"] * jnp.sin(angle)
        loading = jnp.exp(-p["mean_reversion"] * years)
        return constant, jnp.stack([loading, jnp.ones_like(loading)])[: self.factors]

    def initial(self, numbers, first) -> tuple[Array, Array]:
        """The mean [F] and the covariance [F, F] of the state before the first price; `first`: the
        value of X for that price. The short-term factor has its stationary distribution; the
        long-term level has the standard deviation `unit`.
        """
        p = self.by_name(numbers)
        stationary = p["volatility"] ** 2 / (2 * p["mean_reversion"])
        mean = jnp.stack([jnp.zeros_like(first), first])
        return mean[: self.factors], jnp.diag(jnp.stack([stationary, jnp.asarray(self.unit**2)]))[
            : self.factors, : self.factors
        ]

    def state_of(self, price):
        """X of a price; plain NumPy."""
        return price if self.normal else np.log(price + self.shift)


PARTS = ("cosine", "sine")
ONE = (("mean_reversion", POSITIVE), ("volatility", POSITIVE), ("level", LEVEL))
PRICED = (("premium", RATE),)
TWO = (
    ("mean_reversion", POSITIVE),
    ("volatility", POSITIVE),
    ("drift", RATE),
    ("long_volatility", POSITIVE),
    ("correlation", CORRELATION),
)
PRICED_TWO = (("premium", RATE), ("priced_drift", RATE))
