"""How the engines carry the memory of a policy: in the state of a simulator around the user's own.

Outside nothing of it is seen: states and actions that come back are those of the user's simulator.
Only who gives the simulator around it (`Remembering`), as training does, gets the memory back.
"""

import numpy as np
from jaxtyping import PyTree

from snapo.problem.policies.memory import Remembering, remembered, remembers
from snapo.problem.policy import Policy
from snapo.problem.simulator import Simulator

from .base import Adjoint, Rollout


def with_memory(
    simulator: Simulator, policy: Policy | None, actions, start: PyTree, paths: int
) -> tuple[Simulator, PyTree]:
    """The simulator and the starting states that a rollout of this policy needs.

    Recorded actions need no memory; states that were given begin without one.
    """
    size = 0 if actions is not None else remembered(policy)
    if not size or remembers(simulator):
        return simulator, start
    around = Remembering(simulator, size)  # pyright: ignore
    if start is not None:
        start = {"memory": np.zeros((paths, size)), "own": start}
    return around, start


def values_without(simulator: Simulator, used: Simulator, rollout: Rollout) -> Rollout:
    """What a sweep gives, without the memory that `used` carries and `simulator` has not."""
    if used is simulator or not isinstance(used, Remembering):
        return rollout
    record = dict(rollout.record)
    if "state" in record:
        record["state"] = record["state"]["own"]
    if "action" in record:
        record["action"] = record["action"][..., : simulator.action.size]
    return Rollout(rollout.totals, rollout.state["own"], record)


def adjoint_without(simulator: Simulator, used: Simulator, adjoint: Adjoint) -> Adjoint:
    """The same of an adjoint pass."""
    if used is simulator or not isinstance(used, Remembering) or adjoint.start is None:
        return adjoint
    return adjoint._replace(start=adjoint.start["own"])
