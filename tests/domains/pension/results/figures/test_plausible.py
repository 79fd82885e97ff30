"""What `check` shows to a human, and its remarks on cases that look like a slip."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pension.market_cases import no_contribution, plan
from tests.domains.pension.miniature import short_case
from tests.domains.pension.pots_cases import fund

from snapo.domains.pension import DOMAIN
from snapo.domains.pension.read.case import read_case
from snapo.domains.pension.results.figures.human import Human
from snapo.domains.pension.results.figures.lines import readable
from snapo.domains.pension.results.figures.plausible import remarks
from snapo.study.domain import Options

USUAL = Human(
    assets=325e6,
    liability=308.3e6,
    funding=1.054,
    duration=18.7,
    asset_duration=6.4,
    hedge_ratio=0.36,
    inflation_hedge_ratio=None,
    rate={1: 0.021, 10: 0.024, 30: 0.024},
    rate_volatility={1: 0.008, 10: 0.007, 30: 0.005},
    returns={"Cash": 0.02, "Equity": 0.054},
)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return read_case(short_case(tmp_path_factory.mktemp("fund") / "case"))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({}, None),
        ({"assets": 325.0, "funding": 325 / 308.3e6}, "the members' pensions"),
        ({"duration": 120.0}, "the duration of the liability is 120 years"),
        ({"hedge_ratio": 40.0}, "the notionals of the swaps"),
        ({"rate_volatility": {10: 0.69}}, "the volatility of the 10-year rate is 69.00% a year"),
        ({"returns": {"Equity": 0.54}}, "Equity grows by 54.0% a year"),
    ],
)
def test_a_figure_far_from_those_of_funds_is_remarked(small, changes, named):
    found = remarks(small, USUAL._replace(**changes))
    assert len(found) == (named is not None)
    assert all(named in each for each in found)


def test_pots_without_contributions_have_no_deficit_to_close():
    from_rights = USUAL._replace(funding=0.75)
    one = fund()
    for pots, count in ((one.pots, 0), (None, 1)):
        case = replace(one, plan=plan("arrears", contribution=no_contribution()), pots=pots)
        assert len(remarks(case, from_rights)) == count


def test_money_is_readable():
    assert readable(308297419.0, "EUR") == "EUR 308.3 million"
    assert readable(325.0, "EUR") == "EUR 325.0"
    assert readable(-1.234e9, "GBP") == "GBP -1.2 billion"


def closed(folder, *changes):
    """The small example without its actives, funded at three quarters."""
    copy = short_case(folder, [("case.toml", "assets = 325000000.0", "assets = 150000000.0")])
    file = copy / "cohorts.csv"
    lines = [line for line in file.read_text().splitlines() if ",active," not in line]
    file.write_text("\n".join(lines) + "\n")
    text = (copy / "case.toml").read_text()
    text = text.replace("liability = 318916480.0\nduration = 19.06\ntolerance = 0.001\n", "")
    text = text.replace("floor = 0.05                    # share of salaries\n", "")
    text = text.replace('"salary",', "").replace('"contribution_floor", ', "")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (copy / "case.toml").write_text(text)
    return copy


@pytest.mark.prove
def test_check_shows_the_figures_of_a_human(tmp_path):
    text = "\n".join(DOMAIN.check(read_case(short_case(tmp_path / "case"))))
    assert "funding ratio 101.9%" in text
    assert "liability EUR 318.9 million" in text
    assert "duration: liability 19.1 years, assets 6.4 years, hedge ratio 34%" in text
    # sigma (1 - exp(-a u)) / (a u) at a = .03, sigma = .008.
    at = [0.008 * -np.expm1(-0.03 * u) / (0.03 * u) for u in (1, 10, 30)]
    assert ", ".join(f"{u}y {each:.2%}" for u, each in zip((1, 10, 30), at)) in text
    assert "Equity 5.4%" in text
    assert "note:" not in text


@pytest.mark.prove
def test_check_says_what_is_borrowed(tmp_path):
    """Cash of -20 %, in bonds of 43 % in place of 25 % and 4 % more of the longer ones."""
    levered = [
        ("assets.csv", "Cash,cash,,,0.02,0,0.3", "Cash,cash,,,-0.2,-0.4,0.3"),
        ("assets.csv", "Bonds 10y,bond,,,0.25", "Bonds 10y,bond,,,0.43"),
        ("assets.csv", "Bonds 20y,bond,,,0.15", "Bonds 20y,bond,,,0.19"),
        ("assets.csv", "Matching,0.2,0.9", "Matching,0.2,1.4"),
    ]
    text = "\n".join(DOMAIN.check(read_case(short_case(tmp_path / "case", levered))))
    assert "holdings of 120% of the assets, short or borrowed: Cash -20% (down to -40%)" in text
    # 18 % more in bonds of ten years and 4 % more in those of twenty: 6.4 + 1.8 + 0.8 years.
    assert "assets 9.0 years" in text


@pytest.mark.prove
def test_check_remarks_on_slips(tmp_path):
    slips = [
        ("case.toml", "assets = 325000000.0", "assets = 325.0"),
        ("case.toml", "volatility = 0.008", "volatility = 0.8"),
    ]
    case = read_case(short_case(tmp_path / "case", slips))
    (remark,) = [line for line in DOMAIN.check(case) if line.startswith("note: ")]
    assert "is fund.assets in the same unit" in remark
    (note,) = case.notes
    assert note.startswith("rates.volatility: rate_volatility is 8,000 bp (0.8)")


@pytest.mark.prove
def test_a_high_volatility_of_rates_by_little_reversion_is_remarked(tmp_path):
    """Each number is plausible, and the 10-year rate moves by 0.05 (1 - exp(-0.005)) / 0.005."""
    high = [("case.toml", "volatility = 0.008", "volatility = 0.05")]
    high += [("case.toml", "mean_reversion = 0.03 ", "mean_reversion = 0.0005 ")]
    case = read_case(short_case(tmp_path / "case", high))
    assert not case.notes
    notes = [line for line in DOMAIN.check(case) if line.startswith("note: ")]
    assert any("the volatility of the 10-year rate is 4.99% a year" in line for line in notes)


@pytest.mark.prove
def test_remarks_of_check_are_notes_of_a_run(tmp_path):
    slip = [("case.toml", "assets = 325000000.0", "assets = 325.0")]
    case = read_case(short_case(tmp_path / "case", slip))
    known = [each[6:] for each in DOMAIN.check(case) if each.startswith("note: ")]
    notes = DOMAIN.study(case, Options()).about["notes"]
    assert known and notes == [*case.notes, *known]
    # A run that goes on keeps them, without the examination.
    again = DOMAIN.study(case, Options(about={"notes": notes})).about["notes"]
    assert again == notes


@pytest.mark.prove
def test_a_closed_plan_in_deficit_that_gets_nothing_is_told_so(tmp_path):
    unpaid = DOMAIN.check(read_case(closed(tmp_path / "closed")))
    (note,) = [each for each in unpaid if each.startswith("note: ")]
    assert "the funding ratio is" in note
    assert "the cap is a share of salaries, but the plan has no salaries" in note
    assert "plan.contribution.schedule" in note


@pytest.mark.prove
def test_yearly_steps_are_compared_with_monthly_ones(tmp_path):
    yearly = [
        ("case.toml", '# step = "month"  ', 'step = "year"  '),
        ("case.toml", "liability = 318916480.0\nduration = 19.06\ntolerance = 0.001\n", ""),
    ]
    found = DOMAIN.check(read_case(short_case(tmp_path / "case", yearly)))
    (note,) = [each for each in found if "monthly steps" in each]
    assert "the liability differs by -" in note
