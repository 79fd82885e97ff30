"""No unit takes in more than its feed holds: doses, continuous feeds, and balances that say so."""

import tomllib
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import attribute as attribute_text
from tests.domains.pharma.pharma_cases import connections as lines
from tests.domains.pharma.pharma_cases import feed as feed_text
from tests.domains.pharma.pharma_cases import parameter as parameter_text
from tests.domains.pharma.process_cases import (
    Connection,
    attribute,
    batch_reactor,
    case,
    chain,
    constant,
    crystalliser,
    feed,
    linear,
    number,
    series,
)
from tests.domains.pharma.units.test_reactor import first_order_network

from snapo.case.error import CaseError
from snapo.domains.pharma.chapters.verification import balances, unit_balances
from snapo.domains.pharma.control.closed_loop import stages_of
from snapo.domains.pharma.flowsheet.inputs import pharma_inputs
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.flowsheet.stream import NO_CRYSTALS, blank, clear, ledger, unflat
from snapo.domains.pharma.read.case import resolve
from snapo.problem.smooth import Exact

DOSED = (
    """kind = "pharma"
[species]
A = { molar_mass = "100 g/mol" }
B = { molar_mass = "50 g/mol" }
C = { molar_mass = "150 g/mol" }
[[reactions]]
name = "r"
equation = "A + B -> C"
prefactor = "1e-3 L/mol/s"
activation = "0 J/mol"
[units.reactor]
type = "reactor"
kind = "semi-batch"
duration = "1 h"
temperature = "313.15 K"
dosing = "0.5 L/h"
"""
    + feed_text("charge", "1 L", 'A = "1 mol/L"')
    + feed_text("drops", "0.5 L", 'B = "1 mol/L"')
    + lines(("charge", "reactor.feed"), ("drops", "reactor.dose"))
    + parameter_text("V", "charge.volume", ["0.5 L", "4 L"], ["0.8 L", "4 L"])
    + attribute_text("C", "reactor.concentration.C", "mol/L", 'low = "0.1 mol/L"')
)
STIRRED = (
    DOSED[: DOSED.index("[units")]
    + """[units.reactor]
type = "reactor"
kind = "stirred"
volume = "1 L"
duration = "2 h"
temperature = "313.15 K"
"""
    + feed_text("charge", "4 L", 'A = "1 mol/L"', 'duration = "2 h"')
    + lines(("charge", "reactor.feed"))
    + parameter_text("V", "reactor.volume", ["0.5 L", "2 L"], ["0.8 L", "1.2 L"])
    + attribute_text("A", "reactor.concentration.A", "mol/L", 'low = "0.1 mol/L"')
)


def read(text, *changes):
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return resolve(Path("case.toml"), tomllib.loads(text))


def semi_batch(dosing):
    charge, drops = feed((1.0, 0.0), volume=0.06), feed((0.5, 0.0), volume=0.02, name="drops")
    unit = batch_reactor(2000.0, kind="semi-batch", dosing=dosing)
    found = (attribute("A", "reactor.concentration.A"),)
    ports = (*chain("charge", "reactor"), Connection("drops", "", "reactor", "dose"))
    return PharmaProcess(
        case((charge, drops), (unit,), ports, found, network=first_order_network())
    )


def by_hand(seconds, flow):
    """Amount of A left of A -> B at 1e-3 per s: 0.06 kmol at once, 0.5 `flow`(t) kmol/s over time."""
    time = np.linspace(0, seconds, 200_001)
    fed = 0.5 * flow(time / seconds) * np.exp(-1e-3 * (seconds - time))
    return 0.06 * np.exp(-1e-3 * seconds) + np.trapezoid(fed, time)


@pytest.mark.parametrize("seconds", [1000.0, 2000.0, 5000.0])
def test_a_dose_is_what_its_feed_holds_however_long_it_lasts(seconds):
    process = semi_batch(linear("reactor.dosing", [0.0, 2e-5], "m3/s"))
    found = process.values({"reactor.duration": np.array([seconds])})[0]
    expected = by_hand(seconds, lambda share: share * 2 * 0.02 / seconds) / 0.08
    assert found == pytest.approx(expected, rel=1e-8)
    rows = balances(process, {"reactor.duration": np.array([seconds])})
    assert max(abs(row.relative) for row in rows) < 1e-10


def test_a_dose_is_what_its_feed_holds_whatever_its_flow():
    """The flow is a shape, so that a recipe may decide it; and an empty feed doses nothing."""
    process = semi_batch(linear("reactor.dosing", [0.0, 2e-5], "m3/s"))
    doubled = process.values({"reactor.dosing": np.array([0.0, 4e-5])})
    np.testing.assert_allclose(doubled, process.values(), rtol=1e-12)
    more = process.run({"drops.volume": np.array([0.04])}).streams["reactor.product"]
    assert more.volume == pytest.approx(0.1, rel=1e-12)
    none = process.run({"reactor.dosing": np.zeros(2)})
    assert none.status == "ok"
    assert none.streams["reactor.product"].volume == pytest.approx(0.06, rel=1e-12)


def test_an_antisolvent_is_what_its_feed_holds():
    name = "crystalliser"
    unit = crystalliser(
        temperature=constant(f"{name}.temperature", 300.0),
        dosing=constant(f"{name}.dosing", 1e-6, "m3/s"),
    )
    lower = replace(unit.solubility, antisolvent=series(f"{name}.antisolvent", [-3.0, 0.5]))
    unit = replace(unit, solubility=lower)
    feeds = feed((0.0, 0.1, 0.085, 0.1)), feed((0.0,) * 4, volume=0.0072, name="water")
    ports = (*chain("charge", name), Connection("water", "", name, "antisolvent"))
    process = PharmaProcess(case(feeds, (unit,), ports, [attribute("c", f"{name}.concentration")]))
    run = process.run({f"{name}.duration": np.array([14400.0])})
    assert run.streams[f"{name}.slurry"].antisolvent == pytest.approx(0.0072 * 887.6, rel=1e-9)


@pytest.mark.prove
@pytest.mark.parametrize("kind", ["stirred", "plug-flow"])
def test_a_continuous_reactor_ends_with_its_feed(kind):
    """4 L over 2 h: of 3 h the last brings nothing, and 2 h and 3 h give the same."""
    unit = batch_reactor(7200.0, kind=kind, volume=number("reactor.volume", 1e-3, "m3"), cells=5)
    charge, found = feed((1.0, 0.0), volume=4e-3, duration=7200.0), []
    ports, wanted = chain("charge", "reactor"), (attribute("A", "reactor.concentration.A"),)
    network = first_order_network()
    process = PharmaProcess(case((charge,), (unit,), ports, wanted, network=network))
    for seconds in (7200.0, 10800.0):
        run = process.run({"reactor.duration": np.array([seconds])})
        assert run.status == "ok"
        rows = balances(process, {"reactor.duration": np.array([seconds])})
        assert max(abs(row.relative) for row in rows) < 1e-10
        found.append(run.streams["reactor.product"])
    assert found[0].species.sum() == pytest.approx(4e-3, rel=1e-9)
    np.testing.assert_allclose(found[1].species, found[0].species, rtol=1e-12)
    with jax.enable_x64(True):  # at the end itself the slope is that of a shorter run
        slope = jax.jit(jax.grad(
            lambda t: process.attributes({**process.nominal_inputs(), "reactor.duration": t})[0]
        ))  # fmt: skip
        assert np.isfinite(slope(jnp.array([7200.0]))).all()


REFUSED = {
    "longer than its feed": (
        STIRRED, ('duration = "2 h"', 'duration = "3 h"'),
        "units.reactor.duration: got '10800 s'; reactor runs 10800 s, but its inlet feed flows for "
        "7200 s; use at most 7200 s, or a feed that lasts longer."),
    "studied longer than its feed": (
        STIRRED + parameter_text("t", "reactor.duration", ["1 h", "3 h"], ["1.5 h", "2.5 h"]), (),
        "parameters.t: got '10800 s'; reactor may run 10800 s, but its inlet feed flows for 7200 s"),
    "a flow that is a shape": (
        DOSED + parameter_text("q", "reactor.dosing", ["0.4 L/h", "0.6 L/h"],
                               ["0.45 L/h", "0.55 L/h"]), (),
        "parameters.q: got 'reactor.dosing'; a constant flow follows from the volume of its feed and the duration of reactor; vary one of these instead"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", REFUSED)
def test_what_takes_more_than_its_feed_is_refused(mistake):
    text, change, said = REFUSED[mistake]
    with pytest.raises(CaseError) as error:
        read(text, *([change] if change else []))
    assert said in str(error.value)


def test_a_flow_through_two_reactors_ends_with_the_shorter():
    second = '[units.next]\ntype = "reactor"\nkind = "stirred"\nvolume = "1 L"\nduration = "2 h"\n'
    second += 'temperature = "313.15 K"\n' + lines(("reactor.product", "next.feed"))
    read(STIRRED + second)
    with pytest.raises(CaseError, match="next runs 7200 s, but its inlet feed flows for 3600 s"):
        read(STIRRED + second, ('duration = "2 h"', 'duration = "1 h"'))


def test_a_balance_stays_open_where_more_is_taken_in_than_there_is():
    """One kmol comes, two leave, and less than nothing waits: no accumulation closes that."""
    process = semi_batch(constant("reactor.dosing", 1e-5, "m3/s"))

    def gap(out, left):
        streams = (clear(np.array([kmol, 0.0]), *np.zeros(3)) for kmol in (1.0, out))
        into, out = ([each] for each in streams)
        book = ledger(2, left=np.array([left, 0.0]))
        return {
            row.quantity: row.relative for row in unit_balances(process, "r", into, out, [book])
        }

    assert gap(2.0, -1.0)["A"] == pytest.approx(-0.5)
    assert max(map(abs, gap(0.5, 0.5).values())) < 1e-12


CONTROL = """[control]
steps = { reactor = 4 }
substeps = 8
[[control.manipulated]]
of = "reactor.dosing"
low = "0 L/h"
high = "0.8 L/h"
[[control.measurements]]
state = "reactor.concentration.A"
error = "0.01 mol/L"
centre = "0.5 mol/L"
width = "0.5 mol/L"
"""


@pytest.mark.prove
@pytest.mark.parametrize(("share", "dosed"), [(1.0, 0.5e-3), (0.25, 0.2e-3)])
def test_a_policy_doses_until_its_feed_is_empty(share, dosed):
    """0.8 L/h for an hour of a feed of 0.5 L; at a quarter of that all that is asked for."""
    found = read(DOSED + CONTROL)
    with jax.enable_x64(True):
        (stage,) = stages_of(found)
        schedule = stage.prepare({name: each.value for name, each in pharma_inputs(found).items()})

        def dose(schedule):
            state = stage.initial(schedule.constants, jnp.zeros(stage.initial_noise_size))
            for row in range(4):
                now = {name: each[row] for name, each in schedule.steps.items()}
                noise, action = jnp.zeros(stage.noise_size), jnp.array([share])
                state, _ = stage.step(schedule.constants, now, state, action, noise, Exact())
            return stage.leave(schedule.constants, state)["streams"]["reactor.product"]

        left = jax.jit(dose)(schedule)
        product = unflat(left, blank(3, NO_CRYSTALS))
    assert product.volume == pytest.approx(1e-3 + dosed, rel=1e-12)
    assert np.sum(np.asarray(product.species)[1:]) == pytest.approx(dosed, rel=1e-9)
