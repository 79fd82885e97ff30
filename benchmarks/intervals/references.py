"""Exact values of the small problems, computed with only NumPy and SciPy, without snapo.

The method is dynamic programming if the state is small, else quadrature or a closed form. Every
function has the inputs of its problem as arguments and returns the value of the best policy.
"""

import numpy as np
from scipy import optimize, stats
from scipy.special import ndtr

NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(80)
WEIGHTS = WEIGHTS / WEIGHTS.sum()
CURVE = 20 + 4 * np.sin(2 * np.pi * np.arange(16) / 16 - 2.2)


def slope(value, inputs: dict, name: str, share: float) -> float:
    """Central difference of an exact value with respect to a relative change of an input."""
    x = np.asarray(inputs[name], float)
    by = x if x.any() else np.ones(x.shape)
    high, low = (value(**(inputs | {name: x + sign * share * by})) for sign in (1, -1))
    return float(high - low) / (2 * share)


def poisson(mean: float, most: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """The numbers from 0 to `most`, and their Poisson probabilities."""
    numbers = np.arange(most + 1)
    weights = stats.poisson.pmf(numbers, mean)
    return numbers, weights / weights.sum()


def fixed_order(K=5.0, h=1.0, p=4.0, mean=6.0, periods=50, start=6, most=40) -> float:
    """Backlogged demand, with a fixed cost of each order."""
    low, high = -60, 60
    levels = np.arange(low, high + 1)
    demand, weights = poisson(mean)
    after = levels[:, None] - demand
    stage = (weights * (h * np.maximum(after, 0) + p * np.maximum(-after, 0))).sum(1)
    index = np.clip(after, low, high) - low
    raised = np.minimum(levels[:, None] + np.arange(most + 1), high) - low
    fixed = np.where(np.arange(most + 1) > 0, K, 0.0)
    cost = np.zeros(len(levels))
    for _ in range(periods):
        ahead = stage + (weights * cost[index]).sum(1)
        cost = (ahead[raised] + fixed).min(1)
    return -cost[start - low]


def lost_sales(h=1.0, p=4.0, c=0.5, mean=5.0, periods=30, most=20, cap=60) -> float:
    """Lost sales; an order arrives two periods later. Stock and outstanding order start at 5."""
    demand, weights = poisson(mean)
    stock, orders = np.arange(cap + 1), np.arange(most + 1)
    left = np.maximum(stock[:, None] - demand, 0)
    short = np.maximum(demand - stock[:, None], 0)
    stage = (weights * (h * left + p * short)).sum(1)
    cost = np.zeros((cap + 1, most + 1))
    for _ in range(periods):
        ahead = np.empty_like(cost)
        for coming in orders:
            after = cost[np.clip(left + coming, 0, cap)]
            total = stage[:, None] + np.einsum("d,xda->xa", weights, after) + c * orders
            ahead[:, coming] = total.min(1)
        cost = ahead
    return -cost[5, 5]


def dual_sourcing(ce=20.0, h=5.0, b=495.0, periods=60, start=6, low=-8, high=20, most=8) -> float:
    """Two suppliers: one delivers after two periods, the other at once for `ce` more per unit."""
    stock = np.arange(low, high + 1)
    demand = np.arange(5)
    cost = np.zeros((len(stock), most + 1, most + 1))
    for _ in range(periods):
        ahead = np.full_like(cost, np.inf)
        for coming in range(most + 1):
            for fast in range(most + 1):
                after = stock[:, None] + coming + fast - demand
                stage = (h * np.maximum(after, 0) + b * np.maximum(-after, 0)).mean(1)
                index = np.clip(after, low, high) - low
                # cost[stock, coming, later]: what was ordered last is next to come.
                future = cost[index].mean(1)
                best = (ce * fast + stage)[:, None] + future.min(2)
                ahead[:, coming, :] = np.minimum(ahead[:, coming, :], best)
        cost = ahead
    return -cost[start - low, 0, 0]


def put(spot=36.0, strike=40.0, rate=0.06, volatility=0.2, dates=20, fine=60) -> float:
    """A put that may be exercised at 20 dates of a year, by convolution on a fine grid."""
    step = volatility / np.sqrt(dates) / fine
    drift = (rate - volatility**2 / 2) / dates
    size = int(np.ceil(6 * volatility / step))
    grid = np.arange(-size, size + 1) * step
    shifts = np.arange(-8 * fine, 8 * fine + 1)
    weights = np.exp(-0.5 * (shifts / fine) ** 2)
    weights /= weights.sum()

    def payoff(date):
        return np.maximum(strike - spot * np.exp(grid + drift * date), 0)

    value = np.exp(-rate) * payoff(dates)
    pad = len(shifts) // 2
    for date in range(dates - 1, -1, -1):
        padded = np.concatenate([np.full(pad, value[0]), value, np.full(pad, value[-1])])
        kept = np.convolve(padded, weights, "valid")
        value = np.maximum(kept, np.exp(-rate * date / dates) * payoff(date))
    return value[size]


def regulator(a=0.9, b=0.5, q=1.0, r=0.3, s=0.4, x0=1.0, steps=20) -> float:
    """A linear system with quadratic cost: the Riccati recursion."""
    worth, noise = 0.0, 0.0
    for _ in range(steps):
        noise += worth * s**2
        worth = q + a * a * worth - (a * b * worth) ** 2 / (r + b * b * worth)
    return -(worth * x0**2 + noise)


def measured_regulator(r=0.5, w=0.3, v=0.7, s0=1.0, steps=20) -> float:
    """The same with noisy observations: the Riccati recursion and the Kalman filter."""
    worth = np.zeros(steps + 1)
    for t in range(steps - 1, -1, -1):
        worth[t] = 1 + worth[t + 1] - worth[t + 1] ** 2 / (r + worth[t + 1])
    cost, prior = worth[0] * s0**2, s0**2
    for t in range(steps):
        posterior = prior * v**2 / (prior + v**2)
        cost += worth[t + 1] * w**2 + posterior * worth[t + 1] ** 2 / (r + worth[t + 1])
        prior = posterior + w**2
    return -cost


def newsvendor(h=0.18, p=0.7, mean=50.0, sd=8.0) -> float:
    """Normal demand: the critical fractile."""
    z = stats.norm.ppf(p / (p + h))
    return float(-(h + p) * stats.norm.pdf(z) * sd + 0 * mean)


def merton(rate=0.02, drift=0.06, volatility=0.2, gamma=3.0, steps=12, dt=0.25) -> float:
    """Utility of wealth with one stock; the best share is the same at every step."""
    cash = np.exp(rate * dt)
    stock = np.exp((drift - volatility**2 / 2) * dt + volatility * np.sqrt(dt) * NODES)

    def mean(share):
        return (WEIGHTS * (share * stock + (1 - share) * cash) ** (1 - gamma)).sum()

    best = optimize.minimize_scalar(mean, bounds=(0, 1), method="bounded", options={"xatol": 1e-12})
    return best.fun**steps / (1 - gamma)


def at_limit(mu_a=0.08, mu_b=0.01, sd_a=0.15, sd_b=0.2, gamma=2.0, steps=8, dt=0.25) -> float:
    """Two assets; the best share of the second is zero, a limit."""
    first, second = (
        np.exp((mu - sd**2 / 2) * dt + sd * np.sqrt(dt) * NODES)
        for mu, sd in ((mu_a, sd_a), (mu_b, sd_b))
    )
    weights = WEIGHTS[:, None] * WEIGHTS[None, :]

    def mean(share):
        wealth = share * first[:, None] + (1 - share) * second[None, :]
        return (weights * wealth ** (1 - gamma)).sum()

    best = optimize.minimize_scalar(mean, bounds=(0, 1), method="bounded", options={"xatol": 1e-12})
    return min(best.fun, mean(1.0), mean(0.0)) ** steps / (1 - gamma)


def digital(strike=100.0, spot=98.0, sd0=0.1, sd1=0.1, prize=1.0, cost=1.0) -> float:
    """An effort for a prize above a strike: the effort is the probability times the prize."""
    z, w = np.polynomial.hermite_e.hermegauss(120)
    seen = spot * np.exp(sd0 * z - sd0**2 / 2)
    probability = ndtr((np.log(seen / strike) - sd1**2 / 2) / sd1)
    return (w / w.sum() * (prize * probability) ** 2).sum() / (2 * cost)


def store(
    curve=CURVE, sigma=0.12, phi=0.8, into=0.3, out=0.2, cap=1.1, rate=0.25, fine=12
) -> float:
    """A store under one mean-reverting factor, by dynamic programming on all reachable levels."""
    curve = np.asarray(curve, float)
    deviation = sigma / np.sqrt(1 - phi**2)
    step = sigma / fine
    size = int(np.ceil(6.5 * deviation / step))
    factor = np.arange(-size, size + 1) * step
    moves = np.exp(-0.5 * ((factor[None, :] - phi * factor[:, None]) / sigma) ** 2)
    moves /= moves.sum(1, keepdims=True)
    count = int(np.floor(cap / rate + 1e-9)) + 1
    levels = np.concatenate([rate * np.arange(count), cap - rate * np.arange(count)])
    levels = np.unique(np.round(levels, 12))
    levels = levels[(levels >= -1e-12) & (levels <= cap + 1e-12)]
    change = levels[None, :] - levels[:, None]
    feasible = np.abs(change) <= rate + 1e-9
    value = np.zeros((len(factor), len(levels)))
    for t in range(len(curve) - 1, -1, -1):
        variance = sigma**2 * (1 - phi ** (2 * t)) / (1 - phi**2)
        price = (curve[t] * np.exp(factor - variance / 2))[:, None, None]
        cash = np.where(change > 0, -change * (price + into), -change * (price - out))
        ahead = (moves @ value)[:, None, :]
        value = np.where(feasible, cash + ahead, -np.inf).max(2)
    return value[size, 0]


def growth(alpha=0.4, beta=0.96, mu=0.05, s=0.1, y0=1.0, steps=30) -> float:
    """Brock and Mirman's growth with logarithmic utility; the deviation s has no effect."""
    level, slope_ = 0.0, 1.0
    for _ in range(steps - 1):
        saved = alpha * beta * slope_
        share = saved / (1 + saved)
        level = np.log(1 - share) + beta * (level + slope_ * (mu + alpha * np.log(share)))
        slope_ = 1 + saved
    return level + slope_ * np.log(y0) + 0 * s


def signal(v=2.0, w=1.0) -> float:
    """The conditional variance of a normal number that is observed with noise."""
    return -v * w / (v + w)


def allocation(c1=1.0, c2=0.7, c3=0.4, sd=0.3, budget=2.0) -> float:
    """Three projects with returns c sqrt(money); the c of the first is observed as c1 exp(sd z -
    …).

    With c known the best return is sqrt(budget (c1^2 + c2^2 + c3^2)).
    """
    first = c1 * np.exp(sd * NODES - sd**2 / 2)
    return float((WEIGHTS * np.sqrt(budget * (first**2 + c2**2 + c3**2))).sum())


def batches(k=2.0, h=0.5, p=3.0, mean=3.0, steps=20, start=4, cap=30) -> float:
    """Lost sales; each period 0, 4 or 8 units are made, at a cost of 0, k or 1.6 k."""
    demand, weights = poisson(mean, 30)
    stock = np.arange(cap + 1)
    value = np.zeros(cap + 1)
    for _ in range(steps):
        options = []
        for made, cost in ((0, 0.0), (4, k), (8, 1.6 * k)):
            full = np.minimum(stock + made, cap)
            left = full[:, None] - demand
            stage = h * np.maximum(left, 0) + p * np.maximum(-left, 0)
            options.append(cost + (weights * (stage + value[np.maximum(left, 0)])).sum(1))
        value = np.min(options, axis=0)
    return -value[start]


def offers(low=10.0, high=20.0, beta=0.97, wait=0.2, steps=12) -> float:
    """A house to sell: each period has one uniform offer; the last one must be taken."""
    value = (low + high) / 2
    for _ in range(steps - 1):
        least = np.clip(beta * value - wait, low, high)
        share = (high - least) / (high - low)
        value = share * (least + high) / 2 + (1 - share) * (beta * value - wait)
    return float(value)


def cake(beta=0.95, mu=0.03, sd=0.2, x0=1.0, gamma=2.0, steps=10) -> float:
    """Wealth with random growth is consumed over ten periods: V = A x^(1 - gamma) / (1 - gamma)."""
    worth = 1.0
    growth_ = np.exp((1 - gamma) * (mu - sd**2 / 2) + ((1 - gamma) * sd) ** 2 / 2)
    for _ in range(steps - 1):
        worth = (1 + (beta * growth_ * worth) ** (1 / gamma)) ** gamma
    return float(worth * x0 ** (1 - gamma) / (1 - gamma))
