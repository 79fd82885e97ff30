"""Stresses that set keys of a case: its objective, its dates, with factors on its numbers; and sums
of a book in which a contract has no value."""

import json

import numpy as np
import pytest
from tests.book.books import HERE, write_book
from tests.book.conftest import ROWS
from tests.book.test_tasks import ONE, points

from snapo.book import folder as folders
from snapo.book.collect import explained
from snapo.book.file import read_book
from snapo.book.folder import BookFolder
from snapo.book.job import BookPoint
from snapo.book.run import run_book


def test_a_stress_of_the_objective_values_the_other_objective(tmp_path):
    """The mean of the worst half of the paths is above that of the worst twentieth, and equals the
    value of a contract with this objective."""
    stress = '[[stress]]\nname = "half"\nset = { "objective.level" = 0.5 }\n'
    row = ONE[0] | {"objective.kind": '"""cvar"""', "objective.level": 0.95}
    stressed = points(write_book(tmp_path / "a", [row], stresses=stress), tmp_path / "x")["first"]
    other = row | {"objective.level": 0.5}
    of_half = points(write_book(tmp_path / "b", [other], stresses=""), tmp_path / "y")["first"]
    assert stressed["half"].value > stressed["base"].value + 1
    # The policies of the two contracts are trained for different objectives.
    assert stressed["half"].value == pytest.approx(of_half["base"].value, rel=0.02)


def test_a_factor_of_one_changes_nothing_on_other_dates(tmp_path):
    """The numbers of the curve belong to the days that the contract has after its keys are set."""
    later = 'set = { "contract.start" = 2025-01-08 }\n'
    stresses = (
        f'[[stress]]\nname = "later"\n{later}'
        f'[[stress]]\nname = "later, times 1"\n{later}scale = {{ "market.forward_curve" = 1.0 }}\n'
        f'[[stress]]\nname = "later, up"\n{later}scale = {{ "market.forward_curve" = 1.1 }}\n'
    )
    run = points(write_book(tmp_path, ONE, stresses=stresses), tmp_path / "run")["first"]
    np.testing.assert_array_equal(run["later"].shares, run["later, times 1"].shares)
    assert run["later"].value != run["later, up"].value
    # No change of a day that both have; days that the contract no longer has are not changes.
    assert not run["later, times 1"].changes


def test_a_contract_without_a_value_leaves_no_partial_sums(tmp_path):
    rows = [ROWS[0], ROWS[1] | {"contract.max_inventory": -1}]
    result = run_book(
        read_book(write_book(tmp_path, rows)), lambda _: None, HERE, out=tmp_path / "run"
    )
    assert result["cases"] == {"ok": 1, "failed": 1} and result["sums"][0]["value"] is None
    assert result["deltas"] == [] == result["exposure"]
    assert any("derivatives and exposures" in note for note in result["notes"])
    BookFolder(tmp_path / "run").result()  # the report can read it


def test_nothing_is_explained_without_derivatives():
    point = BookPoint.without_value("ok", "")
    assert np.isnan(explained(point, point))


def test_two_shards_may_start_at_once(tmp_path, monkeypatch):
    """A second one prepares the folder while the first one writes book.json."""
    write, out = folders.write_text, tmp_path / "out"

    def slow(file, text, **options):
        monkeypatch.setattr(folders, "write_text", write)
        BookFolder(out).prepare({}, keep=True)
        write(file, text, **options)

    monkeypatch.setattr(folders, "write_text", slow)
    BookFolder(out).prepare({}, keep=True)
    assert json.loads((out / "book.json").read_text())["kind"] == "book"
    assert [x.name for x in out.iterdir() if x.name.endswith(".partial")] == []
