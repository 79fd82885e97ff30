"""What `snapo.check` learns from bumps: every input's adjoint against central differences.

On the same few paths with the decisions held, in float64 with smooth limits. All numbers of an
input are bumped together with random signs, and a few of them alone.
"""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.problem import inputs as inputs_
from snapo.problem.prepare import prepare
from snapo.problem.simulator import Simulator
from snapo.solver.adjoint import pull_back

from .findings import Notes
from .rollout import ENGINE, NOT_DIFFERENTIABLE, Run

TOLERANCE = 1e-4  # of the larger of adjoint and difference; round-off is added to it
WIDE = 1000.0  # the wide bump, which finds steps that a small one does not cross, in bumps
ENTRIES = 3  # numbers of one input that are bumped alone, besides all of them together


def bumped(notes: Notes, simulator: Simulator, inputs: PyTree, run: Run, seed: int) -> None:
    """Every input: the adjoint against central differences, decisions and paths held."""
    result = ENGINE.adjoint(
        simulator, None, run.schedule, run.draws, run.smooth, run.each_output(), actions=run.actions
    )
    outputs = list(run.totals)
    per_output = [
        jax.tree.map(lambda leaf, k=k: leaf[k], result.schedule) for k in range(len(outputs))
    ]
    moved = pull_back(simulator, inputs, per_output)
    rng = np.random.default_rng(seed + 2)
    for entry in inputs_.named(inputs):
        gradient = moved[entry.name]
        if not np.all(np.isfinite(gradient)):
            notes.error(
                f"{notes.method('prepare')}: input {entry.name}",
                "The derivative of the schedule by it is not finite.",
                NOT_DIFFERENTIABLE,
            )
            continue
        for label, direction in _directions(entry, rng):
            comparison = _Comparison(simulator, inputs, run, entry, direction, gradient)
            if _judge(notes, comparison, outputs, f"input {entry.name}{label}"):
                break


def _directions(entry: inputs_.Named, rng) -> list[tuple[str, np.ndarray]]:
    """All numbers together with random signs, then a few alone."""
    shape, size = entry.input.value.shape, entry.input.value.size
    if size == 1:
        return [("", np.ones(shape))]
    found = [(" (all entries)", rng.choice([-1.0, 1.0], shape))]
    for i in np.unique(np.linspace(0, size - 1, min(ENTRIES, size)).astype(int)):
        alone = np.zeros(size)
        alone[i] = 1.0
        found.append((f" [{entry.input.names()[i]}]", alone.reshape(shape)))
    return found


class _Comparison:
    """One direction of one input: its adjoint and its differences, an entry per output."""

    def __init__(self, simulator, inputs, run: Run, entry: inputs_.Named, direction, gradient):
        self.simulator, self.inputs, self.run, self.entry = simulator, inputs, run, entry
        self.direction = direction
        self.adjoint = np.array([np.sum(g * direction) for g in gradient])
        self.dead = not np.any(gradient)
        self.bump = entry.input.step()
        means = np.array(
            [np.abs(total[np.isfinite(total)]).mean() for total in run.totals.values()]
        )
        self.size = np.maximum(means, 1e-300)

    def difference(self, bump: float) -> np.ndarray:
        up, down = self._value(bump), self._value(-bump)
        return (up - down) / (2 * bump)

    def disagrees(self, bump: float) -> np.ndarray:
        """By how much adjoint and difference differ beyond tolerance and round-off, per output."""
        found = self.difference(bump)
        roundoff = 1e-13 * self.size / bump
        allowed = TOLERANCE * np.maximum(np.abs(found), np.abs(self.adjoint)) + roundoff
        return np.where(np.abs(found - self.adjoint) > allowed, np.abs(found - self.adjoint), 0.0)

    def _value(self, bump: float) -> np.ndarray:
        chosen = self.entry.input
        new = replace(chosen, value=chosen.value + bump * self.direction)
        inputs = jax.tree.map(
            lambda x: new if x is chosen else x, self.inputs, is_leaf=inputs_.is_input
        )
        totals = self.run.values(self.simulator, schedule=prepare(self.simulator, inputs))
        return np.array([total[np.isfinite(total)].mean() for total in totals.values()])


def _judge(notes: Notes, pair: _Comparison, outputs: list[str], where: str) -> bool:
    """Writes down what is wrong with one direction of an input; whether anything was."""
    small = pair.difference(pair.bump)
    if not np.all(np.isfinite(small)):
        notes.warning(
            where,
            f"With a bump of {pair.bump:.3g} the outputs are not finite.",
            "It stands on the edge of what is allowed; give a smaller one: Input(…, bump=…).",
        )
        return True
    if pair.dead:
        return _judge_dead(notes, pair, small, outputs, where)
    wrong = pair.disagrees(pair.bump)
    # A path that crosses a corner spoils one bump; a wrong derivative spoils a smaller one too.
    if not wrong.any() or not (again := pair.disagrees(pair.bump / 8)).any():
        return False
    k = int(np.argmax(again / pair.size))
    notes.error(
        where,
        f"d {outputs[k]} is {pair.adjoint[k]:.6g} by the adjoint and {small[k]:.6g} by bumps.",
        "A jump (a comparison, rounding, argmax) that bumps cross, stop_gradient on part of the "
        "way, or a derivative written by hand.",
    )
    return True


def _judge_dead(notes: Notes, pair: _Comparison, small, outputs: list[str], where: str) -> bool:
    """An input with derivative zero everywhere: it does nothing, or its way is cut."""
    # Below this a move is round-off of the sum over paths.
    if (np.abs(small) * pair.bump > 1e-12 * pair.size).any():
        k = int(np.argmax(np.abs(small) / pair.size))
        notes.error(
            where,
            f"Its derivative is exactly zero, but a bump moves {outputs[k]} by {small[k]:.6g} "
            "a unit.",
            "Look for stop_gradient, an integer cast, rounding or a comparison on its way.",
        )
        return True
    wide = pair.difference(WIDE * pair.bump)
    if (np.abs(np.nan_to_num(wide)) * pair.bump * WIDE > 1e-12 * pair.size).any():
        k = int(np.argmax(np.abs(wide) / pair.size))
        notes.warning(
            where,
            f"Its derivative is exactly zero, but {WIDE * pair.bump:.3g} more moves {outputs[k]}.",
            "A limit that does not bind yet is no mistake; an integer cast, rounding or a "
            "comparison is.",
        )
        return True
    notes.warning(where, "It changes no output.", "Use it in prepare, or leave it out.")
    return True
