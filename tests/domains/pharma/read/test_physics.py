"""What is impossible is refused when the case is read, with its limit; what is odd is noted."""

import tomllib

import pytest
from tests.domains.pharma.pharma_cases import TEMPLATE

from snapo.case.error import CaseError
from snapo.domains.pharma.quality.records import Distribution
from snapo.domains.pharma.read.case import resolve
from snapo.domains.pharma.read.plausible.checks import outside


def read(*changes):
    """The template with texts replaced."""
    text = TEMPLATE.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return resolve(TEMPLATE, tomllib.loads(text))


COLD = '"5 K", "308 K", "295 K", "278.15 K"'
GROWTH = 'of = "crystalliser.kinetics.growth"\ndistribution = { kind = "lognormal", spread = 0.1 }'
REFUSED = {
    "crystalliser at 5 K": (
        '"313.15 K", "308 K", "295 K", "278.15 K"', COLD, "from 100 to 1,000 K"),
    "reactor at 5,000 K": (
        'duration = "3600 s"\ntemperature = "313.15 K"', 'duration = "3600 s"\ntemperature = '
        '"5000 K"', "from 100 to 1,000 K (25 degC is 298.15 K)"),
    "Celsius typed as kelvin": (
        'temperature = "323.15 K"\nrate', 'temperature = "25 K"\nrate', "25 degC is 298.15 K"),
    "porosity 0.99": ("porosity = 0.4", "porosity = 0.99", "it must be a number from 0.1 to 0.95"),
    "seed that fills the vessel": (
        'loading = "0.02 kg/m^3"', 'loading = "2000 kg/m^3"',
        "units.crystalliser.seed: the seed takes 166.7 % of the volume; it must be less than 50 %"),
    "negative solubility": (
        "coefficients = [226.9, -1.88, 3.89e-3]", "coefficients = [216.9, -1.88, 3.89e-3]",
        "units.crystalliser.solubility: at 278.15 K, which crystalliser reaches, the solubility "
        "is -5."),
    "density of another unit": (
        'density = "1200 kg/m^3"', 'density = "1.2 kg/m^3"', "from 300 to 10,000 kg/m3"),
    "solvent in kilograms a litre": (
        'solvent = "887.6 kg/m^3"', 'solvent = "887.6 kg/L"', "from 0 to 3,000 kg/m3"),
    "a liquid heavier than any": (
        'A = "0.33 mol/L", B', 'A = "33 mol/L", B', "weigh 4204.1 kg in a cubic metre"),
    "normal rate constants below zero": (
        GROWTH, GROWTH.replace('"lognormal", spread = 0.1', '"normal", spread = "9 um/s"'),
        "29 % of its draws are impossible values of crystalliser.kinetics.growth (at least 0 m/s); "
        'kind "lognormal" stays above 0'),
    "uniform rate constants below zero": (
        GROWTH, GROWTH.replace('"lognormal", spread = 0.1', '"uniform", spread = "10 um/s"'),
        "25 % of its draws are impossible"),
    "a studied wash ratio below zero": (
        "range = [1, 4]", "range = [-1, 4]", "filter.wash_ratio is at least 0"),
    "a studied temperature at 5 K": (
        'range = ["303 K", "323 K"]', 'range = ["5 K", "323 K"]', "from 100 to 1,000 K"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", REFUSED)
def test_what_cannot_be_is_refused(mistake):
    old, new, words = REFUSED[mistake]
    with pytest.raises(CaseError) as caught:
        read((old, new))
    assert words in str(caught.value)


ODD = {
    "hot": ('temperature = "323.15 K"\nrate', 'temperature = "323.15 degC"\nrate',
            "units.dryer.temperature: dryer.temperature is 596.3 K, outside 200 to 500 K: processes in liquids usually run from 200 to 500 K."),
    "porous": ("porosity = 0.4", "porosity = 0.9", "units.filter.porosity: filter.porosity is 0.9, outside 0.25 to 0.75: the porosity of a cake is usually"),
    "light": ('density = "1200 kg/m^3"', 'density = "500 kg/m^3"', "the density of crystals is usually 800"),
    "minutes for hours": (
        'duration = "10800 s"', 'duration = "10800 min"',
        "units.dryer.duration: dryer.duration is 10,800 min (648000), outside 0.0166667 to 10,080 min"),
    "a seed in millimetres": (
        'size = "20 um"', 'size = "20 mm"',
        "units.crystalliser.seed.size: crystalliser.seed.size is 20 mm (0.02)"),
    "activation in joules": (
        'activation = "3.0e4 J/mol"', 'activation = "30 J/mol"',
        "reactions[1].activation: kinetics.activation impurity is 30 J/mol"),
    "pressure in bar": ('pressure = "1e5 Pa"', 'pressure = "1e5 bar"', "units.filter.pressure: "),
    "a viscosity": ('"4.6e-4 Pa*s"', '"4.6e3 Pa*s"', "units.filter.viscosity: "),
    "a diffusivity in cm": ('"7e-10 m^2/s"', '"7e-2 m^2/s"', "units.tablet.diffusivity: "),
    "growth": ('growth = "5 um/s"', 'growth = "5 mm/s"', "units.crystalliser.kinetics.growth: "),
    "a film": ('film = "30 um"', 'film = "30 mm"', "units.tablet.film: tablet.film is 30 mm"),
    "rare": (GROWTH, GROWTH.replace('"lognormal", spread = 0.1', '"normal", spread = "1.5 um/s"'),
             "uncertainty[1]: 0.043 % of its draws are impossible values"),
    "solubility where it is studied": (
        'range = ["273.15 K", "283.15 K"]', 'range = ["240 K", "283.15 K"]',
        "crystalliser.temperature may reach 241.3"),
}  # fmt: skip


@pytest.mark.parametrize("oddity", ODD)
def test_what_is_unusual_is_noted(oddity):
    old, new, words = ODD[oddity]
    changes = [(old, new)]
    if oddity == "hot":
        changes.append(('range = ["313.15 K", "333.15 K"]\nnormal = ["321.15 K", "325.15 K"]',
                        'range = ["313.15 K", "633.15 K"]\nnormal = ["321.15 K", "600 K"]'))  # fmt: skip
    (note,) = read(*changes).notes
    assert words in note


def test_molar_masses_in_kilograms_are_noted():
    """100 g/mol is 0.1 kg/mol; reactions keep their mass only where all are of the same unit."""
    changes = [(f'molar_mass = "{x} g/mol"', f'molar_mass = "0.{x} g/mol"') for x in (100, 250)]
    changes += [('molar_mass = "50 g/mol"', 'molar_mass = "0.05 g/mol"')]
    changes += [('molar_mass = "150 g/mol"', 'molar_mass = "0.15 g/mol"')]
    notes = read(*changes).notes
    assert len(notes) == 4
    assert notes[0].startswith("species.A.molar_mass: species.A.molar_mass is 0.1 g/mol, outside 1")


def test_the_template_has_no_remark():
    assert read().notes == ()


@pytest.mark.parametrize(
    ("kind", "spread", "centre", "share"),
    [("normal", 1.0, 1.0, 0.15865525393), ("uniform", 2.0, 1.0, 0.25), ("lognormal", 1.0, 1.0, 0)],
)
def test_the_share_below_zero_by_closed_form(kind, spread, centre, share):
    assert outside(Distribution(kind, spread), centre, 5e-324, float("inf")) == pytest.approx(share)
