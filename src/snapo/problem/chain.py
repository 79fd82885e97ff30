"""Stages with different states, horizons and outputs as ONE simulator.

A reactor followed by a crystalliser: each stage is a separate `Simulator`, and a map turns the
final state of one into the initial state of the next.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .actions import Actions, Box
from .simulator import Interface, Schedule, Simulator, Total, at

Map = Callable[[PyTree, PyTree, PyTree], PyTree]


class Chain(Simulator):
    """Successive simulators, with one policy for all of them or one for each (`Stages`).

    **Arguments:**

    - `stages`: the simulators. All have the same action set, of any kind, or different Boxes. In
      the second case the set of the chain is the smallest Box that contains them all, and a stage
      uses the first numbers of an action, clipped to its bounds. A stage also uses the first
      numbers of the noise.
    - `maps`: one fewer than stages. `maps[i](constants, state, next_constants)` maps the terminal
      state of stage i to the initial state of stage i + 1, whose `initial` is not called.
    - `names`: prefixes of the stages' outputs ("reactor.yield"). Without them, outputs of the same
      name are added up.

    `inputs` is one module per stage (a sequence, or a mapping by name if there are names), or any
    other module, which all stages share. The policy sees the stage's observation, padded with zeros
    to the longest, followed by one number per stage, which is 1 in that stage.
    """

    stages: tuple[Simulator, ...]
    maps: tuple[Map, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, stages: Sequence[Simulator], maps: Sequence[Map], names: Sequence[str] = ()):
        self.stages, self.maps, self.names = tuple(stages), tuple(maps), tuple(names)
        if not self.stages or len(self.maps) != len(self.stages) - 1:
            raise ValueError(
                f"Chain: {len(self.stages)} stages need {len(self.stages) - 1} maps between them; "
                f"{len(self.maps)} were passed."
            )
        if self.names and len(set(self.names)) != len(self.stages):
            raise ValueError(
                f"Chain: names are {self.names}; there must be {len(self.stages)} different ones."
            )
        sets = [stage.action for stage in self.stages]
        if not self._alike and not all(isinstance(item, Box) for item in sets):
            raise ValueError(
                f"Chain: the stages' action sets are {sets}; all must be Boxes, or the same set."
            )
        self.totals()  # refuses one name with two kinds of total

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return sum(stage.horizon for stage in self.stages)

    @property
    def _alike(self) -> bool:
        """Whether all stages decide in the same set."""
        return all(stage.action == self.stages[0].action for stage in self.stages)

    @property
    def action(self) -> Actions:  # pyright: ignore[reportIncompatibleVariableOverride]
        if self._alike:
            return self.stages[0].action
        size = max(stage.action.size for stage in self.stages)
        low, high = np.full(size, np.inf), np.full(size, -np.inf)
        for stage in self.stages:
            local = slice(stage.action.size)
            minimum, maximum = stage.action.bounds()
            low[local], high[local] = (
                np.minimum(low[local], minimum),
                np.maximum(high[local], maximum),
            )
        return Box(low, high, size)

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return max(stage.noise_size for stage in self.stages)

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.stages[0].initial_noise_size

    def prepare(self, inputs: PyTree) -> Schedule:
        schedules = [s.prepare(values) for s, values in zip(self.stages, self._inputs(inputs))]
        endpoints = [sum(s.horizon for s in self.stages[: i + 1]) for i in range(len(self.stages))]
        steps = jnp.arange(self.horizon)
        padded = []
        for stage, schedule, end in zip(self.stages, schedules, endpoints):
            # Outside its stage a schedule repeats its edge, which no step reads.
            local = jnp.clip(steps - (end - stage.horizon), 0, stage.horizon - 1)
            padded.append(
                jax.tree.map(lambda leaf, custom=local: jnp.asarray(leaf)[custom], schedule.steps)
            )
        last = jnp.asarray(endpoints[:-1], int)
        branch = 2 * jnp.searchsorted(jnp.asarray(endpoints), steps, side="right")
        branch = branch + jnp.isin(steps + 1, last)
        constants = tuple(schedule.constants for schedule in schedules)
        return Schedule(constants, {"branch": branch.astype(jnp.int32), "stages": tuple(padded)})

    def initial(self, constants, noise):
        first = self.stages[0].initial(constants[0], noise)
        selected = {name: jnp.zeros(()) for name, kind in self.totals().items() if kind == "last"}
        return {"stages": self._placeholders(constants, first), "last": selected}

    def observe(self, constants, now, state):
        def stage(i):
            local = self.stages[i].observe(constants[i], now["stages"][i], state["stages"][i])
            return jnp.zeros(features, local.dtype).at[: local.shape[0]].set(local)

        shapes = [
            jax.eval_shape(s.observe, constants[i], now["stages"][i], state["stages"][i])
            for i, s in enumerate(self.stages)
        ]
        features = max(shape.shape[0] for shape in shapes)
        number = now["branch"] // 2
        observed = jax.lax.switch(number, [lambda i=i: stage(i) for i in range(len(self.stages))])
        return jnp.concatenate(
            [observed, jax.nn.one_hot(number, len(self.stages), dtype=observed.dtype)]
        )

    def step(self, constants, now, state, action, noise, smooth):
        def run(i):
            """One step of stage i: its next state, and its outputs as the chain names them."""
            simulator = self.stages[i]
            drawn, selected = noise[: simulator.noise_size], self._own(i, action)
            after, outputs = simulator.step(
                constants[i], now["stages"][i], state["stages"][i], selected, drawn, smooth
            )
            return after, self._named(i, outputs)

        def leave(i):
            """The last step of stage i: its terminal outputs count, and the next stage begins."""
            after, outputs = run(i)
            endpoints = self._named(i, self.stages[i].terminal(constants[i], after, smooth))
            return (
                after,
                self._joined(outputs, endpoints),
                self.maps[i](constants[i], after, constants[i + 1]),
            )

        def branch(i, leaving):
            states = list(state["stages"])
            if leaving:
                states[i], outputs, states[i + 1] = leave(i)
            else:
                states[i], outputs = run(i)
            states = jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), states, was)
            outputs = {
                name: jnp.asarray(outputs.get(name, rest), dtype) for name, rest in idle.items()
            }
            return tuple(states), outputs

        was = jax.tree.map(jnp.asarray, list(state["stages"]))
        dtype = jnp.result_type(float)
        kinds, last = self.totals(), len(self.stages) - 1
        idle = {}
        for i in range(len(self.stages)):
            shapes = jax.eval_shape(lambda i=i: leave(i)[1] if i < last else run(i)[1])
            for name in shapes:
                idle[name] = {"sum": 0.0, "max": -jnp.inf, "last": 0.0}[kinds.get(name, "sum")]
        # An output of which the last counts keeps its value through other stages.
        idle |= state["last"]
        branches = [
            lambda i=i, leaving=leaving: branch(i, leaving)
            for i in range(last + 1)
            for leaving in (False, True)
            if i < last or not leaving
        ]
        states, outputs = jax.lax.switch(now["branch"], branches)
        return {"stages": states, "last": {name: outputs[name] for name in state["last"]}}, outputs

    def terminal(self, constants, state, smooth):
        i = len(self.stages) - 1
        return self._named(i, self.stages[i].terminal(constants[i], state["stages"][i], smooth))

    def totals(self) -> Mapping[str, Total]:
        kinds: dict[str, Total] = {}
        for i, stage in enumerate(self.stages):
            for name, kind in self._named(i, dict(stage.totals())).items():
                if kinds.setdefault(name, kind) != kind:
                    raise ValueError(
                        f"Chain: {name!r} is totalled by {kinds[name]!r} in one stage and by "
                        f"{kind!r} in another; name the stages, or rename the outputs."
                    )
        return kinds

    def control_variates(self) -> tuple[str, ...]:
        prefixes = [
            self._prefix(i) + n for i, s in enumerate(self.stages) for n in s.control_variates()
        ]
        return tuple(dict.fromkeys(prefixes))

    def in_mean(self) -> tuple[str, ...]:
        # By every name that a stage's input may have: shared by all, or of one place or name.
        results = []
        for i, stage in enumerate(self.stages):
            of = ("", f"{i}.", *(f"{name}." for name in self.names[i : i + 1]))
            results += [prefix + name for prefix in of for name in stage.in_mean()]
        return tuple(dict.fromkeys(results))

    def state_scale(self, constants):
        first = jax.eval_shape(lambda: self.initial(constants, jnp.zeros(self.initial_noise_size)))
        scales = []
        for i, (stage, shape) in enumerate(zip(self.stages, first["stages"])):
            local = stage.state_scale(constants[i])
            scales.append(
                jax.tree.map(lambda s: jnp.ones(s.shape), shape) if local is None else local
            )
        return {"stages": tuple(scales), "last": dict.fromkeys(first["last"], jnp.ones(()))}

    def slack(self, constants, now, state, outputs):
        def stage(i):
            prefix = self._prefix(i)
            local = {name: outputs[prefix + name] for name in _names_of(outputs, prefix)}
            slack = self.stages[i].slack(constants[i], now["stages"][i], state["stages"][i], local)
            return self._named(i, slack)

        def padded(i):
            result = stage(i)
            return {
                name: jnp.asarray(result.get(name, full), full.dtype) for name, full in free.items()
            }

        free: dict[str, Any] = {}
        for i in range(len(self.stages)):
            for name, shape in jax.eval_shape(lambda i=i: stage(i)).items():
                free[name] = jnp.full(shape.shape, jnp.inf)
        if not free:
            return {}
        return jax.lax.switch(
            now["branch"] // 2, [lambda i=i: padded(i) for i in range(len(self.stages))]
        )

    def interface(self, schedule: Schedule) -> Interface:
        """The interface of the chain, with those of the stages, without padded observations."""
        constants, now = schedule.constants, at(schedule.steps, 0)

        def observations():
            state = self.initial(constants, jnp.zeros(self.initial_noise_size))["stages"]
            return [
                stage.observe(constants[i], now["stages"][i], state[i])
                for i, stage in enumerate(self.stages)
            ]

        sizes = [observed.shape[0] for observed in jax.eval_shape(observations)]
        stages = [Interface(stage.action, size) for stage, size in zip(self.stages, sizes)]
        return Interface(self.action, max(sizes) + len(sizes), tuple(stages))

    def _own(self, i: int, action):
        """The numbers of an action that stage i reads, within its own bounds."""
        if self._alike:
            return action
        local = self.stages[i].action
        low, high = local.bounds()
        minimum, maximum = (bound[: local.size] for bound in self.action.bounds())
        selected = action[: local.size]
        if np.array_equal(low, minimum) and np.array_equal(high, maximum):
            return selected
        return jnp.clip(
            selected, jnp.asarray(low, selected.dtype), jnp.asarray(high, selected.dtype)
        )

    def _inputs(self, inputs) -> Sequence[PyTree]:
        if isinstance(inputs, Mapping) and self.names:
            return [inputs[name] for name in self.names]
        if isinstance(inputs, list | tuple):
            return inputs
        return [inputs] * len(self.stages)

    def _placeholders(self, constants, first) -> tuple[PyTree, ...]:
        """States of all stages: the first, and zeros of the shape that the maps will give."""
        shapes = [jax.eval_shape(lambda: first)]
        for i, move in enumerate(self.maps):
            shapes.append(jax.eval_shape(move, constants[i], shapes[-1], constants[i + 1]))
        zeros = [jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shape) for shape in shapes[1:]]
        return (first, *zeros)

    def _prefix(self, i: int) -> str:
        return self.names[i] + "." if self.names else ""

    def _named(self, i: int, outputs: Mapping[str, Any]) -> dict[str, Any]:
        return {self._prefix(i) + name: value for name, value in outputs.items()}

    def _joined(self, outputs: dict, endpoints: dict) -> dict:
        """The outputs of a last step together with the terminal ones, by the kind of total."""
        joined, kinds = dict(outputs), self.totals()
        for name, value in endpoints.items():
            kind = kinds.get(name, "sum")
            if name not in joined or kind == "last":
                joined[name] = value
            else:
                joined[name] = (
                    jnp.maximum(joined[name], value) if kind == "max" else joined[name] + value
                )
        return joined


def _names_of(outputs: Mapping[str, Any], prefix: str) -> list[str]:
    return [name[len(prefix) :] for name in outputs if name.startswith(prefix)]
