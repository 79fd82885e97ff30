"""The noise in the bound of a stopping problem: that of the path, and that of nested draws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.problem.noise import noise_of_steps
from snapo.problem.scenarios import Pseudo, Sobol
from snapo.solver.relaxations.stop import StopRelaxation, _shifts

PAY = 10.0


class Late(snapo.Simulator):
    """A right to stop for 10 now, or for 10 + x at the end, where x moves by half a normal. It
    begins one step later in the calendar, and x at its start is the normal of the step before."""

    horizon, noise_size, initial_noise_size = 1, 1, 1
    first_step, initial_steps = 1, 1
    action = snapo.Stop()

    def prepare(self, inputs):
        return snapo.Schedule(constants=inputs, steps={"t": jnp.zeros(1)})

    def initial(self, constants, noise):
        return {"x": noise[0], "right": self.action.initial()}

    def observe(self, constants, now, state):
        return jnp.stack([state["x"]])

    def step(self, constants, now, state, action, noise, smooth):
        right, used = self.action.use(state["right"], action)
        after = {"x": state["x"] + 0.5 * noise[0], "right": right}
        return after, {"cash": used * constants["pay"]}

    def terminal(self, constants, state, smooth):
        return {"cash": self.action.left(state["right"]) * (PAY + state["x"])}


class Recording(StopRelaxation):
    """Records the paths of a bound: x before the decision, and the upper bound of each path."""

    def __init__(self, problem):
        super().__init__(problem, paths=256)
        self.recorded: list[tuple[np.ndarray, np.ndarray]] = []

    def best(self, rollout, draws, scale):
        result = super().best(rollout, draws, scale)
        self.recorded.append((np.asarray(rollout.record["state"]["x"])[0], result))
        return result


@pytest.mark.prove
@pytest.mark.parametrize("source", [None, Sobol(3)], ids=["counted", "stored"])
def test_the_bound_has_the_noise_of_its_own_steps_and_separate_nested_draws(source):
    """The optimal rule waits if x > 0. On each path the bound is max(10, 10 + x), plus the error of
    the nested mean of 0.5 z, which is that of the path's shift: blocks of 1,024 paths must not
    repeat the shifts of the first one."""
    problem = snapo.Problem(Late(), {"pay": snapo.Input(PAY)}, "cash")
    relaxation, rule = Recording(problem), snapo.Threshold(0.0, [1.0], [0.0])
    found = snapo.bound(problem, rule, relaxation=relaxation, source=source, paths=4096)
    x, upper = map(np.concatenate, zip(*relaxation.recorded))
    error = upper - PAY - np.maximum(x, 0.0)
    assert np.sqrt(np.mean(error**2)) < 0.03
    exact = PAY + 1 / np.sqrt(2 * np.pi)
    assert abs(found.upper.value - exact) < 4 * found.upper.standard_error + 0.002
    assert abs(found.lower.value - exact) < 4 * found.lower.standard_error + 0.002
    assert 0 <= found.gap.value < 0.002
    waited = error[x > 0.1]
    assert len(np.unique(waited.round(9))) > 0.999 * len(waited)


def test_noise_of_steps_is_that_of_the_calendar():
    class Early(Late):
        horizon, initial_noise_size = 2, 0
        first_step, initial_steps = 0, 0

    paths = np.arange(6)
    for source in Pseudo(3), Sobol(3):
        with jax.enable_x64(True):
            late = noise_of_steps(source.draws(paths, Late()), 1, 1)
            early = noise_of_steps(source.draws(paths, Early()), 2, 1)
        assert early.shape == (2, 6, 1)
        np.testing.assert_array_equal(late[0], early[1])


def test_shifts_are_those_of_path_seed_and_use():
    def shifts(source, paths):
        with jax.enable_x64(True):
            return np.asarray(_shifts(source.draws(np.asarray(paths), Late()), 2, 3))

    whole = shifts(Pseudo(0), np.arange(2048))
    assert whole.shape == (2, 2048, 3)
    assert len(np.unique(whole)) == whole.size
    np.testing.assert_array_equal(whole[:, [5, 1500]], shifts(Pseudo(0), [5, 1500]))
    for other in (Pseudo(1), Pseudo(0, stream=7)):
        assert not np.any(whole == shifts(other, np.arange(2048)))
    # Uniform: mean 1/2 and variance 1/12, whose errors are 1 / sqrt(12 n) and 1 / sqrt(180 n).
    assert abs(whole.mean() - 1 / 2) < 4 / np.sqrt(12 * whole.size)
    assert abs(whole.var() - 1 / 12) < 4 / np.sqrt(180 * whole.size)
