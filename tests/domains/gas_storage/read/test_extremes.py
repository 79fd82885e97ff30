"""Input far outside of any market, or too deep, too large or circular: one message, no value."""

import shutil
from pathlib import Path

import pytest

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.gas_storage.read.case import read_case

CASES = Path(__file__).parents[1] / "cases"

# A text of the case or of the curve, what replaces it, and what the message must name.
EXTREMES = {
    "no price": ("27.03", "1e308", ["curve.csv", "line", "column price", "1e308", "1e+36"]),
    "price": ("27.03", "1e9", ["curve.csv, line 3, column price", "1e9", "1,000,000"]),
    "negative price": ("27.03", "-1e9", ["curve.csv, line 3", "-1,000,000"]),
    "rate": ("interest_rate = 0.03", "interest_rate = 1e300", ["interest_rate", "-1 and 1"]),
    "negative rate": ("interest_rate = 0.03", "interest_rate = -0.999", ["interest_rate", "-0.5"]),
    "volatility": ("volatility = 0.9", "volatility = 1e6", ["model.volatility", "5,000 %"]),
    "reversion": ("mean_reversion = 20.0", "mean_reversion = 1e12", ["mean_reversion", "100,000"]),
    "paths": ("paths = 4096", "paths = 1_000_000_000_000", ["evaluation.paths", "memory"]),
    "depth": ('title = "Thirty days"', f"title = {'[' * 5000}{']' * 5000}", ["case.toml"]),
}


@pytest.mark.parametrize("extreme", EXTREMES)
def test_an_extreme_is_refused_with_its_limit(extreme, tmp_path):
    old, new, named = EXTREMES[extreme]
    folder = Path(shutil.copytree(CASES / "quick", tmp_path / "case"))
    changed = 0
    for file in folder.iterdir():
        text = file.read_text()
        changed += text.count(old)
        file.write_text(text.replace(old, new))
    assert changed == 1
    with pytest.raises(CaseError) as refused:
        read_case(*load(folder))
    for word in named:
        assert word in str(refused.value)


def test_a_curve_that_is_a_circle_of_links_is_refused(tmp_path):
    folder = Path(shutil.copytree(CASES / "quick", tmp_path / "case"))
    (folder / "curve.csv").unlink()
    (folder / "curve.csv").symlink_to(folder / "other.csv")
    (folder / "other.csv").symlink_to(folder / "curve.csv")
    with pytest.raises(CaseError, match=r"curve\.csv"):
        read_case(*load(folder))
