"""Versions of a user's code: new where it reads other things, the same where it does not."""

from dataclasses import dataclass
from types import ModuleType, SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.problem.code.version import of, reading_once
from snapo.problem.code.walk import Walk
from snapo.problem.process import Schwartz
from snapo.problem.simulator import Schedule

TRACED: list[str] = []  # a list that code only adds to is not read
COUNTS = {"steps": 0}
KEPT: dict[str, float] = {}
NUMBERS = {"a": 1.0}
SETTINGS = 1.0
USED = 0
FILE = ""
MODULE_OR_OBJECT = SimpleNamespace(factor=1.0)


class Own(snapo.Simulator):
    """A simulator of which tests write `step`."""

    horizon: int = 2
    action: snapo.Box = snapo.Box(-np.inf, np.inf)
    noise_size: int = 0

    def prepare(self, inputs):
        return Schedule({"x": inputs["x"]}, {})

    def initial(self, constants, noise):
        return jnp.ones(1)

    def observe(self, constants, now, state):
        return state

    def step(self, constants, now, state, action, noise, smooth):
        return state, {"cash": self.cash(state[0], smooth)}

    def cash(self, x, smooth):
        return x


def problem(kind: type[Own]) -> snapo.Problem:
    return snapo.Problem(kind(), {"x": snapo.Input(1.0)}, snapo.Mean("cash"))


class Counts(Own):
    """What a trace itself changes, and no number of it comes from there."""

    def cash(self, x, smooth):
        global USED
        USED += 1
        COUNTS["steps"] += 1
        TRACED.append("step")
        return KEPT.setdefault("two", 2.0) * x


class Looks(Own):
    def cash(self, x, smooth):
        return NUMBERS["a"] * x


class OnlySmooth(Own):
    def cash(self, x, smooth):
        return x if isinstance(smooth, snapo.Exact) else NUMBERS["a"] * x


class ByName(Own):
    """No name of the global is in the code."""

    def cash(self, x, smooth):
        return globals()["SET" + "TINGS"] * x


class Files(Own):
    def prepare(self, inputs):
        return Schedule({"x": jnp.asarray(np.loadtxt(FILE)) * inputs["x"]}, {})


class MadeName(Own):
    """A member of what its code names, by a name that it makes."""

    def cash(self, x, smooth):
        TRACED.append("step")
        return getattr(MODULE_OR_OBJECT, "fac" + "tor") * x


def test_counters_and_what_a_trace_keeps_make_no_new_version():
    given = problem(Counts)
    first = given.version
    assert first is not None
    assert [given.version, problem(Counts).version] == [first, first]


def test_a_list_that_is_only_added_to_is_not_read():
    class Adds(Own):
        def cash(self, x, smooth):
            TRACED.append("cash")
            return x

    given = problem(Adds)
    first, before = given.version, len(TRACED)
    TRACED.append("another")
    assert given.version == first
    assert len(TRACED) == before + 1  # it was not even traced


@pytest.mark.parametrize("kind", [Looks, OnlySmooth])
def test_what_changes_in_place_makes_one_until_it_is_back(kind, monkeypatch):
    given = problem(kind)
    first = given.version
    monkeypatch.setitem(NUMBERS, "b", 3.0)  # read by nobody
    assert given.version == first
    monkeypatch.setitem(NUMBERS, "a", 2.0)
    assert given.version not in (None, first)
    monkeypatch.undo()
    assert given.version == first


def test_what_no_name_shows_is_traced(monkeypatch):
    given = problem(ByName)
    first = given.version
    assert given.version == first
    monkeypatch.setitem(globals(), "SETTINGS", 2.0)
    assert given.version not in (None, first)


def test_attributes_of_an_object_are_read_without_tracing(monkeypatch):
    monkeypatch.setitem(globals(), "MODULE_OR_OBJECT", SimpleNamespace(factor=1.0))
    given = problem(MadeName)
    first, before = given.version, len(TRACED)
    assert given.version == first
    assert len(TRACED) == before
    MODULE_OR_OBJECT.factor = 2.0
    assert given.version not in (None, first)


def test_attributes_of_a_users_module_by_a_name_that_is_made_are_followed(monkeypatch):
    module = ModuleType("of_a_user")
    monkeypatch.setattr(module, "factor", 1.0, raising=False)
    monkeypatch.setitem(globals(), "MODULE_OR_OBJECT", module)
    given = problem(MadeName)
    first = given.version
    monkeypatch.setattr(module, "factor", 2.0)
    assert given.version not in (None, first)


def test_two_readings_of_the_same_code_print_alike():
    """Seen to fail: what is equal to itself alone had the address of its wrapper in its print,
    which is compared where a program has a derivative by hand: compiled anew at every call."""

    class Custom(Own):
        def cash(self, x, smooth):
            return jax.nn.relu(x)

    first, second = Walk((Custom(),)), Walk((Custom(),))
    assert repr(first.fixed) == repr(second.fixed)


def test_within_one_reading_code_is_read_once(monkeypatch):
    given = problem(Looks)
    with reading_once():
        first = given.version
        monkeypatch.setitem(NUMBERS, "a", 2.0)
        assert given.version == first
    assert given.version != first


def test_a_schedule_follows_the_file_that_it_is_read_from(tmp_path, monkeypatch):
    file = tmp_path / "number.txt"
    monkeypatch.setitem(globals(), "FILE", str(file))
    file.write_text("1.5")
    given = problem(Files)
    assert given.schedule.constants["x"] == 1.5
    kept = given.schedule
    assert given.schedule is kept
    file.write_text("2.5")
    assert given.schedule.constants["x"] == 2.5


def test_an_objective_follows_what_its_formula_reads(monkeypatch):
    @dataclass(frozen=True)
    class Scaled(snapo.Objective):
        outputs = ("cash",)  # pyright: ignore[reportAssignmentType]

        def formula(self, totals):
            return SETTINGS * jnp.mean(totals["cash"])

    own, totals = Scaled(), {"cash": np.array([1.0, 3.0])}
    both = own + snapo.Mean("cash")
    assert (own.value(totals), both.value(totals)) == (2.0, 4.0)
    monkeypatch.setitem(globals(), "SETTINGS", 2.0)
    assert (own.value(totals), both.value(totals)) == (4.0, 6.0)
    np.testing.assert_allclose(own.weights(totals)["cash"], [1.0, 1.0])


def test_a_table_of_decisions_follows_what_the_policy_reads(monkeypatch):
    class Ruled(snapo.Policy):
        def __call__(self, observation, smooth):
            return SETTINGS * observation[:1]

    def decided():
        return snapo.decision_table(Ruled(), x=(0, [1.0]), y=(1, [0.0]), at=[0, 0]).action.item()

    assert decided() == 1.0
    monkeypatch.setitem(globals(), "SETTINGS", 2.0)
    assert decided() == 2.0


def test_the_code_of_snapo_has_no_version():
    """Its programs are those of before."""
    policy = snapo.MLP(snapo.Box(-np.inf, np.inf), 2, key=jax.random.key(0))
    price = Schwartz((0.0, 1.0))  # pyright: ignore[reportCallIssue]
    assert of((policy, price, snapo.Exact()), lambda: 1 / 0) is None
    own = snapo.MLP(
        snapo.Box(-np.inf, np.inf), 2, key=jax.random.key(0), activation=lambda x: SETTINGS * x
    )
    assert of((own, price, snapo.Exact()), lambda: 1 / 0) is not None
