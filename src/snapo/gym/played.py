"""What an agent earns in a real Gymnasium environment, on starts that others can repeat."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.policy import Policy
from snapo.solver import statistics

from .agent import Agent
from .environment import Environment
from .installed import gymnasium
from .spaces import element


class Played(NamedTuple):
    """The mean reward of an episode with its standard error; rewards and steps [starts] of each."""

    mean: float
    standard_error: float
    rewards: np.ndarray
    steps: np.ndarray

    def __str__(self) -> str:
        return f"{self.mean:.4g} ± {self.standard_error:.2g} over {len(self.rewards):,} starts"


def play(
    agent: Agent | Policy | Callable[[np.ndarray], np.ndarray],
    environment: "str | Callable[[], Any]",
    starts: int | Sequence[int] = 2000,
) -> Played:
    """Plays one episode from every start, all episodes side by side.

    **Arguments:**

    - `agent`: an `Agent`, a policy, or any function from observations [N, k] to N actions. A policy
      writes its actions for the environment's space (see `Agent`); a memory begins anew.
    - `environment`: a name such as "Pendulum-v1", or a function that makes an environment.
    - `starts`: seeds of `environment.reset(seed=…)`, or a number n for the seeds 0 … n - 1: the
      same ones for every agent, so that agents are compared on common starts.
    """
    seeds = range(starts) if isinstance(starts, int) else starts
    if not len(seeds):
        raise ValueError("play: give at least one start.")
    worlds = [made(environment) for _ in seeds]
    act = _for_world(agent, worlds[0])
    firsts = [each.reset(seed=int(seed))[0] for each, seed in zip(worlds, seeds)]
    seen = np.stack([np.asarray(each, np.float32) for each in firsts])
    rewards, steps = np.zeros(len(worlds)), np.zeros(len(worlds), int)
    going = list(range(len(worlds)))
    while going:
        actions = act(seen)  # of all: one compiled shape
        left = []
        for i in going:
            seen[i], reward, ended, late, _ = worlds[i].step(element(actions, i))
            rewards[i] += reward
            steps[i] += 1
            if not (ended or late):
                left.append(i)
        going = left
    for each in worlds:
        each.close()
    found = statistics.mean(rewards, np.arange(rewards.size))
    return Played(float(np.mean(rewards)), found.standard_error, rewards, steps)


def _for_world(agent: Any, world: Any) -> Callable[[np.ndarray], Any]:
    """The agent, or that of a policy, for the actions of the environment; it remembers nothing."""
    if not isinstance(agent, Agent | Policy):
        return agent
    act = Agent(agent) if isinstance(agent, Policy) else agent
    own = isinstance(world.unwrapped, Environment)
    return act.on(world.unwrapped.decisions if own else world.action_space)


def made(environment: "str | Callable[[], Any]"):
    """The environment of this name, or the one that the function makes."""
    if isinstance(environment, str):
        return gymnasium.make(environment, disable_env_checker=True)
    return environment()
