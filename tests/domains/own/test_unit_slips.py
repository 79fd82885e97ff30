"""Slips of units among the inputs of a user's own simulator: one note each, with line or key."""

import shutil
from pathlib import Path

import pytest

from snapo.case.load import load
from snapo.domains.own import DOMAIN

SLIPS = {
    "a volatility in points": (
        "case.toml", "price_volatility = { value = 0.10", "price_volatility = { value = 10",
        "inputs.price_volatility.value: price_volatility is 1,000 points (10), outside 0 to 500 points",
        "a fraction is expected",
    ),
    "a price in cents": (
        "weeks.csv", "3,75.0,", "3,7500,",
        "weeks.csv, line 5, column price: price 3 is 7,500 EUR/MWh, ",
        "times its neighbours, which are about 74.",
    ),
}  # fmt: skip


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_units_has_one_note(slip, tmp_path):
    file, old, new, start, part = SLIPS[slip]
    folder = Path(shutil.copytree(DOMAIN.templates["reservoir"], tmp_path / "case"))
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))
    (note,) = DOMAIN.with_simulator("simulator", "Reservoir").read(*load(folder)).notes
    assert note.startswith(start)
    assert part in note
