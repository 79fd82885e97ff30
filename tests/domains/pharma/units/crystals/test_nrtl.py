"""NRTL against published activity coefficients, an ideal solubility and its own derivatives."""

import tomllib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import TEMPLATE, template

from snapo.case.error import CaseError
from snapo.domains.pharma.units.crystalliser import Crystalliser
from snapo.domains.pharma.units.crystals.solubility import (
    activity,
    ideal,
    nominal_solubility,
    share,
    solubility,
)
from snapo.problem.record.either import with_numpy

TAU = np.array([[0.0, -0.178], [1.963, 0.0]])
ALPHA = np.array([[0.0, 0.2974], [0.2974, 0.0]])
NRTL = {
    "molar_mass": "151.16 g/mol",
    "melting": "443.6 K",
    "fusion": "27.1 kJ/mol",
    "solvents": ["ethanol", "water"],
    "solvent_masses": ["46.07 g/mol", "18.015 g/mol"],
    "composition": [0.7, 0.3],
    "density": "820 kg/m^3",
    "b": [[0, 150.0, 400.0], [-80.0, 0, -61.0], [350.0, 670.0, 0]],
    "alpha": [[0, 0.3, 0.3], [0.3, 0, 0.3], [0.3, 0.3, 0]],
}


def crystalliser(**changes) -> Crystalliser:
    table = {"kind": "nrtl", "nrtl": {k: v for k, v in (NRTL | changes).items() if v is not None}}
    found = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))["units"]
    found["crystalliser"]["solubility"] = table
    case = template(units=found)
    unit = next(each for each in case.units if each.name == "crystalliser")
    assert isinstance(unit, Crystalliser)
    return unit


@pytest.mark.prove
def test_activity_coefficients_of_ethanol_and_water():
    """As the tests of the package thermo have them (its example P05.01b, `NRTL_gammas`), and at
    infinite dilution the closed form ln gamma = tau_21 + tau_12 G_12."""
    with jax.enable_x64(True):
        of = jax.jit(activity)
        found = np.exp(of(jnp.array([0.252, 0.748]), TAU, ALPHA))
        thin = of(jnp.array([0.0, 1.0]), TAU, ALPHA)[0]
    assert found == pytest.approx([1.9363183763514304, 1.1537609663170014], rel=1e-14)
    closed = TAU[1, 0] + TAU[0, 1] * np.exp(-0.2974 * TAU[0, 1])
    assert float(thin) == pytest.approx(closed, rel=1e-14)


@pytest.mark.prove
def test_naphthalene_in_benzene():
    """Nearly ideal: measured are shares by mole of 0.2946 and 0.292 at 298 K, and 0.2974 by all
    measurements together (IUPAC-NIST Solubility Database, naphthalene with benzene); melting at
    353.35 K takes 19.01 kJ/mol (CRC Handbook, in the package chemicals)."""
    heat = with_numpy(ideal)(298.15, 353.35, 19010.0)
    assert np.exp(heat) == pytest.approx(0.2946, rel=0.03)
    with jax.enable_x64(True):
        alone = jax.jit(share)(heat, jnp.ones(1), jnp.zeros((2, 2)), ALPHA)
    assert float(alone) == pytest.approx(np.exp(heat), rel=1e-6)


@pytest.mark.prove
def test_equilibrium_holds_and_derivatives_are_those_of_differences():
    """x gamma is the activity of the crystal; by temperature and every number of the model."""
    record = crystalliser().solubility
    mixture = record.mixture
    assert mixture is not None
    names = ("melting", "fusion", "density", "a", "b", "alpha")
    parts = {each: getattr(mixture, each) for each in names}
    with jax.enable_x64(True):
        here = {part.name: np.asarray(part.values) for part in parts.values()}
        one = jax.jit(lambda given, t: solubility(record, given, t))
        slopes, by_t = jax.jit(jax.grad(one, (0, 1)))(here, 298.15)
        c = float(one(here, 298.15))
        x = c / (c + 820 * mixture.ratio)
        full = np.zeros((3, 3))
        rows = np.nonzero(~np.eye(3, dtype=bool))
        full[rows] = mixture.b.values / 298.15
        every = np.zeros((3, 3))
        every[rows] = mixture.alpha.values
        mixed: Any = np.array([x, 0.7 * (1 - x), 0.3 * (1 - x)]), full, every
        gamma = with_numpy(activity)(*mixed)[0]
        heat = with_numpy(ideal)(298.15, 443.6, 27100.0)
        assert float(np.log(x) + gamma) == pytest.approx(heat)
        assert nominal_solubility(record, np.array([298.15]))[0] == pytest.approx(c, rel=1e-9)

        def difference(up, down, step):
            return float(one(*up) - one(*down)) / (2 * step)

        warm = difference((here, 298.16), (here, 298.14), 0.01)
        assert float(by_t) == pytest.approx(warm, rel=1e-6) and warm > 0
        for part in parts.values():
            for i, value in enumerate(part.values):
                step = 1e-4 * max(abs(value), 0.1)
                moves = step * np.eye(part.values.size)[i]
                up, down = (here | {part.name: part.values + s * moves} for s in (1, -1))
                numeric = difference((up, 298.15), (down, 298.15), step)
                assert float(slopes[part.name][i]) == pytest.approx(numeric, rel=1e-5, abs=1e-9)
    assert "crystalliser.solubility.nrtl.b" in {each.name for each in parts.values()}


@pytest.mark.prove
def test_constants_by_name():
    """Ethanol, water and paracetamol of `chemicals`."""
    pytest.importorskip("chemicals")
    named = crystalliser(
        solute="paracetamol", molar_mass=None, solvent_masses=None
    ).solubility.mixture
    given = crystalliser().solubility.mixture
    assert named is not None and given is not None
    assert named.ratio == pytest.approx(given.ratio, rel=1e-3)
    with pytest.raises(CaseError, match=r"solubility.nrtl.solvents.*chemicals has no MW"):
        crystalliser(solvents=["ethanol", "wishwash"], solvent_masses=None)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"composition": [0.7, 0.2]}, "2 shares that add up to 1"),
        ({"b": [[0, 1], [1, 0]]}, "3 rows of 3 numbers"),
        ({"molar_mass": None}, "required if there is no `solute`"),
        ({"melting": "443 g"}, "nrtl.melting"),
    ],
)
def test_tables_that_do_not_fit(changes, words):
    with pytest.raises(CaseError, match=words):
        crystalliser(**changes)
