"""The learned policy of the medium example against classical ones tuned for as long: on fresh paths
it leads each by far more than the error of the paired difference, and within the same limits."""

from types import SimpleNamespace

import numpy as np
import pytest
from tests.domains.pension.miniature import TEMPLATES

from snapo.domains.pension.chapters.policies import compare
from snapo.domains.pension.read.case import read_case
from snapo.domains.pension.results.setup import make_setup
from snapo.solver.evaluate import path_totals
from snapo.solver.train import initial_progress, train

pytestmark = pytest.mark.study

RIVALS = ("constant_mix", "glide_path", "liability_driven")
BASIS_POINT = 1e-4


@pytest.fixture(scope="module")
def setup():
    """The medium example with its own settings, as `snapo solve` takes them."""
    return make_setup(read_case(TEMPLATES / "medium"))


@pytest.fixture(scope="module")
def totals(setup):
    """Path totals of the trained network on paths that it was not trained on."""
    problem, policy, training, evaluation, engines, *_ = setup
    best = train(problem, initial_progress(policy, training), training, engines.train).best
    assert evaluation.paths >= 16384
    return path_totals(problem, best, evaluation.paths, engine=engines.evaluate)


@pytest.fixture(scope="module")
def rows(setup, totals):
    found = compare(setup, SimpleNamespace(totals=totals), lambda text: None)  # pyright: ignore
    return {row.key: row for row in found}


@pytest.mark.parametrize("key", RIVALS)
def test_the_learned_policy_leads(rows, key):
    lead, error = rows[key].lead, rows[key].lead_error
    assert 0 < error < 2 * BASIS_POINT
    assert lead > 3 * error
    assert lead >= 10 * BASIS_POINT
    assert rows[key].difference > 3 * rows[key].difference_error


def test_rules_that_follow_the_funding_ratio_lose_nothing_to_the_mix_they_start_from(rows):
    """They contain it, and the best along the way is kept: on fresh paths 0.5 bp may be chance."""
    mix = rows["constant_mix"].lead
    for key in ("glide_path", "liability_driven"):
        assert rows[key].lead < mix + 0.5 * BASIS_POINT


def test_swaps_are_backed_by_collateral(totals):
    """To round-off of the network's float32, summed over twenty years."""
    assert np.max(totals["collateral_shortfall"]) < 1e-4
