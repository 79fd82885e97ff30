"""Partial observation is named; what follows from what is seen, or only adds up, is not."""

import jax.numpy as jnp
import pytest
from tests.miniatures import MINIATURES
from tests.solver.by_default import problems
from tests.test_examples import NAMES, problem

import snapo
from snapo.problem.unseen import partly_observed
from snapo.study.commands import CaseRequest, load
from snapo.study.domain import Options


class Plant(snapo.Simulator):
    """A scalar linear plant with a quadratic cost, read whole, with an error, or not at all."""

    horizon: int = 12
    action: snapo.Box = snapo.Box(-2.0, 2.0)
    noise_size: int = 2
    initial_noise_size = 1
    read: str = "whole"

    def prepare(self, inputs):
        return snapo.Schedule(inputs, {"t": jnp.arange(12.0)})

    def initial(self, constants, noise):
        return {"x": noise[0], "error": jnp.zeros(()), "paid": jnp.zeros(())}

    def observe(self, constants, now, state):
        reading = {
            "whole": state["x"],
            "noisy": state["x"] + 0.5 * state["error"],
            "cubed": state["x"] ** 3 + now["t"],
            "none": jnp.zeros(()),
        }[self.read]
        return jnp.stack([reading, now["t"]])

    def step(self, constants, now, state, action, noise, smooth):
        cost = state["x"] ** 2 + 0.1 * action[0] ** 2
        after = constants["decay"] * state["x"] + action[0] + 0.3 * noise[0]
        return {"x": after, "error": noise[1], "paid": state["paid"] + cost}, {"cost": cost}

    def terminal(self, constants, state, smooth):
        return {"whole": state["paid"] - 1.0}


INPUTS = {"decay": snapo.Input(0.9)}


@pytest.mark.parametrize(
    "read, named", [("whole", ()), ("cubed", ()), ("noisy", ("x",)), ("none", ("x",))]
)
def test_a_linear_plant_is_partly_observed_where_its_reading_has_an_error(read, named):
    """What is paid adds up beside it: no decision would be another if that were seen."""
    cost = -snapo.Mean("cost") - snapo.Mean("whole")
    assert snapo.Problem(Plant(read=read), INPUTS, cost).partly_observed == named


class Twice(Plant):
    """The state has the exponential of what is seen, and a copy of it."""

    def initial(self, constants, noise):
        return {"log": noise[0], "price": jnp.exp(noise[0]), "pair": jnp.stack([noise[0], 1.0])}

    def observe(self, constants, now, state):
        return state["log"][None]

    def step(self, constants, now, state, action, noise, smooth):
        log = state["log"] + 0.1 * noise[0] + 0.1 * action[0]
        after = {"log": log, "price": jnp.exp(log), "pair": jnp.stack([log, now["t"] + 2.0])}
        paid = state["price"] * action[0] + state["pair"][0] * state["pair"][1] * action[0]
        return after, {"cost": paid}


def test_what_follows_from_what_is_seen_and_from_time_is_told():
    assert snapo.Problem(Twice(), INPUTS, -snapo.Mean("cost")).partly_observed == ()


class Tiger(snapo.Simulator):
    """A tiger waits behind one of two doors; each step a growl is heard, from the right side in 85
    of 100, or a door is opened, after which it hides anew."""

    horizon: int = 8
    action: snapo.Box = snapo.Box(-1.0, 1.0)
    noise_size: int = 2
    initial_noise_size = 2
    seen: bool = False

    def prepare(self, inputs):
        return snapo.Schedule(inputs, {})

    def initial(self, constants, noise):
        left = (noise[0] > 0).astype(jnp.int32)
        return {"left": left, "heard": jnp.zeros(())}

    def observe(self, constants, now, state):
        return jnp.stack([state["heard"], 1.0 * state["left"] if self.seen else 0.0])

    def step(self, constants, now, state, action, noise, smooth):
        side = 2.0 * state["left"] - 1.0
        opens = jnp.abs(action[0]) > 0.5
        won = jnp.where(action[0] * side < 0, constants["gold"], -100.0)
        left = jnp.where(opens, (noise[0] > 0).astype(jnp.int32), state["left"])
        right_side = jnp.where(noise[1] < 1.036, 1.0, -1.0)  # in 85 of 100
        heard = jnp.where(opens, 0.0, right_side * side)
        return {"left": left, "heard": heard}, {"gain": jnp.where(opens, won, -1.0)}


@pytest.mark.parametrize("seen, named", [(False, ("left",)), (True, ())])
def test_where_the_tiger_is_cannot_be_heard_for_sure(seen, named):
    gain = snapo.Mean("gain")
    assert (
        snapo.Problem(Tiger(seen=seen), {"gold": snapo.Input(10.0)}, gain).partly_observed == named
    )


@pytest.mark.prove
def test_a_solution_and_check_say_what_is_not_told():
    of = snapo.Problem(Plant(read="noisy"), INPUTS, -snapo.Mean("cost"))
    few = {
        "training": snapo.Training(steps=1, paths=16, validation_paths=16),
        "evaluation": snapo.Evaluation(64, 0, 0, 0, search_paths=0),
    }
    said = "The observation does not contain all of the state that matters: x."
    for policy, more in ((snapo.Linear(), True), (snapo.GRU(hidden=2), False)):
        (note,) = [each for each in snapo.solve(of, policy, **few).notes if said in each]
        assert ("policy with a memory" in note) == more and "decisions held fixed" in note
    assert said in str(snapo.check(of, paths=4))
    assert "does not contain" not in str(snapo.check(Plant(), INPUTS, paths=4))


@pytest.mark.prove
@pytest.mark.parametrize("name", NAMES)
def test_no_example_is_partly_observed(name):
    assert snapo.Problem(*problem(name)).partly_observed == ()


@pytest.mark.prove
@pytest.mark.parametrize("kind", ["gas-storage", "inventory", "control", "pension"])
def test_no_template_is_partly_observed(kind, tmp_path):
    """A fund's numbers that only its rules see move less than a hundredth of what it pays."""
    size = "small" if kind == "pension" else None
    folder = MINIATURES[kind]._replace(size=size, assignments=(), texts=None).write(tmp_path / "a")
    loaded = load(folder if isinstance(folder, CaseRequest) else CaseRequest(folder))
    setup = loaded.domain.study(loaded.case, Options()).setup
    assert partly_observed(setup().problem) == ()


@pytest.mark.prove
def test_problems_solved_with_no_settings():
    """The prices of a day are the level and noise: the battery cannot tell it, and would use it."""
    for made, inputs, output, named in (
        (problems.Hydro, problems.HYDRO, "value", ()),
        (problems.Battery, problems.BATTERY, "cash", ("level",)),
    ):
        assert snapo.Problem(made(), inputs, snapo.Mean(output)).partly_observed == named
