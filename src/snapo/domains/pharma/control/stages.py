"""One batch of the process as stages of decisions. Every unit with decisions or measurements over
time is a stage, and a last stage has the decisions of all other units.

Units without decisions run between the stages. A stage's state holds the whole batch: its drawn
numbers, the streams made so far, the last value of every control and the last reading of every
sensor.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Box
from snapo.problem.simulator import Schedule, Simulator

from ..flowsheet.case import Flowsheet
from ..flowsheet.feed import feed
from ..flowsheet.flow import crystal_sizes, sources, through, yields
from ..flowsheet.order import groups
from ..flowsheet.possible import smallest
from ..flowsheet.stream import LedgerFinish, Stream, blank, flat, unflat
from ..given import Form, fixed
from ..time.dynamics import Dynamics
from ..time.profile import Profile, values_at
from ..time.runge_kutta import runge_kutta
from ..units.operation import Timed, Unit, timed
from .policy import initial_history, reading, shifted
from .records import Control
from .staging import LoopRecord, Varied, decided, drawn, staged

PLAIN_STEPS = 64  # of a unit between stages, per piece; the native engine takes no more

StageState = dict[str, Any]


class Stage(Simulator):
    """One stage. It contains the form of a `LoopRecord` instead of a case.

    - `name`: the name of its unit; "" for a stage with one decision, before all other units run.
    - `before`, `total`: decisions of the stages before it, and of all. `history`: the number of
      past true readings that its sensors use.
    """

    form: Form[LoopRecord] = eqx.field(static=True)
    name: str = eqx.field(static=True)
    horizon: int = eqx.field(static=True)
    before: int = eqx.field(static=True)
    total: int = eqx.field(static=True)
    history: int = eqx.field(static=True)

    @property
    def flowsheet(self) -> Flowsheet:
        return self.form.record.flowsheet

    @property
    def control(self) -> Control:
        return self.form.record.control

    @property
    def varied(self) -> Varied:
        return self.form.record.varied

    @property
    def unit(self) -> Timed | None:
        """The unit of the stage, in the form for simulators."""
        units = timed(self.flowsheet.units)
        return next((unit for unit in units if unit.name == self.name), None)

    @property
    def action(self) -> Box:  # pyright: ignore[reportIncompatibleVariableOverride]
        return Box(0.0, 1.0, max(1, len(self.decided)))

    @property
    def decided(self) -> tuple[int, ...]:
        """Indices of the `Manipulated` that this stage decides."""
        return decided(self.flowsheet.units, self.control, self.name)

    @property
    def readings(self) -> dict[str, str]:
        """The states of this stage's unit, with their units."""
        return self.unit.states(self.flowsheet.network.species) if self.unit else {}

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return len(self.varied.inputs) + len(self.control.measurements)

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.noise_size

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        correlated = jnp.asarray(self.varied.correlated)
        number = np.arange(self.horizon)
        steps = {"clock": (self.before + number) / self.total, "share": number / self.horizon}
        constants = {name: jnp.asarray(item) for name, item in inputs.items()}
        return Schedule({"inputs": constants, "correlated": correlated}, steps)

    def draw(self, constants, noise) -> Float[Array, " V"]:
        """Values of the varied numbers."""
        uncertain, inputs = self.varied, constants["inputs"]
        z = constants["correlated"] @ noise[: len(uncertain.inputs)]
        columns = [
            drawn(distribution, inputs[name][entry], z[i])
            for i, (distribution, name, entry) in enumerate(
                zip(uncertain.distributions, uncertain.inputs, uncertain.entries)
            )
        ]
        return jnp.stack(columns) if columns else jnp.zeros(0)

    def inputs_of(self, constants, draws) -> dict[str, Array]:
        """The inputs of this batch."""
        inputs, uncertain = dict(constants["inputs"]), self.varied
        for i, (name, entry) in enumerate(zip(uncertain.inputs, uncertain.entries)):
            inputs[name] = jnp.asarray(inputs[name]).at[entry].set(draws[i])
        return inputs

    def initial(self, constants, noise) -> StageState:
        size = len(self.varied.inputs)
        draws = self.draw(constants, noise)
        firsts = [constants["inputs"][item.input][0] for item in self.control.manipulated]
        state = {
            "y": jnp.zeros(0),
            "streams": {},
            "measures": {},
            "draws": draws,
            "control": jnp.stack(firsts) if firsts else jnp.zeros(0),
            "seen": jnp.zeros(len(self.control.measurements)),
            "past": jnp.zeros((len(self.control.measurements), 0)),
            "error": noise[size:],
            "worst": jnp.zeros(()),
        }
        return self.enter(constants, state)

    def enter(self, constants, state: StageState) -> StageState:
        """The state with which this stage begins."""
        if self.unit is None:
            return state | {"y": jnp.zeros(0), "past": state["past"][:, :0]}
        inputs = self.inputs_of(constants, state["draws"])
        state = self.settle(inputs, state)
        problem = self.problem(inputs, state["streams"])
        y = problem.start
        controls = self.controls(
            constants, inputs, problem, 0.0, lambda profile, i: state["control"][i]
        )
        values = self.sensed(problem, y, controls)
        past = initial_history(values, self.history)
        observed = self.read(problem, values, past, state)
        return state | {"y": y, "seen": observed, "past": past}

    def leave(self, constants, state: StageState) -> StageState:
        """The state with the streams and measures of this stage's unit."""
        assert self.unit is not None
        inputs = self.inputs_of(constants, state["draws"])
        problem = self.problem(inputs, state["streams"])
        endpoints = self.controls(
            constants, inputs, problem, 1.0, lambda profile, i: state["control"][i]
        )
        return self.delivered(self.unit, problem.finish(state["y"], *endpoints), state)

    def delivered(self, unit: Unit, finish: LedgerFinish, state: StageState) -> StageState:
        """The state with the outlets and measures of a timed unit."""
        requested = self.flowsheet.measures
        streams = {
            f"{unit.name}.{port}": flat(stream)
            for port, stream in zip(unit.outlets, finish.outlets)
        }
        measures = {f"{unit.name}.{item}": value for item, value in finish.measures.items()}
        selected = {entry: value for entry, value in measures.items() if entry in requested}
        return state | {
            "streams": state["streams"] | streams,
            "measures": state["measures"] | selected,
        }

    def settle(self, inputs, state: StageState) -> StageState:
        """The state after running every timed unit that has no stage and whose inlets are
        available."""
        flowsheet, fed = self.flowsheet, sources(self.flowsheet)
        local = staged(flowsheet.units, self.control)
        numerics = replace(flowsheet.numerics, method="mesh", steps=PLAIN_STEPS, along=True)
        for unit in timed(flowsheet.units):
            done = any(f"{unit.name}.{port}" in state["streams"] for port in unit.outlets)
            if unit in local or done:
                continue
            result, _ = self.streams(inputs, state["streams"])
            if not all(name in result for name in fed[unit.name]):
                continue
            values = tuple(result[name] for name in fed[unit.name])
            finish = unit.operate(flowsheet.network, numerics, values, inputs).finish
            state = self.delivered(unit, finish, state)
        return state

    def streams(self, inputs, made: dict[str, Array]) -> tuple[dict[str, Stream], dict]:
        """All streams and measures that follow from the feeds and the vectors `made` so far."""
        flowsheet, fed = self.flowsheet, sources(self.flowsheet)
        feeds = {item.name: feed(item, inputs) for item in flowsheet.feeds}
        species, sizes = len(flowsheet.network.species), crystal_sizes(flowsheet)
        feeds |= {name: unflat(entry, blank(species, sizes[name])) for name, entry in made.items()}
        measures = {}
        over_time = timed(flowsheet.units)
        for group in groups(flowsheet.units, flowsheet.connections):
            inside = {f"{unit.name}.{port}" for unit in group.units for port in unit.outlets}
            needed = {name for unit in group.units for name in fed[unit.name]} - inside
            if group.units[0] not in over_time and needed <= set(feeds):
                flowed = through(flowsheet, group, feeds, inputs)
                feeds, measures = flowed.streams, measures | flowed.measures
        return feeds, measures

    def problem(self, inputs, made) -> Dynamics:
        """This stage's unit as an initial value problem."""
        assert self.unit is not None
        streams, _ = self.streams(inputs, made)
        inlets = tuple(streams[name] for name in sources(self.flowsheet)[self.unit.name])
        return self.unit.dynamics(self.flowsheet.network, inlets, inputs)

    def controls(
        self, constants, inputs, problem: Dynamics, share, decision: Callable[[Profile, int], Array]
    ) -> list[Array]:
        """The controls of this batch at shares of the duration. A control that is decided is its
        `decision`, a function of its profile and its position among the `Manipulated`, plus the
        disturbance of this batch."""
        results = []
        for profile, value in problem.controls:
            name = profile.value.name
            i = self._manipulated(name)
            if i < 0:
                results.append(values_at(profile, value, share))
                continue
            disturbance = values_at(profile, inputs[name] - constants["inputs"][name], share)
            results.append(decision(profile, i) + disturbance)
        return results

    def sensed(self, problem: Dynamics, y, controls) -> Float[Array, " M"]:
        """The states that this unit's sensors measure, now; 0 for the sensors of other units."""
        assert self.unit is not None
        states, results = problem.states(y, *controls), []
        for sensor in self.control.measurements:
            unit, _, name = sensor.state.partition(".")
            results.append(states[name] if unit == self.unit.name else jnp.zeros(()))
        return jnp.stack(results) if results else jnp.zeros(0)

    def read(self, problem: Dynamics, values, past, state: StageState) -> Float[Array, " M"]:
        """The readings of all sensors, scaled to order one; those of this unit are new, with their
        errors."""
        assert self.unit is not None
        steps, observed = problem.duration / self.horizon, []
        for i, sensor in enumerate(self.control.measurements):
            if sensor.state.partition(".")[0] != self.unit.name:
                observed.append(state["seen"][i])
                continue
            value = reading(values[i], past[i], sensor, steps) + sensor.error * state["error"][i]
            observed.append((value - sensor.centre) / sensor.width)
        return jnp.stack(observed) if observed else jnp.zeros(0)

    def observe(self, constants, now, state: StageState) -> Float[Array, " features"]:
        low = np.array([item.low for item in self.control.manipulated])
        high = np.array([entry.high for entry in self.control.manipulated])
        control = (state["control"] - low) / (high - low)
        timer = jnp.stack([now["clock"], now["share"]])
        return jnp.concatenate([timer, state["seen"], control])

    def renewed(self, constants, state: StageState, noise) -> StageState:
        """The state with new disturbances and sensor errors for this step."""
        uncertain = self.varied
        state = state | {"error": noise[len(uncertain.inputs) :]}
        repeated = np.array([item == "step" for item in uncertain.when], bool)
        if not repeated.any():
            return state
        draws = jnp.where(repeated, self.draw(constants, noise), state["draws"])
        return state | {"draws": draws}

    def target(self, state: StageState, action, smooth, seconds) -> Float[Array, " n"]:
        """The controls after this decision, in their units and within their ramps."""
        control = state["control"]
        for position, i in enumerate(self.decided):
            item = self.control.manipulated[i]
            value = item.low + action[position] * (item.high - item.low)
            if item.ramp is not None and self.unit is not None:
                maximum = item.ramp * seconds
                value = smooth.clip(
                    value, control[i] - maximum, control[i] + maximum, scale=maximum
                )
            control = control.at[i].set(value)
        return control

    def step(self, constants, now, state: StageState, action, noise, smooth):
        state = self.renewed(constants, state, noise)
        inputs = self.inputs_of(constants, state["draws"])
        if self.unit is None:
            return state | {"control": self.target(state, action, smooth, None)}, {}
        problem = self.problem(inputs, state["streams"])
        seconds = problem.duration / self.horizon
        control = self.target(state, action, smooth, seconds)
        count = self.control.substeps
        start = np.arange(count) / count
        part = np.stack([start, start + 0.5 / count, start + 1 / count], -1)

        def decision(profile: Profile, i: int) -> Array:
            # A profile of pieces jumps, unless it may not; any other moves evenly.
            jumps = profile.kind == "constant" and self.control.manipulated[i].ramp is None
            first = control[i] if jumps else state["control"][i]
            return first + (control[i] - first) * part

        share = now["share"] + part / self.horizon
        trajectories = self.controls(constants, inputs, problem, share, decision)
        endpoints = [trajectory[-1, 2] for trajectory in trajectories]
        if problem.to_dose is not None:
            trajectories[-1] = trajectories[-1] * self._dosed(
                problem, state, trajectories[-1], seconds
            )
        y, worst = self._advance(problem, state, trajectories, seconds / count, smooth)
        after = state | {"y": y, "control": control, "worst": worst}
        values = self.sensed(problem, y, endpoints)
        past = shifted(values, state["past"])
        return after | {"seen": self.read(problem, values, past, after), "past": past}, {}

    def _dosed(self, problem: Dynamics, state: StageState, flow, seconds) -> Float[Array, ""]:
        """The share of a `flow` during this decision for which the remaining feed is sufficient."""
        assert problem.to_dose is not None
        requested = seconds * jnp.mean(flow @ fixed(np.array([1, 4, 1]) / 6))
        waits = jnp.maximum(problem.to_dose(state["y"]), 0.0)
        return jnp.where(requested > waits, waits / jnp.where(requested > 0, requested, 1.0), 1.0)

    def _advance(self, problem: Dynamics, state: StageState, trajectories, step, smooth):
        """y after the substeps, and the largest supersaturation on the way."""
        drive = problem.drive(*trajectories)
        margin = self.control.solubility_margin
        monitor = margin is not None and "supersaturation" in self.readings

        def advance(carry, now):
            y, worst = carry
            y = runge_kutta(problem.rate, y, step, now[0])
            if monitor:
                level = problem.states(y, *now[1])["supersaturation"]
                worst = smooth.maximum(worst, level, scale=margin)
            return (y, worst), None

        endpoints = [trajectory[:, 2] for trajectory in trajectories]
        first = state["y"], state["worst"]
        return jax.lax.scan(advance, first, (drive, endpoints))[0]

    def terminal(self, constants, state: StageState, smooth):
        """Runs the other units, and returns every attribute, whether all limits are met, and by how
        much they are violated.

        Only the last stage has these results; the results of earlier stages are empty.
        """
        if self.before + self.horizon < self.total:
            return {}
        inputs = self.inputs_of(constants, state["draws"])
        if self.unit is not None:
            state = self.leave(constants, state)
        for i in decided(self.flowsheet.units, self.control, ""):
            name = self.control.manipulated[i].input
            off = inputs[name] - constants["inputs"][name]
            inputs[name] = state["control"][i] + off
        state = self.settle(inputs, state)
        streams, measures = self.streams(inputs, state["streams"])
        measures |= state["measures"] | yields(self.flowsheet, streams)
        outputs, success, violation = {}, jnp.ones(()), jnp.zeros(())
        gaps = []
        for attribute in self.form.record.attributes:
            value = attribute.scale * measures[attribute.measure]
            outputs[f"attribute.{attribute.name}"] = value
            # An impossible result is a failure; it has no slope, since no good batch is close to
            # it.
            success = success * jnp.where(
                value >= attribute.scale * smallest(attribute.measure), 1.0, 0.0
            )
            if attribute.low is not None:
                gaps.append((value - attribute.low, attribute.margin))
            if attribute.high is not None:
                gaps.append((attribute.high - value, attribute.margin))
        margin = self.control.solubility_margin
        if margin is not None:
            gaps.append((margin - state["worst"], margin / 10))
        for gap, width in gaps:
            success = success * smooth.indicator(gap, scale=width)
            violation = violation + smooth.positive_part(-gap, scale=width) / width
        return outputs | {"success": success, "violation": violation}

    def _manipulated(self, name: str) -> int:
        """The index of the `Manipulated` with this input, -1 if the input is not decided."""
        names = [item.input for item in self.control.manipulated]
        return names.index(name) if name in names else -1
