"""The trained policy in Gymnasium's own environment, where the case has its numbers."""

from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.inputs import plain
from snapo.problem.policy import Policy
from snapo.study.study import Part, StudyRun

from ..inputs import make_inputs
from ..plants.plant import Plant

if TYPE_CHECKING:
    from snapo.gym.agent import Agent


def agent(plant: Plant, policy: Policy, inputs: Any) -> "Agent":
    """The policy as a function from the environment's observations to its actions."""
    from snapo.gym import Agent

    p = plain(inputs)["plant"]
    return Agent(
        policy,
        lambda seen: plant.from_twin(p, seen),
        lambda action: plant.to_twin(p, action),
    )


STARTS = 2000


def gymnasium_part(plant: Plant) -> Part:
    """A part that gives "gymnasium": {name, mean, standard_error, starts} of episodes whose starts
    are those of `reset(seed=0)`, `reset(seed=1)` …"""

    def work(run: StudyRun) -> dict[str, Any]:
        from snapo.gym.played import play

        problem = run.setup.problem
        _check_same(plant, plain(problem.inputs))
        policy = run.solution.policy
        assert policy is not None
        played = play(agent(plant, policy, problem.inputs), plant.twin, STARTS)
        return {
            "gymnasium": {
                "name": plant.twin,
                "mean": played.mean,
                "standard_error": played.standard_error,
                "starts": STARTS,
            }
        }

    return Part("gymnasium", work, needs=("training",))


def _check_same(plant: Plant, values: Any) -> None:
    """Refuses a case whose numbers are not those of the environment."""
    usual = plain(make_inputs(type(plant)))
    for group in ("plant", "cost"):
        for name, given in values[group].items():
            if not np.array_equal(given, usual[group][name]):
                what = f"{plant.twin} has {usual[group][name]:g}; leave --reference out"
                raise CaseError("--reference", f"{group}.{name}", float(given), what)
    if values["noise"] or values["measurement"] or plant.clock:
        what = f"{plant.twin} has no disturbances, no errors of measurement and shows no clock; "
        what += "leave --reference out"
        raise CaseError("--reference", "", None, what)
