"""Least-squares Monte Carlo in NumPy: Longstaff and Schwartz (2001) for the put, and for the store
the same on a grid of inventories (Boogert and de Jong 2008). Rules are fitted on separate paths and
valued on those of the yardstick."""

import numpy as np

from .clock import Clock, Point, Tell
from .tasks import TASKS
from .yardstick import Yardstick

DEGREE = 5
FITTED = {"put": 50_000, "storage": 5_000}  # paths of the regression


def regress(problem: str, seed: int, tell: Tell) -> None:
    """Reports the only point of a method without a curve, for "put" and "storage"."""
    task = TASKS[problem](seed)
    noise = Yardstick(task.problem, task.paths).noise()[1][..., 0].astype(float)
    solver = {"put": put, "storage": storage}[problem]
    clock, fitted = Clock(), FITTED[problem]
    random = np.random.default_rng([seed, 1])
    rule = solver(task, random.standard_normal((len(noise), fitted)))
    processor, wall = clock.read()
    value = float(rule(noise).mean())
    tell(Point(problem, "regression", seed, fitted * len(noise), processor, wall, value))


def put(task, fitting: np.ndarray):
    """The rule that stops if the payoff is above the regression of the earnings of waiting."""
    given = {name: float(entry.value) for name, entry in task.problem.inputs.items()}
    dates, strike = len(fitting), given["strike"]
    drift = (given["rate"] - given["volatility"] ** 2 / 2) / dates
    deviation, discount = given["volatility"] / dates**0.5, np.exp(-given["rate"] / dates)

    def spots(noise: np.ndarray) -> np.ndarray:
        moves = np.cumsum(drift + deviation * noise, 0)
        return given["spot"] * np.exp(np.concatenate([0 * moves[:1], moves]))

    def basis(spot: np.ndarray) -> np.ndarray:
        return np.vander((spot - strike) / strike, DEGREE)

    path = spots(fitting)
    cash, betas = np.maximum(strike - path[-1], 0.0), [None] * dates
    for t in range(dates - 1, -1, -1):
        cash = cash * discount
        payoff = strike - path[t]
        within = payoff > 0
        if t == 0:
            betas[0] = cash.mean()
            break
        if within.sum() > DEGREE:
            betas[t] = np.linalg.lstsq(basis(path[t][within]), cash[within], rcond=None)[0]
            waiting = basis(path[t]) @ betas[t]
            cash = np.where(within & (payoff > waiting), payoff, cash)

    def rule(noise: np.ndarray) -> np.ndarray:
        path = spots(noise)
        alive, total = np.ones(noise.shape[1], bool), np.zeros(noise.shape[1])
        for t in range(dates):
            if betas[t] is None:
                continue
            payoff = strike - path[t]
            waiting = betas[0] if t == 0 else basis(path[t]) @ betas[t]
            stop = alive & (payoff > 0) & (payoff > waiting)
            total[stop] = (payoff * discount**t)[stop]
            alive &= ~stop
        return total + alive * np.maximum(strike - path[-1], 0.0) * discount**dates

    return rule


def storage(task, fitting: np.ndarray):
    """One unit a day in or out, on whole units of inventory; empty at the start and the end."""
    simulator = task.problem.simulator
    forward = task.problem.inputs_by_name[simulator.curve.name].value
    days, levels, keep, shock = len(fitting), 101, 0.88, 365**-0.5
    spread = shock**2 * (1 - keep ** (2 * np.arange(days))) / (1 - keep**2)

    def factors(noise: np.ndarray) -> np.ndarray:
        x = np.zeros((days, noise.shape[1]))
        for t in range(days - 1):
            x[t + 1] = keep * x[t] + shock * noise[t]
        return x

    def spots(x: np.ndarray) -> np.ndarray:
        return forward[:days, None] * np.exp(x - spread[:, None] / 2)

    def basis(x: np.ndarray) -> np.ndarray:
        return np.vander(x * 5, DEGREE)

    def choice(t: int, x: np.ndarray, spot: np.ndarray) -> np.ndarray:
        """[levels, N] the best flow, 1 in or -1 out, by the expected value of the inventory."""
        worth = betas[t] @ basis(x).T  # [levels, N]
        options = np.full((3, levels, x.size), -np.inf)
        options[0, 1:] = worth[:-1] + spot
        options[1] = worth
        options[2, :-1] = worth[1:] - spot
        return options.argmax(0) - 1

    impossible = -1e6
    x = factors(fitting)
    spot, betas = spots(x), np.zeros((days, levels, DEGREE))
    ahead = np.full((levels, x.shape[1]), impossible)
    ahead[0] = 0.0
    grid = np.arange(levels)[:, None]
    for t in range(days - 1, -1, -1):
        seen = basis(x[t]) if t else basis(x[t])[:, -1:]
        found = np.linalg.lstsq(seen, ahead.T, rcond=None)[0].T
        betas[t, :, -found.shape[1] :] = found
        flow = choice(t, x[t], spot[t])
        after = np.take_along_axis(ahead, np.clip(grid + flow, 0, levels - 1), 0)
        ahead = after - flow * spot[t]

    def rule(noise: np.ndarray) -> np.ndarray:
        x = factors(noise)
        spot, held = spots(x), np.zeros(noise.shape[1], int)
        total, each = np.zeros(noise.shape[1]), np.arange(noise.shape[1])
        for t in range(days):
            flow = choice(t, x[t], spot[t])[held, each]
            held, total = held + flow, total - flow * spot[t]
        return np.where(held == 0, total, impossible)

    return rule
