"""Usual units are converted without the library that knows all of them, and as it does."""

import subprocess
import sys

import pytest

from snapo.domains.pharma.read.quantities import USUAL, basis, by_pint, conversion


@pytest.mark.parametrize("target", USUAL)
def test_usual_units_are_converted_as_pint_does(target):
    for unit in USUAL[target]:
        for difference in (False, True):
            assert conversion(unit, target, difference) == by_pint(unit, target, difference)


def test_only_a_ratio_of_two_units_of_one_dimension_has_a_basis():
    units = ["", "%", "ppm", "um", "no unit", "mg/kg", "mL/L", "mol/mol", "kg/m3", "g/", "/kg"]
    assert [basis(unit) for unit in units] == [""] * 5 + ["w/w", "v/v", "n/n", "", "", ""]


def test_the_template_is_checked_without_pint(tmp_path):
    """It took two fifths of a check."""
    code = (
        "import sys; from snapo.cli.main import main\n"
        f"assert main(['new', 'pharma', {str(tmp_path / 'case')!r}]) == 0\n"
        f"assert main(['check', {str(tmp_path / 'case')!r}]) == 0\n"
        "print('pint' in sys.modules, 'numpy.polynomial' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "False False"
