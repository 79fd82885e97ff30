"""The simulator, written by the user: ONE path of a decision problem, in plain ``jax.numpy``.

No batch dimension, no random keys and no loop over time: the engines add those. A simulator defines
how the inputs become a schedule (`prepare`), the start of a path (`initial`), the policy's
observation (`observe`) and the effect of one decision (`step`).
"""

import abc
from collections.abc import Callable, Mapping
from dataclasses import FrozenInstanceError, fields
from functools import wraps
from typing import Any, ClassVar, Literal, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from .actions import Actions
from .record import Schedule as Schedule
from .record import trees as trees  # schedules are trees of JAX from here on

State = PyTree
Outputs = dict[str, Float[Array, ""]]
Total = Literal["sum", "max", "last"]


class Interface(NamedTuple):
    """The properties to which a policy is fitted.

    - `action`: the set of its actions; `features`: the length of its observation.
    - `stages`: for a `Chain`, the interface of every stage.
    """

    action: Actions
    features: int
    stages: tuple["Interface", ...] = ()


class Simulator(eqx.Module):
    """One path of a sequential decision problem. Subclass it and write the four methods.

    **Attributes:**

    - `horizon`: the number of decisions T.
    - `action`: the FIXED set of actions, a `Box`, `Simplex`, `Integers`, `Choice`, `Stop` or a
      `Product` of them. Limits that depend on inputs or on the state act inside `step`.
    - `noise_size`: standard normals per step; `initial_noise_size`: those that `initial` uses.
    - `first_step`: the number of its first step in the calendar by which the steps of scenarios are
      counted, 0 by default. `initial_steps`: `initial` receives the noise of this many steps from
      the calendar's start, one after another, and uses those before `first_step`. If `first_step`
      is larger than this number, the noise of `initial` is drawn separately, and steps are counted
      from the simulator's own start. `calendar`: path p is the same scenario only in simulators
      with an equal `calendar`.
    - `fully_observed`: declares that the observation has all parts of the state that matter for
      decisions; this is then not examined (`problem.unseen`).
    """

    horizon: eqx.AbstractVar[int]
    action: eqx.AbstractVar[Actions]
    noise_size: eqx.AbstractVar[int]
    initial_noise_size: ClassVar[int] = 0
    first_step: ClassVar[int] = 0
    initial_steps: ClassVar[int] = 0
    calendar: ClassVar[tuple[float, ...]] = ()
    fully_observed: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        if (local := cls.__dict__.get("__init__")) is not None:
            cls.__init__ = _explained(local)

    @abc.abstractmethod
    def prepare(self, inputs: PyTree) -> Schedule:
        """Turns inputs into the schedule. `inputs` holds plain arrays instead of every `Input`."""

    def prepared_apart(self) -> tuple["Simulator", Callable[[Schedule], Schedule]]:
        """A simulator that prepares a part of the schedule, and a function that adds the rest. The
        rest consists of arrays of this simulator that `prepare` passes on unchanged, such as a
        fitted value table. The compiled `prepare` of the part can therefore be used before and
        after the table is fitted.
        """
        return self, lambda schedule: schedule

    def on_paths(self) -> "Simulator":
        """This simulator as used by the engines: without the arrays that only `prepare` reads."""
        return self

    def on_step(self) -> "Simulator":
        """This simulator with only the fields that the methods for one path read.

        Without the fields that depend on the number of steps or on their dates, such as `horizon`,
        the native engine has one code for all horizons. By default each horizon has separate code.
        """
        return self

    @abc.abstractmethod
    def initial(self, constants: PyTree, noise: Float[Array, " initial_noise"]) -> State:
        """The state before the first decision: a tree of small arrays (integers allowed)."""

    @abc.abstractmethod
    def observe(self, constants: PyTree, now: PyTree, state: State) -> Float[Array, " features"]:
        """The policy's observation, of order one; `now` is `schedule.steps` at this step."""

    @abc.abstractmethod
    def step(self, constants, now, state, action, noise, smooth) -> tuple[State, Outputs]:
        """One decision: the next state, and named scalars that are totalled over the path.

        `action` lies in `self.action`, `noise` has `noise_size` numbers, and `smooth` is
        `snapo.Exact()` or `snapo.Smooth(temperature)`.
        """

    def terminal(self, constants: PyTree, state: State, smooth) -> Outputs:
        """Outputs of the final state; their names may be those of `step` or new ones."""
        return {}

    def totals(self) -> Mapping[str, Total]:
        """How outputs are totalled over a path, by name: "sum" (the default), "max" or "last"."""
        return {}

    def control_variates(self) -> tuple[str, ...]:
        """Names of outputs whose total has expectation zero under EVERY policy (martingales)."""
        return ()

    def in_mean(self) -> tuple[str, ...]:
        """The names of inputs whose derivative is correct only in the mean over many paths, not on
        a single path, such as parameters of draws in whole units. A certificate compares the mean.
        Parameters of `snapo.noise` need not be named."""
        return ()

    def state_scale(self, constants: PyTree) -> State | None:
        """The typical size of each number in the state, for clipping adjoints; None means one."""
        return None

    def slack(self, constants, now, state, outputs) -> Mapping[str, Any]:
        """Named distances to the limits after a step, negative where one is violated."""
        return {}

    def interface(self, schedule: Schedule) -> Interface:
        """The action set and the number of features, from which policies are created."""
        return Interface(self.action, probe(self, schedule)[1].shape[0])


def _explained(init: Callable[..., None]) -> Callable[..., None]:
    """An `__init__` that explains the fix if it sets an attribute that is not a field."""

    @wraps(init)
    def explained(self: Any, *values: Any, **by_name: Any) -> None:
        try:
            init(self, *values, **by_name)
        except FrozenInstanceError as error:
            name = str(error).partition("'")[2].rstrip("'")
            if not name or name in {field.name for field in fields(self)}:
                raise
            raise TypeError(
                f"{type(self).__name__}: __init__ sets {name!r}, which is not a field. Declare it "
                f"in the class, with its type, `{name}: float`, and without a default, since "
                "__init__ sets it."
            ) from error

    return explained


class Around(Simulator):
    """A wrapper of a simulator for the engines: members are those of `own`, unless replaced."""

    inner: Simulator

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.inner.horizon

    @property
    def action(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.inner.action

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.inner.noise_size

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.inner.initial_noise_size

    @property
    def first_step(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.inner.first_step

    @property
    def initial_steps(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.inner.initial_steps

    @property
    def calendar(self) -> tuple[float, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.inner.calendar

    def prepare(self, inputs):
        return self.inner.prepare(inputs)

    def on_paths(self):
        return self._around(self.inner.on_paths())

    def on_step(self):
        return self._around(self.inner.on_step())

    def _around(self, inner: Simulator) -> Self:
        if inner is self.inner:
            return self
        return eqx.tree_at(lambda around: around.inner, self, inner)

    def initial(self, constants, noise):
        return self.inner.initial(constants, noise)

    def observe(self, constants, now, state):
        return self.inner.observe(constants, now, state)

    def step(self, constants, now, state, action, noise, smooth):
        return self.inner.step(constants, now, state, action, noise, smooth)

    def terminal(self, constants, state, smooth):
        return self.inner.terminal(constants, state, smooth)

    def totals(self):
        return self.inner.totals()

    def control_variates(self):
        return self.inner.control_variates()

    def in_mean(self):
        return self.inner.in_mean()

    def state_scale(self, constants):
        return self.inner.state_scale(constants)

    def slack(self, constants, now, state, outputs):
        return self.inner.slack(constants, now, state, outputs)


def at(steps: PyTree, t: Any) -> PyTree:
    """The schedule's step `t` (a view of every leaf)."""
    return jax.tree.map(lambda leaf: leaf[t], steps)


def probe(simulator: Simulator, schedule: Schedule) -> tuple[State, Float[Array, " features"]]:
    """Shapes of one state and one observation; nothing is computed."""

    def first(schedule):
        noise = jnp.zeros(simulator.initial_noise_size)
        state = simulator.initial(schedule.constants, noise)
        return state, simulator.observe(schedule.constants, at(schedule.steps, 0), state)

    return jax.eval_shape(first, schedule)
