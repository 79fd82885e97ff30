"""After ± stands half of a 95 % interval, on every page and terminal, from one function."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import snapo
from snapo.report.quantity import PLUS_MINUS, measured, plus_minus, plus_minus_half
from snapo.solver import statistics
from snapo.solver.statistics import Estimate, Sampled

ROOT = Path(snapo.__file__).parent
WRITERS = ("report/quantity.py", "report/page.py", "solver/statistics.py")  # ± before a number
# Differences between two numbers that should be equal, no estimates.
ERRORS = {"line.error", "sums.error"}
FORMATTERS = {"number", "percent", "quantity", "power", "large", "money", "points", "_figure"}


def faults(text: str) -> list[str]:
    """What a source writes of errors by itself: ± before a number, or a standard error."""
    nodes = list(ast.walk(ast.parse(text)))
    documented = {
        id(node.body[0].value)
        for node in nodes
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    found = []
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            for part, following in zip(node.values, node.values[1:]):
                ends = isinstance(part, ast.Constant) and str(part.value).rstrip().endswith("±")
                if ends and "half" not in ast.unparse(following):
                    found.append(f"{node.lineno}: {ast.unparse(node)}")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in documented and re.search(
                r"one standard error|std\. error|^standard error$", node.value, re.I
            ):
                found.append(f"{node.lineno}: {node.value!r}")
        elif isinstance(node, ast.Call) and node.args:
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            shown = ast.unparse(node.args[0]) if name in FORMATTERS else ""
            is_error = re.search(r"(standard_error|_error|\.error)$", shown) and shown not in ERRORS
            if is_error and "worst" not in shown:
                found.append(f"{node.lineno}: {ast.unparse(node)}")
    return found


def test_the_search_finds_what_it_is_for():
    assert faults('f"{value} ± {error:.2g}"') and faults('head = ("Std. error", "")')
    assert faults("number(test.standard_error)") and faults('x = "± one standard error"')
    assert not faults('f"{value} ± {half:.2g}"') and not faults('"""The standard error."""')


FILES = [x for x in sorted(ROOT.rglob("*.py")) if str(x.relative_to(ROOT)) not in WRITERS]


def test_no_source_writes_an_error_by_itself():
    found = {str(x.relative_to(ROOT)): faults(x.read_text(encoding="utf-8")) for x in FILES}
    assert not {file: items for file, items in found.items() if items}


def test_no_script_of_the_live_page_writes_an_error_by_itself():
    scripts = {file.name: file.read_text(encoding="utf-8") for file in ROOT.glob("live/page/*.js")}
    assert [name for name, text in scripts.items() if "± $" in text] == ["numbers.js"]
    assert scripts["numbers.js"].count("± $") == 1
    half = re.search(r"HALF = ([\d.]+)", scripts["numbers.js"])
    assert half and float(half[1]) == pytest.approx(statistics.critical(), abs=1e-5)
    page = (ROOT / "live/page/index.html").read_text(encoding="utf-8")
    assert page.count(PLUS_MINUS) == 1


def test_half_of_the_interval_is_that_of_students_t():
    assert statistics.plus_minus(10.0, 3) == "± 19.6"
    assert plus_minus(10.0, 1) == plus_minus_half(19.6, 1) == measured(1.0, 10.0, 1)[1]
    few = Sampled(0.0, 1.0, 9)
    assert str(few) == "0.0 ± 2.3" and few.interval()[1] == pytest.approx(stats.t.ppf(0.975, 9))
    blocks = np.random.default_rng(0).normal(size=32)
    half = stats.t.ppf(0.975, 31) * np.std(blocks, ddof=1) / np.sqrt(32)
    assert str(Estimate(blocks)).endswith(f"± {half:.2f}")
