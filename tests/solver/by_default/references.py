"""Optima of the benchmark problems: a linear program for each day, and stochastic dual dynamic
programming (Pereira and Pinto 1991), both on HiGHS through SciPy; recursions of one number."""

import numpy as np
from scipy import sparse
from scipy.optimize import linprog, minimize_scalar
from scipy.stats import norm

from . import problems as p


def best_days(prices: np.ndarray) -> np.ndarray:
    """[days] the most that a battery earns in each day alone, with the prices [days, 24] known.

    It begins empty, as a day that earns by itself also ends. One program of all days in blocks.
    """
    days = len(prices)
    ones = np.eye(p.HOURS)
    lower = np.tril(np.ones((p.HOURS, p.HOURS)))
    block = sparse.csr_array(np.hstack([lower, -lower]))  # energy after every hour: in less out
    inside = sparse.block_diag([block] * days, format="csr")
    cost = np.hstack([prices / p.EFFICIENCY + p.WEAR, p.WEAR - prices * p.EFFICIENCY])
    found = linprog(
        cost.ravel(),
        A_ub=sparse.vstack([inside, -inside]),
        b_ub=np.concatenate([np.full(days * len(ones), p.SIZE), np.zeros(days * len(ones))]),
        bounds=(0, p.POWER),
        method="highs",
    )
    assert found.status == 0, found.message
    return -(cost.ravel() * found.x).reshape(days, -1).sum(1)


def best_stocks() -> float:
    """The least cost of the twelve stocks: a newsvendor's in every period, since stock is above its
    level again only where demand is negative, once in 2,300 periods."""
    quantile = norm.ppf(p.SHORT / (p.SHORT + 1))
    return p.PERIODS * float(np.sum((p.SHORT + 1) * 0.3 * p.SOLD * norm.pdf(quantile)))


RELEASE, KEPT, SPILT, THERMAL = slice(0, 4), slice(4, 8), slice(8, 12), slice(12, 16)
AHEAD, SIZE = 16, 17  # the cost ahead, and the number of unknowns of a month
LEAST = -1e5  # kEUR: no cost ahead is below


class Sddp:
    """Cuts [T][k] = (level, slope [4]) on the expected cost ahead of the water kept."""

    def __init__(self):
        self.inflows = p.inflows()
        self.cuts = [[] for _ in range(p.MONTHS)]
        # At the end the water is worth its yield; that of the last inflow is a constant.
        last = p.WORTH * p.YIELD
        self.cuts[-1].append((-float(last @ self.inflows[p.MONTHS].mean(0)), -last))

    def month(self, t: int, water: np.ndarray):
        """Costs [n] (with all ahead), water kept [n, 4] and slopes [n, 4] by water on hand [n, 4].

        One linear program of n blocks.
        """
        n, cost = len(water), np.zeros(SIZE)
        cost[THERMAL], cost[AHEAD] = np.append(p.COSTS, p.SHORTAGE), 1.0
        balance = np.zeros((5, SIZE))
        balance[:4, RELEASE] = np.eye(4)
        balance[1, 0] = -1.0  # the first reservoir lies above the second
        balance[:4, KEPT] = balance[:4, SPILT] = np.eye(4)
        balance[4, RELEASE], balance[4, THERMAL] = p.YIELD, 1.0
        ahead = np.zeros((len(self.cuts[t]), SIZE))
        ahead[:, KEPT] = np.reshape([slope for _, slope in self.cuts[t]], (-1, 4))
        ahead[:, AHEAD] = -1.0
        least = -np.array([level for level, _ in self.cuts[t]])
        # The turbines take no water that comes from above in the same month.
        own = np.hstack([np.eye(4), np.zeros((4, SIZE - 4))])
        upper = [*p.TURBINES, *p.STORES, *[None] * 4, *p.THERMAL, None, None]
        bounds = [(0.0, high) for high in upper[:AHEAD]] + [(LEAST, None)]
        found = linprog(
            np.tile(cost, n),
            A_ub=_blocks(np.vstack([ahead, own]), n),
            b_ub=np.hstack([np.tile(least, (n, 1)), water]).ravel(),
            A_eq=_blocks(balance, n),
            b_eq=np.hstack([water, np.full((n, 1), p.DEMAND[t])]).ravel(),
            bounds=bounds * n,
            method="highs-ds",
        )
        assert found.status == 0, found.message
        x = found.x.reshape(n, SIZE)
        slope = found.eqlin.marginals.reshape(n, 5)[:, :4]
        slope = slope + found.ineqlin.marginals.reshape(n, -1)[:, -4:]
        return x @ cost, x[:, KEPT], slope

    def forward(self, rng, paths: int):
        """The water kept [T, paths, 4] on fresh paths."""
        return self._along(rng.integers(0, p.OUTCOMES, (p.MONTHS, paths)))[1]

    def cost(self, month: np.ndarray) -> np.ndarray:
        """[n] the costs of the rule that the cuts make, with outcomes [T, n] of the inflow."""
        return self._along(month)[0]

    def _along(self, month: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        paths = month.shape[1]
        water = np.tile(p.FIRST + self.inflows[0, 0], (paths, 1))
        total, kept = np.zeros(paths), []
        for t in range(p.MONTHS):
            value, left, _ = self.month(t, water)
            total += value - self.ahead(t, left)
            kept.append(left)
            water = left + self.inflows[t + 1, month[t]]
        return total - p.WORTH * water @ p.YIELD, np.array(kept)

    def ahead(self, t: int, kept: np.ndarray) -> np.ndarray:
        """[n] the largest of all cuts."""
        found = np.full(len(kept), LEAST)
        for level, slope in self.cuts[t]:
            found = np.maximum(found, level + kept @ slope)
        return found

    def improve(self, rng, paths: int = 2) -> None:
        """One round: fresh paths forward, a cut for each at every month backward."""
        kept = self.forward(rng, paths)
        for t in reversed(range(p.MONTHS - 1)):
            water = (kept[t][:, None] + self.inflows[t + 1]).reshape(-1, 4)
            value, _, slope = self.month(t + 1, water)
            value = value.reshape(paths, -1).mean(1)
            slope = slope.reshape(paths, -1, 4).mean(1)
            for i in range(paths):
                self.cuts[t].append((float(value[i] - slope[i] @ kept[t][i]), slope[i]))

    def bound(self) -> float:
        """A cost that no rule is below."""
        return float(self.month(0, (p.FIRST + self.inflows[0, 0])[None])[0][0])


def best_saver() -> float:
    """The utility of the best rule of a `Saver` who never comes near the floors.

    The worth of a wealth W is -K W^-4 / 4, the stock's weight the same at all times, and a share c
    of W is consumed with dt^5 c^-5 = K E[growth^-4] (1 - c)^-5.
    """
    power, month, market = p.AVERSE - 1, p.MONTH, p.SAVER
    normals, weights = np.polynomial.hermite_e.hermegauss(41)
    over = (market["drift"] - market["rate"]) * month
    over = over + market["volatility"] * month**0.5 * normals

    def shrunk(weight: float) -> float:
        growth = 1 + market["rate"] * month + weight * over
        return float(weights @ growth**-power / weights.sum())

    least = minimize_scalar(shrunk, bounds=(0.0, 0.6), method="bounded", options={"xatol": 1e-9})
    worth = 1.0
    for _ in range(p.Saver().horizon):
        ratio = month * (worth * least.fun) ** (-1 / p.AVERSE)
        share = ratio / (1 + ratio)
        worth = month * (share / month) ** -power + worth * least.fun * (1 - share) ** -power
    return -worth / power


def _blocks(one: np.ndarray, count: int):
    return sparse.kron(sparse.eye_array(count), sparse.csr_array(one), format="csr")
