"""The plane of two states: the policy's decision at every place, and some paths on it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.policies.memory import first_decision
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.study.parts.profile import recorded
from snapo.study.study import Part, StudyRun

from ..plants.plant import Plant

CELLS, PATHS, KNOWN = 48, 8, 512  # of the map to a side; drawn; recorded


def plane_part(plant: Plant) -> Part:
    """A part that gives "plane": {`states` [across, up], `units`, `turn`, `across`, `up` [CELLS],
    `action`, `paths`}.

    `action` [CELLS, CELLS] is the decision of the first step at (up, across), where these two are
    all the states, else empty. A plant of one number has no plane: `states` is empty.
    """

    def work(run: StudyRun) -> dict[str, Any]:
        problem, policy = run.setup.problem, run.solution.policy
        assert policy is not None
        known: dict[str, np.ndarray] = {}
        for kind, name, values in recorded(run.setup, policy, KNOWN):
            if kind == "state" and name in plant.states:
                count = values.shape[2]
                for i in range(count):
                    known[name if count == 1 else f"{name}.{i}"] = values[:, :, i]
        if len(known) < 2:
            return {"plane": {"states": []}}
        names = _pair(plant, list(known))
        about = [plant.states[name.partition(".")[0]] for name in names]
        ranges = [_range(known[name], each.turn) for name, each in zip(names, about)]
        whole = len(known) == 2
        # Eight paths, from the lowest first state to the highest.
        first = known[names[0]][0]
        chosen = np.argsort(first)[np.linspace(0, first.size - 1, PATHS).round().astype(int)]
        return {
            "plane": {
                "states": names,
                "units": [each.unit for each in about],
                "turn": [each.turn for each in about],
                "across": ranges[0],
                "up": ranges[1],
                "action": _decisions(problem, policy, names, ranges) if whole else [],
                "paths": [[known[name][:, i] for name in names] for i in chosen],
            }
        }

    return Part("plane of states", work, needs=("training",))


def _pair(plant: Plant, known: list[str]) -> list[str]:
    """The two states of the picture: an angle with its speed where there is one."""
    return list(plant.portrait) if plant.portrait else known[:2]


def _range(values: np.ndarray, turn: bool) -> np.ndarray:
    """Places along an axis: a whole turn of an angle, or all but the outermost states."""
    low, high = (-np.pi, np.pi) if turn else np.quantile(values, [0.002, 0.998])
    room = 0.0 if turn else 0.05 * max(high - low, 1e-9)
    return np.linspace(low - room, high + room, CELLS)


def _decisions(problem: Problem, policy: Policy, names, ranges) -> np.ndarray:
    """[up, across] the first number of the decision at the first step."""
    schedule = problem.schedule
    now, vector = at(schedule.steps, 0), "." in names[0]

    def decide(up, across):
        state: Any = {names[0]: across, names[1]: up}
        if vector:
            state = {names[0].partition(".")[0]: jnp.stack([across, up])}
        return first_decision(policy, problem.simulator.observe(schedule.constants, now, state))[0]

    grid = jax.vmap(jax.vmap(decide, (None, 0)), (0, None))
    return np.asarray(jax.jit(grid)(jnp.asarray(ranges[1]), jnp.asarray(ranges[0])))
