"""The template of a fund of personal pots, made short: trained by itself, and as a whole run."""

import shutil

import numpy as np
import pytest
from tests.domains.pension.miniature import TEMPLATES, solved

from snapo.domains.pension.read.case import read_case
from snapo.domains.pension.results.setup import make_setup
from snapo.solver.evaluate import path_totals
from snapo.solver.train import initial_progress, train

YOUNG, OLD = "Actives M 27", "Pensioners F 80"
SHORT = (
    ("years = 15\n", 'years = 2\nstep = "year"\n'),
    ("steps = 300\npaths = 512", "steps = 4\npaths = 32\nvalidation_paths = 64"),
    ("paths = 16384\nsensitivity_paths = 4096", "paths = 256\nsensitivity_paths = 64"),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("pots") / "case"
    shutil.copytree(TEMPLATES / "wtp", place)
    text = (place / "case.toml").read_text()
    for old, new in SHORT:
        assert old in text, old
        text = text.replace(old, new, 1)
    (place / "case.toml").write_text(text)
    return place


def test_its_published_numbers_stand_in_it():
    """Those of `test_published.py`, within the law."""
    case = read_case(TEMPLATES / "wtp")
    assert case.pots is not None
    assert float(case.pots.reserve.used()) == 0.075
    assert float(case.pots.release.used()) == 0.2
    assert float(case.pots.largest.used()) == case.pots.rules.largest == 0.15


@pytest.mark.prove
def test_it_is_trained_and_keeps_the_law(folder):
    setup = make_setup(read_case(folder))
    state = initial_progress(setup.policy, setup.training)
    best = train(setup.problem, state, setup.training, setup.engines.train).best
    totals = path_totals(setup.problem, best, 256, engine=setup.engines.evaluate)
    reserve, pension = np.asarray(totals["reserve"]), np.asarray(totals["pension"])
    assert reserve.min() >= 0 and reserve.max() <= 0.15 + 1e-12
    assert 0.9 < np.median(pension) < 1.3 and pension.min() > 0.5
    # The young have the excess return, those who draw a pension the protection.
    spread = {name: np.std(np.log(totals[f"pension {name}"])) for name in (YOUNG, OLD)}
    assert spread[OLD] < 0.5 * spread[YOUNG]


@pytest.mark.study
def test_every_part_of_its_run_is_done(folder):
    result = solved(folder)
    assert result["status"] == "trained"
    assert result["failures"] == {}
    report = (folder / "run" / "report.html").read_text()
    assert 'class="missing"' not in report
    assert "Certainty-equivalent pension" in report
