"""The checks that every run is put to, and the words for what is not in order."""

import math
from typing import Any, Protocol

from ..quality.estimation import DOUBT

CLOSED, AGREED = 1e-10, 1e-10  # relative gaps of balances, and of paths against the matrix
CELLS = "twice as many cells"
LOST = 1e-3  # share of batches without a finite result from which a run is not in order


class Tables(Protocol):
    """A run while it is done, or its folder."""

    def get(self, path: str, default: Any = None) -> Any: ...


def checks(run: Tables) -> list[tuple[str, bool]]:
    """(name of the check, whether it held)."""
    found = []
    balances = run.get("balances")
    if balances:
        found.append(("balances", all(closed(each) for each in balances)))
    if run.get("convergence") is not None:
        found.append(("convergence in time", bool(run.get("convergence.passed"))))
    cells = run.get("convergence.cells")
    if cells:
        found.append((CELLS, all(each.get("passed") for each in cells)))
    if run.get("certificate"):
        good = all(each.get("passed") for each in run.get("certificate"))
        found.append(("adjoint against differences", good))
    closure = run.get("attribution.closure")
    if run.get("attribution") is not None:
        found.append(("paths add up", closure is not None and closure <= AGREED))
    return found


def closed(each: dict[str, Any]) -> bool:
    """Whether a balance closes; one that is not a number does not."""
    gap = each.get("relative")
    return each.get("quantity") == "energy" or (gap is not None and abs(gap) <= CLOSED)


def status(run: Tables) -> str:
    """The first thing that is not in order, in words, or "ok"."""
    batch = run.get("run.status", "ok")
    if batch != "ok":
        return str(batch)
    missing = [name for name, x in (run.get("run.attributes") or {}).items() if x is None]
    if missing:
        return f"{missing[0]} is not a number"
    if run.get("estimation") and not run.get("estimation.converged"):
        return f"the fit did not converge: {run.get('estimation.message')}"
    tail = run.get("estimation.tail")
    if tail is not None and tail < DOUBT:
        return (
            f"the fit does not describe its data: chi² {run.get('estimation.chi2'):.4g} at "
            f"{run.get('estimation.freedom')} degrees of freedom, which chance exceeds in "
            f"{tail:.1g} of all cases"
        )
    if run.get("optimise") and not run.get("optimise.converged"):
        return f"the best recipe did not converge: {run.get('optimise.message')}"
    failed = [name for name, good in checks(run) if not good]
    if failed:
        return f"a check fails: {', '.join(name + _where(run, name) for name in failed)}"
    count = run.get("capability.batches")
    lost = (run.get("capability.failed") or 0) / count if count else 0.0
    if lost > LOST:
        return f"{100 * lost:.2g} % of the batches gave no finite result"
    return "ok"


def _where(run: Tables, name: str) -> str:
    """Where a check that does not hold is off most, in brackets."""
    if name == "balances":
        row = next(each for each in run.get("balances") if not closed(each))
        keys = ("unit", "quantity")
    elif name == "adjoint against differences":
        row = next(each for each in run.get("certificate") if not each.get("passed"))
        keys = ("attribute", "parameter", "point")
    elif name == "convergence in time":
        rows = run.get("convergence.rows", [])
        row = max(rows, key=_gap, default={})
        keys = ("attribute", "parameter")
    elif name == CELLS:
        row = max(run.get("convergence.cells"), key=lambda each: each.get("margins") or math.inf)
        keys = ("attribute",)
    else:
        return ""
    said = ", ".join(str(row[key]) for key in keys if row.get(key))
    return f" ({said})" if said else ""


def _gap(row: dict[str, Any]) -> float:
    """The larger gap of a row of the table of convergence; one that is not a number is largest."""
    gaps = (row.get("halving_gap"), row.get("adaptive_gap"))
    return max(math.inf if gap is None else abs(gap) for gap in gaps)
