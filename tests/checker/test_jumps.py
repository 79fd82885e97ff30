"""Comparisons that make an output or the state jump are named; corners and smooth limits are not."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import snapo
from snapo.checker.check import check
from snapo.checker.jumps import MINIMUM, _sides
from snapo.problem.smooth import Exact

from .test_check import Good, inputs


class Jumping(Good):
    """`how` says which numbers are compared, and what is made of each: an output of that name."""

    how: tuple[str, ...] = eqx.field(static=True, default=())
    level: float = eqx.field(static=True, default=1.3)

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        x, level, z = state["stock"], self.level, noise[0]
        ways = {
            "bool": lambda: x + 10 * (x > level),
            "where": lambda: jnp.where(x > level, 10.0, 0.0),
            "vector": lambda: jnp.where(x * jnp.ones(3) > level + jnp.arange(3), 10.0, x).sum(),
            "both": lambda: jnp.where((x > level) & (x < 99.0), 10.0, 0.0),
            "action": lambda: jnp.where(action[0] > 0.5, x + 10.0, x),
            "input": lambda: jnp.where(z > constants["drift"], 10.0, 0.0),
            "corner": lambda: jnp.where(x > level, x - level, 0.0),
            "vector corner": lambda: jnp.where(jnp.stack([x, 2 * x]) > level, x, x).sum(),
            "functions": lambda: (
                jnp.maximum(x, level) + jnp.abs(x - level) + jnp.clip(x, 1.0, level)
            ),
            "smooth": lambda: smooth.indicator(x - level) + smooth.positive_part(x - level),
            "exact": lambda: Exact().minimum(x, level),
            "noise": lambda: jnp.where(z > 0.3, 10.0, 0.0),
            "now": lambda: jnp.where(now["price"] > 1.05, 10.0, 0.0),
            "count": lambda: jnp.where(state["count"] > 2, 10.0, 0.0),
            "guard": lambda: jnp.where(x > -5.0, x, 10.0),
            "rounding": lambda: jnp.where(x > level, x * (1 + 1e-12), x),
        }
        if "state" in self.how:
            after = after | {"stock": jnp.where(x > level, 0.5, after["stock"])}
        return after, outputs | {name: way() for name, way in ways.items() if name in self.how}

    def terminal(self, constants, state, smooth):
        paid = {"terminal": jnp.where(state["stock"] > 1.5, 10.0, 0.0)}
        return Good.terminal(self, constants, state, smooth) | (
            paid if "terminal" in self.how else {}
        )


def told(*how: str):
    return [f for f in check(Jumping(how=how), inputs(), paths=8) if "jump, by" in f.subject]


@pytest.mark.prove
@pytest.mark.parametrize(
    "how, names",
    [
        (("bool", "where", "vector", "both", "action", "input", "terminal"), None),
        (("state",), ("state stock",)),
    ],
)
def test_a_jump_is_a_warning_with_its_line_size_and_remedy(how, names):
    found = told(*how)
    names = names or [f"output {name}" for name in how]
    assert len(found) == len(names), str(found)
    for name in names:
        (jump,) = (item for item in found if f"makes {name} jump" in item.subject)
        assert jump.severity == "warning" and ">" in jump.subject
        method = "terminal" if name == "output terminal" else "step"
        assert jump.where.startswith(f"{method}, ") and "test_jumps.py:" in jump.where
        assert "smooth.indicator(" in jump.fix and "snapo.Choice" in jump.fix
        if name not in ("output vector", "state stock"):
            assert "jump, by 10 on a path" in jump.subject


@pytest.mark.prove
def test_corners_smooth_limits_noise_and_time_are_no_jumps():
    found = told(
        *("corner", "vector corner", "functions", "smooth", "exact", "noise", "now", "count"),
        *("guard", "rounding"),
    )
    assert not found, str(found)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 5), st.integers(1, 6), st.integers(0, 2**30))
def test_the_two_sides_are_of_one_step_and_differ(steps, paths, bits):
    truth = np.array([bits >> k & 1 for k in range(steps * paths)], bool)
    first, second = _sides(truth, steps)
    assert np.all(first // paths == second // paths) and np.all(truth[first] != truth[second])
    each = truth.reshape(steps, paths)
    assert bool(first.size) == bool(np.any(each.any(1) & ~each.all(1)))
    assert 0 < MINIMUM < 1


class Fall(snapo.Simulator):
    """Draws nothing, and has a comparison without any number."""

    horizon: int = 4
    action: snapo.Box = snapo.Box(-1.0, 1.0)
    noise_size: int = 0

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.arange(4.0)})

    def initial(self, constants, noise):
        return {"height": constants["height"], "others": jnp.zeros(0) * constants["height"]}

    def observe(self, constants, now, state):
        return jnp.stack([state["height"], now["t"] / 4])

    def step(self, constants, now, state, action, noise, smooth):
        others = jnp.where(state["others"] > 1, 0.0, state["others"])
        after = {"height": state["height"] + action[0], "others": others}
        return after, {"cost": after["height"] ** 2}


def test_a_simulator_without_noise_has_no_findings():
    found = snapo.check(Fall(), {"height": snapo.Input(2.0)})
    assert "no findings" in str(found), str(found)
