"""Descriptions of the problems, and their values as the table shows them, without computation."""

from collections.abc import Callable
from typing import NamedTuple


class Told(NamedTuple):
    """A problem's description, its best possible value, and the number of the table for a value."""

    words: str
    exact: str
    shown: Callable[[float], float] = float


def certainty(utility: float) -> float:
    """The certainty equivalent of a mean utility -F^-4 / 4, as a funding ratio F."""
    return (-4 * utility) ** -0.25


# Of the methods, as pages write them.
NAMES = {"snapo": "snapo", "ppo": "PPO", "sac": "SAC", "td3": "TD3", "regression": "regression"}
STORE = "gas storage G6, 365 days"
TOLD = {
    "pendulum": Told("Pendulum-v1, 200 steps", "-137.2, dynamic programming"),
    "inventory": Told("inventory, lost sales, lead time 4", "-4.7285, value iteration"),
    "storage": Told(STORE, "656.15, dynamic programming"),
    "plain_storage": Told(f"{STORE}, a plain network", "656.15, dynamic programming"),
    "put": Told("American put, 50 dates", "4.478, finite differences"),
    "fund": Told("small pension fund, 120 months", "not known", certainty),
}
