"""Many batches by the native engine are those by XLA, wherever the event falls."""

import tomllib
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.compilations import compilations
from tests.domains.pharma.pharma_cases import CASE, LOOP, TEMPLATE, small, template

from snapo.domains.pharma.flowsheet import march
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.quality.draws import all_draws, all_entries
from snapo.domains.pharma.read.case import read_case, resolve
from snapo.engine import Unsupported

PLUG_FLOW = Path(__file__).parents[4] / "examples" / "plug_flow" / "case.toml"
CRYSTALS = {
    "method": "finite-volumes",
    "sizes": {"smallest": "0 um", "largest": "300 um", "cells": 40, "spacing": "equal"},
    "seed": {"loading": "0.02 kg/m^3", "size": "20 um", "spread": 0.3},
}


def on_mesh(case, steps=40) -> PharmaProcess:
    return PharmaProcess(replace(case, numerics=replace(case.numerics, method="mesh", steps=steps)))


@pytest.fixture(scope="module")
def process():
    return on_mesh(template())


def compared(process, entries, draws, by, tolerance=1e-10):
    """Both engines' batches, the derivatives as shares of the largest of each attribute."""
    native = process.batch(entries, draws, by, chunk=4, engine="native")
    xla = process.batch(entries, draws, by, chunk=4, engine="xla")
    np.testing.assert_array_equal(native.ok, xla.ok)
    np.testing.assert_allclose(native.values, xla.values, rtol=1e-11)
    if by:
        largest = np.maximum(np.abs(xla.jacobian).max((0, 2)), 1e-300)[None, :, None]
        np.testing.assert_allclose(
            native.jacobian / largest, xla.jacobian / largest, atol=tolerance
        )
    return native


@pytest.mark.prove
def test_uncertain_batches_with_every_sensitivity_wherever_the_event_falls(process):
    """Also with nodes moved so far that saturation is reached in any piece, at once, or never."""
    entries = all_entries(process.case)
    draws = all_draws(process.case, 14, 1, process.inputs)
    nodes = [entries.index(("crystalliser.temperature", k)) for k in (1, 2, 3)]
    moves = np.random.default_rng(0).normal(size=(6, 3)) * np.array([15.0, 15.0, 5.0])
    found = compared(process, entries, draws[:6], process.entries)
    draws[6:, nodes] += np.concatenate([moves, [[-30.0] * 3], [[60.0] * 3]])
    # Where supersaturation falls back through zero, growth's slope S^0.32 magnifies round-off.
    compared(process, entries, draws[6:], process.entries, tolerance=1e-5)
    assert found.ok.all()
    # Neither washing nor drying acts on the crystals.
    names, columns = process.names, process.parameters
    assert not found.jacobian[:, names.index("mean size d43"), columns.index("W")].any()
    assert not found.jacobian[:, names.index("mean size d43"), columns.index("T_d")].any()


@pytest.mark.prove
def test_no_sensitivities_and_sensitivities_by_what_only_later_units_read(process):
    entries = all_entries(process.case)
    draws = all_draws(process.case, 5, 2, process.inputs)
    assert compared(process, entries, draws, ()).jacobian is None
    found = compared(process, entries, draws, (("dryer.temperature", 0),))
    assert not process._natives[entries, (("dryer.temperature", 0),)].legs["reactor"].columns.size
    assert found.jacobian[:, process.names.index("residual solvent")].all()


@pytest.mark.parametrize(
    "which",
    [
        pytest.param("plug flow", marks=pytest.mark.prove),
        pytest.param("finite volumes", marks=pytest.mark.study),
    ],
)
def test_units_of_many_states(which):
    case = read_case(PLUG_FLOW) if which == "plug flow" else finite_volumes()
    # The native engine has no stiff steps for so many unknowns.
    process = on_mesh(replace(case, numerics=replace(case.numerics, stiff="none")))
    entries = process.entries
    draws = process.at(entries) * (1 + 1e-3 * np.random.default_rng(0).normal(size=(5, 1)))
    compared(process, entries, draws, entries)


def finite_volumes():
    known = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))["units"]
    return template(units={"crystalliser": {**known["crystalliser"], **CRYSTALS}})


@pytest.mark.prove
def test_what_the_native_engine_cannot_run_xla_runs(monkeypatch):
    process = on_mesh(resolve(TEMPLATE, tomllib.loads(small(CASE + LOOP))), steps=8)
    entries = process.entries[:1]
    draws = process.at(entries)[None]
    expected = process.batch(entries, draws, engine="xla")

    def refuse(*_, **__):
        raise Unsupported("no")

    monkeypatch.setattr(march.Native, "values", refuse)
    with pytest.raises(Unsupported):
        process.batch(entries, draws, engine="native")
    np.testing.assert_array_equal(process.batch(entries, draws).values, expected.values)


def test_steps_chosen_freely_are_for_xla():
    case = template()
    process = PharmaProcess(replace(case, numerics=replace(case.numerics, method="adaptive")))
    with pytest.raises(Unsupported, match="fixed mesh"):
        process.batch((), np.zeros((1, 0)), engine="native")


@pytest.mark.prove
@pytest.mark.parametrize("stiff", ["none", pytest.param("all", marks=pytest.mark.prove)])
def test_a_unit_of_another_process_of_its_form_takes_the_same_kernel(stiff):
    def process(volume: str) -> PharmaProcess:
        data = tomllib.loads(small(CASE + LOOP))
        data["feeds"]["charge"]["volume"] = volume
        case = resolve(TEMPLATE, data)
        numerics = replace(case.numerics, method="mesh", steps=8, stiff=stiff)
        return PharmaProcess(replace(case, numerics=numerics))

    def batch(process: PharmaProcess, engine="native") -> np.ndarray:
        draws = process.at(process.entries) + np.array([[0.0, 0.0], [1.0, -60.0]])
        return process.batch(process.entries, draws, process.entries, engine=engine).values

    first, other = process("60 L"), process("65 L")
    batch(first)
    with compilations() as compiled:
        moved = batch(other)
    assert "/snapo/compile" not in compiled
    marches = [next(iter(x._natives.values())).legs["reactor"].march for x in (first, other)]
    assert marches[0] == marches[1]
    np.testing.assert_allclose(moved, batch(other, "xla"), rtol=1e-11)


def test_marks_spread_to_what_depends_on_them():
    def function(a, b, c):
        d = jax.jit(lambda x: x * 2.0)(a)
        return d + b, jnp.sin(c), jnp.ones(()), d

    jaxpr = jax.make_jaxpr(function)(1.0, 2.0, 3.0).jaxpr
    found = march.spread(jaxpr, list(np.eye(3, dtype=bool)))
    expected = [[1, 1, 0], [0, 0, 1], [0, 0, 0], [1, 0, 0]]
    np.testing.assert_array_equal(found, np.array(expected, bool))
