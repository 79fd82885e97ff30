"""The study of a pension fund: its parts, and those that need no training."""

import json

import numpy as np
import pytest
from tests.domains.pension.miniature import short_case

from snapo.domains.pension import DOMAIN
from snapo.domains.pension.chapters.attribution import sources
from snapo.domains.pension.read.case import read_case
from snapo.study.domain import Domain, Options
from snapo.study.run_folder import plain_json
from snapo.study.study import StudyRun


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = short_case(tmp_path_factory.mktemp("fund") / "case")
    return DOMAIN.study(read_case(folder), Options("xla"))


def test_the_domain_is_complete():
    assert isinstance(DOMAIN, Domain)
    assert list(DOMAIN.templates) == ["small", "medium", "large", "wtp"]


@pytest.mark.prove
def test_a_lost_frontier_or_rival_costs_no_other_part(study):
    """Only training is needed by several parts; every table can be written as JSON."""
    needed = {name for part in study.parts for name in part.needs}
    assert needed == {"training", "paths", "reconciliation"}
    assert json.loads(json.dumps(plain_json(study.about)))["measure"] == "P"


@pytest.mark.prove
def test_figures_and_shocks_come_before_training(study, tmp_path):
    run = StudyRun(study, tmp_path, print)
    for part in study.parts[:2]:
        run.results |= json.loads(json.dumps(plain_json(part.work(run))))
    assert run.get("funding") == pytest.approx(study.about["assets"] / run.get("liability"))
    years = np.array(run.get("reconciliation.key_rate_durations.years"))
    assert years.sum() == pytest.approx(run.get("reconciliation.duration"), rel=1e-9)
    shocked = {each["scenario"]: each for each in run.get("stresses")}
    up = shocked["Rates +100 bp"]
    # A duration of 18.7 years: the liability falls by about a sixth.
    assert 0.8 < up["liability"] / run.get("liability") < 0.9
    assert up["surplus"] == pytest.approx(up["assets"] - up["liability"])


@pytest.mark.prove
def test_sources_of_variance_are_the_volatilities_of_the_case(study):
    case = study.setup().case
    names = {name: [each.name for each in found] for name, found in sources(case).items()}
    assert names["interest rates"] == ["rate_volatility"]
    assert names["inflation and wages"] == [
        "inflation_volatility",
        "index_volatility",
        "wage_volatility",
    ]
    assert names["asset prices"] == ["asset_volatility"]
    assert names["credit spreads"] == ["credit_volatility"]
    assert names["currencies"] == ["currency_volatility"]
