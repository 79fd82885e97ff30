"""Compares every input's adjoint with central differences on the same few paths, with decisions
held fixed.

The comparison is in float64 with smooth limits. All numbers of an input are bumped together with
random signs, and a few of them separately. An input without effect under the random policy is
tested at low, middle or high actions. Inputs that change no single path (`in_mean`) are not tested
here.
"""

from dataclasses import replace
from typing import NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.engine.transpose import pull_back
from snapo.problem import inputs as inputs_
from snapo.problem.problem import in_mean, prepare
from snapo.problem.simulator import Schedule, Simulator

from .findings import Notes, StopCheck
from .rollout import ENGINE, CheckedRollout

NOT_DIFFERENTIABLE = (
    "A root, logarithm, power or division at zero has no derivative, even in a branch that "
    "jnp.where does not take. Give that branch a harmless argument: f(jnp.where(ok, x, 1.0))."
)


def locate(notes: Notes, simulator: Simulator, run: CheckedRollout) -> NoReturn:
    """Names the method and step at which a derivative is non-finite, and stops.

    The reverse sweep starts at the end, so it reaches the last bad step first.
    """
    constants, T, N = run.schedule.constants, simulator.horizon, run.draws.size

    def finite(function, *arguments):
        """{argument: whether d(sum of floating results) / d argument is finite}, for one path."""
        moving, fixed = eqx.partition(arguments, eqx.is_inexact_array)

        def total(moving):
            results = jax.tree.leaves(function(*eqx.combine(moving, fixed)))
            return sum(jnp.sum(x) for x in results if jnp.issubdtype(x.dtype, jnp.floating))

        return jax.tree.map(lambda g: jnp.all(jnp.isfinite(g)), jax.grad(total)(moving))

    def one(now, state, action, noise):
        def step(state, now, action, constants):
            return simulator.step(constants, now, state, action, noise, run.smooth)

        def observe(state, now, constants):
            return simulator.observe(constants, now, state)

        return {
            "step": finite(step, state, now, action, constants),
            "observe": finite(observe, state, now, constants),
        }

    with jax.enable_x64(True):
        mapped = jax.jit(lambda xs: jax.lax.map(lambda x: jax.vmap(one, (None, 0, 0, 0))(*x), xs))
        marks = mapped((run.schedule.steps, run.states, run.actions, run.draws.step_noise))
        marks = jax.tree.map(np.asarray, marks)
    names = {
        "step": ("state", "now", "action", "constants"),
        "observe": ("state", "now", "constants"),
    }
    invalid = []
    for method, arguments in names.items():
        for path, ok in jax.tree_util.tree_flatten_with_path(marks[method])[0]:
            if not ok.all():
                step, number = (int(i) for i in np.argwhere(~ok)[-1])
                leaf = arguments[path[0].idx] + jax.tree_util.keystr(path[1:])
                invalid.append((step, method, leaf, number))
    if invalid:
        step, method, leaf, path = max(invalid)
        notes.error(
            notes.method(method),
            f"Its derivative with respect to {leaf} is non-finite; going backwards, this occurs "
            f"first at step {step} of {T} (path {path} of {N}).",
            NOT_DIFFERENTIABLE,
        )
    else:
        notes.error(
            notes.method("initial") + " or terminal",
            "A derivative is non-finite.",
            NOT_DIFFERENTIABLE,
        )
    raise StopCheck


TOLERANCE = 1e-4  # of the larger of adjoint and difference; round-off is added to it
SMALLER = (1.0, 1 / 8, 1 / 64)  # bumps, in steps: a path on a corner or a jump may spoil one
WIDE = (1e3, 3e4)  # wide bumps, which find steps that a small one does not cross, in steps
ENTRIES = 3  # numbers of one input that are bumped separately, besides all of them together


def bumped(
    notes: Notes, simulator: Simulator, inputs: PyTree, runs: list[CheckedRollout], seed: int
) -> None:
    """Compares the adjoint of every input with central differences, decisions held fixed."""
    gradients: list[dict[str, np.ndarray]] = []

    def gradient(k: int, name: str) -> np.ndarray:
        """[outputs, *shape] of the k-th run, by one adjoint pass when it is first needed."""
        while len(gradients) <= k:
            gradients.append(_gradients(simulator, inputs, runs[len(gradients)]))
        return gradients[k][name]

    rng, together = np.random.default_rng(seed + 2), in_mean(simulator, inputs)
    for entry in inputs_.named_inputs(inputs):
        if not entry.input.value.size:
            continue
        alive = (k for k in range(len(runs)) if np.any(gradient(k, entry.name)))
        k = next(alive, None)
        judged = runs if k is None else [runs[k]]
        result = gradient(k or 0, entry.name)
        if not np.all(np.isfinite(result)):
            notes.error(
                f"{notes.method('prepare')}: input {entry.name}",
                "The derivative of the schedule with respect to it is non-finite.",
                NOT_DIFFERENTIABLE,
            )
            continue
        if entry.name in together:
            continue
        for label, direction in _directions(entry, rng):
            pairs = [
                _Comparison(simulator, inputs, run, entry, direction, result) for run in judged
            ]
            if _judge(notes, pairs, list(judged[0].totals), f"input {entry.name}{label}"):
                break


def _gradients(simulator: Simulator, inputs: PyTree, run: CheckedRollout) -> dict[str, np.ndarray]:
    """{input: [outputs, *shape]}, the derivatives of every output's mean."""
    result = ENGINE.adjoint(
        simulator, None, run.schedule, run.draws, run.smooth, run.each_output(), actions=run.actions
    )
    parts = [
        jax.tree.map(lambda leaf, k=k: leaf[k], result.schedule) for k in range(len(run.totals))
    ]
    return pull_back(simulator, inputs, parts)


def _directions(entry: inputs_.NamedInput, rng) -> list[tuple[str, np.ndarray]]:
    """All numbers together with random signs, then a few separately."""
    shape, size = entry.input.value.shape, entry.input.value.size
    if size == 1:
        return [("", np.ones(shape))]
    pairs = [(" (all entries)", rng.choice([-1.0, 1.0], shape))]
    for i in np.unique(np.linspace(0, size - 1, min(ENTRIES, size)).astype(int)):
        alone = np.zeros(size)
        alone[i] = 1.0
        pairs.append((f" [{entry.input.names()[i]}]", alone.reshape(shape)))
    return pairs


class _Comparison:
    """One direction of one input in one run: its adjoint and differences, an entry per output.

    Every number moves by its own step; derivatives are with respect to the largest of these moves.
    """

    def __init__(
        self, simulator, inputs, run: CheckedRollout, entry: inputs_.NamedInput, direction, gradient
    ):
        self.simulator, self.inputs, self.run, self.entry = simulator, inputs, run, entry
        moved = entry.input.step() * direction
        self.bump = float(np.max(np.abs(moved)))
        self.direction = moved / self.bump
        self.adjoint = np.array([np.sum(g * self.direction) for g in gradient])
        self.dead = not np.any(gradient)
        means = np.array(
            [np.abs(total[np.isfinite(total)]).mean() for total in run.totals.values()]
        )
        self.size = np.maximum(means, 1e-300)
        self.rounding = run.rounding()

    def difference(self, bump: float) -> np.ndarray:
        up, down = self._value(bump), self._value(-bump)
        return (up - down) / (2 * bump)

    def disagrees(self, result: np.ndarray, bump: float) -> np.ndarray:
        """The gap between adjoint and difference beyond tolerance and round-off, per output."""
        roundoff = np.maximum(1e-13 * self.size, self.rounding) / bump
        allowed = TOLERANCE * np.maximum(np.abs(result), np.abs(self.adjoint)) + roundoff
        return np.where(np.abs(result - self.adjoint) > allowed, np.abs(result - self.adjoint), 0.0)

    def moves(self, bump: float) -> np.ndarray | None:
        """The differences, where they are more than round-off of a sum over paths."""
        result = np.nan_to_num(self.difference(bump))
        minimum = np.maximum(1e-12 * self.size, self.rounding)
        return result if (np.abs(result) * bump > minimum).any() else None

    def moves_decisions(self, bump: float) -> bool:
        """Whether outputs move if the policy decides, through its observations (as by a measurement
        error)."""
        there = self.run.values(self.simulator, False, schedule=self._schedule(bump))
        back = self.run.values(self.simulator, False, schedule=self._schedule(-bump))
        return not self.run.same(there, back)

    def _value(self, bump: float) -> np.ndarray:
        totals = self.run.values(self.simulator, schedule=self._schedule(bump))
        return np.array([total[np.isfinite(total)].mean() for total in totals.values()])

    def _schedule(self, bump: float) -> Schedule:
        selected = self.entry.input
        new = replace(selected, value=selected.value + bump * self.direction)
        inputs = jax.tree.map(
            lambda x: new if x is selected else x, self.inputs, is_leaf=inputs_.is_input
        )
        return prepare(self.simulator, inputs)


def _judge(notes: Notes, pairs: list[_Comparison], outputs: list[str], where: str) -> bool:
    """Reports the mistakes along one direction of an input; returns whether there was any."""
    pair = pairs[0]
    small = pair.difference(pair.bump)
    if not np.all(np.isfinite(small)):
        notes.warning(
            where,
            f"With a bump of {pair.bump:.3g} the outputs are non-finite.",
            "The input is on the edge of its range; specify a smaller bump: Input(…, bump=…).",
        )
        return True
    if pair.dead:
        return _judge_dead(notes, pairs, outputs, where)
    # A path that crosses a corner spoils one bump; a wrong derivative spoils smaller ones too.
    for factor in SMALLER:
        bump = factor * pair.bump
        wrong = pair.disagrees(small if factor == 1 else pair.difference(bump), bump)
        if not wrong.any():
            return False
    k = int(np.argmax(wrong / pair.size))
    notes.error(
        where,
        f"d {outputs[k]} is {pair.adjoint[k]:.6g} by the adjoint and {small[k]:.6g} by bumps.",
        "Likely causes: a jump (comparison, rounding, argmax) that bumps cross, a stop_gradient "
        "between input and output, a derivative written by hand. If the input is a parameter of "
        "a noise of whole numbers that prepare or step creates, such as Poisson, its derivative is "
        "correct only in the mean over paths. Declare this with def in_mean(self): return "
        f"({pair.entry.name!r},).",
    )
    return True


def _judge_dead(notes: Notes, pairs: list[_Comparison], outputs: list[str], where: str) -> bool:
    """An input with derivative zero in every run: it has no effect, or its derivative is lost."""
    bump = pairs[0].bump
    for pair in pairs:
        if (small := pair.moves(bump)) is not None:
            k = int(np.argmax(np.abs(small) / pair.size))
            notes.error(
                where,
                f"Its derivative is exactly zero, but a bump moves {outputs[k]} by "
                f"{small[k]:.6g} per unit.",
                "Look for a stop_gradient, an integer cast, rounding or a comparison between the "
                "input and the outputs.",
            )
            return True
    for pair in pairs:
        for factor in WIDE:
            if (wide := pair.moves(factor * bump)) is not None:
                k = int(np.argmax(np.abs(wide) / pair.size))
                notes.warning(
                    where,
                    f"Its derivative is exactly zero, but a bump of {factor * bump:.3g} moves "
                    f"{outputs[k]}.",
                    "If a limit does not bind at these inputs, this is not a mistake; an integer "
                    "cast, rounding or a comparison is one.",
                )
                return True
    if any(pair.moves_decisions(bump) for pair in pairs):
        return False
    notes.warning(where, "It changes no output.", "Use it in prepare, or leave it out.")
    return True
