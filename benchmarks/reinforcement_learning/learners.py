"""Training by Stable-Baselines3: the curve of one run."""

import numpy as np
import torch
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import VecNormalize

from .clock import Budget, Clock, Point, Tell
from .environment import Paths, raw_of
from .settings import settings
from .tasks import TASKS
from .yardstick import Yardstick

ALGORITHMS = {"ppo": PPO, "sac": SAC, "td3": TD3}
MEASURED = 8  # points of a curve


def learn(
    problem: str, algorithm: str, seed: int, steps: int | None, budget: Budget, tell: Tell
) -> None:
    """Reports the points of one run of `steps` simulated steps (None: those of the settings), or
    fewer if the budget ends earlier."""
    torch.set_num_threads(1)
    task, chosen = TASKS[problem](seed), settings(problem, algorithm)
    options = bool(task.options) and algorithm == "ppo"
    clock = Clock()  # the problem itself was made before, of which an agent does not need all
    total = steps or chosen.steps
    keywords = {"gamma": task.discount} | chosen.keywords
    environment = Paths(task, chosen.paths, seed, options)
    if chosen.normalise:
        environment = VecNormalize(environment, norm_obs=False, gamma=keywords["gamma"])
    if chosen.exploration:
        spread = np.full(task.size, chosen.exploration)
        keywords["action_noise"] = NormalActionNoise(np.zeros(task.size), spread)
    model = ALGORITHMS[algorithm]("MlpPolicy", environment, seed=seed, device="cpu", **keywords)
    with clock.paused():
        yardstick = Yardstick(task.problem, task.paths, task.decode)
    names = problem, algorithm, seed
    record = Record(yardstick, clock, task, options, names, total, budget, tell)
    model.learn(total, callback=record)


class Record(BaseCallback):
    """Values the rule at growing intervals, during which the clock is stopped."""

    def __init__(self, yardstick, clock, task, options, names, total, budget, tell):
        super().__init__()
        self.yardstick, self.clock, self.task, self.options = yardstick, clock, task, options
        self.names, self.budget, self.tell = names, budget, tell
        self.marks = list(np.geomspace(total / 40, total, MEASURED).astype(int))

    def _on_step(self) -> bool:
        late = self.budget.spent(self.clock)
        if not late and self.marks and self.num_timesteps >= self.marks[0]:
            self._measure()
        return not late

    def _on_training_end(self) -> None:
        self._measure()  # after the last update

    def _measure(self) -> None:
        self.marks = [mark for mark in self.marks if mark > self.num_timesteps]
        processor, wall = self.clock.read()
        with self.clock.paused():
            value = self.yardstick.value(self._rule)
        self.tell(Point(*self.names, self.num_timesteps, processor, wall, value))

    def _rule(self, seen: np.ndarray) -> np.ndarray:
        return raw_of(self.task, self.model.predict(seen, deterministic=True)[0], self.options)
