"""The problems of the comparison, each as snapo solves it and as an agent plays it."""

import runpy
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import snapo
from snapo.case.load import load
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.pendulum import Pendulum
from snapo.domains.gas_storage import DOMAIN as STORAGE
from snapo.domains.gas_storage.setup import make_setup as storage_setup
from snapo.domains.inventory.read.case import read_case as read_inventory
from snapo.domains.inventory.setup import make_setup as inventory_setup
from snapo.domains.pension import DOMAIN as PENSION
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.policies.allocation import AllocationLimits, new_policy, present
from snapo.domains.pension.read.case import read_case as read_fund
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.problem.smooth import Exact

from .lessons import lessons, plant

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Task:
    """A problem and the two ways to learn it.

    - `problem`: the problem whose value counts; `training`, `policy`: the settings and the network
      of snapo; `lesson`: the problem on which snapo trains, by default the same; `before`: an
      earlier problem, with its settings, on which snapo trains first.
    - `played`: the problem on which an agent trains; `endless`: whether its end is only a limit of
      time.
    - `decode`: a function from an agent's action [size], between -1 and 1, to the simulator's
      action.
    - `options`: the number of options of PPO if the decision is one of several; 0: it has numbers.
    - `paths`: the number of common paths, on which every rule is valued.
    - `unit`: divides an agent's rewards, so that they are of order one; `discount`: the agent's
      discount factor per step.
    """

    problem: snapo.Problem
    policy: Any
    training: snapo.Training
    decode: Callable
    size: int
    discount: float
    paths: int = 1000
    unit: float = 1.0
    lesson: snapo.Problem | None = None
    before: tuple[snapo.Problem, snapo.Training] | None = None
    played: snapo.Problem | None = None
    endless: bool = False
    options: int = 0


def pendulum(seed: int) -> Task:
    """Pendulum-v1, exactly as in Gymnasium; snapo by the recipe of docs/control.md."""
    before, (lesson, training) = lessons(seed, 10)
    return Task(
        plant(make_inputs(Pendulum), 200), snapo.MLP(), training, lambda raw: raw, 1, 0.99,
        lesson=lesson, before=before, endless=True,
    )  # fmt: skip


def inventory(seed: int) -> Task:
    """Lost sales, Poisson demand of 5, lead time 4, shortage cost 4 (Zipkin 2008)."""
    tables = {
        "kind": "inventory",
        "item": {"unmet": "lost", "lead_time": 4, "holding": 1.0, "shortage": 4.0, "most": 20},
        "demand": {"kind": "poisson", "mean": 5.0},
        "training": {"steps": 200, "seed": seed},
    }
    horizons = {"periods": 60, "warm_up": 30}, {"periods": 60, "warm_up": 0}
    # A cost that does not count in the first thirty periods would be hidden from an agent.
    setup, plain = (
        inventory_setup(read_inventory(ROOT / "case.toml", tables | {"horizon": horizon}))
        for horizon in horizons
    )
    training = replace(
        setup.training, steps=200, paths=128, window=None, validation_paths=512,
        validation_every=10, seed=seed,
    )  # fmt: skip
    return Task(
        setup.problem, setup.policy, training,
        lambda raw: jnp.round(10 * (raw + 1)), 1, 0.99, unit=5 / 60, played=plain.problem,
        endless=True,
    )  # fmt: skip


def storage(seed: int) -> Task:
    """Slow gas storage over a year, one price factor (Boogert and de Jong 2011)."""
    folder = ROOT / "tests" / "domains" / "gas_storage" / "cases" / "G6"
    setup = storage_setup(STORAGE.read(*load(folder)))
    training = snapo.Training(
        steps=60, paths=64, window=None, validation_paths=256, validation_every=10, seed=seed
    )
    return Task(
        setup.problem, setup.policy, training,
        lambda raw: jnp.maximum(jnp.concatenate([raw, -raw]), 0.0), 1, 0.9999, paths=500, unit=25.0,
    )  # fmt: skip


def plain_storage(seed: int) -> Task:
    """The same with a plain network instead of the rule that uses prices of gas."""
    found = storage(seed)
    return replace(found, policy=snapo.MLP())


def put(seed: int) -> Task:
    """An American put on 50 dates: `examples/american_put.py`."""
    example = runpy.run_path(str(ROOT / "examples" / "american_put.py"))

    class Put(example["Put"]):
        """An episode ends when the right is used."""

        def over(self, constants, state):
            return self.action.left(state["right"]) < 0.5

    problem = snapo.Problem(Put(), example["inputs"], snapo.Mean("cash"))
    training = snapo.Training(
        steps=720, paths=256, window=None, validation_paths=4096, validation_every=40, seed=seed
    )
    return Task(
        problem, snapo.MLP(), training,
        lambda raw: (raw > 0).astype(jnp.float32), 1, 1.0, paths=6000, options=2,
    )  # fmt: skip


class Fund(PensionSimulator):
    """A fund with the utility of its funding ratio F at the end, -F^-4 / 4, as an output."""

    def terminal(self, constants, state, smooth):
        found = super().terminal(constants, state, smooth)
        return found | {"utility": -(found["funding_ratio"] ** -4.0) / 4}


def fund(seed: int) -> Task:
    """The small fund that comes with snapo, over 120 months; risk aversion 5."""
    case = read_fund(Path(str(PENSION.templates["small"])))
    simulator = Fund.of(case)
    problem = snapo.Problem(simulator, pension_inputs(case), snapo.Mean("utility"))
    policy = new_policy(case, simulator, problem.schedule, jax.random.key(seed))
    limits, start = AllocationLimits(case), np.asarray(present(case), np.float32)
    training = snapo.Training(
        steps=60, paths=128, window=None, validation_paths=256, validation_every=10, seed=seed
    )
    return Task(
        problem, policy, training,
        lambda raw: limits(start + 4 * raw, Exact()), len(start), 0.9999, unit=0.1,
    )  # fmt: skip


TASKS: dict[str, Callable[[int], Task]] = {
    each.__name__: each for each in (pendulum, inventory, storage, plain_storage, put, fund)
}
