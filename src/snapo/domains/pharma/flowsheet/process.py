"""A flowsheet as one differentiable function: from its inputs to its quality attributes."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.engine import Unsupported
from snapo.lanes.machine.threads import cores

from ..derivatives.mode import of_method
from ..given import Entry, Form
from ..progress import say
from ..time.dynamics import LATE
from .case import Flowsheet, PharmaCase
from .flow import Flow, entry_words, flow
from .inputs import pharma_inputs
from .march import Marches
from .possible import impossible
from .recycle import Closed
from .stiffness import with_steps
from .stream import Ledger, Stream

_Key = tuple[tuple[Entry, ...], tuple[Entry, ...]]  # entries drawn, and those to derive by


class ProcessRun(NamedTuple):
    """One batch through the flowsheet.

    - `streams`: {"unit.outlet" or feed's name: Stream}; `measures`: {"unit.measure": number in
      the domain's unit}; `attributes`: {name: number in the case's unit}.
    - `trajectories`: {unit: {"time": [n] s, state: [n]}}, states as in `Unit.states`.
    - `status`: "ok"; or "unit: did not converge at t s", with the error estimate of a held step
      that it refuses; "unit: the steps are too long …"; or the measure whose value is impossible.
    - `errors`: {unit on held steps: the largest error estimate of a step, relative}.
    - `loops`: {units of a loop, as text: (relative change in one more iteration, rounds of Newton's
      method)}.
    - `ledgers`: {unit: the terms of its balance other than its streams}.
    """

    streams: dict[str, Stream]
    measures: dict[str, float]
    attributes: dict[str, float]
    trajectories: dict[str, dict[str, np.ndarray]]
    status: str
    errors: dict[str, float]
    loops: dict[str, tuple[float, int]]
    ledgers: dict[str, Ledger]


class Batch(NamedTuple):
    """Many batches: `values` [N, Q], `jacobian` [N, Q, E] or None, `ok` [N] whether all numbers are
    finite."""

    values: np.ndarray
    jacobian: np.ndarray | None
    ok: np.ndarray


class PharmaProcess:
    """A case with its compiled functions, which are compiled once and can be called many times.

    - `case`: the case, with the steps that it needs. `form`: the form of its flowsheet,
      which is all that the functions are compiled for.
    - `inputs`: {name: nominal values}; `names`: [Q] attributes; `parameters`: [P] names;
      `entries`: [P] their positions. `traces` counts how often the flowsheet was traced.
    """

    def __init__(self, case: PharmaCase):
        self.case = case = with_steps(case)
        self.form: Form[Flowsheet] = Form.of(case.flowsheet, case.held)
        self.inputs = {name: entry.value for name, entry in pharma_inputs(case).items()}
        self.names = tuple(attribute.name for attribute in case.attributes)
        self.parameters = tuple(parameter.name for parameter in case.parameters)
        self.entries: tuple[Entry, ...] = tuple((p.input, p.entry) for p in case.parameters)
        self.traces = 0
        self._compiled: dict[Any, Callable] = {}
        self._natives: dict[_Key, Callable] = {}

    def attributes(
        self, inputs: dict[str, Array], along: bool = False, nominal_steps: bool = True
    ) -> Float[Array, " Q"]:
        """The quality attributes in the case's units; plain JAX, which can be traced. `along` and
        `nominal_steps` as in `Numerics`."""
        return self.of_measures(
            self.flow(inputs, along=along, nominal_steps=nominal_steps).measures
        )

    def of_measures(self, measures: dict[str, Array]) -> Float[Array, " Q"]:
        """The attributes from the measures of all units."""
        return jnp.stack(
            [attribute.scale * measures[attribute.measure] for attribute in self.case.attributes]
        )

    def flow(
        self,
        inputs: dict[str, Array],
        record: bool = False,
        along: bool = False,
        nominal_steps: bool = True,
    ) -> Flow:
        """All streams and measures; plain JAX, which can be traced."""
        self.traces += 1
        numerics = replace(self.case.numerics, along=along, own_steps=nominal_steps)
        return flow(replace(self.form.record, numerics=numerics), inputs, record)

    def values(self, inputs=None) -> np.ndarray:
        """[Q] attributes at `inputs`, by default the nominal ones."""
        make = lambda local: partial(self.attributes, nominal_steps=local)  # noqa: E731
        return self.either("values", make, self.nominal_inputs(inputs))

    def nominal_inputs(self, inputs=None) -> dict[str, np.ndarray]:
        """The nominal inputs, with those in `inputs` replaced; float64."""
        result = self.inputs | (inputs or {})
        return {name: np.asarray(item, np.float64) for name, item in result.items()}

    def compiled(self, key: Any, make: Callable[[], Callable]) -> Callable:
        """The function that `make` returns, compiled once for each `key`; float64, NumPy out."""
        if key not in self._compiled:
            self._compiled[key] = jax.jit(make())
        function = self._compiled[key]

        def call(*arguments):
            with jax.enable_x64(True):
                return jax.tree.map(np.asarray, function(*arguments))

        return call

    def either(
        self, key: Any, make: Callable[[bool], Callable], *arguments, of=lambda result: result
    ):
        """The function `make(own)` at `arguments`: first on held steps; if those are refused, on
        steps chosen for this run, compiled when first needed. A result is refused if a number in
        `of(result)` is non-finite."""
        result = self.compiled(key, lambda: make(False))(*arguments)
        if self.case.numerics.held and not all(map(_finite, jax.tree.leaves(of(result)))):
            result = self.compiled(("own", key), lambda: make(True))(*arguments)
        return result

    def run(self, inputs=None) -> ProcessRun:
        """One batch with all streams, measures and trajectories."""
        make = lambda local: partial(self._everything, nominal_steps=local)  # noqa: E731
        values = self.nominal_inputs(inputs)
        either = self.either("run", make, values, of=lambda result: result[2])
        streams, measures, attributes, trajectories, times, loops, ledgers = either
        measured = {name: float(measure) for name, measure in measures.items()}
        held = {name: time[3] for name, time in times.items() if time[3] is not None}
        return ProcessRun(
            streams,
            measured,
            {name: float(attribute) for name, attribute in zip(self.names, attributes)},
            trajectories,
            self._open(loops)
            or _status({unit.name: times[unit.name] for unit in self.case.units})
            or impossible(self.case, measured)
            or self._unsound(trajectories, values)
            or "ok",
            {name: float(error) for name, error in held.items()},
            {name: (float(loop.change), int(loop.rounds)) for name, loop in loops.items()},
            ledgers,
        )

    def _unsound(self, trajectories: dict[str, dict[str, np.ndarray]], inputs) -> str:
        """A sentence on the first unit whose model became invalid within the run; "" if there is
        none."""
        with jax.enable_x64(True):
            metadata = (
                unit.unsound(trajectories[unit.name], inputs)
                for unit in self.case.units
                if unit.name in trajectories
            )
            return next(filter(None, metadata), "")

    def _open(self, loops: dict[str, Closed]) -> str:
        """A sentence on the first loop without a steady state; "" if all loops have one."""
        for name, loop in loops.items():
            if not loop.converged:
                text = entry_words(self.form.record, name)[int(loop.worst)]
                size = f"by a relative {loop.change:.2g}"
                size = size if np.isfinite(loop.change) else "without end"
                return (
                    f"the loop {name} has not reached a steady state after {loop.rounds} "
                    f"iterations: {text} changes most, {size} per iteration; is there an outlet "
                    "for it?"
                )
        return ""

    def _everything(self, inputs, nominal_steps: bool):
        result = self.flow(inputs, record=True, nominal_steps=nominal_steps)
        trajectories, times = {}, {}
        for name, outcome in result.outcomes.items():
            rough = outcome.duration if outcome.rough is None else outcome.rough
            times[name] = outcome.duration, outcome.reached, rough, outcome.error
            track, states = outcome.track, outcome.states
            if track is not None and states is not None:
                rows = jax.vmap(lambda y, c, states=states: states(y, *c))
                trajectories[name] = {"time": track.time} | rows(track.state, track.controls)
        ledgers = {name: outcome.finish.ledger for name, outcome in result.outcomes.items()}
        attributes = self.of_measures(result.measures)
        produced = result.streams, result.measures, attributes
        return *produced, trajectories, times, result.loops, ledgers

    def shifted(self, changes, entries: Sequence[Entry], inputs) -> dict:
        """`inputs` with `entries` REPLACED by `changes` [E]; plain JAX, which can be traced."""
        table = {name: jnp.asarray(item) for name, item in inputs.items()}
        for i, (name, position) in enumerate(entries):
            table[name] = table[name].at[position].set(changes[i])
        return table

    def at(self, entries: Sequence[Entry], inputs=None) -> np.ndarray:
        """[E] the numbers at `entries`."""
        result = self.nominal_inputs(inputs)
        return np.array([result[name][position] for name, position in entries])

    def batch(
        self,
        entries: Sequence[Entry],
        draws: np.ndarray,
        sensitivities: Sequence[Entry] = (),
        chunk: int = 512,
        inputs=None,
        engine: Literal["auto", "native", "xla"] = "auto",
    ) -> Batch:
        """Attributes, and derivatives with respect to `sensitivities`, at `draws` [N, E] of
        `entries`.

        All other numbers are those of `inputs`. All chunks have the same shape: the last one is
        padded with its first row. They run on all cores. "auto" takes the native engine if it can
        run the case.
        """
        key = tuple(entries), tuple(sensitivities)
        nominal, draws = self.nominal_inputs(inputs), np.asarray(draws, np.float64)
        call = self._xla(key)

        def run(start: int) -> list[np.ndarray]:
            rows = draws[start : start + chunk]
            short = min(chunk, len(draws)) - len(rows)
            filled = np.concatenate([rows, np.repeat(rows[:1], short, 0)])
            return [item[: len(rows)] for item in call(filled, nominal)]

        try:
            if engine != "xla":
                call = self._native(key)
            parts = [run(0)]
        except Unsupported:
            if engine == "native":
                raise
            call = self._natives[key] = self._xla(key)
            parts = [run(0)]
        # One chunk keeps one core busy: the others run in parallel, now that it is compiled.
        with ThreadPoolExecutor(cores()) as threads:
            for part in threads.map(run, range(chunk, len(draws), chunk)):
                parts.append(part)
                say(f"{min(chunk * len(parts), len(draws)):,} of {len(draws):,} batches")
        values, jacobian = (np.concatenate(entry) for entry in zip(*parts))
        if self.case.numerics.held:
            self._on_own_steps(key, draws, nominal, values, jacobian)
        ok = np.isfinite(values).all(1) & np.isfinite(jacobian).all((1, 2))
        return Batch(values, jacobian if sensitivities else None, np.asarray(ok))

    def _on_own_steps(self, key: _Key, draws, nominal, values, jacobian) -> None:
        """Repeats, one by one, the batches for which the steps of stiff units were refused."""
        one = self.compiled(("alone", *key), lambda: self._one(*key, alone=True))
        for i in np.flatnonzero(~np.isfinite(values).all(1)):
            values[i], jacobian[i] = one(draws[i], nominal)

    def _native(self, key: _Key) -> Callable:
        """Many batches by the native engine, or by its substitute."""
        if key not in self._natives:
            if self.case.numerics.method != "mesh":
                raise Unsupported("The native engine needs a fixed mesh of steps.")
            self._natives[key] = Marches(self, *key)
        return self._natives[key]

    def _xla(self, key: _Key) -> Callable:
        return self.compiled(("batch", *key), lambda: jax.vmap(self._one(*key), in_axes=(0, None)))

    def _one(
        self, entries: tuple[Entry, ...], by: tuple[Entry, ...], alone: bool = False
    ) -> Callable:
        """One batch's attributes and their derivatives in JAX; with steps chosen for this batch
        where it runs separately (`alone`) because held ones were refused."""

        def one(draw, inputs):
            drawn = self.shifted(draw, entries, inputs)
            if not by:
                return self.attributes(drawn, not alone, alone), jnp.zeros((len(self.names), 0))

            def value(numbers):
                attributes = self.attributes(self.shifted(numbers, by, drawn), not alone, alone)
                return attributes, attributes

            numbers = jnp.stack([drawn[name][position] for name, position in by])
            derivative = of_method(self.case.numerics.method)
            jacobian, result = derivative(value, has_aux=True)(numbers)
            return result, jacobian

        return one

    def observe(self, inputs, unit: str, states: Sequence[str], times) -> Float[Array, " n"]:
        """[n] the state `states[i]` of `unit` at `times[i]` s; plain JAX, which can be traced.

        Between mesh points, the integrated states are interpolated by cubic Hermite polynomials.
        The result is NaN before the unit's start and after its end.
        """
        outcome = self.flow(inputs, record=True).outcomes[unit]
        track, of_row = outcome.track, outcome.states
        if track is None or of_row is None:
            raise ValueError(f"{unit} has no states over time.")
        times = jnp.asarray(times)
        grid = jnp.asarray(track.time)
        left = jnp.clip(jnp.searchsorted(grid, times, side="right") - 1, 0, len(grid) - 2)
        width = grid[left + 1] - grid[left]
        share = jnp.clip((times - grid[left]) / jnp.where(width > 0, width, 1.0), 0.0, 1.0)
        state = _hermite(track, left, width, share)
        controls = jnp.asarray(track.controls)
        control = controls[left] + share[:, None] * (controls[left + 1] - controls[left])
        rows = jax.vmap(lambda y, c: of_row(y, *c))(state, control)
        within = (times >= 0) & (times <= grid[-1] * (1 + LATE))
        result = jnp.stack([rows[name][i] for i, name in enumerate(states)])
        return jnp.where(within, result, jnp.nan)


def _finite(result: np.ndarray) -> bool:
    return bool(np.isfinite(result).all())


def _status(times: dict[str, Any]) -> str:
    """The first unit, in the order of flow, that was not integrated to its end; "" if all were."""
    for name, (duration, reached, rough, error) in times.items():
        if rough < duration:
            return (
                f"{name}: the time steps are too long from {rough:.6g} s on; "
                'use [numerics] method = "adaptive", or more steps'
            )
        if not reached >= duration:
            estimate = "" if error is None else f" (estimated error of one step: {error:.2g})"
            return f"{name}: did not converge at {reached:.6g} s{estimate}"
    return ""


def _hermite(track, left, width, share) -> Float[Array, "n m"]:
    """The cubic through both mesh points' states and slopes."""
    state, slope = jnp.asarray(track.state), jnp.asarray(track.slope)
    s, h = share[:, None], width[:, None]
    rise = s * s * (3 - 2 * s)
    bend = s * (1 - s) ** 2 * slope[left] - s * s * (1 - s) * slope[left + 1]
    return (1 - rise) * state[left] + rise * state[left + 1] + h * bend
