"""A measure of a tail that has few paths says so, and how many it takes."""

import jax.numpy as jnp
import pytest

import snapo


class Bets(snapo.Simulator):
    """A share of a normal outcome."""

    horizon: int = 1
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def prepare(self, inputs):
        return snapo.Schedule(inputs, {"t": jnp.zeros(1)})

    def initial(self, constants, noise):
        return jnp.zeros(())

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def step(self, constants, now, state, action, noise, smooth):
        return state, {"cash": action[0] * (constants["mean"] + noise[0])}


@pytest.mark.parametrize(
    "objective, limits, told",
    [
        (snapo.CVaR("cash", 0.9), (), ["102 of 1,024 paths", "use 2,000 paths"]),
        (snapo.Mean("cash") - 0.5 * snapo.CVaR("cash", 0.95), (), ["51 of 1,024", "use 4,000"]),
        (snapo.Mean("cash"), (snapo.AtMost(snapo.CVaR("cash", 0.9), 9.0),), ["102 of 1,024"]),
        (snapo.Mean("cash") + snapo.CVaR("cash", 0.5), (), []),
    ],
)
def test_a_tail_of_few_paths_is_noted(objective, limits, told):
    found = snapo.solve(
        snapo.Problem(Bets(), {"mean": snapo.Input(1.0)}, objective, constraints=limits),
        training=snapo.Training(steps=2, paths=16, validation_paths=16),
        evaluation=snapo.Evaluation(paths=1024, sensitivity_paths=0),
    )
    notes = [note for note in found.notes if note.startswith("There are few paths in the tail")]
    assert len(notes) == bool(told)
    assert all(part in notes[0] for part in told)
