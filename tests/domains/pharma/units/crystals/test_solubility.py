"""Solubility by van 't Hoff: its slope in a plot over 1/T, and what its table refuses."""

import tomllib

import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import TEMPLATE, template

from snapo.case.error import CaseError
from snapo.domains.pharma.units.crystalliser import Crystalliser
from snapo.domains.pharma.units.crystals.solubility import nominal_solubility, solubility

TABLE = {"kind": "van-t-hoff", "value": "20 g/L", "enthalpy": "25 kJ/mol", "reference": "25 degC"}


def changed(table):
    """The template with this table of solubility."""
    data = tomllib.loads(TEMPLATE.read_text("utf-8"))
    data["units"]["crystalliser"]["solubility"] = table
    return template(units=data["units"])


def record():
    case = changed(TABLE)
    return next(each for each in case.units if isinstance(each, Crystalliser)).solubility


def test_the_line_over_the_inverse_temperature():
    found = record()
    t = np.array([280.0, 298.15, 310.0])
    value = nominal_solubility(found, t)
    assert value[1] == pytest.approx(20.0, rel=1e-14)
    slope = np.log(value[2] / value[0]) / (1 / t[2] - 1 / t[0])
    assert slope * -8.314 == pytest.approx(25_000, rel=1e-12)


@pytest.mark.prove
def test_both_ways_of_computing_it_agree():
    found, t = record(), np.array([280.0, 310.0])
    inputs = {each.name: each.values for each in (found.value, found.enthalpy)}
    np.testing.assert_allclose(
        solubility(found, inputs, t), nominal_solubility(found, t), rtol=1e-6
    )


def test_mistakes():
    with pytest.raises(CaseError, match='kind "van-t-hoff" needs this key'):
        changed({key: value for key, value in TABLE.items() if key != "enthalpy"})
    with pytest.raises(CaseError, match='kind "van-t-hoff" has no such key'):
        changed({**TABLE, "coefficients": [1.0]})
    with pytest.raises(CaseError, match='kind "polynomial" needs this key'):
        changed({"kind": "polynomial"})
