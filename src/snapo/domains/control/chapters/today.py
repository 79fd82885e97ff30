"""The first decision, at the middle of the initial states."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.policies.memory import first_decision
from snapo.problem.policy import Policy
from snapo.problem.simulator import at
from snapo.study.study import Setup, Today

from ..plants.plant import Plant


def today(setup: Setup, policy: Policy) -> Today:
    """The physical action of the first step, from the mean of the initial state."""
    plant, schedule = setup.problem.simulator, setup.problem.schedule
    assert isinstance(plant, Plant)
    start = schedule.constants["start"]
    state = {name: _middle(start[name], keys) for name, keys in plant.starts}

    def decide(state: Any) -> Any:
        observed = plant.observe(schedule.constants, at(schedule.steps, 0), state)
        return plant.drive(schedule.constants["plant"], first_decision(policy, observed))

    action = np.ravel(np.asarray(jax.jit(decide)(jax.tree.map(jnp.asarray, state)), np.float64))
    facts = [(f"first {name}", *_one(x, plant.states[name].unit)) for name, x in state.items()]
    by_name = [(name, item.unit) for name, item in plant.actions.items()]
    if len(by_name) != len(action):  # one name for several numbers
        by_name = [(f"{by_name[0][0]} {i + 1}", by_name[0][1]) for i in range(len(action))]
    summary = [
        (name, float(x), "" if unit == "1" else unit) for (name, unit), x in zip(by_name, action)
    ]
    text = ", ".join(f"{name} {x:,.4g} {unit}".strip() for name, x, unit in summary)
    return Today(text, [fact for fact in facts if fact[1] is not None], (), ())


def _middle(start: dict[str, Any], keys: tuple[str, ...]) -> np.ndarray:
    if keys == ("low", "high"):
        return (np.asarray(start["low"], np.float64) + np.asarray(start["high"])) / 2
    return np.asarray(start[keys[0]], np.float64)


def _one(value: np.ndarray, unit: str) -> tuple[float | None, str]:
    """A number with its unit; nothing of a state of several numbers."""
    return (float(value) if np.size(value) == 1 else None), "" if unit == "1" else unit
