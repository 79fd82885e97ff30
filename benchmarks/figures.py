"""The figures of README and docs, which are stored in one place, `docs/figures.toml`.

    python -m benchmarks.figures                pages take their figures from that file
    python -m benchmarks.figures demo RUN       first the table `demo`, and its picture, from a run
    python -m benchmarks.figures cases FOLDER   first the table `cases`, from runs of the templates
    python -m benchmarks.figures reservoir      first the table `reservoir`, by running the example
    python -m benchmarks.figures pharma LOG     first a table of `make bench`, from its output

`make demo` and `make bench` do the same. Every table has the machine, the date and the command. In
a page a figure stands between two comments, `<!--demo.value-->78,377 ± 2<!--/-->`; a block of
output stands between two lines of the same form. `tests/benchmarks/test_figures.py` compares both.
"""

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

import snapo
from snapo.solver.statistics import half_width

ROOT = Path(__file__).parents[1]
FILE = ROOT / "docs" / "figures.toml"
MARKED = re.compile(r"(<!--([\w.]+)-->)(.*?)(<!--/-->)", re.S)
# {table: {figure: where it stands in the lines that `make bench` prints}}; several are a range.
TAKEN = {
    "gas_storage": {
        "total": r"^Native +smooth.* ([\d.]+)$",
        "held": r"^Native +held.* ([\d.]+)$",
        "total_xla": r"^Xla +smooth.* ([\d.]+)$",
        "held_xla": r"^Xla +held.* ([\d.]+)$",
    },
    "native": {
        "flops": r"threads, (\d+) GFLOP/s",
        "floor": r"multiply-add floor: ([\d.]+)",
        "storage": r"^storage, float32 .* ([\d.]+) +10 ",
        "width_64": r"^width 64 .* ([\d.]+) +7 ",
        "width_128": r"^width 128 .* ([\d.]+) +4 ",
        "factors": r"^300 correlated factors .* ([\d.]+) +5 ",
        "steps": r"^3650 steps .* ([\d.]+) +7 ",
        "first": r"first result: ([\d.]+) s",
        "on_disk": r"kernel on disk: ([\d.]+) s",
    },
    "pension": {
        "ratio": r"^(?:small|medium|large) .* ([\d.]+) +[\d.]+s +\d+$",
        "small": r"^small .* (\d+)$",
        "medium": r"^medium .* (\d+)$",
        "large": r"^large .* (\d+)$",
    },
    "pharma": {
        "temperatures": r"faster (\d+) times",
        "temperatures_native": r"([\d.]+) times where",
        "batches": r"^  batch  .* ([\d.]+ s) for 10,000",
        "one_by_one": r"same call, one by one.* ([\d.]+ s) for",
        "adjoint": r"snapo adjoint, 5 passes +([\d.]+ ms)",
        "adjoint_casadi": r"CasADi adjoint, 5 passes +([\d.]+ ms)",
        "forward": r"snapo chosen mode +([\d.]+ ms)",
        "forward_casadi": r"CasADi forward +([\d.]+ ms)",
    },
}
PLAIN_PATHS = 2000  # of the example in cmdty-storage's README
FENCE = "\n```text\n{}\n```\n"
HEAD = """\
# Figures of README and docs, written by `make demo` and `make bench`; see benchmarks/figures.py.
# A table that says so was taken from an earlier measurement.
"""


def figures() -> dict[str, dict[str, str]]:
    """{table: {figure: its text}}."""
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


def pages(root: Path = ROOT) -> list[Path]:
    """README and docs."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def record(table: str, command: str, values: Mapping[str, str]) -> None:
    """Rewrites a table of the file, with machine and date; figures without a new text stay."""
    from .machine import machine

    tables = figures() if FILE.exists() else {}
    about = {"command": command, "machine": machine(), "date": date.today().isoformat()}
    tables[table] = tables.get(table, {}) | about | dict(values)
    FILE.write_text(HEAD + "".join(_written(tables)), encoding="utf-8")


def _written(tables: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    for name, entries in tables.items():
        yield f"\n[{name}]\n"
        for key, text in entries.items():
            quoted = f"'''\n{text}'''" if "\n" in text else json.dumps(text, ensure_ascii=False)
            yield f"{key} = {quoted}\n"


def text_of(name: str, tables: Mapping[str, Mapping[str, str]]) -> str:
    """The text of a page between the comments of a figure."""
    table, _, key = name.partition(".")
    text = tables[table][key]
    return FENCE.format(text) if "\n" in text else text


def filled(page: str, tables: Mapping[str, Mapping[str, str]]) -> str:
    """A page with the figures of the file."""
    return MARKED.sub(lambda m: m[1] + text_of(m[2], tables) + m[4], page)


def fill() -> None:
    """Writes the figures into all pages."""
    tables = figures()
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if (new := filled(text, tables)) != text:
            page.write_text(new, encoding="utf-8")
            print(f"figures in {page.relative_to(ROOT)}")


def taken(table: str, lines: list[str]) -> dict[str, str]:
    """The figures of a table of `make bench`, from its lines; those of programs that are missing on
    this machine are unchanged."""
    found = {}
    for name, pattern in TAKEN[table].items():
        texts = [m[1] for line in lines if (m := re.search(pattern, line.rstrip()))]
        if texts:
            low, high = min(texts, key=_number), max(texts, key=_number)
            found[name] = low if low == high else f"{low} to {high}"
    return found


def _number(text: str) -> float:
    return float(text.split()[0])


def demo(run: Path) -> dict[str, str]:
    """The figures of a run of the flagship case."""
    deviation = np.std(snapo.Solution.load(run).totals["cash_flow"])
    result = json.loads((run / "result.json").read_text(encoding="utf-8"))
    ladder = json.loads((run / "parts" / "value-ladder.json").read_text(encoding="utf-8"))
    rungs = {rung["name"]: _estimate(rung) for rung in ladder["value_ladder"]}
    bound, names = result["bound"], (run / "sensitivities.csv").read_text(encoding="utf-8")
    lines = names.splitlines()[1:]
    share, seconds = bound["gap"]["value"] / result["value"], result["seconds"]
    return {
        "value": rungs["Trained policy"],
        "starting_rule": rungs["Fitted rule"],
        "intrinsic": rungs["Intrinsic"],
        "upper_bound": rungs["Upper bound"],
        "upper_95": f"{bound['upper']['high']:,.0f}",
        "gap": f"{100 * share:.2f} %",
        "deltas": f"{sum(line.startswith('forward_curve,') for line in lines)}",
        "inputs": f"{len(lines)}",
        "deviation": f"{deviation:,.0f}",
        "plain_error": f"{deviation / PLAIN_PATHS**0.5:.0f}",
        "seconds": f"{seconds['total'] - seconds.get('dynamic programming', 0.0):.0f} s",
    }


def exact(run: Path) -> dict[str, str]:
    """Value and error of dynamic programming in a run with `--reference`; else nothing."""
    result = json.loads((run / "result.json").read_text(encoding="utf-8"))
    value = result["references"].get("dynamic_programming")
    errors = result.get("reference_errors") or {}
    if value is None:
        return {}
    return {"value": f"{value:,.0f}", "grid_error": f"{errors['dynamic_programming']:,.0f}"}


def cases(folder: Path) -> dict[str, str]:
    """The figures of the templates, solved as `snapo new KIND KIND` writes them in this folder."""

    def result(kind: str) -> dict[str, Any]:
        return json.loads((folder / kind / "run" / "result.json").read_text(encoding="utf-8"))

    def estimate(kind: str) -> tuple[float, float]:
        entries = result(kind)
        return entries["value"], half_width(entries["standard_error"])

    stock, parts = result("inventory"), folder / "pension" / "run" / "parts"
    policies = json.loads((parts / "classical-policies.json").read_text(encoding="utf-8"))
    leads = {
        row["key"]: (1e4 * row["lead"], half_width(1e4 * row["lead_error"]))
        for row in policies["policies"]
    }
    tuned = min(leads[key] for key in ("constant_mix", "glide_path", "liability_driven"))
    return {
        **{
            name: f"{x['value']:,.2f} ± {half_width(x['standard_error']):.2f}"
            for kind in ("swing", "battery", "park-and-loan", "stores", "plant")
            for name, x in (
                (kind.replace("-", "_"), result(kind)),
                (f"{kind.replace('-', '_')}_upper", result(kind)["bound"]["upper"]),
            )
        },
        "inventory": f"{-stock['value']:.3f} ± {half_width(stock['standard_error']):.3f}",
        "base_stock": f"{-stock['references']['base stock']:.2f}",
        "pharma": "{:.3f} ± {:.3f}".format(*estimate("pharma")),
        "control": "{:.1f} ± {:.1f}".format(*estimate("control")),
        "lead_present": "{:.0f} ± {:.0f}".format(*leads["present_mix"]),
        "lead_tuned": "{:.1f} ± {:.1f}".format(*tuned),
    }


def _estimate(rung: Mapping[str, Any]) -> str:
    error = rung["standard_error"]
    return f"{rung['value']:,.0f}" + ("" if error is None else f" {plus_minus_of(error)}")


def plus_minus_of(error: float) -> str:
    """Half of the 95 % interval in whole units."""
    return f"± {half_width(error):,.0f}"


def reservoir() -> dict[str, str]:
    """The output of the README's example, and its value."""
    command = [sys.executable, "examples/own_simulator.py"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    output = done.stdout.strip()
    value = output.split()[1:4]
    return {"output": output, "value": " ".join(value)}


def main(arguments: list[str]) -> None:
    """Measures one table, if the arguments select one; then fills all pages."""
    if arguments[:1] == ["demo"]:
        from snapo.domains.gas_storage.report import readme_picture

        run = Path(arguments[1])
        record("demo", "make demo", demo(run))
        if found := exact(run):
            record("exact", "snapo solve demo --reference", found)
        value = figures()["exact"]["value"].replace(",", "")
        picture = readme_picture(run, exact=float(value))
        (FILE.parent / "storage.svg").write_text(picture, encoding="utf-8")
    elif arguments[:1] == ["cases"]:
        record("cases", "snapo new KIND; snapo solve KIND", cases(Path(arguments[1])))
    elif arguments == ["reservoir"]:
        record("reservoir", "python examples/own_simulator.py", reservoir())
    elif arguments and arguments[0] in TAKEN:
        lines = Path(arguments[1]).read_text(encoding="utf-8").splitlines()
        record(arguments[0], "make bench", taken(arguments[0], lines))
    elif arguments:
        sys.exit(__doc__)
    fill()


if __name__ == "__main__":
    main(sys.argv[1:])
