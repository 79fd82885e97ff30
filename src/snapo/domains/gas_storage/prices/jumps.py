"""`[model]` of kind "one-factor-jumps": a mean-reverting factor, and spikes that die out faster
than it."""

from typing import Literal, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.plausible import Plausible
from snapo.case.quantity import Quantity, Range
from snapo.case.table import doc
from snapo.problem.process import integral
from snapo.problem.record import Schedule, field
from snapo.problem.record.arrays import Array, jnp

from .process import (
    REVERSION,
    YEAR,
    Delivery,
    GaussianFactors,
    PriceProcess,
    SingleFactorTable,
    Times,
    register,
    use,
)
from .spikes import Spikes

INTENSITY = Quantity(
    "1/year",
    Range(0.0, YEAR, "()", noun="a number of jumps per year"),
    "price model",
    move=1.0,
    plausible=Plausible(0.05, 200.0, "it is the number of spikes per year"),
)
SIZE = Quantity(
    "1",
    Range(0.0, 1.0, "()", ": the mean rise of ln S"),
    "price model",
    move=0.01,
    plausible=Plausible(0.01, 0.95, "it is the mean rise of ln S; 0.5 is a spike of 65 %"),
)


class JumpTable(SingleFactorTable):
    """`[model]` of kind "one-factor-jumps"."""

    kind: Literal["one-factor-jumps"] = doc("one factor, and at most one upward spike a day")
    jump_intensity: CaseInput = INTENSITY("spikes per year")
    jump_size: CaseInput = SIZE("mean rise of ln S in a spike")
    jump_mean_reversion: CaseInput = REVERSION("speed at which a spike dies out")


class JumpConstants(NamedTuple):
    """The constants of the first shock and of every day: decays, standard deviation of a day, jump
    probability and size."""

    first_deviation: Array
    decay: Array
    deviation: Array
    jump_decay: Array
    threshold: Array
    size: Array
    feature: Array


class JumpStep(NamedTuple):
    """The forward price, the volatility of the delivery day, the variance of the factor, and ln
    E[exp y] of the spikes y."""

    forward: Array
    loading: Array
    variance: Array
    compensator: Array


@register
class OneFactorJumps(PriceProcess):
    """S(T) = F(T) exp(s(T) f(T) - variance / 2 + y(T) - c(T)), c(T) = ln E[exp y(T)].

    f is an Ornstein-Uhlenbeck factor as in "one-factor". y is a sum of upward spikes that decay at
    `jump_mean_reversion` b: on each day after the valuation date a spike occurs with probability p
    = 1 - exp(-intensity / 365). Its size in ln S is exponentially distributed with mean eta. A
    spike of n days ago has shrunk by the factor exp(-b n / 365). c is therefore a sum over days,
    with which E[S(T)] = F(T):

        c(d) = sum_{n=0}^{d-1} ln(1 - p + p / (1 - eta exp(-b n / 365))),   eta < 1.

    A spike is eta x max(0, E - ln(1 / p)) with E = (z1^2 + z2^2) / 2 of two standard normals, which
    is exponential: P(E > ln(1 / p)) = p, and the excess is exponential again. This size is
    continuous in p, so that pathwise derivatives with respect to the intensity are unbiased.
    Source: the jump sizes are those of Kou (2002), but only upward, added to a mean-reverting
    price; jump diffusions are from Merton (1976). The state is (f, y). `gap`, `last`: the days from
    the valuation date to the first and to the last price.
    """

    kind = "one-factor-jumps"
    table = JumpTable
    martingale = True
    proportional = True
    delivery: Times
    mean_reversion: CaseInput
    volatility: CaseInput
    jump_intensity: CaseInput
    jump_size: CaseInput
    jump_mean_reversion: CaseInput
    gap: int = field(static=True)
    last: int = field(static=True)
    noise_size: int = field(static=True, default=3)

    @classmethod
    def of(cls, delivery: Delivery, **numbers: CaseInput):
        gap, last = delivery.ahead[0], delivery.ahead[-1]
        return cls(delivery.times, gap=gap, last=last, **numbers)  # pyright: ignore

    @property
    def initial_noise_size(self) -> int:
        return 1 + (self.noise_size - 1) * self.gap

    def _threshold(self, inputs) -> Array:
        """Minus the logarithm of the probability of a spike on a day."""
        return -jnp.log(-jnp.expm1(-use(inputs, self.jump_intensity) / YEAR))

    def _compensator(self, inputs, days: Array) -> Array:
        """ln E[exp y] after these numbers of days."""
        probability = -jnp.expm1(-use(inputs, self.jump_intensity) / YEAR)
        # Sizes that a spike has left after 0, 1, … days, and the mean of its exponential.
        ages = np.arange(max(self.last, 1))
        left = jnp.exp(-use(inputs, self.jump_mean_reversion) * ages / YEAR)
        left = use(inputs, self.jump_size) * left
        compensator = jnp.cumsum(jnp.log1p(probability * left / (1 - left)))
        return jnp.concatenate([jnp.zeros(1), compensator])[days.astype(int)]

    def _spike(self, constants: JumpConstants, noise) -> Array:
        """The remainder, at the end of a day, of the spikes of this day."""
        excess = (noise[0] ** 2 + noise[1] ** 2) / 2 - constants.threshold
        return constants.size * jnp.maximum(excess, 0.0)

    def prepare(self, inputs) -> Schedule:
        reversion = use(inputs, self.mean_reversion)
        days = jnp.round(self.delivery.years * YEAR)
        loading = use(inputs, self.volatility)
        variance = integral(2 * reversion, days / YEAR)
        constants = JumpConstants(
            jnp.sqrt(integral(2 * reversion, days[0] / YEAR)) if self.gap else jnp.zeros(()),
            jnp.exp(-reversion / YEAR),
            jnp.sqrt(integral(2 * reversion, 1 / YEAR)),
            jnp.exp(-use(inputs, self.jump_mean_reversion) / YEAR),
            self._threshold(inputs),
            use(inputs, self.jump_size),
            1 / jnp.sqrt(integral(2 * reversion, 1.0)),
        )
        forward = self.delivery.forward(inputs)
        compensator = self._compensator(inputs, days)
        return Schedule(constants, JumpStep(forward, loading, loading**2 * variance, compensator))

    def initial(self, constants, noise):
        spikes, size = jnp.zeros(()), self.noise_size - 1
        for day in range(self.gap):
            one = noise[1 + size * day : 1 + size * (day + 1)]
            spikes = constants.jump_decay * spikes + self._spike(constants, one)
        return jnp.stack([constants.first_deviation * noise[0], spikes])

    def step(self, constants, now, state, noise):
        factor = constants.decay * state[0] + constants.deviation * noise[0]
        spikes = constants.jump_decay * state[1] + self._spike(constants, noise[1:])
        return jnp.stack([factor, spikes])

    def level(self, constants, now, state):
        calm = now.loading * state[0] - now.variance / 2
        return now.forward * jnp.exp(calm + state[1] - now.compensator)

    def forward(self, constants, now):
        return now.forward

    def observe(self, constants, now, state):
        return jnp.stack([constants.feature * state[0], state[1] / constants.size])

    def state_at(self, constants, now, spot):
        moved = jnp.log(spot / now.forward) + now.variance / 2 + now.compensator
        moved = moved / jnp.where(now.loading > 0, now.loading, 1.0)
        return jnp.stack([jnp.where(now.loading > 0, moved, 0.0), jnp.zeros_like(moved)])

    def fast(self, state):
        return state[0]

    def gaussian(self, state):
        return state

    def factors(self, schedule):
        constants, steps = schedule.constants, schedule.steps
        count = len(steps.forward)
        shock = np.full((count, 1, 1), constants.deviation)
        shock[0] = constants.first_deviation
        decay = np.full((count, 1), constants.decay)
        spikes = Spikes(
            float(constants.jump_decay),
            float(constants.size),
            *self._rate(float(constants.threshold)),
            self.gap,
            np.asarray(steps.compensator),
        )
        return GaussianFactors(steps.loading[:, None], steps.variance, decay, shock, spikes=spikes)

    def _rate(self, threshold: float) -> tuple[float, bool]:
        """The number of spikes per day, and whether they are a Poisson process."""
        return -np.log1p(-np.exp(-threshold)), False

    def describe(self) -> str:
        return "One mean-reverting factor with upward spikes that die out, around the forward price"


class PoissonJumpTable(JumpTable):
    """`[model]` of kind "one-factor-poisson-jumps"."""

    kind: Literal["one-factor-poisson-jumps"] = doc(  # pyright: ignore[reportIncompatibleVariableOverride]
        "one factor, and upward spikes at any time"
    )


LOST = 1e-7  # probability of more spikes a day than are drawn


@register
class OneFactorPoissonJumps(OneFactorJumps):
    """The model of `OneFactorJumps`, with spikes of a compound Poisson process in continuous time:
    dy = -b y dt + dJ.

    Several spikes may occur on a day, and each has partly decayed at the end of the day. The
    compensator is

        c(T) = (intensity / b) ln((1 - eta exp(-b T)) / (1 - eta)),   eta < 1.

    The spikes of a day are drawn from the largest to the smallest: with G_k the k-th point of a
    Poisson process of rate 1, the k-th size is eta max(0, ln(intensity / 365) - ln G_k), and its
    time is uniform. A path is continuous in the intensity. Source: Kluge (2006), "Pricing swing
    options and other electricity derivatives"; the series of Ferguson and Klass (1972).
    """

    kind = "one-factor-poisson-jumps"
    table = PoissonJumpTable

    @classmethod
    def of(cls, delivery: Delivery, **numbers: CaseInput):
        from scipy.stats import poisson  # late: it takes a second to load

        gap, last = delivery.ahead[0], delivery.ahead[-1]
        rate = float(numbers["jump_intensity"].values[0]) / YEAR
        size = 1 + 2 * max(int(poisson.isf(LOST, rate)), 1)
        return cls(delivery.times, gap=gap, last=last, noise_size=size, **numbers)  # pyright: ignore

    def _threshold(self, inputs) -> Array:
        return -jnp.log(use(inputs, self.jump_intensity) / YEAR)

    def _compensator(self, inputs, days: Array) -> Array:
        eta, speed = use(inputs, self.jump_size), use(inputs, self.jump_mean_reversion)
        left = -jnp.expm1(-speed * days / YEAR)
        # (intensity / b) ln(1 + eta (1 - exp(-b T)) / (1 - eta)), also where b is 0.
        share = eta / (1 - eta) * left
        mean = jnp.where(share > 0, jnp.log1p(share) / jnp.where(share > 0, share, 1.0), 1.0)
        time = integral(speed, days / YEAR)
        return use(inputs, self.jump_intensity) * eta / (1 - eta) * time * mean

    def _spike(self, constants: JumpConstants, noise) -> Array:
        """The remainder of the spikes of a day: sizes from the exponentials, times from the
        angles."""
        total, point = jnp.zeros(()), jnp.zeros(())
        log_decay = jnp.log(constants.jump_decay)
        for first in range(0, self.noise_size - 1, 2):
            x, y = noise[first], noise[first + 1]
            point = point + (x**2 + y**2) / 2
            excess = jnp.maximum(-jnp.log(point) - constants.threshold, 0.0)
            time = 0.5 + jnp.arctan2(y, x) / (2 * jnp.pi)
            total = total + excess * jnp.exp(log_decay * time)
        return constants.size * total

    def _rate(self, threshold: float) -> tuple[float, bool]:
        return float(np.exp(-threshold)), True

    def describe(self) -> str:
        return "One mean-reverting factor with upward spikes of a compound Poisson process"
