"""`[model]` of kind "regimes": a mean-reverting factor in a market that is calm or tight."""

from typing import Any, Literal, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import Quantity, Range
from snapo.case.table import doc
from snapo.problem.process import integral
from snapo.problem.record import Schedule, field
from snapo.problem.record.arrays import Array, Float, Int, jax, jnp

from .process import (
    YEAR,
    Delivery,
    GaussianFactors,
    PriceProcess,
    SingleFactorTable,
    Times,
    register,
    use,
)

PROBABILITY = Quantity(
    "1",
    Range(0.0, 1.0, "()", noun="a probability per day"),
    "price model",
    move=0.001,
    display_unit="percentage point",
    display_factor=100.0,
)
PREMIUM = Quantity(
    "1", Range(0.0, note=": the rise of ln S in a tight market"), "price model", move=0.01
)


class RegimeTable(SingleFactorTable):
    """`[model]` of kind "regimes"."""

    kind: Literal["regimes"] = doc("one factor in a market that is calm or tight")
    tightens: CaseInput = PROBABILITY("probability per day that a calm market becomes tight")
    eases: CaseInput = PROBABILITY("probability per day that a tight market becomes calm")
    premium: CaseInput = PREMIUM(
        "logarithm of the ratio of the price in a tight market to that in a calm market"
    )


class RegimeState(NamedTuple):
    """The factor, the regime of the market (1 if it is tight, 0 if it is calm), and the likelihood
    ratio of the regimes so far."""

    factor: Float[Array, ""]
    tight: Int[Array, ""]
    weight: Float[Array, ""]


class RegimeConstants(NamedTuple):
    """The constants: for the first day the standard deviation of the factor and the probability []
    of a tight market; for every day its decay, standard deviation and transition matrix [2, 2]; the
    premium; and the size of the factor after a year."""

    first_deviation: Array
    first_tight: Array
    decay: Array
    deviation: Array
    transition: Array
    premium: Array
    feature: Array


class RegimeStep(NamedTuple):
    """The forward price, the volatility of the delivery day, the variance of ln S without regimes,
    and ln E[exp(premium R)]."""

    forward: Array
    loading: Array
    variance: Array
    compensator: Array


@register
class Regimes(PriceProcess):
    """S(T) = F(T) exp(s(T) f(T) - variance / 2 + premium R(T) - c(T)), R a Markov chain on {0, 1}.

    f is an Ornstein-Uhlenbeck factor as in "one-factor", and R = 1 in a tight market. The market is
    calm on the valuation date. After d days it is tight with the probability

        p(d) = pi (1 - (1 - tightens - eases)^d),   pi = tightens / (tightens + eases),

    so that c(d) = ln E[exp(premium R)] = ln(1 + p(d) (exp(premium) - 1)) and E[S(T)] = F(T). A path
    has no derivative with respect to the probabilities. The state therefore carries its likelihood
    ratio (`weight`), with which the derivative of the mean is correct. Source: Hamilton (1989), "A
    new approach to the economic analysis of nonstationary time series"; de Jong (2006), "The nature
    of power spikes". `gap`, `last`: the days from the valuation date to the first and to the last
    price.
    """

    kind = "regimes"
    table = RegimeTable
    martingale = True
    proportional = True
    delivery: Times
    mean_reversion: CaseInput
    volatility: CaseInput
    tightens: CaseInput
    eases: CaseInput
    premium: CaseInput
    gap: int = field(static=True)
    last: int = field(static=True)
    noise_size: int = field(static=True, default=2)

    @classmethod
    def of(cls, delivery: Delivery, **numbers: CaseInput):
        gap, last = delivery.ahead[0], delivery.ahead[-1]
        return cls(delivery.times, gap=gap, last=last, **numbers)  # pyright: ignore

    @property
    def initial_noise_size(self) -> int:
        return 2

    def prepare(self, inputs) -> Schedule:
        reversion, premium = use(inputs, self.mean_reversion), use(inputs, self.premium)
        up, down = use(inputs, self.tightens), use(inputs, self.eases)
        days = jnp.round(self.delivery.years * YEAR).astype(int)

        def next_day(tight, _):
            return (1 - tight) * up + tight * (1 - down), tight

        _, tight = jax.lax.scan(next_day, jnp.zeros_like(up), None, length=self.last + 1)
        tight, loading = tight[days], use(inputs, self.volatility)
        variance = integral(2 * reversion, days / YEAR)
        gap = days[0] / YEAR
        constants = RegimeConstants(
            jnp.sqrt(integral(2 * reversion, gap)) if self.gap else jnp.zeros(()),
            tight[0],
            jnp.exp(-reversion / YEAR),
            jnp.sqrt(integral(2 * reversion, 1 / YEAR)),
            jnp.stack([jnp.stack([1 - up, up]), jnp.stack([down, 1 - down])]),
            premium,
            1 / jnp.sqrt(integral(2 * reversion, 1.0)),
        )
        forward = self.delivery.forward(inputs)
        compensator = jnp.log1p(tight * jnp.expm1(premium))
        return Schedule(constants, RegimeStep(forward, loading, loading**2 * variance, compensator))

    def initial(self, constants, noise):
        tight = constants.first_tight
        row = jnp.stack([1 - tight, tight])
        regime, weight = _chain(jnp.stack([row, row])).weigh(noise[1:], jnp.zeros((), jnp.int32))
        return RegimeState(constants.first_deviation * noise[0], regime, weight)

    def step(self, constants, now, state, noise):
        factor = constants.decay * state.factor + constants.deviation * noise[0]
        tight, likelihood = _chain(constants.transition).weigh(noise[1:], state.tight)
        return RegimeState(factor, tight, state.weight * likelihood)

    def weight(self, state):
        return state.weight

    def in_mean(self):
        return self.tightens.name, self.eases.name

    def level(self, constants, now, state):
        calm = now.forward * jnp.exp(now.loading * state.factor - now.variance / 2)
        return calm * self.slow_level(constants, now, state)

    def forward(self, constants, now):
        return now.forward

    def observe(self, constants, now, state):
        return jnp.stack([constants.feature * state.factor, 1.0 * state.tight])

    def state_at(self, constants, now, spot):
        """The state with this spot price in a calm market."""
        level = jnp.log(spot / now.forward) + now.variance / 2 + now.compensator
        factor = jnp.where(
            now.loading > 0, level / jnp.where(now.loading > 0, now.loading, 1.0), 0.0
        )
        return RegimeState(factor, jnp.zeros_like(factor, jnp.int32), jnp.ones_like(factor))

    def fast(self, state):
        return state.factor

    def slow_level(self, constants, now, state):
        return jnp.exp(constants.premium * state.tight - now.compensator)

    def factors(self, schedule):
        """The factor of a market without regimes. This is an approximation: a lattice in this
        factor is not exact."""
        constants, steps = schedule.constants, schedule.steps
        count = len(steps.forward)
        shock = np.full((count, 1, 1), constants.deviation)
        shock[0] = constants.first_deviation
        decay = np.full((count, 1), constants.decay)
        return GaussianFactors(steps.loading[:, None], steps.variance, decay, shock, exact=False)

    def describe(self) -> str:
        return "One mean-reverting factor in a calm or tight market, around the forward price"


def _chain(transition: Float[Array, "2 2"]) -> Any:
    from snapo.problem.noise import Markov  # JAX: of a path, not of a case

    return Markov(transition)
