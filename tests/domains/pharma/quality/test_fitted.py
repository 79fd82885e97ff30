"""What was fitted is used: values and covariance in the case, measurements in their own unit."""

import tomllib
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from tests.domains.pharma.filled import filled
from tests.domains.pharma.pharma_cases import CASE, data

from snapo.case.error import CaseError
from snapo.domains.pharma.chapters.estimation import fitted_rows
from snapo.domains.pharma.control.staging import drawn
from snapo.domains.pharma.derivatives.sensitivities import spread
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.quality import draws
from snapo.domains.pharma.quality.estimation import ParameterFit
from snapo.domains.pharma.read.case import read_case, resolve
from snapo.domains.pharma.read.plausible.checks import outside

FIT = filled(
    ParameterFit,
    at_bound=("", ""),
    names=("kinetics.prefactor[product]", "kinetics.prefactor[impurity]"),
    values=np.array([2.654e4, 5.3e2]),
    covariance=np.array([[0.01**2, 0.0001], [0.0001, 0.02**2]]),
    correlation=np.array([[1.0, 0.5], [0.5, 1.0]]),
)
ROWS = "of,value,logarithm,deviation,correlation\n"


def write(folder: Path, rows: str, text: str = CASE) -> Path:
    """A case that names a file of fitted numbers; the prefactors have no [[uncertainty]] left."""
    cut, rest = text.split("[[uncertainty]]"), text.index("[design_space]")
    (folder / "case.toml").write_text(f'fitted = "fitted.csv"\n{cut[0]}{text[rest:]}', "utf-8")
    (folder / "batch.csv").write_text(data())
    (folder / "fitted.csv").write_text(ROWS + rows)
    return folder


def rows_of(folder: Path) -> str:
    (folder / "batch.csv").write_text(data())
    case = resolve(folder / "case.toml", tomllib.loads(CASE))
    return "".join(",".join(row) + "\n" for row in fitted_rows(case, FIT))


def test_values_and_covariance_go_on(tmp_path):
    """The file of a run, named in a case: nominal values, deviations and correlation are the fit's."""
    case = read_case(write(tmp_path, rows_of(tmp_path)))
    assert case.network.prefactor.values.tolist() == [2.654e4, 5.3e2]
    assert (
        "fitted.csv has the values and uncertainties of kinetics.prefactor[product]"
        in case.notes[0]
    )
    drawn = np.log(draws.draw(case, 20_000, 1))
    assert drawn.std(0) == pytest.approx([0.01, 0.02], rel=0.02)
    assert np.corrcoef(drawn.T)[0, 1] == pytest.approx(0.5, abs=0.02)
    assert draws.unknown(case)[:2].all()


def test_a_number_fitted_as_its_logarithm_has_its_value_as_median(tmp_path):
    """The Gaussian fit in (ln A, E) has its mean at the fitted rate constant, however wide it is
    along the line on which the rate constant does not change; nor does that width remain in it."""
    rows = (
        "kinetics.prefactor[product],26540 L/mol/s,true,0.724,1.0 0.9999\n"
        "kinetics.activation[product],40000 J/mol,false,1854 J/mol,0.9999 1.0\n"
    )
    case = read_case(write(tmp_path, rows))
    kinds, normal = case.uncertainty.distributions, draws.normals(case, 20_000, 1)[:, :2]
    per_energy = 1 / (8.314 * 308)
    width = 1854 * per_energy
    narrow = np.sqrt(0.724**2 + width**2 - 2 * 0.9999 * 0.724 * width)  # 0.0102
    numpy = draws.draw(case, 20_000, 1)
    with jax.enable_x64(True):
        columns = zip(kinds, (26540, 4e4), normal.T)
        traced = np.stack([drawn(kind, centre, z) for kind, centre, z in columns], 1)
    for values in (numpy, traced):
        logarithm = np.log(values[:, 0] / 26540) - (values[:, 1] - 4e4) * per_energy
        assert logarithm.mean() == pytest.approx(0.0, abs=5 * narrow / np.sqrt(20_000))
        assert logarithm.std() == pytest.approx(narrow, rel=0.03)
    # To first order ln A and E cancel too: d ln k has the same standard deviation.
    slope = np.array([[1 / 26540, -per_energy]])
    assert spread(replace(case, parameters=()), slope).total[0] == pytest.approx(narrow, rel=1e-9)
    # Half of the draws are above the fitted value, P(z > 1) above exp(s) times it.
    assert outside(kinds[0], 26540, 0.0, 26540) == pytest.approx(0.5, abs=1e-12)
    high = 26540 * np.exp(0.724)
    assert outside(kinds[0], 26540, 0.0, high) == pytest.approx(0.15865525393, abs=1e-10)


def test_a_fit_that_leaves_numbers_free_is_not_handed_on(tmp_path):
    (tmp_path / "batch.csv").write_text(data())
    case = resolve(tmp_path / "case.toml", tomllib.loads(CASE))
    assert fitted_rows(case, replace(FIT, unidentified=("one of them",))) == []
    assert fitted_rows(case, replace(FIT, converged=False)) == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("product", "main", "its entries are 0 to 1 or product, impurity"),
        ("26540.0 m3", "-26540.0 m3", "kinetics.prefactor[product] is at least 0"),
        ("26540.0 m3", "0.0 m3", "a number fitted as its logarithm must be above 0"),
        ("true", "yes", "it must be true or false"),
        ("1.0 0.5\n", "1.0\n", "must be 2 numbers"),
        ("1.0 0.5\n", "1.0 0.7\n", "not a correlation matrix"),
    ],
)
def test_mistakes_in_the_file_are_named(tmp_path, old, new, words):
    rows = rows_of(tmp_path)
    assert old in rows
    with pytest.raises(CaseError) as caught:
        read_case(write(tmp_path, rows.replace(old, new, 1)))
    assert words in str(caught.value) and "fitted.csv, line 2" in str(caught.value)


def test_a_number_is_not_uncertain_twice(tmp_path):
    folder = write(tmp_path, rows_of(tmp_path))
    file = folder / "case.toml"
    table = '[[uncertainty]]\nof = "kinetics.prefactor"\n'
    table += 'distribution = { kind = "lognormal", spread = 0.1 }\n'
    file.write_text(file.read_text() + table)
    with pytest.raises(CaseError, match="the file `fitted` has the uncertainty"):
        read_case(folder)


def test_measurements_keep_their_unit_and_may_lie_a_little_below_zero(tmp_path):
    (tmp_path / "case.toml").write_text(CASE)
    text = data() + "59 min,reactor.concentration.A,-0.2 mmol/L,0.1 mmol/L\n"
    (tmp_path / "batch.csv").write_text(text)
    found = read_case(tmp_path).estimation
    assert found is not None and found.units == ("L/mol/s", "L/mol/s")
    batch = found.experiments[0]
    assert batch.units[-1] == "mmol/L" and batch.scales[-1] == pytest.approx((1e-3, 0.0))
    assert batch.value[-1] == pytest.approx(-2e-4) and batch.units[0] == "mol/L"
    (tmp_path / "batch.csv").write_text(text.replace("-0.2 mmol/L", "-2 mmol/L"))
    with pytest.raises(
        CaseError, match="20 of its standard deviations below the smallest possible value"
    ):
        read_case(tmp_path)


LATE = "70 min,reactor.concentration.A,1 mmol/L,0.1 mmol/L\n"


def test_a_measurement_after_the_end_of_its_unit_is_refused(tmp_path):
    """A batch of an hour says nothing of the 70th minute, unless it was itself a longer one."""
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "batch.csv").write_text(data() + LATE)
    with pytest.raises(CaseError) as caught:
        read_case(tmp_path)
    words = str(caught.value)
    assert "batch.csv, line 14, column time: got '70 min'; reactor ends at 3600 s in" in words
    assert "reactor.duration" in words
    longer = 'data = "batch.csv"\nsettings = { "reactor.duration" = "70 min" }'
    (tmp_path / "case.toml").write_text(CASE.replace('data = "batch.csv"', longer))
    found = read_case(tmp_path).estimation
    assert found is not None and found.experiments[0].time[-1] == 4200


def test_after_its_end_a_unit_has_no_states(tmp_path):
    """From Python as well: no number stands for a time at which there was no batch."""
    (tmp_path / "batch.csv").write_text(data())
    process = PharmaProcess(resolve(tmp_path / "case.toml", tomllib.loads(CASE)))
    state, times = ("concentration.A",) * 3, np.array([1800.0, 3600.0, 4200.0])
    with jax.enable_x64(True):
        found = jax.jit(lambda x: process.observe(x, "reactor", state, times))(process.inputs)
    assert np.isfinite(found).tolist() == [True, True, False]
