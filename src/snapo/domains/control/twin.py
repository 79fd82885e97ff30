"""A policy that was trained on a plant, as an agent for the plant's twin in Gymnasium."""

from typing import TYPE_CHECKING, Any

from snapo.problem.inputs import plain
from snapo.problem.policy import Policy

from .plants.plant import Plant

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
