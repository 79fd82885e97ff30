"""Actions that find out: random ones that are held, and those of a policy with such noise.

White noise averages out in a system with momentum: a mountain car that shakes never leaves its
valley. An action held for a random while moves it. (Eberhard and others 2023, "Pink noise is all
you need", measure how much correlation in time matters.)
"""

from collections.abc import Callable

import numpy as np

from .real import Act, Real

SHORTEST, LONGEST = 0.01, 0.1  # for how much of an episode an action is held, log-uniformly
NOISE = 0.3  # of half the range of an action, added to those of a policy


def random_actions(real: Real, rng: np.random.Generator) -> Act:
    """Random actions, each held for one time that is drawn for the episode; ends are likely."""
    low, high = (np.ravel(item) for item in (real.actions.low, real.actions.high))
    drawn = _held(real, rng)

    def act(observed, number):
        return low + (high - low) * (np.clip(drawn(number), -1, 1) + 1) / 2

    return act


def noisy(policy: Callable[[np.ndarray], np.ndarray], real: Real, rng: np.random.Generator) -> Act:
    """The policy's actions with held noise, within bounds."""
    low, high = (np.ravel(item) for item in (real.actions.low, real.actions.high))
    drawn, size = _held(real, rng), NOISE * (high - low) / 2

    def act(observed, number):
        return np.clip(policy(observed) + size * drawn(number), low, high)

    return act


def _held(real: Real, rng: np.random.Generator) -> Callable[[int], np.ndarray]:
    """Uniform numbers from -2 to 2 [m], a new one after every so many decisions."""
    shortest, longest = (max(1.0, share * real.decisions) for share in (SHORTEST, LONGEST))
    while_ = max(1, round(float(np.exp(rng.uniform(np.log(shortest), np.log(longest))))))
    now = np.zeros(real.size)

    def drawn(number: int) -> np.ndarray:
        nonlocal now
        if number % while_ == 0:
            now = rng.uniform(-2, 2, real.size)
        return now

    return drawn
