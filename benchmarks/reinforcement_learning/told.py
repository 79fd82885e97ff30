"""The problems in words, and their values as the table tells them; nothing is made for it."""

from collections.abc import Callable
from typing import NamedTuple


class Told(NamedTuple):
    """A problem in words, the best possible, and from a value to the number that the table has."""

    words: str
    exact: str
    shown: Callable[[float], float] = float


def certainty(utility: float) -> float:
    """The funding ratio that is worth as much when it is sure: utility is -F^-4 / 4."""
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
