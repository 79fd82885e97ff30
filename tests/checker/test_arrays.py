"""Tables, slices and indices: the mistakes that JAX passes over without a word, and no others."""

from contextlib import suppress

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from snapo.checker.check import check
from snapo.checker.findings import Notes, StopCheck
from snapo.checker.indices import moving_indices, outside, short_slices, tables
from snapo.checker.methods import Method
from snapo.checker.watch import SamplePoints
from snapo.problem.problem import prepare
from snapo.problem.simulator import Schedule

from .test_check import Good, inputs


class Tabled(Good):
    """Uses a table of its class in one method."""

    noise_size: int = 2
    method: str = eqx.field(static=True, default="step")
    how: str = eqx.field(static=True, default="product")
    table: np.ndarray = eqx.field(default_factory=lambda: np.array([0.3, 0.7]))

    def read(self, method, noise):
        if method != self.method:
            return 0.0
        ways = {
            "product": lambda: jnp.sum(self.table * noise),
            "dot": lambda: jnp.dot(jnp.asarray(self.table), noise),
            "entry": lambda: jnp.asarray(self.table)[jnp.int32(noise[0] > 0)],
            "interp": lambda: jnp.interp(noise[0], self.table, self.table),
            "where": lambda: jnp.sum(jnp.where(noise > 0, self.table, 0.0)),
            "whole": lambda: jnp.asarray(np.array([1, 2]))[jnp.int32(noise[0] > 0)] * noise[0],
            "number": lambda: self.table[0] * noise[0],
            "listed": lambda: jnp.dot(jnp.asarray(self.table.tolist()), noise),
        }
        return ways[self.how]()

    def initial(self, constants, noise):
        both = jnp.stack([constants["drift"], constants["drift"]])
        return {"stock": 1.0 + self.read("initial", both), "count": jnp.int32(0)}

    def observe(self, constants, now, state):
        both = jnp.stack([state["stock"], now["price"]])
        return both + self.read("observe", both)

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        return after, {"cash": outputs["cash"] + self.read("step", noise)}

    def terminal(self, constants, state, smooth):
        both = jnp.stack([state["stock"], state["stock"]])
        return {"cash": state["stock"] * self.read("terminal", both)}


def tabled(simulator) -> Notes:
    notes = Notes(simulator)
    with suppress(StopCheck):
        tables(notes, simulator, prepare(simulator, inputs()))
    return notes


@pytest.mark.parametrize("how", ["product", "dot", "entry", "interp", "where"])
@pytest.mark.parametrize("method", ["initial", "observe", "step", "terminal"])
def test_a_numpy_table_is_named_with_its_method_and_line(method, how):
    items = tabled(Tabled(method=method, how=how)).items
    assert len(items) == 1 and items[0].severity == "error"
    assert items[0].where.startswith(f"{method}, ") and "test_arrays.py:" in items[0].where
    assert "A table of shape (2,) is float" in items[0].subject
    assert f'"{how}": lambda' in items[0].subject and "self.table" in items[0].subject
    assert "put it into the schedule" in items[0].fix


@pytest.mark.parametrize("how", ["whole", "number", "listed"])
@pytest.mark.parametrize("method", ["initial", "observe", "step", "terminal"])
def test_whole_numbers_single_ones_and_fresh_tables_are_fine(method, how):
    assert not tabled(Tabled(method=method, how=how)).items


# --- slices ---------------------------------------------------------------------------------------


class Sliced(Good):
    noise_size: int = 2
    wrong: bool = eqx.field(static=True, default=True)

    def prepare(self, inputs):
        price = inputs.price[2:9] if self.wrong else inputs.price[:4]
        return Schedule({"drift": inputs.drift, "last": price}, {"price": inputs.price})

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        if self.wrong:
            shock = noise[1:4].sum()
            shock += action[0:3].sum()
            shock += noise[-3:].sum()
        else:
            shock = noise[1:].sum() + noise[0:2].sum() + noise[-2:].sum() + noise[::-1].sum()
            shock += noise[None, ..., :2].sum() + noise[2:].sum() + noise[noise.shape[0] :].sum()
            shock += noise[1::-1].sum()
        return after, {"cash": outputs["cash"] + shock}


def sliced(simulator) -> Notes:
    notes = Notes(simulator)
    short_slices(notes, simulator, inputs(), prepare(simulator, inputs()))
    return notes


def test_slices_past_the_end_are_warnings_with_slice_length_and_line():
    items = sliced(Sliced()).items
    said = [item.subject for item in items]
    assert len(items) == 4 and {item.severity for item in items} == {"warning"}
    assert items[0].where.startswith("prepare, ") and "[2:9] is taken from an array of 4" in said[0]
    assert all(item.where.startswith("step, ") for item in items[1:])
    assert "[1:4] is taken from an array of 2 entries" in said[1] and "noise[1:4].sum()" in said[1]
    assert (
        "[0:3] is taken from an array of 1 " in said[2]
        and "[-3:] is taken from an array of 2 entries" in said[3]
    )


def test_slices_within_are_no_mistake_and_jax_is_left_as_it_was():
    before = jax.core.Tracer.__getitem__
    assert not sliced(Sliced(wrong=False)).items
    assert jax.core.Tracer.__getitem__ is before


@settings(max_examples=200, deadline=None)
@given(st.integers(-6, 6), st.integers(-6, 6), st.integers(0, 5))
def test_a_slice_that_reaches_past_an_end_is_shorter_than_in_a_longer_array(start, stop, length):
    """A slice with both ends of one sign is short exactly where more entries would make it longer."""
    if (start < 0) != (stop < 0) or start >= stop:
        return
    here = len(np.zeros(length)[start:stop])
    assert (here < stop - start) <= outside(slice(start, stop), length)
    if not outside(slice(start, stop), length):
        assert here == stop - start


# --- indices that move ----------------------------------------------------------------------------


class Moving(Good):
    """Reads a curve of four entries at indices that move; `how` says where and how, an output
    for each."""

    how: tuple[str, ...] = eqx.field(static=True, default=())

    def prepare(self, inputs):
        constants = {"drift": inputs.drift, "curve": inputs.price}
        if "prepare" in self.how:
            constants["drift"] += 1e-3 * jnp.asarray([1.0, 2.0])[jnp.int32(3 * inputs.price[0])]
        if "known" in self.how:
            constants["drift"] += 1e-3 * inputs.price[4]
        return Schedule(constants, {"price": inputs.price, "i": jnp.arange(4)})

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = Good.step(self, constants, now, state, action, noise, smooth)
        curve, i, k = constants["curve"], now["i"], state["count"]
        ways = {
            "state": lambda: curve[k + 1],
            "now": lambda: curve[i + 1],
            "noise": lambda: curve[jnp.int32(jnp.abs(100 * noise[0]))],
            "negative": lambda: curve[-i - 2],
            "gather": lambda: curve[jnp.stack([i, i + 1])].sum(),
            "slice": lambda: jax.lax.dynamic_slice(curve, (i,), (2,)).sum(),
            "write": lambda: curve.at[i + 1].set(state["stock"]).sum(),
            "right": lambda: curve[i] + curve[-i - 1] + curve.at[k].set(1.0).sum(),
            "clipped": lambda: curve[jnp.clip(i + 1, 0, 3)] + curve[jnp.minimum(k + 1, 3)],
            "meant": lambda: curve.at[i + 1].get(mode="clip") + jnp.take(curve, i + 1, mode="clip"),
            "filled": lambda: curve.at[i + 1].get(mode="fill", fill_value=0.0),
            "masked": lambda: jnp.where(i < 3, curve[i + 1], 0.0) + (i < 3) * curve[i + 1],
        }
        return after, outputs | {name: way() for name, way in ways.items() if name in self.how}


@pytest.mark.prove
def test_indices_that_leave_their_array_on_a_path():
    """A read is an error and a write a warning, with method, line, index and remedy."""
    four = "the array has 4 entries"
    expected = {
        "state": f"an index is 4, but {four}",
        "now": f"an index is 4, but {four}",
        "noise": f"but {four}",
        "negative": f"an index is -5, but {four}",
        "gather": f"an index is 4, but {four}",
        "slice": "2 entries are taken from index 3 on, but the array has 4",
        "write": f"an index is 4, but {four}",
        "prepare": "With these inputs, an index is 3, but the array has 2 entries",
    }
    findings = check(Moving(how=tuple(expected)), inputs(), paths=8)
    wrong = [item for item in findings if "index" in item.subject]
    assert len(wrong) == len(expected), str(findings)
    # All else that is reported: the adjoint knows nothing of the price that is read instead.
    assert {item.where.split()[1] for item in findings if item not in wrong} <= {"price"}
    for how, said in expected.items():
        line = "inputs.price" if how == "prepare" else f'"{how}": lambda'
        (found,) = (item for item in wrong if line in item.subject)
        method = "prepare" if how == "prepare" else "step"
        assert found.where.startswith(f"{method}, ") and "test_arrays.py:" in found.where
        assert said in found.subject and "Correct the index" in found.fix
        assert ("jnp.clip" in found.fix) == (how != "write")
        assert found.severity == ("warning" if how == "write" else "error")
        assert ("drops" if how == "write" else "reads the nearest one") in found.subject


def test_known_indices_in_prepare_are_followed():
    errors = check(Moving(how=("known",)), inputs()).errors
    assert len(errors) == 1 and errors[0].where.startswith("prepare, ")
    assert errors[0].where.endswith("price[4]") and "4 entries" in errors[0].subject


@pytest.mark.prove
def test_a_write_past_the_end_is_the_only_finding_and_no_error():
    findings = check(Moving(how=("write",)), inputs(), paths=8)
    assert len(findings) == 1 and findings.ok
    assert "an index is 4" in findings.items[0].subject and "drops" in findings.items[0].subject


@pytest.mark.prove
def test_indices_that_are_meant_or_do_not_matter_are_no_mistake():
    how = ("right", "clipped", "meant", "filled", "masked")
    wrong = [f for f in check(Moving(how=how), inputs(), paths=8) if "index" in f.subject]
    assert not wrong, str(wrong)


@settings(max_examples=12, deadline=None)
@given(st.lists(st.integers(-7, 7), min_size=3, max_size=3))
def test_an_index_is_named_exactly_where_numpy_would_refuse_it(indices):
    method = Method(
        "step",
        lambda table, noise: ({}, {"cash": table[jnp.int32(noise[0])]}),
        {"table": np.arange(4.0), "noise": np.zeros(1)},
    )
    notes = Notes(None)
    with jax.enable_x64(True):
        at = jnp.asarray(np.array(indices, float)[:, None])
        moving_indices(notes, SamplePoints(method, {"noise": at}, 1))
    assert bool(notes.items) == any(not -4 <= k < 4 for k in indices)
