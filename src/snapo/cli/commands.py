"""What each command does: read the case, call its domain, print. Anything heavier is imported late.

A domain is found by the case's `kind`: its package has `case.read_case(path)`, a `template`
folder, and `run` with `check(case)`, `solve(case, …)` and `report(folder)`.
"""

import argparse
import json
import math
import os
import sys
from contextlib import redirect_stdout, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.case.table import load, nearest

from .main import KINDS
from .new import write_case
from .own import read_own

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
GOOD = ("ok", "trained", "stopped early")


def run(options: argparse.Namespace) -> int:
    """Runs the command that `options` name; mistakes in the input become one message."""
    commands = {"new": _new, "check": _check, "solve": _solve, "report": _report, "bench": _bench}
    try:
        return commands[options.command](options)
    except CaseError as error:
        say(f"snapo: {error}")
        if getattr(options, "json", False):
            print(to_json({"status": "bad-input", "message": str(error)}))
        return BAD_INPUT
    except KeyboardInterrupt:
        say("snapo: interrupted")
        return INTERRUPTED


def say(text: str) -> None:
    """One line for a person, on stderr at once: stdout is for results."""
    print(text, file=sys.stderr, flush=True)


def _new(options: argparse.Namespace) -> int:
    written = write_case(KINDS[options.kind], options.folder, options.size)
    print("\n".join(map(str, written)))
    say(f"now: snapo solve {options.folder}")
    return OK


def _check(options: argparse.Namespace) -> int:
    if options.simulator:
        _, own = read_own(options.simulator, options.case)
        findings = import_module("snapo.checker.check").check(own["simulator"], own["inputs"])
        print(findings)
        return OK if findings.ok else FAILED
    case = _read(options.case)
    print("\n".join(import_module(f"{_package(case.kind)}.run").check(case)))
    return OK


def _use_every_core() -> None:
    """XLA runs one device per core; JAX must hear of it before its first computation."""
    import jax

    with suppress(RuntimeError):  # it has computed already: then it keeps the devices it has
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)


def _solve(options: argparse.Namespace) -> int:
    with redirect_stdout(sys.stderr):
        result = _solve_own(options) if options.simulator else _solve_case(options)
    print(to_json(result) if options.json else summary(result))
    return OK if result.get("status") in GOOD else FAILED


def _solve_case(options: argparse.Namespace) -> dict[str, Any]:
    case = _read(options.case)
    _use_every_core()
    return import_module(f"{_package(case.kind)}.run").solve(
        case,
        out=options.out or case.file.parent / "run",
        seed=case.training.seed if options.seed is None else options.seed,
        engine=options.engine,
        reference=options.reference,
        resume=options.resume,
        progress=say,
    )


def _solve_own(options: argparse.Namespace) -> dict[str, Any]:
    if options.reference:
        what = "a simulator of your own has no references"
        raise CaseError("--reference", "", None, what)
    file, own = read_own(options.simulator, options.case)
    _use_every_core()
    return import_module("snapo.study.run_folder").solve_own(
        **own,
        out=options.out or file.parent / "run",
        seed=own["training"].seed if options.seed is None else options.seed,
        engine=options.engine,
        resume=options.resume,
        progress=say,
    )


def _report(options: argparse.Namespace) -> int:
    file = options.run / "result.json"
    try:
        kind = json.loads(file.read_text(encoding="utf-8"))["kind"]
    except (OSError, ValueError, KeyError, TypeError):
        what = "this is not the folder of a run: `snapo solve` writes result.json into it"
        raise CaseError(str(options.run), "", None, what) from None
    print(import_module(f"{_package(kind)}.run").report(options.run))
    return OK


def _bench(options: argparse.Namespace) -> int:
    domain = import_module(f"{_package('gas-storage')}.bench")
    print(domain.bench(engine=options.engine, progress=say))
    return OK


def _read(path: Path) -> Any:
    """The case at `path`, read by the domain that its `kind` names; remarks go to stderr."""
    file, data = load(path)
    kind = data.get("kind")
    if kind not in KINDS:
        kinds = ", ".join(f'"{known}"' for known in sorted(KINDS))
        if kind is None:
            raise CaseError(str(file), "kind", None, f"this key is missing; it is one of {kinds}")
        close = nearest(str(kind), sorted(KINDS)) if isinstance(kind, str) else ""
        raise CaseError(str(file), "kind", kind, f"allowed is one of {kinds}; {close}".rstrip("; "))
    case = import_module(f"{_package(kind)}.case").resolve(file, data)
    for note in case.notes:
        say(f"note: {note}")
    return case


def _package(kind: str) -> str:
    if kind not in KINDS:
        raise CaseError("result.json", "kind", kind, f"allowed is one of {', '.join(KINDS)}")
    return KINDS[kind]


def summary(result: dict[str, Any]) -> str:
    """The result for a person: the value, what stands beside it, and where the run lies."""
    lines = [f"{result.get('kind', '')}: {result.get('status', '')}"]
    for key in ("value", "standard_error", "smooth_value", "smoothing_gap"):
        if result.get(key) is not None:
            lines.append(f"{key.replace('_', ' '):<24}{_figure(result[key]):>16}")
    for name, value in (result.get("references") or {}).items():
        if value is not None:
            lines.append(f"{name.replace('_', ' '):<24}{_figure(value):>16}")
    seconds = (result.get("seconds") or {}).get("total")
    if seconds is not None:
        lines.append(f"{'seconds':<24}{seconds:>16,.1f}")
    if result.get("run"):
        lines.append(f"report: {Path(result['run']) / 'report.html'}")
    return "\n".join(lines)


def _figure(value: float) -> str:
    """Money to the cent; what is small, such as a utility, with its significant digits."""
    return f"{value:,.2f}" if abs(value) >= 10 else f"{value:,.6g}"


def to_json(result: Any) -> str:
    """One JSON object; what is not finite becomes null, which JSON can say."""
    return json.dumps(_plain(result), allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, Path):
        return str(value)
    number = float(value) if not hasattr(value, "tolist") else value.tolist()
    if isinstance(number, float):
        return number if math.isfinite(number) else None
    return _plain(number)
