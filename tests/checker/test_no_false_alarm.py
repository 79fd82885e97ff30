"""What looks idle or wrong with decisions held fixed, and is neither."""

import jax.numpy as jnp
import pytest

import snapo
from snapo.checker.check import check


class Seen(snapo.Simulator):
    """Wear that is only seen with an error: the error moves decisions and nothing else."""

    horizon, noise_size = 4, 3  # wear, the error of its reading, and one that nothing reads
    action = snapo.Box(0.0, 1.0)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.arange(4.0)})

    def initial(self, constants, noise):
        return {"wear": 1.0, "seen": 1.0}

    def observe(self, constants, now, state):
        return jnp.stack([now["t"], state["seen"]])

    def step(self, constants, now, state, action, noise, smooth):
        wear = state["wear"] * (1 - action[0]) + 0.2 * jnp.exp(0.5 * noise[0])
        seen = wear + constants["error"] * noise[1]
        return {"wear": wear, "seen": seen}, {"cost": state["wear"] ** 2 + action[0]}


@pytest.mark.prove
def test_an_error_of_a_reading_is_not_idle():
    inputs = {"error": snapo.Input(0.5), "idle": snapo.Input(1.0)}
    findings = check(Seen(), inputs)
    told = [(found.where.split(": ")[-1], found.severity) for found in findings]
    assert sorted(told) == [("input idle", "warning"), ("noise[2]", "warning")], told
    assert "The observation does not contain all of the state that matters: wear." in str(findings)


class Charging(snapo.Simulator):
    """Two cars that have all they need long before they leave: what is missed is rounding."""

    horizon, noise_size = 24, 1
    action = snapo.Box(0.0, 7.0, 2)

    def prepare(self, inputs):
        hour = jnp.arange(24)
        return snapo.Schedule(dict(inputs), {"leaves": hour == 23, "price": 0.3 + 0.01 * hour})

    def initial(self, constants, noise):
        return {"need": constants["need"]}

    def observe(self, constants, now, state):
        return state["need"] / 10 - 1

    def step(self, constants, now, state, action, noise, smooth):
        power = smooth.minimum(action, state["need"], scale=7.0)
        room = smooth.positive_part(constants["limit"] + noise[0], scale=10.0)
        power *= smooth.minimum(1.0, room / jnp.maximum(jnp.sum(power), 1e-6))
        need = state["need"] - power
        missed = jnp.where(now["leaves"], jnp.sum(need), 0.0)
        return {"need": need}, {"cost": now["price"] * jnp.sum(power), "missed": missed}


@pytest.mark.prove
def test_rounding_of_an_output_that_is_zero_is_no_derivative():
    given = {"need": snapo.Input([20.0, 15.0]), "limit": snapo.Input(12.0)}
    assert not len(findings := check(Charging(), given)), str(findings)


class Sold(snapo.Simulator):
    """Demand whose mean is known in the step alone: no path moves with it."""

    horizon, noise_size = 3, 1
    action = snapo.Box(0.0, 3.0)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.arange(3.0)})

    def initial(self, constants, noise):
        return {"stock": 10.0}

    def observe(self, constants, now, state):
        return state["stock"][None] / 10

    def step(self, constants, now, state, action, noise, smooth):
        wanted = snapo.noise.Poisson(constants["rate"] * jnp.exp(-action[0]), maximum=20).draw(
            noise
        )
        sold = smooth.minimum(wanted, state["stock"])
        return {"stock": state["stock"] - sold}, {"cash": action[0] * sold}


class Named(Sold):
    """The same, with the remedy that the finding names."""

    def in_mean(self):
        return ("rate",)


@pytest.mark.prove
def test_a_mean_of_whole_numbers_made_in_the_step_is_told_with_its_remedy():
    given = {"rate": snapo.Input(4.0)}
    (found,) = check(Sold(), given)
    assert "def in_mean(self): return ('rate',)" in found.fix, found
    assert not len(findings := check(Named(), given)), str(findings)
