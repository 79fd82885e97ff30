"""The cost of a second contract in a process that has solved a first one of the same shape.

    python -m benchmarks.second_contract [DOMAIN …]

The second contract has as many prices, rates, volumes, costs and dates as the first one, but other
values. Training and evaluation are as short as possible, so that the remaining
work is measured. The program prints processor seconds, the numbers of compiled programs of JAX and
of the native engine, and whether the results have the same bits as in a separate process.
"""

import datetime
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from snapo.case.load import load
from snapo.study.study import Setup

EVENTS = {"/jax/core/compile/backend_compile_duration": "XLA", "/snapo/compile": "native"}
SHORT = {"steps": 2, "paths": 64, "validation_paths": 64}
FEW = {"paths": 128, "sensitivity_paths": 128, "judge_paths": 0, "search_paths": 0}


def storage(second: bool) -> Setup:
    """The template of a gas store; the second store starts a year later, in another market."""
    from snapo.domains.gas_storage import setup
    from snapo.domains.gas_storage.read.case import read_case

    with tempfile.TemporaryDirectory() as folder:
        file, data = load(Path(setup.__file__).parent / "template")
        for table in file.parent.glob("*.csv"):
            text = table.read_text(encoding="utf-8")
            (Path(folder) / table.name).write_text(_later(text) if second else text, "utf-8")
        if second:
            data["contract"] |= {
                "start": datetime.date(2022, 4, 1),
                "end": datetime.date(2023, 4, 1),
                "inventory": 1200.0,
                "max_inventory": 6800.0,
                "injection_cost": 0.02,
            }
            data["market"]["valuation_date"] = datetime.date(2022, 4, 25)
            data["market"]["settlement"] = {"months": 1, "day": 25}
            data["model"]["spot_volatility"] = 0.7
        data["training"], data["evaluation"] = SHORT, FEW
        case = read_case(Path(folder) / file.name, data)
    return setup.make_setup(case, "native", setup.fitted_value(setup.bare_problem(case)))


def _later(text: str) -> str:
    """A table whose dates are a year later, and whose last column is larger by a twentieth."""

    def row(line: str) -> str:
        start, _, last = line.rpartition(",")
        start = re.sub(r"^\d{4}", lambda year: str(int(year[0]) + 1), start)
        return f"{start},{1.05 * float(last):.6g}"

    head, *rows = text.splitlines()
    return "\n".join([head, *map(row, rows)]) + "\n"


def stores(second: bool) -> Setup:
    """The template of a depot with stores; the second case has other costs."""
    from snapo.domains.inventory import setup
    from snapo.domains.inventory.read.network import read_network

    file, data = load(Path(setup.__file__).parent / "template_stores")
    if second:
        for table in data["place"]:
            table["holding"] *= 1.05
    data["training"], data["evaluation"] = SHORT, FEW
    return setup.make_setup(read_network(file, data), "native")


def fund(second: bool) -> Setup:
    """The template of a small fund; the second fund is a year later, and its members are older."""
    return _fund("small", second)


def pots(second: bool) -> Setup:
    """The template of a fund of personal pots; the second case is changed like that of a fund."""
    return _fund("wtp", second)


def _fund(name: str, second: bool) -> Setup:
    from snapo.domains.pension import DOMAIN
    from snapo.domains.pension.results.setup import make_setup

    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(str(DOMAIN.templates[name]), folder, dirs_exist_ok=True)
        file, data = load(Path(folder))
        if second:
            day = data["fund"]["valuation_date"]
            data["fund"] |= {
                "assets": 1.1 * data["fund"]["assets"],
                "valuation_date": day.replace(year=day.year + 1),
            }
            data["rates"]["volatility"] = 0.009
            data["plan"]["retirement_age"] = 68.0
            for table, found, other in (
                ("cohorts.csv", r"(male,)(\d+)", _older),
                ("assets.csv", r"(Equity,equity,[\d.]+,[\d.]+,[\d.]+,0,)0.6,", r"\g<1>0.65,"),
            ):
                text = (file.parent / table).read_text("utf-8")
                (file.parent / table).write_text(re.sub(found, other, text), "utf-8")
        data["training"], data["evaluation"] = SHORT, FEW
        case = DOMAIN.read(file, data)
    return make_setup(case, "native")


def _older(age: re.Match) -> str:
    return f"{age[1]}{int(age[2]) + 1}"


def plant(second: bool) -> Setup:
    """The template of a pendulum; the second pendulum is heavier, and has another cost."""
    from snapo.domains.control import read, study

    file, data = load(Path(study.__file__).parent / "template" / "pendulum")
    if second:
        data["plant"]["mass"] = 1.1
        data["cost"] = data.get("cost", {}) | {"speed": 0.12}
    data["training"], data["evaluation"] = SHORT, FEW
    return study.make_setup(read.read_case(file, data), "native")


def reactor(second: bool) -> Setup:
    """The reactor of the template of a process, in closed loop; the second reactor has more feed
    and faster reactions."""
    from snapo.domains.pharma import study
    from snapo.domains.pharma.control.closed_loop import ClosedLoop
    from snapo.domains.pharma.read.case import resolve

    file, data = load(Path(study.__file__).parent / "template")
    data = {
        key: data[key] for key in ("kind", "species", "reactions", "feeds", "units", "parameters")
    }
    if second:
        data["feeds"]["charge"]["volume"] = "65 L"
        data["reactions"][0]["prefactor"] = "2.8e4 L/mol/s"
    data["units"] = {"reactor": data["units"]["reactor"]}
    data["parameters"] = data["parameters"][:1]  # the temperature of the reactor
    data["connections"] = [{"from": "charge", "to": "reactor.feed"}]
    concentration = {"measure": "reactor.concentration.C", "unit": "mol/L", "low": "0.11 mol/L"}
    data["attributes"] = [{"name": "product", "citation": "made up", **concentration}]
    varied = {"kind": "lognormal", "spread": 0.1}
    data["uncertainty"] = [{"of": "kinetics.prefactor", "distribution": varied}]
    decided = {"of": "reactor.temperature", "low": "303 K", "high": "323 K"}
    sensor = {"state": "reactor.concentration.C", "error": "1e-3 mol/L"}
    sensor |= {"centre": "0.1 mol/L", "width": "0.05 mol/L"}
    control = {"manipulated": [decided], "measurements": [sensor]}
    data["control"] = {"steps": {"reactor": 3}, "substeps": 16, **control}
    data["training"], data["evaluation"] = SHORT, FEW
    return ClosedLoop(resolve(file, data), "xla").setup()


DOMAINS: dict[str, Callable[[bool], Setup]] = {
    "gas-storage": storage,
    "inventory": stores,
    "control": plant,
    "pension": fund,
    "pots": pots,
}


def solved(domain: str, second: bool) -> dict[str, Any]:
    """One contract, prepared and solved: its seconds, its compilations, and a digest of its
    numbers."""
    made = dict.fromkeys(EVENTS.values(), 0)

    def count(event: str, duration_secs: float, **more: Any) -> None:
        if event in EVENTS:
            made[EVENTS[event]] += 1

    jax.monitoring.register_event_duration_secs_listener(count)
    started = time.process_time()
    setup = DOMAINS[domain](second)
    solution = setup.solve()
    spent = time.process_time() - started
    jax.monitoring.unregister_event_duration_listener(count)
    assert solution.sensitivities is not None
    held = {name: found.value for name, found in solution.sensitivities.held.items()}
    leaves = jax.tree.leaves((solution.totals, solution.policy, held))
    arrays = b"".join(np.asarray(leaf).tobytes() for leaf in filter(eqx.is_array, leaves))
    return {
        "seconds": spent,
        **made,
        "value": solution.value,
        "digest": hashlib.blake2b(arrays).hexdigest()[:16],
    }


def apart(domain: str, *which: bool) -> list[dict[str, Any]]:
    """Contracts solved one after another in a separate process, without kernels on disk."""
    words = [sys.executable, "-m", "benchmarks.second_contract", "--apart", domain]
    with tempfile.TemporaryDirectory() as empty:
        own = os.environ | {"XDG_CACHE_HOME": empty}
        asked = [*words, *(str(int(each)) for each in which)]
        done = subprocess.run(asked, env=own, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def table(domain: str) -> Iterator[str]:
    """The lines of one domain."""
    first, second = apart(domain, False, True)
    (alone,) = apart(domain, True)
    for name, found in (("first", first), ("second", second), ("second alone", alone)):
        yield (
            f"{domain:<12} {name:<13} {found['seconds']:6.2f} processor s, "
            f"{found['XLA']:4d} programs of XLA, {found['native']:3d} of the native engine, "
            f"value {found['value']:,.2f}"
        )
    same = "the same bits" if second["digest"] == alone["digest"] else "OTHER BITS"
    yield f"{domain:<12} the second contract has {same} as in a separate process"


if __name__ == "__main__":
    if sys.argv[1:2] == ["--apart"]:
        print(json.dumps([solved(sys.argv[2], each == "1") for each in sys.argv[3:]]))
    else:
        for domain in sys.argv[1:] or DOMAINS:
            for line in table(domain):
                print(line, flush=True)
