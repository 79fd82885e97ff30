"""Units of measure, and what a case file becomes."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.domains.pharma.pharma_cases import TEMPLATE, template

from snapo.domains.pharma.chapters.model import statement
from snapo.domains.pharma.flowsheet.inputs import pharma_inputs
from snapo.domains.pharma.read.case import read_case
from snapo.domains.pharma.read.quantities import UnitError, conversion, prefactor_unit, split


@pytest.mark.parametrize(
    ("unit", "target", "difference", "scale", "offset"),
    [
        ("K", "K", False, 1, 0),
        ("degC", "K", False, 1, 273.15),
        ("degC", "K", True, 1, 0),
        ("K/min", "K/s", True, 1 / 60, 0),
        ("degC/min", "K/s", True, 1 / 60, 0),
        ("mol/L", "kmol/m3", False, 1, 0),
        ("L/mol/s", "m3/kmol/s", False, 1, 0),
        ("g/mol", "kg/kmol", False, 1, 0),
        ("um/s", "m/s", False, 1e-6, 0),
        ("1/um3/min", "1/m3/s", False, 1e18 / 60, 0),
        ("% w/w", "1", False, 0.01, 0),
        ("ppm", "1", False, 1e-6, 0),
        ("cm2", "m2", False, 1e-4, 0),
        ("mPa*s", "Pa*s", False, 1e-3, 0),
    ],
)
def test_units_of_measure(unit, target, difference, scale, offset):
    found = conversion(unit, target, difference)
    assert found.scale == pytest.approx(scale, rel=1e-15)
    assert found.offset == pytest.approx(offset, rel=1e-15)


def test_a_text_is_taken_apart_and_never_evaluated():
    assert split("-4.5e3 L/mol/s") == (-4500.0, "L/mol/s")
    assert split("40%") == (40.0, "%")
    for text in ("3 + 4 K", "(1) K", "K", "", "1e5e5 K"):
        with pytest.raises(UnitError):
            unit = split(text)[1]
            conversion(unit, "K")
    with pytest.raises(UnitError, match="not the name of a unit"):
        conversion("m^99999999", "m")


def test_the_template_is_the_flagship_chain():
    case = read_case(TEMPLATE)
    assert [unit.name for unit in case.units] == [
        "reactor", "crystalliser", "filter", "dryer", "tablet",
    ]  # fmt: skip
    values = {name: entry.value.tolist() for name, entry in pharma_inputs(case).items()}
    assert values["crystalliser.temperature"] == [313.15, 308.0, 295.0, 278.15]
    assert values["kinetics.prefactor"] == [2.654e4, 530.0]
    assert values["charge.volume"] == [0.06]
    assert values["crystalliser.kinetics.growth"] == pytest.approx([5e-6], rel=1e-15)
    assert case.numerics.method == "mesh" and case.notes == ()
    assert statement(case).reactions[0].equation == "A + B → C"


def test_a_steep_profile_is_remarked():
    steep = {"nodes": ["313.15 K", "278.15 K"], "at": [0, 1], "ramp": "0.1 K/min"}
    units = {**_units(), "crystalliser": {**_units()["crystalliser"], "temperature": steep}}
    case = template(units=units, parameters=_parameters("filter.wash_ratio"), design_space=None)
    assert "by up to 0.292 K/min, but its ramp allows only 0.1 K/min" in case.notes[0]


def test_what_moves_before_the_event_is_integrated_adaptively():
    crystalliser = _units()["crystalliser"]
    kinetics = {**crystalliser["kinetics"], "dissolution": "1 um/s"}
    case = template(units={**_units(), "crystalliser": {**crystalliser, "kinetics": kinetics}})
    assert case.numerics.method == "adaptive"


def _units():
    import tomllib

    return tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))["units"]


def _parameters(of):
    return [{"name": "W", "of": of, "range": [1, 4], "normal": [1.5, 2.5], "source": "made up"}]


@settings(max_examples=60, deadline=None)
@given(
    st.one_of(
        st.integers(0, 400).map(lambda n: n / 100),
        st.tuples(st.integers(0, 12), st.integers(1, 12)).map(lambda pair: pair[0] / pair[1]),
    ),
    st.sampled_from(["cm3^{0}/mol^{0}/min", "(cm3/mol)^{0}/min", "cm3^{0}*mol^-{0}/min"]),
    st.sampled_from(["{!r}", "{:.3f}"]),
)
def test_a_rate_constant_of_every_order_has_its_own_unit(order, spelling, digits):
    """k c^n is mol per volume and time, so k is (volume/mol)^(n - 1) per time, whatever n is; a
    fraction may be written to three digits, and the factor is still that of the order itself."""
    power = order - 1
    if power < 0:  # 1/4 is written mol^.. / cm3^..
        spelling = spelling.replace("cm3", "?").replace("mol", "cm3").replace("?", "mol")
    unit = spelling.format(digits.format(abs(power)))
    scale = conversion(unit, prefactor_unit(order)).scale
    assert scale == pytest.approx(1e-3**power / 60, rel=1e-10)  # its name has twelve digits


def test_another_order_is_another_unit():
    for order, unit in ((1.5, "L/mol/s"), (1.3, "L^0.31/mol^0.31/s"), (2.3, "L^1.3/mol^1.2/s")):
        with pytest.raises(UnitError, match="but the quantity is"):
            conversion(unit, prefactor_unit(order))
