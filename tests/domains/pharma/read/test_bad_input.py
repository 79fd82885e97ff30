"""Each mistake in a pharma case: exit code 2, the whole message, and nothing written."""

import shutil
from pathlib import Path

import pytest
from tests.domains.pharma.pharma_cases import TEMPLATE

from snapo.cli.main import main

REACTOR = """[units.reactor]
type = "reactor"
kind = "batch"                    # or "semi-batch" (dosing), "stirred" or "plug-flow" (volume)
duration = "3600 s"
temperature = "313.15 K"
"""
LAST = """[[connections]]
from = "dryer.product"
to = "tablet.product"
"""
CRYSTALLISER_FED = """from = "reactor.product"
to = "crystalliser.feed"
"""

# Each mistake: what is replaced by what, and the message after the name of the file.
MISTAKES = {
    "unknown species in a reaction": (
        'equation = "C + A -> D"', 'equation = "C + A -> E"',
        "reactions[1].equation: got 'C + A -> E'; there is no species E; "
        "the known species are A, B, C, D.",
    ),
    "unknown species in a feed": (
        'B = "0.33 mol/L" }', 'E = "0.33 mol/L" }',
        "feeds.charge.concentration.E: got 'E'; there is no species E; "
        "the known species are A, B, C, D.",
    ),
    "unknown solute": (
        'solute = "C"', 'solute = "X"',
        "units.crystalliser.solute: got 'X'; there is no such species; "
        "the known species are A, B, C, D.",
    ),
    "mass not conserved": (
        '"A + B -> C"', '"A + 2 B -> C"',
        "reactions[0].equation: got 'A + 2 B -> C'; mass is not conserved: the left side weighs "
        "200 g/mol and the right side 150 g/mol.",
    ),
    "no equation": (
        '"A + B -> C"', '"A + B = C"',
        "reactions[0].equation: got 'A + B = C'; it must be an equation such as \"A + 2 B -> C\".",
    ),
    "missing unit": (
        REACTOR, REACTOR.replace('"313.15 K"', "313.15"),
        "units.reactor.temperature: got 313.15; a quantity needs its unit, such as \"313.15 K\".",
    ),
    "missing unit in a text": (
        'porosity = 0.4', 'porosity = 0.4\nresistance = "1e11"',
        "units.filter.resistance: got '1e11'; a quantity needs its unit, such as \"1.5 m/kg\".",
    ),
    "unit that does not exist": (
        'area = "200 cm^2"', 'area = "200 square"',
        "units.filter.area: got '200 square'; there is no unit 'square'.",
    ),
    "unit that is code": (
        'area = "200 cm^2"', 'area = "200 __import__(\'os\')"',
        "units.filter.area: got \"200 __import__('os')\"; \"__import__('os')\" is not the name of "
        "a unit.",
    ),
    "wrong dimension": (
        'duration = "7200 s"', 'duration = "7200 m"',
        "units.crystalliser.duration: got '7200 m'; m is [length], but the quantity is [time], s.",
    ),
    "prefactor of another order": (
        'prefactor = "5.3e2 L/mol/s"', 'prefactor = "5.3e2 1/s"',
        "reactions[1].prefactor: got '5.3e2 1/s'; 1/s is 1 / [time], but the quantity is [length] ** 3 / [substance] / [time], m3/kmol/s.",
    ),
    "coulomb for Celsius": (
        'temperature = "323.15 K"\nrate', 'temperature = "50 C"\nrate',
        "units.dryer.temperature: got '50 C'; C is [current] * [time], but the quantity is [temperature], K.",
    ),
    "negative concentration": (
        '{ A = "0.33 mol/L", B', '{ A = "-0.33 mol/L", B',
        "feeds.charge.concentration.A: got '-0.33 mol/L'; it must be a quantity of at least 0.",
    ),
    "negative time": (
        'duration = "7200 s"', 'duration = "-7200 s"',
        "units.crystalliser.duration: got '-7200 s'; it must be a quantity above 0.",
    ),
    "no volume": (
        'volume = "60 L"\n', 'volume = "0 L"\n',
        "feeds.charge.volume: got '0 L'; it must be a quantity above 0.",
    ),
    "temperature below zero": (
        REACTOR, REACTOR.replace('"313.15 K"', '"-300 degC"'),
        "units.reactor.temperature: got '-300 degC'; it must be a quantity from 100 to 1,000 K (25 degC is 298.15 K).",
    ),
    "infinite": (
        'growth = "5 um/s"', 'growth = "1e999 um/s"',
        "units.crystalliser.kinetics.growth: got '1e999 um/s'; it must be a quantity of at least 0, and finite.",
    ),
    "loop": (
        '[[connections]]\nfrom = "charge"\nto = "reactor.feed"', '[units.mix]\ntype = "tank"\n'
        'inlets = ["fresh", "back"]\n[units.split]\ntype = "splitter"\noutlets = ["on", "back"]\n'
        'share = 0.9\n[[connections]]\nfrom = "charge"\nto = "mix.fresh"\n[[connections]]\n'
        'from = "mix.product"\nto = "split.feed"\n[[connections]]\nfrom = "split.back"\n'
        'to = "mix.back"\n[[connections]]\nfrom = "split.on"\nto = "reactor.feed"',
        "connections: a batch reaches the loop mix -> split, which is solved at its steady state: "
        "every feed of the loop needs a duration, because its units take only flows.",
    ),
    "unconnected port": (
        LAST, "",
        "connections: the inlet tablet.product is not fed; unused outlets are "
        "filter.filtrate, filter.washings, dryer.product, dryer.vapour.",
    ),
    "port fed twice": (
        LAST, LAST + '[[connections]]\nfrom = "filter.washings"\nto = "tablet.product"\n',
        "connections[5].to: got 'tablet.product'; this port is connected already, to "
        "dryer.product.",
    ),
    "outlet used twice": (
        LAST, LAST.replace("dryer.product", "filter.cake"),
        "connections[4].from: got 'filter.cake'; this port is connected already, to dryer.cake.",
    ),
    "unknown port": (
        LAST, LAST.replace("tablet.product", "tablet.produkt"),
        "connections[4].to: got 'tablet.produkt'; there is no such port; the nearest known port "
        "is tablet.product.",
    ),
    "filter without crystals": (
        CRYSTALLISER_FED, 'from = "reactor.product"\nto = "filter.slurry"\n[[connections]]\n'
        'from = "charge2"\nto = "crystalliser.feed"\n',
        None,
    ),
    "unknown measure": (
        'measure = "dryer.solvent"', 'measure = "dryer.solvents"',
        "attributes[3].measure: got 'dryer.solvents'; there is no such measure; the nearest known "
        "measure is dryer.solvent.",
    ),
    "limits the wrong way round": (
        'low = "70 um"', 'low = "120 um"',
        "attributes[1].high: got '100 um'; it must be above the lower limit, 120 um.",
    ),
    "limit in another dimension": (
        'low = "70 um"', 'low = "80 s"',
        "attributes[1].low: got '80 s'; s is [time], but the quantity is [length], m.",
    ),
    "limit without a citation": (
        'citation = "own limit, constructed for this example"\n\n[[attributes]]\nname = "mean',
        '\n[[attributes]]\nname = "mean',
        "attributes[0].citation: a limit needs a source, or a note that you set it.",
    ),
    "nominal outside its range": (
        'range = ["304 K", "311 K"]', 'range = ["309 K", "311 K"]',
        "parameters[1].range: got ['309 K', '311 K']; the nominal value of "
        "crystalliser.temperature[1], 308 K, must lie in the range.",
    ),
    "normal range outside the range": (
        'normal = ["294 K", "296 K"]', 'normal = ["280 K", "296 K"]',
        "parameters[2].normal: got ['280 K', '296 K']; the normal range must lie in the range, "
        "288 K to 302 K.",
    ),
    "range the wrong way round": (
        'range = [1, 4]', 'range = [4, 1]',
        "parameters[4].range: got [4, 1]; the first number must lie below the second.",
    ),
    "entry out of reach": (
        'of = "crystalliser.temperature[3]"', 'of = "crystalliser.temperature[4]"',
        "parameters[3].of: got 'crystalliser.temperature[4]'; its entries are 0 to 3 or node 0, "
        "node 1, node 2, node 3.",
    ),
    "entry not said": (
        'of = "crystalliser.temperature[3]"', 'of = "crystalliser.temperature"',
        "parameters[3].of: got 'crystalliser.temperature'; crystalliser.temperature has 4 "
        "entries; specify one, such as crystalliser.temperature[0].",
    ),
    "two parameters of one number": (
        'of = "dryer.temperature"\nrange = ["313.15 K", "333.15 K"]\nnormal = ["321.15 K", "325.15 K"]\n'
        'distribution = { kind = "normal", spread = "0.5 K" }',
        'of = "filter.wash_ratio"\nrange = [1, 4]\nnormal = [1.8, 2.2]',
        None,
    ),
    "shares that do not rise": (
        'ramp = "0.6 K/min" }', 'at = [0, 0.6, 0.5, 1] }',
        "units.crystalliser.temperature.at: got [0, 0.6, 0.5, 1]; the shares must increase from 0 "
        "to 1.",
    ),
    "ramp that is a temperature": (
        'ramp = "0.6 K/min" }', 'ramp = "0.6 K" }',
        "units.crystalliser.temperature.ramp: got '0.6 K'; K is [temperature], but the quantity is [temperature] / [time], K/s.",
    ),
    "porosity": (
        "porosity = 0.4", "porosity = 1.0",
        "units.filter.porosity: got 1; it must be a number from 0.1 to 0.95.",
    ),
    "probability": (
        "required = 0.9", "required = 1.5",
        "design_space.required: got 1.5; it must be a probability between 0 and 1.",
    ),
    "unknown axis": (
        'axes = ["T1", "T_d"]', 'axes = ["T1", "T_g"]',
        "design_space.axes[1]: got 'T_g'; there is no such parameter; the nearest known parameter "
        "is T_f.",
    ),
    "correlations of no numbers": (
        "# Where the probability", '[[correlations]]\nbetween = ["kinetics.prefactor[0]", '
        '"kinetics.prefactor[1]"]\nvalue = 0.9\n[[correlations]]\nbetween = '
        '["kinetics.prefactor[0]", "crystalliser.kinetics.growth"]\nvalue = 0.9\n'
        '[[correlations]]\nbetween = ["kinetics.prefactor[1]", "crystalliser.kinetics.growth"]\n'
        "value = -0.9\n# Where the probability",
        "correlations: the matrix of all correlations is not positive definite.",
    ),
    "spread in percent of a temperature": (
        '{ kind = "normal", spread = "0.5 K" }', '{ kind = "normal", spread = 0.5 }',
        "parameters[5].distribution.spread: got 0.5; a quantity needs its unit, such as "
        "\"313.15 K\".",
    ),
    "spread with a unit for a logarithm": (
        'of = "crystalliser.kinetics.growth"\ndistribution = { kind = "lognormal", spread = 0.1 }',
        'of = "crystalliser.kinetics.growth"\n'
        'distribution = { kind = "lognormal", spread = "1 um/s" }',
        "uncertainty[1].distribution.spread: got '1 um/s'; um/s is [length] / [time], but the quantity is a pure number.",
    ),
    "varied twice": (
        'of = "crystalliser.kinetics.growth"\n', 'of = "dryer.temperature"\n',
        None,
    ),
    "key of another kind": (
        REACTOR, REACTOR + 'dosing = "0.01 L/s"\n',
        "units.reactor.dosing: got '0.01 L/s'; kind \"batch\" has no such key; it belongs to "
        '"semi-batch".',
    ),
    "key that its kind needs": (
        REACTOR, REACTOR.replace('"batch"', '"plug-flow"'),
        'units.reactor.volume: kind "plug-flow" needs this key.',
    ),
    "wash of another kind": (
        "efficiency = 0.9", "peclet = 20",
        'units.filter.efficiency: wash "exponential" needs this key.',
    ),
    "unknown type": (
        'type = "dryer"', 'type = "drier"',
        None,
    ),
    "misspelt key": (
        'porosity = 0.4', 'porosty = 0.4',
        "units.filter.porosty: got 0.4; there is no such key; the nearest known key is porosity.",
    ),
    "name that is taken": (
        "[units.tablet]", "[units.process]",
        "units.process: got 'process'; a name has letters, digits, - and _, and begins with a "
        'letter; "process" and "kinetics" are reserved.',
    ),
    "held parameter": (
        '# held = ["charge.temperature"]', 'held = ["dryer.temperature"]',
        "held: got 'dryer.temperature'; parameter T_d is one of these numbers, and needs a "
        "sensitivity.",
    ),
    "unknown pair": (
        "# held", 'pairs = [["T_R", "X"]]\n# held',
        "pairs[0]: got 'X'; there is no such parameter; there are T_R, T1, T2, T_f, W, T_d.",
    ),
    "goal without its attribute": (
        "# Where the probability", '[goal]\nkind = "mean"\n# Where the probability',
        None,
    ),
}  # fmt: skip
# Mistakes of which the message need only name these words.
NAMED = {
    "filter without crystals": ["connections[2].from", "charge2", "no such port"],
    "two parameters of one number": ["parameters[5].of", "parameter W has this number too"],
    "varied twice": ["dryer.temperature[0]", "[[parameters]] as well; keep"],
    "unknown type": ["units.dryer.type", "'drier'", "the nearest known type is dryer"],
    "goal without its attribute": ["goal.attribute", "no such attribute"],
}


@pytest.fixture
def case(tmp_path) -> Path:
    """A copy of the template that a test may spoil."""
    return Path(shutil.copytree(TEMPLATE.parent, tmp_path / "case"))


def spoil(case: Path, old: str, new: str) -> None:
    file = case / "case.toml"
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")


def refused(case: Path, capsys) -> str:
    """Asserts exit code 2 and that `solve` wrote nothing; returns the message."""
    before = {p: p.read_bytes() for p in case.parent.rglob("*") if p.is_file()}
    assert main(["solve", str(case), "--out", str(case.parent / "out")]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and len(printed.err.splitlines()) == 1
    assert {p: p.read_bytes() for p in case.parent.rglob("*") if p.is_file()} == before
    return printed.err.removeprefix("snapo: ").strip()


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_and_nothing_is_written(mistake, case, capsys):
    old, new, message = MISTAKES[mistake]
    spoil(case, old, new)
    said = refused(case, capsys)
    if message is not None:
        assert said == f"{case / 'case.toml'}, {message}"
    for name in NAMED.get(mistake, []):
        assert name in said, said


DATA = "time,state,value,error\n600 s,reactor.concentration.A,0.118 mol/L,0.001 mol/L\n"
ESTIMATION = """[estimation]
[[estimation.fit]]
of = "kinetics.prefactor[product]"
low = "1e3 L/mol/s"
high = "1e6 L/mol/s"
logarithm = true
[[estimation.experiments]]
name = "one"
data = "one.csv"
settings = { "reactor.temperature" = "303 K" }
"""
BAD_DATA = {
    "value without a unit": (
        "0.118 mol/L", "0.118", ["one.csv, line 2, column value", "needs its unit"],
    ),
    "unknown state": ("n.A", "n.E", ["one.csv, line 2, column state", "the nearest known state is reactor."]),
    "error of zero": ("0.001 mol/L", "0 mol/L", ["one.csv, line 2, column error", "above 0"]),
    "too few": ("", "", ["estimation.experiments", "1 measurements are too few to fit 1"]),
    "no such file": (None, None, ["estimation.experiments[0].data", "no such file"]),
}  # fmt: skip


@pytest.mark.parametrize("mistake", BAD_DATA)
def test_a_mistake_in_the_data_is_named(mistake, case, capsys):
    old, new, named = BAD_DATA[mistake]
    file = case / "case.toml"
    file.write_text(file.read_text(encoding="utf-8") + ESTIMATION, encoding="utf-8")
    if old is not None:
        (case / "one.csv").write_text(DATA.replace(old, new, 1))
    said = refused(case, capsys)
    for name in named:
        assert name in said, said


@pytest.mark.parametrize(
    ("held", "where"),
    [
        ("kinetics.prefactor", "estimation.fit[0].of"),
        ("kinetics.activation", "estimation.experiments.one.settings"),
    ],
)
def test_a_number_of_an_estimation_cannot_be_held(held, where, case, capsys):
    setting = '"kinetics.activation[product]" = "41 kJ/mol"'
    more = ESTIMATION.replace('"reactor.temperature" = "303 K"', setting)
    file = case / "case.toml"
    text = file.read_text(encoding="utf-8")
    (case / "one.csv").write_text(DATA + DATA.splitlines()[1].replace("600", "1800") + "\n")
    file.write_text(text + more, encoding="utf-8")
    assert main(["check", str(case)]) == 0
    capsys.readouterr()
    held_too = text.replace('# held = ["charge.temperature"]', f'held = ["{held}"]')
    file.write_text(held_too + more, encoding="utf-8")
    message = "this number is in the list `held`, whose numbers cannot be varied"
    assert refused(case, capsys) == f"{file}, {where}: got '{held}'; {message}."
