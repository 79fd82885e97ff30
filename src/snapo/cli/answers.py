"""The output of the commands, as text and as JSON."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def by_seed(result: Mapping[str, Any]) -> list[str]:
    """The table of `--seeds` as text."""
    lines = [f"{'seed':>8}{'value':>18}{'below the best':>30}{'seconds':>10}   verdict"]
    for row in result["rows"]:
        below = "the best"
        if row["seed"] != result["best"]:
            below = _known(row["below_best"], row["below_best_error"])
        verdict = ", ".join(filter(None, (row["status"], row["convergence"])))
        value = _known(row["value"])
        lines.append(f"{row['seed']:>8}{value:>18}{below:>30}{row['seconds']:>10,.1f}   {verdict}")
    worst, best = (_known(result[name]) for name in ("worst", "highest"))
    mean = _known(result["mean"], result["standard_error"])
    spread = f"standard deviation between seeds {_known(result['deviation'])}"
    endpoints = f"mean {mean}, worst {worst}, best {best}; {spread}"
    note = (
        f"± is half of a 95 % interval on {result['paths']:,} common paths, simulation error only"
    )
    return [*lines, f"{endpoints}; {note}"]


def _known(value: float | None, error: float | None = None) -> str:
    return "none" if value is None else f"{_figure(value)}{_half(error)}"


def _half(error: float | None) -> str:
    from snapo.solver.statistics import plus_minus

    return "" if error is None else f" {plus_minus(error)}"


def _two_digits(value: float) -> str:
    from snapo.solver.statistics import rounded

    return rounded(value, 2)


def summary(result: Mapping[str, Any]) -> str:
    """The result as text: the value, further figures, and the folder of the run."""
    seeds = by_seed(result["seeds"]) if result.get("seeds") else []
    lines = [*seeds, f"{result.get('kind', '')}: {result.get('status', '')}"]
    for key in ("value", "smooth_value", "smoothing_gap"):
        if result.get(key) is not None:
            half = _half(result.get("standard_error")) if key == "value" else ""
            note = f"   {result['meaning']}" if key == "value" and result.get("meaning") else ""
            note = f"{half} (95 %){note}" if half else note
            lines.append(f"{key.replace('_', ' '):<24}{_figure(result[key]):>16}{note}")
    for name, value in (result.get("references") or {}).items():
        if value is not None:
            small = (result.get("bound") or {}).get("says_little") if name == "upper_bound" else ""
            note = f"   {small}" if small else ""
            error = (result.get("reference_errors") or {}).get(name)
            note += "" if error is None else f"   finer grids move it by {_two_digits(error)}"
            lines.append(f"{name.replace('_', ' '):<24}{_figure(value):>16}{note}")
    lines += result.get("description") or []
    start = result.get("start") or {}
    for key, name in (("before", "given policy"), ("value", "gained over it")):
        if start.get(key) is not None and "before" in start:
            lines.append(f"{name:<24}{_figure(start[key]):>16}")
    seconds = (result.get("seconds") or {}).get("total")
    if seconds is not None:
        lines.append(f"{'seconds':<24}{seconds:>16,.1f}")
    lines += [f"{part}: {note}" for part, note in (result.get("failures") or {}).items()]
    if result.get("verdict"):
        lines.append(result["verdict"])
    if result.get("run"):
        lines.append(f"report: {_report_of(result)}")
    return "\n".join(lines)


def _report_of(result: Mapping[str, Any]) -> Path:
    """The path of the report, with the shortest name of its run."""
    from snapo.study.runs.store import shown

    return shown(Path(result["run"])) / "report.html"


def bounds(result: Mapping[str, Any]) -> str:
    """The bounds as text, each with its 95 % interval."""
    results = result.get("bound") or {}
    lines = [f"{result.get('kind', '')}: 95 % intervals, {results.get('paths', 0):,} paths"]
    for name in ("lower", "upper", "gap"):
        item = results.get(name)
        if item:
            low, high = _figure(item["low"]), _figure(item["high"])
            lines.append(f"{name:<8}{_figure(item['value']):>16}   {low} to {high}")
    if results.get("says_little"):
        lines.append(f"this bound {results['says_little']}")
    lines.append(f"report: {_report_of(result)}")
    return "\n".join(lines)


def _figure(value: float) -> str:
    """Money to the cent; small numbers, such as a utility, with a fixed number of significant
    digits."""
    return f"{value:,.2f}" if abs(value) >= 10 else f"{value:,.6g}"


def to_json(result: Any) -> str:
    """One JSON object; non-finite numbers become null."""
    return json.dumps(_plain(result), allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, Path):
        return str(value)
    number = float(value) if not hasattr(value, "tolist") else value.tolist()
    if isinstance(number, float):
        return number if math.isfinite(number) else None
    return _plain(number)
