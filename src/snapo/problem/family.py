"""One policy for a range of inputs, which it observes in addition to the state.

In training every path belongs to a member of the family: one of a number of points that fill the
ranges evenly, each with a separate schedule. After training the policy can be used in any member.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import PyTree

from . import inputs as inputs_
from .problem import Problem
from .simulator import Around, Schedule, Simulator


@dataclass(frozen=True, eq=False)
class Family:
    """A problem for all values of some inputs between bounds.

        family = snapo.Family(problem, {"volatility": (0.1, 0.5), "cost": (1.0, 3.0)})
        solution = snapo.solve(family.training)
        member = family.at({"volatility": 0.2, "cost": 2.5})
        snapo.evaluate(member, solution.policy)
        snapo.sensitivities(member, solution.policy)

    The policy observes these inputs, scaled from -1 at the lower to 1 at the upper bound, after the
    features of the simulator. An objective that is not a mean, such as a CVaR, is computed over the
    paths of all members together, so that training gives the largest weights to the worst members.

    **Arguments:**

    - `ranges`: {input: (low, high)}, numbers or arrays shaped like the input; the entries of an
      array vary separately.
    - `members`: the number of training points in the ranges (Sobol points).
    """

    problem: Problem
    ranges: dict[str, tuple[Any, Any]]
    members: int = 64

    def __post_init__(self):
        if unknown := set(self.ranges) - set(self.problem.inputs_by_name):
            raise ValueError(
                f"Family: there is no input {sorted(unknown)}; the inputs are "
                f"{list(self.problem.inputs_by_name)}."
            )
        if not self.ranges:
            raise ValueError("Family: ranges is empty; name at least one input.")
        if self.members < 2:
            raise ValueError(f"Family: members is {self.members}; it must be at least 2.")
        for name, endpoints in self.ranges.items():
            if not isinstance(endpoints, tuple | list) or len(endpoints) != 2:
                raise ValueError(
                    f"Family: the range of {name} is {endpoints!r}; it must be (low, high)."
                )
            low, high = endpoints
            if not np.all(np.asarray(low) < np.asarray(high)):
                raise ValueError(
                    f"Family: the range of {name} is ({low}, {high}); low must be less than high."
                )

    @cached_property
    def training(self) -> Problem:
        """The problem to solve: its value is the objective of all members' paths together.

        In it the inputs with ranges are plain numbers without derivatives, since they differ
        between members; differentiate at a member.
        """
        from scipy.stats import qmc  # late: it takes a second to load

        unit = qmc.Sobol(len(self._low), rng=np.random.default_rng(0)).random(self._power)
        points = self._low + (self._high - self._low) * unit[: self.members]
        return replace(self.problem, simulator=Members(self._seen, points), inputs=self._others)

    def at(self, values: dict[str, Any]) -> Problem:
        """The member with these values of the inputs, the others as in the problem.

        **Raises:** `ValueError` outside the ranges, where the policy was not trained.
        """
        member = self.problem.at(values)
        for name, (low, high) in self.ranges.items():
            value = member.inputs_by_name[name].value
            if np.any(value < low) or np.any(value > high):
                raise ValueError(
                    f"Family: {name} is {value.tolist()}, outside its range {(low, high)}."
                )
        return replace(member, simulator=self._seen)

    @property
    def _power(self) -> int:
        """Sobol points come in powers of two."""
        return 1 << (self.members - 1).bit_length()

    @cached_property
    def _low(self) -> np.ndarray:
        return self._bounds(0)

    @cached_property
    def _high(self) -> np.ndarray:
        return self._bounds(1)

    def _bounds(self, side: int) -> np.ndarray:
        by_name = self.problem.inputs_by_name
        shaped = [
            np.broadcast_to(np.asarray(pair[side], np.float64), by_name[name].value.shape)
            for name, pair in self.ranges.items()
        ]
        return np.concatenate([item.ravel() for item in shaped])

    @property
    def _others(self) -> PyTree:
        """The inputs, those named as plain numbers."""
        names = iter(self.problem.inputs_by_name)

        def plain(leaf: Any) -> Any:
            if not inputs_.is_input(leaf):
                return leaf
            return leaf.value if next(names) in self.ranges else leaf

        return jax.tree.map(plain, self.problem.inputs, is_leaf=inputs_.is_input)

    @cached_property
    def _seen(self) -> "ObservedMember":
        # Where each input is among the leaves of the plain tree that `prepare` gets.
        leaves = jax.tree.leaves(self.problem.inputs, is_leaf=inputs_.is_input)
        positions = [i for i, leaf in enumerate(leaves) if inputs_.is_input(leaf)]
        position = dict(zip(self.problem.inputs_by_name, positions))
        where = tuple(position[name] for name in self.ranges)
        return ObservedMember(self.problem.simulator, where, self._low, self._high)


class ObservedMember(Around):
    """A simulator whose policy observes some inputs, scaled. Its constants are the pair (constants
    of the base simulator, inputs)."""

    where: tuple[int, ...] = eqx.field(static=True)
    low: tuple[float, ...] = eqx.field(static=True)
    high: tuple[float, ...] = eqx.field(static=True)

    def __init__(self, simulator: Simulator, where: tuple[int, ...], low, high):
        self.inner, self.where = simulator, where
        self.low, self.high = tuple(map(float, low)), tuple(map(float, high))

    def prepare(self, inputs):
        leaves = jax.tree.leaves(inputs)
        values = jnp.concatenate([jnp.ravel(leaves[i]) for i in self.where])
        low, high = np.asarray(self.low), np.asarray(self.high)
        schedule = self.inner.prepare(inputs)
        return Schedule((schedule.constants, 2 * (values - low) / (high - low) - 1), schedule.steps)

    def with_values(self, inputs: PyTree, values) -> PyTree:
        """The inputs with other values of those that the policy observes."""
        leaves, structure = jax.tree.flatten(inputs)
        first = 0
        for i in self.where:
            size, shape = np.size(leaves[i]), np.shape(leaves[i])
            leaves[i] = values[first : first + size].reshape(shape)
            first += size
        return structure.unflatten(leaves)

    def initial(self, constants, noise):
        return self.inner.initial(constants[0], noise)

    def observe(self, constants, now, state):
        observed = self.inner.observe(constants[0], now, state)
        return jnp.concatenate([observed, constants[1].astype(observed.dtype)])

    def step(self, constants, now, state, action, noise, smooth):
        return self.inner.step(constants[0], now, state, action, noise, smooth)

    def terminal(self, constants, state, smooth):
        return self.inner.terminal(constants[0], state, smooth)

    def state_scale(self, constants):
        return self.inner.state_scale(constants[0])

    def slack(self, constants, now, state, outputs):
        return self.inner.slack(constants[0], now, state, outputs)


class Members(Around):
    """Each path belongs to one of the members, drawn with one more normal at its start."""

    inner: ObservedMember
    points: np.ndarray
    initial_steps: ClassVar[int] = 0  # pyright: ignore[reportIncompatibleMethodOverride]

    def __init__(self, local: ObservedMember, points: np.ndarray):
        self.inner, self.points = local, points

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.inner.initial_noise_size + 1

    def prepare(self, inputs):
        def one(point):
            result = self.inner.prepare(self.inner.with_values(inputs, point))
            return result.constants, result.steps

        constants, steps = eqx.filter_vmap(one)(jnp.asarray(self.points))
        return Schedule(constants, jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), steps))

    def initial(self, constants, noise):
        number = jnp.floor(ndtr(noise[-1]) * len(self.points)).astype(jnp.int32)
        number = jnp.clip(number, 0, len(self.points) - 1)
        return {"member": number, "own": self.inner.initial(_of(constants, number), noise[:-1])}

    def observe(self, constants, now, state):
        number = state["member"]
        return self.inner.observe(_of(constants, number), _of(now, number), state["own"])

    def step(self, constants, now, state, action, noise, smooth):
        number = state["member"]
        values = _of(constants, number), _of(now, number), state["own"]
        after, outputs = self.inner.step(*values, action, noise, smooth)
        return {"member": number, "own": after}, outputs

    def terminal(self, constants, state, smooth):
        return self.inner.terminal(_of(constants, state["member"]), state["own"], smooth)

    def state_scale(self, constants):
        # That of the first member serves all.
        scale = self.inner.state_scale(_of(constants, 0))
        return None if scale is None else {"member": 1.0, "own": scale}

    def slack(self, constants, now, state, outputs):
        number = state["member"]
        values = _of(constants, number), _of(now, number)
        return self.inner.slack(*values, state["own"], outputs)


def _of(tree: PyTree, number) -> PyTree:
    """The numbers of one member."""
    return jax.tree.map(lambda leaf: jnp.take(leaf, number, axis=0, mode="clip"), tree)
