"""Shares name what they are a share of: by weight, volume, moles or area of a chromatogram."""

import tomllib

import pytest
from tests.domains.pharma.pharma_cases import TEMPLATE, template

from snapo.case.error import CaseError

MASS = {"A": 100, "B": 50, "C": 150, "D": 250}  # g/mol


def with_attribute(measure: str, unit: str, high: str | None = None):
    """The template with one attribute."""
    limit = {} if high is None else {"high": high, "citation": "made up"}
    row = {"name": "share", "measure": measure, "unit": unit, **limit}
    return template(attributes=[row], design_space=None, goal=None, optimise=None, control=None)


def scale(measure: str, unit: str) -> float:
    return with_attribute(measure, unit).attributes[0].scale


def test_moles_per_mole_of_an_impurity():
    """0.1 % w/w of D in crystals of C is 0.1 % x 150/250 of their moles."""
    for unit in ("% w/w", "%", "% m/m", "% (w/w)"):
        assert scale("filter.impurity.D", unit) == pytest.approx(100)
    for unit in ("% n/n", "% mol/mol"):
        assert scale("filter.impurity.D", unit) == pytest.approx(100 * MASS["C"] / MASS["D"])
    assert scale("filter.impurity.B", "ppm n/n") == pytest.approx(1e6 * MASS["C"] / MASS["B"])
    case = with_attribute("filter.impurity.D", "% n/n", "0.12 % n/n")
    assert case.attributes[0].high == pytest.approx(0.12)


def test_a_yield_by_weight():
    """A yield is by moles: by weight it is as many times more as the product is heavier."""
    assert scale("process.yield.C.A", "%") == scale("process.yield.C.A", "% n/n") == 100
    assert scale("process.yield.C.A", "% w/w") == pytest.approx(100 * MASS["C"] / MASS["A"])


@pytest.mark.parametrize(
    ("measure", "unit", "words"),
    [
        (
            "filter.impurity.D",
            "% v/v",
            "% v/v means volume per volume, but this number is mass per mass",
        ),
        ("filter.impurity.D", "% a/a", "response factor"),
        ("dryer.solvent", "% n/n", "write it in % w/w"),
        (
            "crystalliser.supersaturation",
            "% w/w",
            "is not a share with a basis: write it without w/w",
        ),
    ],
)
def test_what_has_no_meaning_here_is_refused_with_the_remedy(measure, unit, words):
    with pytest.raises(CaseError) as caught:
        with_attribute(measure, unit)
    assert words in str(caught.value) and "attributes[0].unit" in str(caught.value)


def test_a_limit_is_read_on_the_basis_of_its_attribute():
    with pytest.raises(
        CaseError, match="% w/w means mass per mass, but this number is moles per mole"
    ):
        with_attribute("filter.impurity.D", "% n/n", "0.12 % w/w")


@pytest.mark.parametrize(
    ("text", "good"),
    [("40 %", True), ("40 % v/v", True), ("0.4 L/L", True), ("40 % w/w", False),
     ("0.4 kg/kg", False), ("40 % a/a", False)],
)  # fmt: skip
def test_a_porosity_is_by_volume(text, good):
    units = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))["units"]
    units["filter"]["porosity"] = text
    if good:
        assert template(units=units).units[2].porosity.values[0] == pytest.approx(0.4)
        return
    with pytest.raises(CaseError, match="but this number is volume per volume"):
        template(units=units)


def test_seed_moments_are_those_of_some_crystals():
    """The mean square of a size is not below the square of its mean, and so on up to mu5."""
    units = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))["units"]

    def seeded(moments):
        units["crystalliser"]["seed"] = {
            "moments": [f"{x!r} {f'm^{k}/m^3' if k else '1/m^3'}" for k, x in enumerate(moments)]
        }
        return template(units=units, uncertainty=None, correlations=None)

    size = [4e9 * 20e-6**k for k in range(6)]
    seeded(size)
    seeded([float(f"{x:.3g}") for x in size])  # crystals of one size, to three digits
    seeded([x * 1.09 ** (k * (k - 1) / 2) for k, x in enumerate(size)])  # lognormal
    two = [1e9 * (10e-6**k + 60e-6**k) for k in range(6)]
    seeded(two)
    for k in (0, 2, 3, 4, 5):
        wrong = list(two)
        wrong[k] *= 0.4
        with pytest.raises(CaseError, match="these moments are impossible"):
            seeded(wrong)
