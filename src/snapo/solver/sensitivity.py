"""Sensitivities: what one unit more of every input is worth, with its standard error.

Two derivatives of one value, both from adjoint passes. HELD: the exact simulator with the
recorded decisions replayed; at an optimum it is the derivative of the optimal value (envelope
theorem), and it is what the tables report. SMOOTH: the smooth simulator through the policy's
reaction, what training follows. Their difference is a diagnostic: sub-optimality, smoothing and
noise together; zero is necessary, not sufficient.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Engine, Xla
from snapo.engine.xla import weighted_sum
from snapo.problem import inputs as inputs_
from snapo.problem.noise import Draws
from snapo.problem.objective import Objective, Weights
from snapo.problem.policy import Policy, trainable
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Scenarios
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from .adjoint import adjoint_gradient, flat_weights, float64, pull_back


class Estimate(NamedTuple):
    """Derivatives for one input from independent blocks of paths: `blocks` [B, *shape]."""

    blocks: np.ndarray

    @property
    def value(self) -> np.ndarray:
        """The derivatives, shaped like the input."""
        return self.blocks.mean(0)

    @property
    def standard_error(self) -> np.ndarray:
        """Their standard errors, of the same shape (Student's t has B - 1 degrees of freedom)."""
        if len(self.blocks) < 2:
            return np.full(self.blocks.shape[1:], np.nan)
        return self.blocks.std(0, ddof=1) / np.sqrt(len(self.blocks))

    def along(self, direction: np.ndarray) -> tuple[float, float]:
        """The derivative along a direction of the input, and its standard error."""
        joined = Estimate((self.blocks * direction).reshape(len(self.blocks), -1).sum(1))
        return float(joined.value), float(joined.standard_error)


class Row(NamedTuple):
    """One line of a sensitivity table; `value` is per one `unit` of the input."""

    input: str
    label: str
    value: float
    standard_error: float
    unit: str


class Sensitivities(NamedTuple):
    """Derivatives of the objective by every input, {input: Estimate}.

    - `held`: exact simulator, decisions held (what is reported as delta).
    - `smooth`: through the policy's reaction, or None when it was not asked for.
    - `moved`: how far `held` moved since an earlier policy, {input: array}, or None.
    - `policy_gradient`: norm of the policy's gradient at this policy, and of its standard error.
    """

    inputs: dict[str, inputs_.Input]
    held: dict[str, Estimate]
    smooth: dict[str, Estimate] | None = None
    moved: dict[str, np.ndarray] | None = None
    policy_gradient: tuple[float, float] | None = None

    def rows(self) -> Iterator[Row]:
        """The held table, input by input."""
        for name, given in self.inputs.items():
            found = self.held[name]
            numbers = zip(given.names(), found.value.ravel(), found.standard_error.ravel())
            for label, value, error in numbers:
                yield Row(name, label, float(value), float(error), given.unit)


def sensitivities(
    simulator: Simulator,
    inputs: PyTree,
    policy: Policy,
    objective: Objective,
    scenarios: Scenarios,
    paths: int,
    *,
    smooth: Any = None,
    smooth_paths: int = 4096,
    earlier: Policy | None = None,
    engine: Engine | None = None,
) -> Sensitivities:
    """Held derivatives on `paths`, and if `smooth` is given, smooth ones on `smooth_paths`.

    Standard errors come from 32 independent blocks of paths. `earlier` is a policy from halfway
    through training: its held derivatives on the same paths tell how far they still moved.
    """
    engine = engine or Xla(precision="float64")
    schedule = prepare(simulator, inputs)
    named = {entry.name: entry.input for entry in inputs_.named(inputs)}
    blocks = scenarios.blocks(paths)

    def held(policy: Policy) -> dict[str, np.ndarray]:
        passes = _held(engine, simulator, policy, schedule, objective, scenarios, blocks)
        return pull_back(simulator, inputs, passes)

    found = held(policy)
    moved = None
    if earlier is not None:
        before = held(earlier)
        moved = {name: found[name].mean(0) - before[name].mean(0) for name in found}
    result = Sensitivities(named, _estimates(found), moved=moved)
    if smooth is None:
        return result
    blocks = scenarios.blocks(min(smooth_paths, paths))
    passes, gradients = _smooth(
        engine, simulator, policy, schedule, objective, scenarios, blocks, smooth
    )
    through = _estimates(pull_back(simulator, inputs, passes))
    norm = float(np.linalg.norm(gradients.mean(0)))
    noise = float(np.linalg.norm(gradients.std(0, ddof=1)) / np.sqrt(len(gradients)))
    return result._replace(smooth=through, policy_gradient=(norm, noise))


def _estimates(blocks: Mapping[str, np.ndarray]) -> dict[str, Estimate]:
    """The leading axis of every array is that of the blocks."""
    return {name: Estimate(x) for name, x in blocks.items()}


def _held(engine, simulator, policy, schedule, objective, scenarios: Scenarios, blocks) -> list:
    """The schedule's derivatives block by block, decisions recorded and replayed."""
    weights = _weights(engine, simulator, policy, schedule, objective, scenarios, blocks, Exact())
    passes = []
    for block, weight in zip(blocks, weights):
        draws = scenarios.draws(block, simulator)
        record = engine.values(
            simulator, policy, schedule, draws, Exact(), record=("action",)
        ).record
        result = engine.adjoint(
            simulator,
            None,
            schedule,
            draws,
            Exact(),
            weight,
            actions=record["action"],
            wrt=("schedule",),
        )
        passes.append(jax.tree.map(np.asarray, result.schedule))
    return passes


def _smooth(engine, simulator, policy, schedule, objective, scenarios, blocks, smooth):
    """The schedule's derivatives block by block through the policy, and the policy's own [B, P]."""
    weights = _weights(engine, simulator, policy, schedule, objective, scenarios, blocks, smooth)
    passes, gradients = [], []
    for block, weight in zip(blocks, weights):
        draws = scenarios.draws(block, simulator)
        result = engine.adjoint(simulator, policy, schedule, draws, smooth, weight)
        passes.append(jax.tree.map(np.asarray, result.schedule))
        leaves = jax.tree.leaves(trainable(result.policy)[0])
        gradients.append(np.concatenate([np.zeros(0), *(np.ravel(leaf) for leaf in leaves)]))
    return passes, np.stack(gradients)


def _weights(
    engine, simulator, policy, schedule, objective: Objective, scenarios, blocks, smooth
) -> list[Weights]:
    """Each block's path weights, such that every block estimates the whole derivative.

    A risk measure's weights come from all paths together and are held.
    """
    if objective.linear:
        return [flat_weights(objective, len(block)) for block in blocks]
    parts = [
        float64(
            engine.values(simulator, policy, schedule, scenarios.draws(b, simulator), smooth).totals
        )
        for b in blocks
    ]
    sizes = [len(block) for block in blocks]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    whole = objective.weights(joined)
    edges = np.cumsum(sizes)[:-1]
    split = {name: np.split(weight, edges) for name, weight in whole.items()}
    scale = [sum(sizes) / size for size in sizes]
    return [{name: split[name][i] * scale[i] for name in split} for i in range(len(blocks))]


def second_order(
    simulator: Simulator,
    inputs: PyTree,
    policy: Policy,
    objective: Objective,
    scenarios: Scenarios,
    paths: int,
    directions: list[Mapping[str, np.ndarray]],
    smooth: Any,
) -> list[dict[str, np.ndarray]]:
    """How the held derivatives change along chosen directions of the inputs (forward over reverse).

    The decisions respond through the smooth policy: with decisions held alone, a value that is
    linear in prices has no second derivative. A direction is {input: array}, zero where not named.
    Each result is {input: array}: d (held derivative) / d direction. XLA only; on Mean-like
    objectives the weights are constant, on others they are held.
    """
    engine = Xla(precision="float64")
    draws = scenarios.draws(np.arange(paths), simulator)
    schedule = prepare(simulator, inputs)
    totals = float64(engine.values(simulator, policy, schedule, draws, smooth).totals)
    weights = objective.weights(totals)
    names = [entry.name for entry in inputs_.named(inputs)]
    values = inputs_.values(inputs)
    results = []
    for direction in directions:
        unknown = set(direction) - set(names)
        if unknown:
            raise KeyError(f"second_order: no input {sorted(unknown)}; the inputs are {names}.")
        along = [
            np.broadcast_to(np.asarray(direction.get(n, 0.0), float), v.shape)
            for n, v in zip(names, values)
        ]
        with engine.numbers():
            moved = _second(
                engine, simulator, inputs, policy, draws, smooth, weights, values, along
            )
            results.append({name: np.asarray(x) for name, x in zip(names, moved)})
    return results


@eqx.filter_jit
def _second(engine: Xla, simulator, inputs, policy, draws: Draws, smooth, weights, values, along):
    def made(values) -> Schedule:
        return simulator.prepare(inputs_.replace(inputs, values))

    def held_gradient(values):
        call = engine.call(simulator, policy, made(values), draws, smooth)
        actions = engine.traced(call, ("action",)).record["action"]

        def value(moved):
            replayed = engine.call(simulator, None, made(moved), draws, smooth, actions=actions)
            return weighted_sum(engine.traced(replayed).totals, weights)

        return adjoint_gradient(value)(values)

    return jax.jvp(held_gradient, (values,), (along,))[1]
