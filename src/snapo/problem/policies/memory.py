"""Policies that remember: recurrent networks and windows of past observations.

A policy with memory decides by its observation and by internal numbers, which it passes on to its
next decision. The engines carry these next to the simulator's state (`Remembering`): a simulator
need not know of them, and recorded actions can be replayed without them.
"""

import abc
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from ..actions import Actions, Box
from ..policy import MLP, Network, Policy, as_observation, widths
from ..problem import Problem
from ..simulator import Around, Interface, Simulator
from ..smooth import EXACT, Exact


class Memory(Policy):
    """A policy with a memory of `memory` numbers, which are zeros before the first decision.

    A subclass defines their number in `memory` and the method `decide`. When called, it takes the
    observation followed by the memory, and returns the action followed by the next memory.
    """

    @property
    @abc.abstractmethod
    def memory(self) -> int:
        """The size of the memory."""

    @abc.abstractmethod
    def decide(
        self, observation: Float[Array, " features"], memory: Float[Array, " memory"], smooth
    ) -> tuple[Float[Array, " size"], Float[Array, " memory"]]:
        """The action, and the memory at the next decision."""

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        features = observation.shape[0] - self.memory
        if features < 1:
            raise ValueError(
                f"{type(self).__name__}: pass the observation, followed by the {self.memory} "
                "numbers of the memory, which are zeros before the first decision."
            )
        observed, memory = observation[:features], observation[features:]
        action, selected = self.decide(observed, memory, smooth)
        return jnp.concatenate([action, selected.astype(action.dtype)])


class GRU(Memory):
    """A recurrent network (gated recurrent unit, Cho et al. 2014) with `hidden` units.

    Its decision is linear in the observation and in its units, squashed into the action set.
    `GRU(hidden=16)` is a recipe like `MLP(hidden=…)`: `solve` creates the network for the
    simulator. The default of `hidden` is 16 units; if more than eight numbers are decided, it is
    half the width of an `MLP`.
    """

    gates: Network | None
    fresh: Network | None
    readout: Network | None
    action: Actions | None
    hidden: int | None = eqx.field(static=True)

    def __init__(
        self,
        action: Actions | None = None,
        features: int | None = None,
        *,
        key=None,
        hidden: int | None = None,
    ):
        if hidden is not None and (not isinstance(hidden, int) or hidden < 1):
            raise ValueError(f"GRU: hidden is {hidden!r}; it must be a whole number above 0.")
        if hidden is None and action is not None:
            hidden = widths(action)[0] // 2
        self.hidden, self.action = hidden, action
        self.gates = self.fresh = self.readout = None
        if action is None and features is None and key is None:
            return
        if action is None or features is None or key is None or hidden is None:
            raise ValueError(
                "GRU: specify the action set, the number of features and a key together, or none "
                "of them; solve then adds them."
            )
        keys, width = jax.random.split(key, 3), features + hidden
        self.gates, self.fresh = (
            _scaled(Network((width, size), key=item), 100.0)
            for size, item in zip((2 * hidden, hidden), keys)
        )
        self.readout = Network((width, action.size), key=keys[2])

    @property
    def memory(self) -> int:
        return self.hidden or 0

    def decide(self, observation, memory, smooth):
        if self.gates is None or self.fresh is None or self.readout is None or self.action is None:
            raise ValueError(
                "GRU: this is a recipe without numbers; make the policy with "
                "for_problem(simulator.interface(schedule), key), as solve does."
            )
        gates = jax.nn.sigmoid(self.gates(jnp.concatenate([observation, memory])))
        keep, reset = gates[: self.memory], gates[self.memory :]
        fresh = jnp.tanh(self.fresh(jnp.concatenate([observation, reset * memory])))
        selected = keep * memory + (1 - keep) * fresh
        raw = self.readout(jnp.concatenate([observation, selected]))
        return self.action.squash(raw, smooth), selected

    def for_problem(self, interface: Interface, key) -> "GRU":
        _no_stages(self, interface)
        if self.gates is None:
            return GRU(interface.action, interface.features, key=key, hidden=self.hidden)
        features = self.gates.weights[0].shape[1] - self.memory
        if self.action is None or (features, self.action.size) != (
            interface.features,
            interface.action.size,
        ):
            raise ValueError(
                f"GRU: it takes {features} features; the simulator has {interface.features}."
            )
        return self


class LastObservations(Memory):
    """A policy that sees the last `steps` observations, and the decisions between them.

    `LastObservations(4, MLP(hidden=(32,)))` is a recipe. The inner policy observes the present
    observation, then each earlier observation followed by the decision that was taken at it, the
    latest first; before the start both are zeros.
    """

    policy: Policy
    steps: int = eqx.field(static=True)
    width: int = eqx.field(static=True)  # of an observation and a decision; 0: still a recipe

    def __init__(self, steps: int, policy: Policy | None = None, width: int = 0):
        if not isinstance(steps, int) or steps < 2:
            raise ValueError(
                f"LastObservations: steps is {steps!r}; it must be a whole number of 2 or more."
            )
        self.policy, self.steps, self.width = MLP() if policy is None else policy, steps, width
        if isinstance(self.policy, Memory):
            message = "its inner policy has a memory already; it must be one without memory"
            raise ValueError(f"LastObservations: {message}.")

    @property
    def memory(self) -> int:
        return (self.steps - 1) * self.width

    def decide(self, observation, memory, smooth):
        if not self.width:
            raise ValueError("LastObservations: this is a recipe; solve makes the policy from it.")
        action = self.policy(jnp.concatenate([observation, memory]), smooth)
        selected = jnp.concatenate([observation, action.astype(observation.dtype), memory])
        return action, selected[: self.memory]

    def for_problem(self, interface: Interface, key) -> "LastObservations":
        _no_stages(self, interface)
        width = interface.features + interface.action.size
        if self.width and self.width != width:
            raise ValueError(
                "LastObservations: this policy was made for an observation and a decision of "
                f"{self.width} numbers together; this simulator has {width}."
            )
        observed = interface.features + (self.steps - 1) * width
        inner = self.policy.for_problem(Interface(interface.action, observed), key)
        made = self.width == width and inner is self.policy
        return self if made else LastObservations(self.steps, inner, width)


def remembered(policy: Policy | None) -> int:
    """The number of values that a policy remembers; 0 for policies without a memory."""
    return policy.memory if isinstance(policy, Memory) else 0


def first_decision(policy: Policy, observation: Float[Array, " features"]) -> Float[Array, " size"]:
    """The exact decision of the first step, when the memory is empty."""
    if isinstance(policy, Memory):
        return policy.decide(observation, jnp.zeros(policy.memory, observation.dtype), Exact())[0]
    return policy(observation, Exact())


class Remembering(Around):
    """A simulator whose state holds a policy's memory as well, for the engines.

    Its observation ends with the memory, and its action ends with the next memory.
    """

    memory: int = eqx.field(static=True)

    @property
    def action(self) -> Box:  # pyright: ignore[reportIncompatibleVariableOverride]
        return Box(-jnp.inf, jnp.inf, self.inner.action.size + self.memory)

    def initial(self, constants, noise):
        return self.initial_state(self.inner.initial(constants, noise))

    def initial_state(self, state: PyTree) -> PyTree:
        """A state of the simulator before the first decision."""
        return {"memory": jnp.zeros(self.memory), "own": state}

    def observe(self, constants, now, state):
        observed = self.inner.observe(constants, now, state["own"])
        return jnp.concatenate([observed, state["memory"].astype(observed.dtype)])

    def step(self, constants, now, state, action, noise, smooth):
        size = self.inner.action.size
        selected, memory = action[:size], action[size:]
        after, outputs = self.inner.step(constants, now, state["own"], selected, noise, smooth)
        return {"memory": memory, "own": after}, outputs

    def terminal(self, constants, state, smooth):
        return self.inner.terminal(constants, state["own"], smooth)

    def state_scale(self, constants):
        scale = self.inner.state_scale(constants)
        if scale is None:
            return None
        return {"memory": jnp.ones(self.memory), "own": scale}

    def slack(self, constants, now, state, outputs):
        return self.inner.slack(constants, now, state["own"], outputs)


def remembers(simulator: Simulator) -> bool:
    """Whether the state already contains a policy's memory, also inside another simulator."""
    return isinstance(simulator, Remembering) or isinstance(
        getattr(simulator, "inner", None), Remembering
    )


def remembering(problem: Problem, policy: Policy) -> Problem:
    """The problem whose states hold the memory of a policy; the problem itself for a policy without
    one."""
    size, simulator = remembered(policy), problem.simulator
    if not size or remembers(simulator):
        return problem
    return replace(problem, simulator=Remembering(simulator, size))  # pyright: ignore[reportCallIssue]


def _scaled(network: Network, factor: float) -> Network:
    """A network whose last layer does not start small."""
    return eqx.tree_at(lambda n: n.weights[-1], network, factor * network.weights[-1])


def _no_stages(policy: Policy, interface: Interface) -> None:
    if interface.stages:
        raise ValueError(
            f"{type(policy).__name__}: a policy with memory cannot decide in a Chain, whose stages "
            "observe different things."
        )
