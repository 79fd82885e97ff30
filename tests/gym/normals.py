"""A problem on the normals that its environment draws, for equal paths in both."""

import numpy as np
from gymnasium.utils.seeding import np_random

import snapo


def on_the_noise_of(problem: snapo.Problem, seeds: int) -> snapo.Problem:
    """The same problem on the normals that an environment draws after `reset(seed=0)` …"""
    simulator, first, later = problem.simulator, [], []
    for seed in range(seeds):
        random = np_random(seed)[0]
        first.append(random.standard_normal(simulator.initial_noise_size, np.float32))
        later.append(
            [
                random.standard_normal(simulator.noise_size, np.float32)
                for _ in range(simulator.horizon)
            ]
        )
    given = snapo.Supplied(np.swapaxes(np.array(later, float), 0, 1), np.array(first, float))
    sources = snapo.Sources(given, given, given)
    return snapo.Problem(simulator, problem.inputs, problem.objective, sources)
