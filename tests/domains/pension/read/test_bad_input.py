"""Each mistake in a pension case: one message that names it, before anything is written."""

import shutil
from pathlib import Path

import pytest
from tests.domains.pension.miniature import TEMPLATES

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.pension import DOMAIN
from snapo.study.domain import Options

TEMPLATE = TEMPLATES / "small"

# Each mistake: the file to spoil, what is replaced by what (None: the whole file; `...`: the file
# is removed), and what the message must name.
MISTAKES = {
    # The TOML file.
    "missing file": ("curve.csv", None, ..., ["curve.file", "'curve.csv'", "no such file"]),
    "unknown key": (
        "case.toml", "measure =", "mesure =",
        ["curve.mesure", "no such key", "measure"],
    ),
    "unknown table": ("case.toml", "[stress]", "[stres]", ["stres", "no such key", "stress"]),
    "unknown key below plan": (
        "case.toml", "averaging = 12", "average = 12", ["plan.indexation.average", "averaging"]
    ),
    "missing key": ("case.toml", "years = 10  ", "# ", ["fund.years", "missing"]),
    "missing table": ("case.toml", "[rates]", "[policy]", ["rates", "this table is missing"]),
    "wrong type": (
        "case.toml", "mean_reversion = 0.03", 'mean_reversion = "slow"',
        ["rates.mean_reversion", "'slow'", "above 0"],
    ),
    "NaN": ("case.toml", "mean_reversion = 0.03", "mean_reversion = nan", ["rates", "nan"]),
    "infinite": (
        "case.toml", "expenses = 900000.0", "expenses = inf",
        ["plan.expenses", "inf"],
    ),
    "quoted date": (
        "case.toml", "2024-12-31", '"2024-12-31"',
        ["fund.valuation_date", "without quotation marks"],
    ),
    "unknown word": ("case.toml", '"arrears"', '"later"', ["plan.timing", "'later'", '"advance"']),
    "negative mean reversion": (
        "case.toml", "mean_reversion = 0.03", "mean_reversion = -0.03", ["rates.mean_reversion"]
    ),
    "one number for two factors": (
        "case.toml", 'kind = "hull-white"', 'kind = "g2++"',
        ["rates.volatility", "g2++", "one number for each factor: 2"],
    ),
    "no number for a factor": (
        "case.toml", "mean_reversion = 0.03", "mean_reversion = []",
        ["rates.mean_reversion", "hull-white", "one number for each factor: 1"],
    ),
    "missing rate of the basis": (
        "case.toml", "rate = 0.002", "# ",
        ["liability.rate", '"spread"'],
    ),
    "rate without use": (
        "case.toml", 'basis = "spread"', 'basis = "risk-free"',
        ["liability.rate", "0.002", "does not use"],
    ),
    "key of another contribution": (
        "case.toml", "spread_factor = 0.06", "spread_factor = 0.06\ntarget_ratio = 1.1",
        ["plan.contribution.target_ratio", "1.1", '"spread"'],
    ),
    "floor above cap": (
        "case.toml", "floor = 0.05", "floor = 0.5",
        ["plan.contribution.floor", "0.5", "0.35"],
    ),
    "ramp upside down": (
        "case.toml", "lower_ratio = 1.0", "lower_ratio = 1.3",
        ["plan.indexation.lower_ratio", "1.3", "1.2"],
    ),
    "ultimate without its rate": (
        "case.toml", 'measure = "P"', 'extrapolation = "ultimate"',
        ["curve.ultimate", "ultimate"],
    ),
    "swap rates without their method": (
        "curve.csv", "tenor,zero", "tenor,swap", ["curve.extrapolation", "smith-wilson"],
    ),
    "no such last liquid tenor": (
        "case.toml", 'measure = "P"', 'measure = "P"\nlast_liquid = 11.5',
        ["curve.last_liquid", "11.5"],
    ),
    "convergence without its method": (
        "case.toml", 'measure = "P"', 'measure = "P"\nconvergence = 60',
        ["curve.convergence", "smith-wilson"],
    ),
    "unknown observation": (
        "case.toml", '[objective]\n', '[policy]\nobservation = ["funding"]\n[objective]\n',
        ["policy.observation", "'funding'", "funding_ratio"],
    ),
    "unknown output": (
        "case.toml", "risk_aversion = 5.0", 'risk_aversion = 5.0\noutput = "fundng_ratio"',
        ["objective.output", "'fundng_ratio'", "funding_ratio"],
    ),
    "objective without its level": (
        "case.toml", 'kind = "crra"   ', 'kind = "cvar"   ',
        ["objective.level", '"cvar"'],
    ),
    "windows without a mean": (
        "case.toml", "steps = 300\n", "steps = 300\nwindow = 12\n",
        ["training.window", "12", 'kind "mean", but the kind is "crra"'],
    ),
    "unknown input held": ("case.toml", '"asset_cost"', '"asset_csot"', ["held", "asset_cost"]),
    "both members and cash flows": (
        "case.toml", 'file = "cohorts.csv"', 'file = "cohorts.csv"\ncash_flows = "x.csv"',
        ["members.file", "not both"],
    ),
    "figure that is missed": (
        "case.toml", "liability = 318916480.0", "liability = 1000.0",
        ["reconcile.liability", "1000", "tolerance"],
    ),
    "too few points of the frontier": (
        "case.toml", "points = 5", "points = 1", ["frontier.points", "1", "from 2 to 20"]
    ),
    "unknown part": (
        "case.toml", "[training]\n", '[report]\nparts = ["today", "fronteer"]\n[training]\n',
        ["report.parts[1]", "'fronteer'", "the nearest known part is frontier"],
    ),
    "part of another fund": (
        "case.toml", "[training]\n", '[report]\nparts = ["pots"]\n[training]\n',
        ["report.parts[0]", "'pots'", "the case has no [pots]"],
    ),
    "parts without a list": (
        "case.toml", "[training]\n", '[report]\nparts = "today"\n[training]\n',
        ["report.parts", "'today'", 'names of parts such as ["sensitivities"]'],
    ),
    "unknown stress": ("stress.csv", "price,equity", "price,equities", ["stress.csv", "equities"]),
    # Curves.
    "tenors out of order": (
        "curve.csv", "\n5,", "\n2.5,",
        ["curve.csv, line 7", "tenor", "'2.5'", "must increase", "3"],
    ),
    "negative tenor": ("curve.csv", "\n1,", "\n-1,", ["curve.csv, line 4", "'-1'", "above 0"]),
    "rate in percent": (
        "curve.csv", "\n1,0.0", "\n1,2.0",
        ["curve.csv, line 4", "zero", "from -0.999 to 1"],
    ),
    "zero and forward": ("curve.csv", "tenor,zero", "tenor,rate", ["curve.csv", "zero", "forward"]),
    "NaN in a curve": (
        "break_evens.csv", "\n1,0.0", "\n1,nan#",
        ["break_evens.csv, line 4", "'nan#"],
    ),
    "empty curve": ("curve.csv", None, "", ["curve.csv", "empty"]),
    "curve in Latin-1": (
        "curve.csv", None, "tenor,zero\n1,£\n".encode("latin-1"),
        ["curve.csv", "UTF-8"],
    ),
    # Assets.
    "weights that do not add up": (
        "assets.csv", ",0.35,", ",0.45,",
        ["assets.file", "add up to 1.1", "must add up to 1"],
    ),
    "negative weight": ("assets.csv", ",0.35,", ",-0.35,", ["assets.csv", "weight", "'-0.35'"]),
    "weight above one, nothing short": ("assets.csv", ",0.35,", ",1.35,", ["weight", "'1.35'"]),
    "more than all, nothing short": (
        "assets.csv", "0.25,0,0.7", "0.25,0,1.7",
        ["assets.csv", "high", "'1.7'", "at most 1", "low below 0"],
    ),
    "bound in per cent": (
        "assets.csv", "0.02,0,0.3", "0.02,-40,0.3",
        ["assets.csv", "low", "'-40'", "from -10 to 10"],
    ),
    "weight below its negative bound": (
        "assets.csv", "0.02,0,0.3", "-0.3,-0.2,0.3",
        ["assets.csv", "weight", "'-0.3'", "from -0.2 to 1"],
    ),
    "short, and sold by shares of the holding": (
        "assets.csv", None,
        "name,kind,weight,low,high,maturity,max_sale\nCash,cash,0.2,0,1,,\n"
        "Bonds,bond,0.8,-0.1,1.1,10,0.5\n",
        ["assets.csv", "max_sale", "'0.5'", "low is below 0"],
    ),
    "short bounds that leave too much": (
        "assets.csv", None,
        "name,kind,weight,low,high,maturity\nCash,cash,-0.4,-0.4,-0.3,\n"
        "Bonds,bond,1,0,1.2,10\nLong,bond,0.4,0,0,20\n",
        ["assets.file", "add up to -0.4 to 0.9", "lower bounds add up to at most 1"],
    ),
    "bounds that cannot sum to one": (
        "assets.csv", "0,0.3,,,,0,,,,1\nBonds 10y,bond,,,0.25,0,0.7,Matching,0.2,0.9",
        "0,0.05,,,,0,,,,1\nBonds 10y,bond,,,0.25,0,0.7,Matching,0,0.1",
        ["assets.file", "0 to 0.85", "the weights must be able to add up to 1"],
    ),
    "lower bounds above one": (
        "assets.csv", "0.02,0,0.3", "0.02,0.9,1.0",
        ["assets.file", "add up to 1.1"],
    ),
    "bounds upside down": (
        "assets.csv", "0.02,0,0.3", "0.02,0.4,0.3",
        ["assets.csv", "low", "'0.4'", "0.3"],
    ),
    "group out of reach": (
        "assets.csv", "Growth,0,0.7", "Growth,0.9,1.0",
        ["assets.file", "Growth", "0 to 0.8"],
    ),
    "unknown kind of class": (
        "assets.csv", "Equity,equity", "Equity,shares",
        ["assets.csv", "kind", "'shares'", "hedge-fund"],
    ),
    "class twice": ("assets.csv", "Property,property", "Equity,property", ["assets.csv", "name"]),
    "misspelt bound": (
        "assets.csv", "low,high,group", "low,hihg,group",
        ["assets.csv, line 3", "'hihg'", "the nearest known column is high"],
    ),
    "misspelt salary": ("cohorts.csv", "salary", "salery", ["cohorts.csv", "'salery'", "salary"]),
    "misspelt cost of swaps": ("overlay.csv", ",cost", ",csot", ["overlay.csv", "'csot'", "cost"]),
    "recovery plan without a time": (
        "case.toml", 'kind = "spread"   ', 'schedule = "curve.csv"\nkind = "spread"   ',
        ["curve.csv", "column amount is missing"],
    ),
    "two kinds of cash": ("assets.csv", "Bonds 10y,bond", "Bonds 10y,cash", ["maturity", "bond"]),
    "bond without a maturity": (
        "assets.csv", "0.0003,10,", "0.0003,,",
        ["assets.csv", "maturity", "empty"],
    ),
    "coupon bond without a coupon": (
        "assets.csv", "Bonds 10y,bond", "Bonds 10y,coupon-bond",
        ["assets.csv", "coupon", "it must be a rate per year or \"par\""],
    ),
    "kind of a swap": (
        "overlay.csv", None, "tenor,kind,notional,low,high\n10,par,0,0,0.2\n",
        ["overlay.csv", "kind", "'par'", "rates", "zero-coupon", "inflation"],
    ),
    "maturity between steps": (
        "assets.csv", "0.0003,10,", "0.0003,10.01,",
        ["assets.csv", "maturity", "'10.01'", "1m"],
    ),
    "unknown rating": (
        "assets.csv", "7,BBB", "7,BB",
        ["assets.csv", "rating", "'BB'", "BBB"],
    ),
    "unknown currency": ("assets.csv", ",USD,", ",JPY,", ["assets.csv", "currency", "'JPY'"]),
    "mean of a bond": (
        "assets.csv", "Bonds 10y,bond,,", "Bonds 10y,bond,0.03,",
        ["assets.csv", "mean", "0.03", "the curve"],
    ),
    "negative volatility": (
        "assets.csv", "0.054,0.2", "0.054,-0.2",
        ["assets.csv", "volatility", "'-0.2'"],
    ),
    "spread of zero": ("credit.csv", "BBB,0.013", "BBB,0", ["credit.csv", "spread", "above 0"]),
    "hedge ratio above one": (
        "currencies.csv", "0,0.5,", "0,1.5,",
        ["currencies.csv", "hedge_ratio", "'1.5'"],
    ),
    "swap limits upside down": (
        "overlay.csv", "10,0,0,0.25", "10,0,0.5,0.25",
        ["overlay.csv", "low", "0.25"],
    ),
    # Correlations.
    "correlation above one": (
        "correlations.csv", "inflation,0.3", "inflation,1.3",
        ["correlations.csv", "rate", "'1.3'"],
    ),
    "not a correlation matrix": (
        "correlations.csv", "Property,-0.5,0,0.5", "Property,-0.95,0.95,0.95",
        ["correlations.file", "eigenvalue", "positive definite", "repair"],
    ),
    "not symmetric": (
        "correlations.csv", "rate,1,,", "rate,1,0.4,",
        ["correlations.csv", "symmetric", "0.3"],
    ),
    "diagonal": ("correlations.csv", "rate,1,", "rate,0.9,", ["correlations.csv", "diagonal"]),
    "unknown name": (
        "correlations.csv", "\nUSD,", "\nEUR,",
        ["correlations.csv", "'EUR'", "USD"],
    ),
    # People.
    "negative age": ("cohorts.csv", "male,35,", "male,-35,", ["cohorts.csv", "age", "'-35'"]),
    "cohort past the end of the table": (
        "cohorts.csv", "female,78,", "female,121,",
        ["cohorts.csv", "age", "'121'", "20 to 119"],
    ),
    "active past retirement": (
        "cohorts.csv", "male,52,", "male,68,",
        ["cohorts.csv", "age", "'68'", "67"],
    ),
    "unknown status": ("cohorts.csv", "Spouses F 78,spouse", "Spouses F 78,widow", ["'widow'"]),
    "salary of a pensioner": ("cohorts.csv", "11800,,", "11800,100,", ["cohorts.csv", "salary"]),
    "probability above one": (
        "mortality.csv", "male,20,0.001", "male,20,1.001",
        ["mortality.csv", "q", "from 0 to 1"],
    ),
    "hole in the table": (
        "mortality.csv", "male,65,", "male,66,",
        ["mortality.csv", "age"],
    ),
    "sexes of different ages": (
        "mortality.csv", "male,20,", "male,19,",
        ["mortality.file", "no row for male, 20"],
    ),
    "multiplier that begins too late": (
        "multipliers.csv", "male,0,", "male,30,",
        ["mortality.multiplier", "male at 20"],
    ),
}  # fmt: skip

SCENARIOS = """
[scenarios]
training = "training.csv"
evaluation = "evaluation.csv"
"""
COLUMNS = ["return cash", "return bonds 10y", "return bonds 20y", "return credit bbb"]
COLUMNS += ["return equity", "return property", "inflation", "wage", "zero 1", "zero 10"]


@pytest.fixture
def case(tmp_path):
    """A copy of the small example that a test may spoil."""
    return Path(shutil.copytree(TEMPLATE, tmp_path / "case"))


def listing(folder: Path) -> dict[str, bytes]:
    """Every file below `folder` with its content."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def refused(folder: Path, named: list[str]) -> str:
    """Asserts one mistake of one line that names these words; returns it."""
    before = listing(folder.parent)
    with pytest.raises(CaseError) as caught:
        DOMAIN.study(DOMAIN.read(*load(folder)), Options())
    message = str(caught.value)
    assert len(message.splitlines()) == 1, message
    for name in named:
        assert name in message, message
    assert listing(folder.parent) == before
    return message


# The actuary's figures are compared with the valued fund, which has to be compiled.
SLOW = ("figure that is missed",)


@pytest.mark.parametrize(
    "mistake", [pytest.param(m, marks=[pytest.mark.prove] * (m in SLOW)) for m in MISTAKES]
)
def test_a_mistake_is_named_and_nothing_is_written(mistake, case):
    name, old, new, named = MISTAKES[mistake]
    file = case / name
    if new is ...:
        file.unlink()
    elif old is None:
        file.write_bytes(new if isinstance(new, bytes) else new.encode())
    else:
        text = file.read_text(encoding="utf-8")
        assert old in text
        file.write_text(text.replace(old, new, 1), encoding="utf-8")
    refused(case, named)


def supply(case: Path, drop: tuple[int, int] | None = None) -> None:
    """Two paths of ten years by month; without the row (path, month) `drop`."""
    lines = [",".join(["path", "month", *COLUMNS])]
    for path in (1, 2):
        for month in range(1, 121):
            if (path, month) != drop:
                cells = ["0.001"] * 8 + ["0.02", "0.025"]
                lines.append(",".join([str(path), str(month), *cells]))
    for name in ("training.csv", "evaluation.csv"):
        (case / name).write_text("\n".join(lines) + "\n")
    text = (case / "case.toml").read_text(encoding="utf-8")
    (case / "case.toml").write_text(text + SCENARIOS, encoding="utf-8")


def test_scenarios_with_a_hole(case):
    supply(case, drop=(2, 57))
    refused(case, ["training.csv", "no row for path 2, step 57", "all 120 steps"])


def test_scenarios_without_a_class(case):
    supply(case)
    file = case / "training.csv"
    file.write_text(file.read_text().replace("return equity", "return stocks"))
    refused(case, ["training.csv", "return Equity", "missing"])


def test_scenarios_measured_on_the_training_paths(case):
    supply(case)
    text = (case / "case.toml").read_text()
    (case / "case.toml").write_text(text.replace('"evaluation.csv"\n', '"training.csv"\n'))
    refused(case, ["scenarios.evaluation", "paths on which it was trained"])


def test_level_payments_end_after_a_whole_step(case):
    file = case / "case.toml"
    text = file.read_text(encoding="utf-8").replace('kind = "spread"  ', 'kind = "target"  ', 1)
    level = 'recovery = "level"\nrecovery_years = 5.01'
    file.write_text(text.replace("spread_factor = 0.06", level), encoding="utf-8")
    refused(case, ["case.toml", "plan.contribution.recovery_years", "5.01", "whole steps of 1m"])


def test_several_mistakes_are_told_at_once(case):
    text = (case / "case.toml").read_text(encoding="utf-8")
    text = text.replace("valuation_date = ", "valuation = ").replace("assets = 3", "asets = 3")
    (case / "case.toml").write_text(text, encoding="utf-8")
    with pytest.raises(CaseError) as caught:
        DOMAIN.read(*load(case))
    message = str(caught.value)
    for name in ("fund.valuation", "nearest known key is", "fund.asets"):
        assert name in message


def test_smith_wilson_needs_zero_or_swap_rates(case):
    for name, old, new in (
        ("curve.csv", "tenor,zero", "tenor,forward"),
        ("case.toml", 'measure = "P"', 'extrapolation = "smith-wilson"\nultimate = 0.03'),
    ):
        file = case / name
        file.write_text(file.read_text().replace(old, new, 1))
    refused(case, ["curve.file", "zero or swap"])
