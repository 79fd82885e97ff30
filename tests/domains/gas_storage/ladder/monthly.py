"""D6: a store of eight months on month forwards in one factor, see the desk's reference cases."""

from types import SimpleNamespace

import numpy as np

from snapo.domains.gas_storage.ladder.forwards import PathCurves, drawn_states
from snapo.domains.gas_storage.ladder.rolling import Chains, TradeBlock, rolling
from snapo.domains.gas_storage.ladder.store import FlatStore
from snapo.domains.gas_storage.prices.process import GaussianFactors

FORWARD = np.array([20, 19, 21, 22.3, 24.1, 25.2, 23.4, 26.5, 26.5])  # and a price of the end
BLOCK = 2000  # paths at once
MONTHS, REVERSION, VOLATILITY = 8, 3.0, 0.55


def schedule(cost: float = 0.0) -> SimpleNamespace:
    """0 to 3 units, empty at both ends, 1 a month; `cost`: of a unit injected or withdrawn."""
    one, zero = np.ones(MONTHS), np.zeros(MONTHS)
    row = np.ones((MONTHS, 1))
    steps = {
        "forward": FORWARD[:-1], "gas_discount": one, "flow_discount": one,
        "injection_cost": cost * one, "withdrawal_cost": cost * one,
        "injection_cost_discount": one, "withdrawal_cost_discount": one, "inventory_cost": zero,
        "injection_fuel": zero, "withdrawal_fuel": zero, "inventory_loss": zero,
        "levels": 0 * row, "withdrawal_rate": row, "injection_rate": row,
        "min_injection": zero, "min_withdrawal": zero,
        "low": zero, "high": np.array([0.0, 1, 2, 3, 3, 3, 2, 1]),
        "next_low": zero, "next_high": np.array([1.0, 2, 3, 3, 3, 2, 1, 0]),
    }  # fmt: skip
    ends = {
        "inventory": 0.0, "end_levels": np.zeros(1), "end_values": np.zeros(1),
        "end_fraction": 0.0, "end_forward": FORWARD[-1], "end_discount": 1.0,
    }  # fmt: skip
    return SimpleNamespace(steps=SimpleNamespace(**steps), constants=SimpleNamespace(**ends))


def factors() -> GaussianFactors:
    decay = np.full((MONTHS + 1, 1), np.exp(-REVERSION / 12))
    wide = np.sqrt((1 - np.exp(-2 * REVERSION / 12)) / (2 * REVERSION))
    shock = np.full((MONTHS + 1, 1, 1), wide)
    decay[0], shock[0] = 1.0, 0.0
    years = np.arange(MONTHS + 1) / 12
    variance = VOLATILITY**2 * (1 - np.exp(-2 * REVERSION * years)) / (2 * REVERSION)
    return GaussianFactors(np.full((MONTHS + 1, 1), VOLATILITY), variance, decay, shock)


def months(spread: float):
    """Every month that is left, each a product."""
    return lambda t: tuple(TradeBlock(i, i + 1, spread) for i in range(t, MONTHS))


def rolled(spread: float, paths: int, seed: int) -> np.ndarray:
    """[paths / 2] the money of rolling intrinsic, the mean of antithetic pairs."""
    chains, parts = Chains(FlatStore(schedule(), "linear"), 4), []  # whole units are enough
    for number in range(max(paths // BLOCK, 1)):
        curves = path_curves(min(paths, BLOCK), 1000 * seed + number)
        count = curves.states.shape[2]
        parts.append(paired(rolling(chains, months(spread), curves, count).money))
    return np.concatenate(parts)


def path_curves(paths: int, seed: int) -> PathCurves:
    return PathCurves(factors(), FORWARD, drawn_states(factors(), paths, seed))


def paired(money: np.ndarray) -> np.ndarray:
    return money.reshape(2, -1).mean(axis=0)


def mean(values: np.ndarray) -> tuple[float, float]:
    """A mean and its standard error."""
    return float(values.mean()), float(values.std() / np.sqrt(len(values)))
