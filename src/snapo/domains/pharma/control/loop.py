"""The process in closed loop: a policy decides temperatures and ratios on measurements."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from snapo.problem.chain import Chain
from snapo.problem.inputs import Input
from snapo.problem.problem import prepare
from snapo.problem.simulator import Simulator, probe

from ..flowsheet.case import PharmaCase
from ..flowsheet.inputs import pharma_inputs
from ..flowsheet.stiffness import with_stiff_steps
from ..given import Form
from .policy import Feedback
from .sensors import history_length
from .stages import Stage
from .staging import LoopRecord, decided, staged


class ControlLoop(NamedTuple):
    """A closed loop, ready for `snapo.solve`.

    - `inputs`: {name: Input}. `baseline`: the recipe of the case as a policy that sees nothing;
      trained, it is the best fixed recipe. `policy`: the same recipe with feedback.
    - `stages`: in order. `outputs`: names of the attributes' totals. Beside them "success" is 1
      where all limits hold, and "violation" adds up the distances beyond them in margins.
    """

    simulator: Simulator
    inputs: dict[str, Input]
    policy: Feedback
    baseline: Feedback
    stages: tuple[Stage, ...]
    outputs: tuple[str, ...]


def closed_loop(
    case: PharmaCase, inputs: dict[str, Any] | None = None, seed: int = 0
) -> ControlLoop:
    """The simulator, a policy to train and the fixed recipe as a policy, at `inputs`."""
    if case.control is None:
        raise ValueError("closed_loop: the case has no [control].")
    case = with_stiff_steps(case)
    stages = stages_of(case)
    moves = [NextStage(before, after) for before, after in pairwise(stages)]
    simulator = Chain(stages, moves) if moves else stages[0]
    result = pharma_inputs(case)
    for name, value in (inputs or {}).items():
        result[name] = eqx.tree_at(lambda item: item.value, result[name], np.asarray(value, float))
    features = probe(simulator, prepare(simulator, result))[1].shape[0]
    recipe = nominal_recipe(case, stages, result)
    baseline = Feedback(recipe, features, key=jax.random.key(seed))
    names = tuple(f"attribute.{attribute.name}" for attribute in case.attributes)
    return ControlLoop(simulator, result, baseline.closed(), baseline, tuple(stages), names)


def stages_of(case: PharmaCase) -> list[Stage]:
    """A stage for each unit with decisions or sensors, and one for decisions on all the others."""
    control, form = case.control, Form.of(LoopRecord.of(case), case.held)
    assert control is not None
    steps, units = dict(control.steps), staged(case.units, control)
    rest = decided(case.units, control, "") or not units
    counts = [steps.get(item.name, 1) for item in units] + [1] * bool(rest)
    starts, stages = np.cumsum([0, *counts]).tolist(), []
    for i, count in enumerate(counts):
        name, history = "", 0
        if i < len(units):
            interval = float(units[i].duration.used()) / count
            name, history = units[i].name, history_length(control.measurements, interval)
        stages.append(Stage(form, name, count, starts[i], starts[-1], history))  # pyright: ignore[reportCallIssue]
    return stages


@dataclass(frozen=True)
class NextStage:
    """From the end of one stage to the beginning of the next."""

    before: Stage
    after: Stage

    def __call__(self, constants, state, later):
        return self.after.enter(later, self.before.leave(constants, state))


def nominal_recipe(case: PharmaCase, stages: list[Stage], inputs: dict[str, Input]) -> np.ndarray:
    """[T, size] actions that follow the case's profiles and numbers."""
    assert case.control is not None
    size = max(stage.action.size for stage in stages)
    table = np.full((stages[-1].total, size), 0.5)
    for stage in stages:
        for position, i in enumerate(stage.decided):
            item = case.control.manipulated[i]
            value = inputs[item.input].value
            endpoints = (np.arange(stage.horizon) + 1) / stage.horizon
            requested = _course(case, item.input, value, endpoints)
            rows = slice(stage.before, stage.before + stage.horizon)
            table[rows, position] = np.clip((requested - item.low) / (item.high - item.low), 0, 1)
    return table


def _course(case: PharmaCase, name: str, value: np.ndarray, share: np.ndarray) -> np.ndarray:
    """A control at shares of its unit's duration: its profile, or one number all the time."""
    unit = next(item for item in case.units if item.name == name.partition(".")[0])
    profile = next((entry for entry in unit.profiles if entry.value.name == name), None)
    if profile is None:
        return np.full(len(share), value[0])
    if profile.kind == "linear":
        return np.interp(share, profile.share, value)
    return value[np.searchsorted(profile.share[1:-1], share - 1e-9, side="right")]
