"""Every kind of mistake is found and named; a clean simulator has no findings."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.checker.check import check
from snapo.checker.effects import stopped_once
from snapo.checker.findings import Notes
from snapo.checker.rollout import rollouts
from snapo.problem.actions import Box, Stop
from snapo.problem.inputs import Input
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo, Supplied
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Smooth

T = 4


class Inputs(eqx.Module):
    drift: Input
    price: Input


def inputs():
    return Inputs(Input(0.3, "1/step"), Input([1.0, 1.2, 0.9, 1.1], "EUR"))


class Good(Simulator):
    """Stock that grows, and a price; the mistakes below are made in copies of it."""

    horizon: int = T
    action: Box = Box(0.0, 1.0)
    noise_size: int = 1

    def prepare(self, inputs):
        return Schedule({"drift": inputs.drift}, {"price": inputs.price})

    def initial(self, constants, noise):
        return {"stock": 1.0, "count": jnp.int32(0)}

    def observe(self, constants, now, state):
        return jnp.stack([state["stock"], now["price"]])

    def step(self, constants, now, state, action, noise, smooth):
        sold = smooth.minimum(action[0], state["stock"], scale=1.0)
        stock = state["stock"] - sold + constants["drift"] * jnp.exp(0.1 * noise[0])
        return {"stock": stock, "count": state["count"] + 1}, {"cash": sold * now["price"]}

    def terminal(self, constants, state, smooth):
        return {"cash": state["stock"] ** 2 * 0.1}


def only(findings, severity="error"):
    """The one finding of this severity."""
    chosen = [f for f in findings if f.severity == severity]
    assert len(chosen) == 1, str(findings)
    return chosen[0]


def test_a_clean_simulator_has_no_findings():
    findings = check(Good(), inputs())
    assert len(findings) == 0 and findings.ok, str(findings)
    assert "no findings" in str(findings)


def test_supplied_scenarios_may_take_the_place_of_normals():
    noise = np.random.default_rng(0).normal(size=(T, 64, 1))
    assert len(check(Good(), inputs(), scenarios=Supplied(noise))) == 0


# --- what a look at one step shows: nothing is compiled ---------------------------------------


class NoHorizon(Good):
    horizon: float = 4.0  # pyright: ignore


class ShortSchedule(Good):
    horizon: int = T + 1


class NotASchedule(Good):
    def prepare(self, inputs):
        return {"price": inputs.price}


class InfiniteSchedule(Good):
    def prepare(self, inputs):
        return Schedule({"drift": inputs.drift}, {"price": jnp.log(inputs.price - 1.0)})


class SingleSchedule(Good):
    def prepare(self, inputs):
        return Schedule({"drift": inputs.drift}, {"price": inputs.price.astype(jnp.float32)})


class NewShape(Good):
    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after | {"stock": after["stock"][None]}, outputs


class NewType(Good):
    def initial(self, constants, noise):
        return {"stock": jnp.int32(1), "count": jnp.int32(0)}


class NewTree(Good):
    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after | {"more": 0.0}, outputs


class VectorOutput(Good):
    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after, {"cash": outputs["cash"] * jnp.ones(2)}


class FlatObservation(Good):
    def observe(self, constants, now, state):
        return state["stock"]


class ChangingOutputs(Good):
    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after, outputs | ({"gap": 0.0} if hasattr(smooth, "temperature") else {})


class UnknownTotal(Good):
    def totals(self):
        return {"crash": "max"}


class OneResult(Good):
    def step(self, constants, now, state, action, noise, smooth):
        return state


class PlainNumpy(Good):
    def step(self, constants, now, state, action, noise, smooth):
        return state, {"cash": np.exp(state["stock"])}  # this very line is named


class PythonIf(Good):
    def step(self, constants, now, state, action, noise, smooth):
        return state, {"cash": 1.0 if state["stock"] > 0 else 0.0}


class PythonFloat(Good):
    def observe(self, constants, now, state):
        return jnp.asarray([float(state["stock"])])


class WrongKey(Good):
    def terminal(self, constants, state, smooth):
        return {"cash": state["stok"]}


@pytest.mark.parametrize(
    "simulator, where, what",
    [
        (NoHorizon(), "horizon", "4.0"),
        (ShortSchedule(), "steps['price']", "(4,)"),
        (NotASchedule(), "prepare", "dict"),
        (InfiniteSchedule(), "price", "Entry (0,) is -inf"),
        (SingleSchedule(), "price", "float32"),
        (NewShape(), "state['stock']", "[1]"),
        (NewType(), "state['stock']", "int32"),
        (NewTree(), "step", "structure"),
        (VectorOutput(), "output 'cash'", "[2]"),
        (FlatObservation(), "observe", "float64[]"),
        (ChangingOutputs(), "step", "gap"),
        (UnknownTotal(), "totals", "crash"),
        (OneResult(), "step", "return (state, outputs)"),
        (PlainNumpy(), "step, ", "NumPy was called"),
        (PythonIf(), "step, ", "to decide something here"),
        (PythonFloat(), "observe, ", "Python needs the value"),
        (WrongKey(), "terminal, ", "KeyError: 'stok'"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Simulator) else "",
)
def test_mistakes_that_one_step_shows(simulator, where, what):
    error = only(check(simulator, inputs()))
    assert where in error.where and what in error.subject and error.fix


def test_a_class_and_a_vector_of_one_number_get_their_own_remedy():
    assert "Good()" in only(check(Good, inputs())).fix
    assert "action[0]" in only(check(NewShape(), inputs())).fix


class Sells(Good):
    """Sells at a price, as often as it stops."""

    action: Stop = Stop()

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action * 0.0, noise, smooth)
        return after, outputs | {"sold": action[0] * now["price"]}


class SellsOnce(Sells):
    def initial(self, constants, noise):
        return Good.initial(self, constants, noise) | {"right": self.action.initial()}

    def step(self, constants, now, state, action, noise, smooth):
        right, used = self.action.use(state["right"], action)
        after, outputs = Good.step(self, constants, now, state, action * 0.0, noise, smooth)
        return after | {"right": right}, outputs | {"sold": used * now["price"]}


def stops(simulator) -> list[str]:
    """What is reported of a stop by its own part of the check."""
    notes, schedule = Notes(simulator), prepare(simulator, inputs())
    (run, *_) = rollouts(notes, simulator, schedule, np.zeros(2), None, 32, Smooth(0.05), 0)
    stopped_once(notes, simulator, run)
    return [item.subject for item in notes.items]


@pytest.mark.prove
@pytest.mark.parametrize("rights", [1, 2])
def test_a_stop_that_is_not_used_up_is_told(rights):
    (subject,) = stops(Sells(action=Stop(rights)))
    assert "more often than there are rights" in subject
    assert stops(SellsOnce(action=Stop(rights))) == []


@pytest.mark.prove
def test_the_whole_check_looks_at_stops():
    found = check(Sells(action=Stop(2)), inputs())
    assert any("more often than there are rights (2)" in each.subject for each in found), str(found)


def test_errors_of_user_code_name_file_and_line():
    error = only(check(PlainNumpy(), inputs()))
    with open(__file__) as source:
        line = 1 + next(i for i, text in enumerate(source) if "this very line is named" in text)
    assert f"test_check.py:{line}" in error.where
    assert "np.exp" in error.subject


class Random(Good):
    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after, {"cash": outputs["cash"] * np.random.uniform()}


class Mutable(Good):
    calls: list = eqx.field(static=True, default_factory=list)

    def observe(self, constants, now, state):
        self.calls.append(0)
        return jnp.stack([state["stock"], jnp.asarray(float(len(self.calls)))])

    __hash__ = object.__hash__


def test_python_randomness_and_counters():
    assert "step" in only(check(Random(), inputs())).where
    assert "observe" in only(check(Mutable(), inputs())).where


# --- what a rollout shows -----------------------------------------------------------------------


class Overflow(Good):
    def step(self, constants, now, state, action, noise, smooth):
        after, _ = Good.step(self, constants, now, state, action, noise, smooth)
        return after, {"cash": 1.0 / (state["count"] - 2.0)}


class RootOfZero(Good):
    """sqrt(x - x) is finite, its derivative is not; it begins at step 2 from the end."""

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        zero = jnp.where(state["count"] == 2, 0.0, 1.0) * after["stock"]
        return after, {"cash": outputs["cash"] + jnp.sqrt(zero)}


@pytest.mark.prove
def test_numbers_and_derivatives_that_are_not_finite_are_placed():
    error = only(check(Overflow(), inputs()))
    assert "cash" in error.subject and "step 2" in error.subject
    error = only(check(RootOfZero(), inputs()))
    assert error.where.startswith("step") and "step 2 of 4" in error.subject


class Idle(Good):
    """Three actions: one works, one is rounded away, one is ignored; two normals, one ignored."""

    action: Box = Box(0.0, 1.0, 3)
    noise_size: int = 2

    def observe(self, constants, now, state):
        return jnp.stack([state["stock"] * 1000, now["price"], 1e-4 * now["price"]])

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after, {"cash": outputs["cash"] + jnp.round(action[1] * 4)}


@pytest.mark.prove
def test_idle_actions_and_noise_and_badly_scaled_observations():
    findings = check(Idle(), inputs())
    errors = {f.where.split(": ")[1]: f.subject for f in findings.errors}
    warnings = {f.where.split(": ")[1] for f in findings.warnings}
    assert set(errors) == {"action[1]", "action[2]"}, str(findings)
    assert "exactly zero" in errors["action[1]"] and "no output" in errors["action[2]"]
    assert warnings == {"noise[1]", "feature 0", "feature 2"}, str(findings)


class Cut(eqx.Module):
    stopped: Input
    floored: Input
    partly: Input
    unused: Input
    slack: Input
    right: Input


@jax.custom_jvp
def square(x):
    return x**2


square.defjvps(lambda dx, y, x: x * dx)  # half of the derivative


class Cuts(Good):
    def prepare(self, inputs):
        constants = {
            "drift": jax.lax.stop_gradient(inputs.stopped)
            + 0.1 * jnp.floor(inputs.floored * 1000.0),
            "limit": inputs.slack,
        }
        return Schedule(constants, {"price": square(inputs.partly) * inputs.right})

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after, {"cash": jnp.minimum(outputs["cash"], constants["limit"])}


@pytest.mark.prove
def test_inputs_whose_derivative_is_wrong():
    right = Input([1.0, 1.1, 1.0, 1.2])
    given = Cut(
        Input(0.3), Input(0.00101), Input([1.0, 1.2, 0.9, 1.1]), Input(7.0), Input(9.0), right
    )
    findings = check(Cuts(), given)
    by_input = {f.where.split()[1]: f for f in findings}
    assert set(by_input) == {"stopped", "floored", "partly", "unused", "slack"}, str(findings)
    assert by_input["stopped"].severity == "error" and "bump moves" in by_input["stopped"].subject
    assert (
        by_input["floored"].severity == "warning" and "exactly zero" in by_input["floored"].subject
    )
    assert by_input["partly"].severity == "error" and "by the adjoint" in by_input["partly"].subject
    assert by_input["unused"].severity == by_input["slack"].severity == "warning"


@pytest.mark.prove
def test_a_plain_number_beside_inputs_is_no_mistake():
    """Given as constants as they come: the float becomes an array there, and has no derivative."""

    class Plain(Good):
        def prepare(self, inputs):
            return Schedule(
                {"drift": inputs["drift"], "cut": inputs["cut"]}, {"price": inputs["price"]}
            )

        def step(self, constants, now, state, action, noise, smooth):
            after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
            return after, {"cash": outputs["cash"] * constants["cut"]}

    given = {"drift": Input(0.3), "price": Input([1.0, 1.2, 0.9, 1.1]), "cut": 0.8}
    assert not len(findings := check(Plain(), given)), str(findings)


class NoOutputs(Good):
    def step(self, constants, now, state, action, noise, smooth):
        return Good.step(self, constants, now, state, action, noise, smooth)[0], {}

    def terminal(self, constants, state, smooth):
        return {}


class NoTotals(Good):
    def totals(self):
        raise RuntimeError("which ones?")


class Table(Good):
    """A NumPy table of the class, used inside step: one simulator, two precisions."""

    noise_size: int = 2

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after, {"cash": outputs["cash"] + jnp.sum(TABLE * noise)}


TABLE = np.array([0.3, 0.7])


def test_nothing_that_a_simulator_does_raises():
    assert "no outputs" in only(check(NoOutputs(), inputs())).subject
    assert "which ones?" in only(check(NoTotals(), inputs())).subject
    assert "scenarios" in only(check(Good(), inputs(), scenarios=Pseudo(0))).where
    assert not check(Good(), None).ok


class Converted(Table):
    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after, {"cash": outputs["cash"] + jnp.dot(jnp.asarray(SECOND), noise)}


SECOND = np.array([0.2, 0.8])


class Fresh(Table):
    """A table that is made anew in every trace is as right as one in the schedule."""

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after, {"cash": outputs["cash"] + jnp.asarray([0.2, 0.8]) @ noise}


@pytest.mark.prove
def test_a_numpy_table_in_step_fails_in_one_precision():
    for simulator in (Table(), Converted()):
        error = only(check(simulator, inputs()))
        assert error.where.startswith("step, ") and "float" in error.subject
        assert "schedule" in error.fix
    assert not len(findings := check(Fresh(), inputs())), str(findings)


# --- indices past the end, which JAX moves to the last entry --------------------------------------


class Indices(Good):
    """Reads `wrong` of its methods' arrays, which are past their ends, or nothing."""

    wrong: str = eqx.field(static=True, default="")

    def observe(self, constants, now, state):
        both = jnp.stack([state["stock"], now["price"]])
        return both[jnp.array([0, 2])] if self.wrong == "gather" else both[jnp.array([1, -2])]

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        more = {
            "noise": lambda: noise[1],
            "action": lambda: action[1],
            "negative": lambda: noise[-2],
            "branch": lambda: jax.lax.cond(noise[0] > 0, lambda: action[3], lambda: action[0]),
            "write": lambda: jnp.zeros(2).at[2].set(noise[0]).sum(),
            "": lambda: noise[0] + noise[-1] + jnp.zeros(2).at[1].add(action[0]).sum(),
        }
        return after, {"cash": outputs["cash"] + more.get(self.wrong, more[""])()}


@pytest.mark.parametrize(
    "wrong, where, length",
    [
        ("noise", "step, ", "noise[1]"),
        ("action", "step, ", "action[1]"),
        ("negative", "step, ", "noise[-2]"),
        ("branch", "step, ", "[3]"),
        ("write", "step, ", "[2]"),
        ("gather", "observe, ", "[2]"),
    ],
)
def test_indices_past_the_end_are_found(wrong, where, length):
    errors = [f for f in check(Indices(wrong=wrong), inputs()).errors if "entries" in f.subject]
    assert len(errors) == 1, str(errors)
    assert errors[0].where.startswith(where) and errors[0].where.endswith(length)
    assert "test_check.py" in errors[0].subject


@pytest.mark.prove
def test_indices_within_an_array_are_no_mistake():
    assert not len(findings := check(Indices(), inputs())), str(findings)


# --- no false alarms: one policy does not get everywhere ------------------------------------------


class Corner(Good):
    """A second action and an input that matter near the end of the action's range only."""

    action: Box = Box(0.0, 1.0, 2)

    def prepare(self, inputs):
        return Schedule({"drift": inputs.drift, "fee": inputs.fee}, {"price": inputs.price})

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        fee = constants["fee"] * jnp.maximum(action[1] - 0.97, 0.0)
        kink = 0.1 * jnp.abs(constants["drift"] - 0.304)
        return after, {"cash": outputs["cash"] - fee - kink}


class CornerInputs(eqx.Module):
    drift: Input
    price: Input
    fee: Input


@pytest.mark.prove
def test_what_matters_at_high_actions_only_is_no_mistake():
    given = CornerInputs(Input(0.3), Input([1.0, 1.2, 0.9, 1.1]), Input(2.0))
    assert not len(findings := check(Corner(), given)), str(findings)


@pytest.mark.prove
def test_a_corner_within_the_bump_is_no_mistake():
    """A step of 0.05 crosses the corner at 0.304, and so does an eighth of it."""
    given = CornerInputs(Input(0.3, bump=0.05), Input([1.0, 1.2, 0.9, 1.1]), Input(2.0))
    assert not len(findings := check(Corner(), given)), str(findings)
