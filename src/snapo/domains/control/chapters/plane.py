"""The plane of two states: the policy's decision at every point, and some paths in the plane."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.angle import wrap_angle
from snapo.problem.policies.memory import first_decision
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.report.drawing import LIGHT, draw, number_axis, unit_above
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Chart, Text
from snapo.report.quantity import readable, with_unit
from snapo.study.chapter import Chapter, Floats, floats
from snapo.study.chapters.profile import recorded
from snapo.study.study import StudyRun

from ..plants.plant import Plant
from .baselines import plant_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CELLS, PATHS, RECORDED = 48, 8, 512  # of the map to a side; drawn; recorded
LEVELS = 9  # of colour, from the lowest decision to the highest
EMPTY = np.zeros(0)


@dataclass(frozen=True)
class Plane:
    """The plane of two states; all fields are empty for a plant with one number.

    - `states`, `units`, `turn`: the names of the states on the horizontal and the vertical axis,
      their units, and whether they are angles.
    - `across`, `up` [CELLS]: the points of the map on the two axes.
    - `action` [CELLS, CELLS]: the decision of the first step at (up, across), if the plant has no
      other states, otherwise empty.
    - `paths` [P][2][T + 1]: the two states of some paths.
    """

    states: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    turn: tuple[bool, ...] = ()
    across: Floats = floats()
    up: Floats = floats()
    action: Floats = floats()
    paths: tuple[Floats, ...] = ()

    def label(self, axis: int) -> str:
        """The label of an axis: its state and unit."""
        return with_unit(readable(self.states[axis]), self.units[axis])


def measure(run: StudyRun) -> Plane:
    """The map of the trained policy and its paths."""
    plant, problem, policy = plant_of(run), run.setup.problem, run.solution.policy
    assert policy is not None
    states: dict[str, np.ndarray] = {}
    for kind, name, values in recorded(run.setup, policy, RECORDED):
        if kind == "state" and name in plant.states:
            count = values.shape[2]
            for i in range(count):
                states[name if count == 1 else f"{name}.{i}"] = values[:, :, i]
    if len(states) < 2:
        return Plane()
    names = _pair(plant, list(states))
    about = [plant.states[name.partition(".")[0]] for name in names]
    across, up = (_axis(states[name], state.turn) for name, state in zip(names, about))
    # Eight paths, from the lowest initial state to the highest.
    initial = states[names[0]][0]
    drawn = np.argsort(initial)[np.linspace(0, initial.size - 1, PATHS).round().astype(int)]
    return Plane(
        tuple(names),
        tuple(state.unit for state in about),
        tuple(state.turn for state in about),
        across,
        up,
        _decisions(problem, policy, names, across, up) if len(states) == 2 else EMPTY,
        tuple(np.stack([states[name][:, i] for name in names]) for i in drawn),
    )


def _pair(plant: Plant, states: list[str]) -> list[str]:
    """The two states of the picture; if the plant has an angle, the angle and its speed."""
    return list(plant.portrait) if plant.portrait else states[:2]


def _axis(values: np.ndarray, turn: bool) -> np.ndarray:
    """The points of an axis: a full turn of an angle, or the range of all but the outermost
    states."""
    low, high = (-np.pi, np.pi) if turn else np.quantile(values, [0.002, 0.998])
    room = 0.0 if turn else 0.05 * max(high - low, 1e-9)
    return np.linspace(low - room, high + room, CELLS)


def _decisions(problem: Problem, policy: Policy, names, across, up) -> np.ndarray:
    """[up, across] the first number of the decision at the first step."""
    schedule = problem.schedule
    now, vector = at(schedule.steps, 0), "." in names[0]

    def decide(y, x):
        state: Any = {names[0]: x, names[1]: y}
        if vector:
            state = {names[0].partition(".")[0]: jnp.stack([x, y])}
        return first_decision(policy, problem.simulator.observe(schedule.constants, now, state))[0]

    grid = jax.vmap(jax.vmap(decide, (None, 0)), (0, None))
    return np.asarray(jax.jit(grid)(jnp.asarray(up), jnp.asarray(across)))


def show(run: RunFiles, plane: Plane) -> Sequence[Block]:
    """A phase portrait, drawn on the map of the policy if the plant has no other states."""
    if not plane.states:
        return [Text("There is no phase portrait, as the plant has only one state.")]
    count = len(plane.paths)
    alt = f"{plane.label(0)} and {plane.label(1)}: {count} paths; dots are the initial states."
    svg = draw("plane", alt, lambda axes: _paint(axes, plane), 330)
    caption = f"{count} paths; a dot is an initial state, a ring a terminal state."
    if plane.action.size:
        caption += (
            " The background is the decision of the first step: blue is the lowest, orange "
            "the highest, no colour the middle."
        )
    blocks: list[Block] = [Chart(svg, caption)]
    if any(plane.turn):
        blocks.append(Text("Angles are drawn between −π and π.", caveat=True))
    return blocks


def _paint(axes: "Axes", plane: Plane) -> None:
    if plane.action.size:
        _map(axes, plane)
    for path in plane.paths:
        x, y = (_folded(path[i]) if plane.turn[i] else path[i] for i in (0, 1))
        axes.plot(x, y, color=LIGHT["ink"], linewidth=0.9)
        axes.plot(x[:1], y[:1], "o", color=LIGHT["ink"], markersize=4)
        axes.plot(x[-1:], y[-1:], "o", color=LIGHT["ink"], markersize=7, fillstyle="none")
    axes.set_xlim(plane.across[0], plane.across[-1])
    axes.set_ylim(plane.up[0], plane.up[-1])
    axes.set_xlabel(plane.label(0))
    axes.grid(False)
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis)
    unit_above(axes, plane.label(1))


def _map(axes: "Axes", plane: Plane) -> None:
    from matplotlib.colors import to_rgba

    low, high = float(plane.action.min()), float(plane.action.max())
    if not high > low:
        return
    edges = np.linspace(low, high, LEVELS + 1)
    sides = [2 * (i + 0.5) / LEVELS - 1 for i in range(LEVELS)]
    colours = [to_rgba(LIGHT["withdraw" if s > 0 else "inject"], 0.75 * abs(s)) for s in sides]
    axes.contourf(plane.across, plane.up, plane.action, levels=edges, colors=colours)


def _folded(angle: np.ndarray) -> np.ndarray:
    """An angle between -pi and pi, with a gap where it jumps over the edge."""
    folded = np.array(wrap_angle(angle))
    folded[1:][np.abs(np.diff(folded)) > np.pi] = np.nan
    return folded


PLANE = Chapter("plane of states", "Decisions and paths in the plane of states", Plane, measure,
                show, "Plane", key="plane")  # fmt: skip
