"""Histories drawn from a model, by formulas of their own."""

import numpy as np

from snapo.domains.gas_storage.history.kalman import History
from snapo.domains.gas_storage.history.model import HistoryModel


def empty_history(dates: int, years, step: float) -> History:
    """Dates in equal steps, with a price for each of `years` to delivery, series by series."""
    count = len(years)
    gap = np.full(dates, step)
    gap[0] = 0.0
    ahead = np.tile(np.asarray(years, float), (dates, 1))
    phase = (np.cumsum(gap)[:, None] + ahead) % 1.0
    shape = (dates, count)
    column = np.tile(np.arange(count), (dates, 1))
    return History(gap, np.zeros(shape), np.ones(shape, bool), ahead, phase, column, np.zeros(()))


def drawn(model: HistoryModel, table: dict[str, float], history: History, seed: int) -> History:
    """The history with prices of the model; the long-term level begins at 3."""
    rng, p = np.random.default_rng(seed), {name: 0.0 for name in OPTIONAL} | table
    a, s, l, rho = (
        p[n] for n in ("mean_reversion", "volatility", "long_volatility", "correlation")
    )
    two = model.factors == 2
    chi, xi = s / np.sqrt(2 * a) * rng.standard_normal(), 3.0 * two
    deviation = np.array([p.get(f"deviation_{name}", 0.0) for name in model.columns])
    value = np.zeros_like(history.value)
    for i, gap in enumerate(history.gap):
        if gap > 0:
            first = s * np.sqrt((1 - np.exp(-2 * a * gap)) / (2 * a))
            shared = rho * s * l * (1 - np.exp(-a * gap)) / a / first
            one, other = rng.standard_normal(2)
            chi = np.exp(-a * gap) * chi + first * one
            rest = np.sqrt(max(l * l * gap - shared**2, 0.0))
            xi += p["drift"] * gap + shared * one + rest * other
        t = history.years[i]
        decay = np.exp(-a * t)
        curve = p["level"] + p["priced_drift"] * t - (1 - decay) * p["premium"] / a
        if not model.normal:
            both = 2 * rho * s * l * (1 - decay) / a
            curve = curve + (s * s * (1 - decay**2) / (2 * a) + l * l * t + both) / 2
        angle = 2 * np.pi * history.phase[i]
        curve = curve + p["season_cosine_1"] * np.cos(angle) + p["season_sine_1"] * np.sin(angle)
        error = deviation[history.column[i]] * rng.standard_normal(len(t))
        value[i] = decay * chi + xi * two + curve + error
    return history._replace(value=value, first=np.asarray(value[0, 0]))


OPTIONAL = (
    "long_volatility", "correlation", "drift", "level", "priced_drift", "premium",
    "season_cosine_1", "season_sine_1",
)  # fmt: skip
