"""The process in closed loop: a policy decides temperatures and ratios on what is measured."""

from dataclasses import fields
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import numpy as np

from ...adjoint import prepare
from ...chain import Chain
from ...inputs import Input
from ...policy import Policy, Residual
from ...simulator import Simulator, probe
from .inputs import every_given, pharma_inputs
from .policy import FixedRecipe
from .records import PharmaCase
from .records_units import Crystalliser, Profile
from .stages import PLAIN_STEPS, Stage, decided, timed_units


class Loop(NamedTuple):
    """A closed loop, ready for `snapo.solve`.

    - `inputs`: {name: Input}. `baseline`: the recipe of the case as a `FixedRecipe`; trained, it
      is the best fixed recipe. `policy`: the same recipe with a network's corrections.
    - `outputs`: names of the attributes' totals. Beside them "success" is 1 where all limits
      hold, and "violation" adds up the distances beyond the limits in margins.
    """

    simulator: Simulator
    inputs: dict[str, Input]
    policy: Policy
    baseline: FixedRecipe
    outputs: tuple[str, ...]


def closed_loop(case: PharmaCase, inputs: dict[str, Any] | None = None, seed: int = 0) -> Loop:
    """The simulator, a policy to train and the fixed recipe as a policy, at `inputs`."""
    if case.control is None:
        raise ValueError("closed_loop: the case has no [control].")
    stages = _stages(case)
    simulator = Chain(stages, [_move(a, b) for a, b in pairwise(stages)])
    found = pharma_inputs(case)
    for name, value in (inputs or {}).items():
        found[name] = Input(value, found[name].unit, found[name].labels)
    baseline = FixedRecipe(nominal_recipe(case, stages, found).astype(np.float32))
    names = tuple(f"attribute.{each.name}" for each in case.attributes)
    return Loop(simulator, found, corrected(simulator, found, baseline, seed), baseline, names)


def corrected(simulator: Simulator, inputs, recipe: FixedRecipe, seed: int = 0) -> Policy:
    """A policy that starts as the fixed recipe; a network corrects it by what is measured."""
    features = probe(simulator, prepare(simulator, inputs))[1].shape[0]
    key = jax.random.key(seed)
    return Residual(recipe, simulator.action, features, key=key, scale=0.3)


def _stages(case: PharmaCase) -> list[Stage]:
    """A stage for each timed unit, and one step for all the others."""
    assert case.control is not None
    steps, units = dict(case.control.steps), timed_units(case)
    plain = [PLAIN_STEPS if isinstance(each, Crystalliser) else 1 for each in units]
    counts = [steps.get(each.name, count) for each, count in zip(units, plain)] + [1]
    starts = np.cumsum([0, *counts])
    return [
        Stage(  # pyright: ignore[reportCallIssue]
            case=case,
            unit=unit,
            horizon=counts[i],
            before=int(starts[i]),
            total=int(starts[-1]),
        )
        for i, unit in enumerate((*units, None))
    ]


def _move(before: Stage, after: Stage):
    """From the end of one stage to the beginning of the next."""

    def move(constants, state, later):
        return after.enter(later, before.leave(constants, state))

    return move


def nominal_recipe(case: PharmaCase, stages: list[Stage], inputs: dict[str, Input]) -> np.ndarray:
    """[T, size] actions that follow the case's own profiles and numbers."""
    assert case.control is not None
    size = max(stage.action.size for stage in stages)
    table = np.full((stages[-1].total, size), 0.5)
    for stage in stages:
        for place, i in enumerate(decided(case, stage.unit)):
            item = case.control.manipulated[i]
            value = inputs[item.input].value if item.input in inputs else _held(case, item.input)
            ends = (np.arange(stage.horizon) + 1) / stage.horizon
            wanted = _course(case, item.input, value, ends)
            rows = slice(stage.before, stage.before + stage.horizon)
            table[rows, place] = np.clip((wanted - item.low) / (item.high - item.low), 0, 1)
    return table


def _held(case: PharmaCase, name: str) -> np.ndarray:
    return next(each.values for each in every_given(case.units) if each.name == name)


def _course(case: PharmaCase, name: str, value: np.ndarray, share: np.ndarray) -> np.ndarray:
    """A control at shares of its unit's duration: its profile, or one number all the time."""
    unit = next(each for each in case.units if each.name == name.partition(".")[0])
    owned = [unit, getattr(unit, "jacket", None)]
    profile = next((p for p in _profiles(owned) if p.value.name == name), None)
    if profile is None:
        return np.full(len(share), value[0])
    if profile.kind == "linear":
        return np.interp(share, profile.share, value)
    return value[np.searchsorted(profile.share[1:-1], share - 1e-9, side="right")]


def _profiles(records) -> list[Profile]:
    """The profiles among the fields of some records, of which some may be None."""
    found = [getattr(r, f.name) for r in records if r is not None for f in fields(r)]
    return [each for each in found if isinstance(each, Profile)]
