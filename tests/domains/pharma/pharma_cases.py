"""Pharma cases as files, runs of them, and processes with closed forms in place of a flowsheet."""

import copy
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import snapo
from snapo.domains.pharma.flowsheet.case import PharmaCase
from snapo.domains.pharma.flowsheet.inputs import pharma_inputs
from snapo.domains.pharma.read.case import resolve
from snapo.report.folder import RunFiles
from snapo.study import commands
from snapo.testing.miniature import quiet

TEMPLATE = Path(snapo.__file__).parent / "domains" / "pharma" / "template" / "case.toml"


def template(**changes) -> PharmaCase:
    """The template, with tables of the file replaced or (a table for a table) changed."""
    data = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))
    for name, value in changes.items():
        known = data.get(name)
        data[name] = {**known, **value} if isinstance(known, dict) and value else value
    return resolve(TEMPLATE, copy.deepcopy({k: v for k, v in data.items() if v is not None}))


def feed(name: str, volume: str, concentration: str, *more: str) -> str:
    """`[feeds.NAME]`, at 313.15 K in a solvent of 880 kg/m3."""
    rows = (
        f"[feeds.{name}]",
        f'volume = "{volume}"',
        'temperature = "313.15 K"',
        f"concentration = {{ {concentration} }}",
        'solvent = "880 kg/m^3"',
        *more,
    )
    return "\n".join(rows) + "\n"


def connections(*pairs: tuple[str, str]) -> str:
    """`[[connections]]`, each from one port to another."""
    return "".join(f'[[connections]]\nfrom = "{a}"\nto = "{b}"\n' for a, b in pairs)


def parameter(name: str, of: str, reach: list[str], normal: list[str]) -> str:
    """`[[parameters]]`"""
    rows = (
        "[[parameters]]",
        f'name = "{name}"',
        f'of = "{of}"',
        f"range = {reach}",
        f"normal = {normal}",
        'source = "constructed"',
    )
    return "\n".join(rows) + "\n"


def attribute(name: str, measure: str, unit: str, *limits: str) -> str:
    """`[[attributes]]`"""
    rows = ("[[attributes]]", f'name = "{name}"', f'measure = "{measure}"', f'unit = "{unit}"')
    cited = ('citation = "constructed"',) if limits else ()
    return "\n".join((*rows, *limits, *cited)) + "\n"


# A continuous crystalliser of 30 L whose steady state has a closed form (Randolph and Larson).
COLD = """
type = "msmpr"
solute = "P"
volume = "30 L"
temperature = "283.15 K"
growth = "0.2 um/s"
growth_order = 1.3
nucleation = "1e6 1/m^3/s"
reference_growth = "0.05 um/s"
reference_suspension = "20 kg/m^3"
growth_power = 2
suspension_power = 0.7
shape = 0.5236
density = "1200 kg/m^3"
solubility = { coefficients = [226.9, -1.88, 3.89e-3] }
basis = "suspension"
"""

# A -> B for an hour: at 0.26 1/s explicit steps on 320 pieces are not stable.
FAST = (
    """kind = "pharma"
[species]
A = { molar_mass = "100 g/mol" }
B = { molar_mass = "100 g/mol" }
[[reactions]]
name = "r"
equation = "A -> B"
prefactor = "0.26 1/s"
activation = "0 J/mol"
[units.reactor]
type = "reactor"
duration = "1 h"
temperature = "313.15 K"
"""
    + feed("charge", "60 L", 'A = "1 mol/L"')
    + connections(("charge", "reactor.feed"))
    + parameter("k", "kinetics.prefactor", ["0.01 1/s", "0.3 1/s"], ["0.015 1/s", "0.27 1/s"])
    + parameter("t", "reactor.duration", ["30 min", "90 min"], ["55 min", "65 min"])
    + attribute("A left", "reactor.concentration.A", "mol/L", 'high = "0.5 mol/L"')
)


def fast(constant: float = 0.26, **numerics) -> PharmaCase:
    """`FAST` with this rate constant in 1/s and these `[numerics]`."""
    data = tomllib.loads(FAST.replace("0.26 1/s", f"{constant} 1/s"))
    return resolve(Path("case.toml"), data | {"numerics": numerics})


class Batch(NamedTuple):
    values: np.ndarray
    jacobian: np.ndarray | None
    ok: np.ndarray


class Polynomial:
    """Attributes a + b . x + x . C x of the moved entries x, about the case's nominal numbers.

    `slope` {(input, entry): [Q]}, `curve` the same for squares; it has the methods of a process
    that statistics need.
    """

    def __init__(self, case, constant, slope, curve=None):
        self.case, self.constant = case, np.asarray(constant, float)
        self.slope, self.curve = slope, curve or {}
        self.inputs = {k: np.array(v.value) for k, v in pharma_inputs(case).items()}
        self.calls = 0

    def batch(self, entries, draws, sensitivities=(), chunk=512):
        self.calls += len(draws)
        values = np.tile(self.constant, (len(draws), 1))
        for (name, entry), column in zip(entries, np.asarray(draws).T):
            x = (column - self.inputs[name][entry])[:, None]
            values = values + x * self.slope.get((name, entry), 0.0)
            values = values + x**2 * self.curve.get((name, entry), 0.0)
        return Batch(values, None, np.isfinite(values).all(1))


class FirstOrder:
    """One reaction c' = -k exp(-E / R / T) c, c(0) = 0.33: what a fit needs of a process."""

    def __init__(self, case):
        self.case = case
        self.inputs = {k: np.array(v.value) for k, v in pharma_inputs(case).items()}

    def shifted(self, changes, entries, inputs):
        found = dict(inputs)
        for i, (name, entry) in enumerate(entries):
            found[name] = jnp.asarray(found[name]).at[entry].set(changes[i])
        return found

    def observe(self, inputs, unit, states, times):
        k = inputs["kinetics.prefactor"][0]
        energy = inputs["kinetics.activation"][0]
        rate = k * jnp.exp(-energy / 8.314 / inputs["reactor.temperature"][0])
        return 0.33 * jnp.exp(-rate * 0.33 * jnp.asarray(times))


# Concentrations of an isothermal batch at 313.15 K with the kinetics published with PharmaPy, from
# a multistep solution at a relative tolerance of 1e-11: at 600, 1800 and 3600 s, kmol/m3.
TIMES = (600, 1800, 3600)
BATCH = {
    "A": (0.118582315, 0.022330171, 0.002312084),
    "B": (0.165839680, 0.113279266, 0.103639153),
    "C": (0.116902954, 0.125771639, 0.125033777),
    "D": (0.047257366, 0.090949095, 0.101327069),
}
CASE = """kind = "pharma"
title = "Batch reactor"
pairs = [["T", "t"]]
[species]
A = { molar_mass = "100 g/mol" }
B = { molar_mass = "50 g/mol" }
C = { molar_mass = "150 g/mol" }
D = { molar_mass = "250 g/mol" }
[[reactions]]
name = "product"
equation = "A + B -> C"
prefactor = "2.2e4 L/mol/s"
activation = "40 kJ/mol"
[[reactions]]
name = "impurity"
equation = "C + A -> D"
prefactor = "6e2 L/mol/s"
activation = "30 kJ/mol"
[feeds.charge]
volume = "60 L"
temperature = "313.15 K"
concentration = { A = "0.33 mol/L", B = "0.33 mol/L" }
solvent = "887.6 kg/m^3"
[units.reactor]
type = "reactor"
duration = "3600 s"
temperature = "40 degC"
[[connections]]
from = "charge"
to = "reactor.feed"
[[parameters]]
name = "T"
of = "reactor.temperature"
range = ["30 degC", "50 degC"]
normal = ["39 degC", "41 degC"]
distribution = { kind = "normal", spread = "0.5 degC" }
source = "made up"
[[parameters]]
name = "t"
of = "reactor.duration"
range = ["30 min", "90 min"]
normal = ["55 min", "65 min"]
source = "made up"
[[attributes]]
name = "product"
measure = "reactor.concentration.C"
unit = "mol/L"
low = "0.11 mol/L"
citation = "made up"
[[attributes]]
name = "impurity"
measure = "reactor.concentration.D"
unit = "mol/L"
high = "0.12 mol/L"
citation = "made up"
[[uncertainty]]
of = "kinetics.prefactor"
distribution = { kind = "lognormal", spread = 0.1 }
[design_space]
axes = ["T", "t"]
points = 5
samples = 32
[estimation]
[[estimation.fit]]
of = "kinetics.prefactor[product]"
low = "1e3 L/mol/s"
high = "1e6 L/mol/s"
logarithm = true
[[estimation.fit]]
of = "kinetics.prefactor[impurity]"
low = "1e1 L/mol/s"
high = "1e4 L/mol/s"
logarithm = true
[[estimation.experiments]]
name = "batch"
data = "batch.csv"
[evaluation]
paths = 256
"""


def data() -> str:
    """What was measured of `CASE`, as a CSV file."""
    rows = ["time,state,value,error"]
    for name, values in BATCH.items():
        for time, value in zip(TIMES, values):
            rows.append(f"{time} s,reactor.concentration.{name},{value} mol/L,1e-4 mol/L")
    return "\n".join(rows) + "\n"


LOOP = """
[control]
steps = { reactor = 3 }
substeps = 16
[[control.manipulated]]
of = "reactor.temperature"
low = "30 degC"
high = "50 degC"
[[control.measurements]]
state = "reactor.concentration.C"
error = "0.001 mol/L"
centre = "0.1 mol/L"
width = "0.05 mol/L"
[optimise]
[[optimise.terms]]
of = "reactor.concentration.C"
unit = "mol/L"
[[optimise.per]]
of = "reactor.duration"
unit = "h"
[[optimise.decisions]]
of = "reactor.temperature"
low = "30 degC"
high = "50 degC"
[[optimise.decisions]]
of = "reactor.duration"
low = "15 min"
high = "90 min"
[goal]
kind = "mean"
attribute = "product"
[training]
steps = 6
paths = 16
validation_paths = 64
validation_every = 3
"""
SMALLER = ("design_space", "estimation", "pairs", "evaluation")


# A controller beside the policy, which measures with a delay.
RULE = """[[control.rules]]
name = "PI"
[[control.rules.loops]]
of = "reactor.temperature"
measure = "reactor.concentration.C"
gain = "-50 K/(mol/L)"
"""
RULED_LOOP = LOOP.replace("[optimise]", RULE + "[optimise]", 1).replace(
    'width = "0.05', 'delay = "7 min"\nwidth = "0.05'
)


def small(text: str) -> str:
    """A case without the parts that other tests run, and with few paths."""
    kept = text[: text.index("[design_space]")] + text[text.index("[control]") :]
    kept = kept.replace('pairs = [["T", "t"]]\n', "")
    return (
        kept
        + "[evaluation]\npaths = 128\nsensitivity_paths = 64\nsearch_paths = 0\n[numerics]\nrefine = false\n"
    )


def solve(folder: Path, out: Path, *changes: str) -> tuple[dict[str, Any], RunFiles]:
    """A run of the case in a folder as the command does it: result.json, and what was found."""
    result = commands.solve(commands.CaseRequest(folder, changes), quiet, out=out)
    return result, RunFiles.read(out)
