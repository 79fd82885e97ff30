"""`snapo`: reads the arguments; imports NumPy and JAX only when they are needed."""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from snapo import __version__

from .arguments import (
    RUN,
    add_cache,
    add_compare,
    add_completion,
    add_explain,
    add_past,
    add_runs,
    add_schema,
    even_number,
    port,
    seed,
    seeds,
    shard,
    simulator_class,
    whole_number,
)  # fmt: skip

ENGINES = ("auto", "xla", "native")
PENALTIES = ("none", "value", "trained")
ENGINE = "native compiles the simulator for CPUs, xla uses JAX; auto uses native if possible"
EXTRAS = {  # and the packages that they bring
    "cli": ("pydantic", "jinja2", "matplotlib", "scipy"), "pharma": ("diffrax", "pint"),
    "live": ("aiohttp",), "xlsx": ("openpyxl",), "parquet": ("pyarrow",), "book": ("duckdb",),
    "gym": ("gymnasium",), "chemicals": ("chemicals",), "native": ("llvmlite",),
}  # fmt: skip
CASE = "a TOML file, a folder with case.toml, or a workbook (.xlsx)"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code.

    0: done; 1: the command failed; 2: the input is wrong; 130: the command was interrupted; 141:
    the program that reads the output, such as `head`, has closed it.
    """
    options = _parser().parse_args(arguments)
    try:
        if options.command == "completion":
            from .completion import script

            print(script(_parser(), options.shell), end="")
            code = 0
        else:
            from .commands import run

            code = run(options)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the rest of the output is dropped
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # as of a program that SIGPIPE ends
    except ModuleNotFoundError as error:
        extra = next((key for key, names in EXTRAS.items() if error.name in names), None)
        if extra is None:
            raise
        message = f"snapo {options.command} needs {error.name}: pip install 'snapo[{extra}]'"
        print(f"snapo: {message}", file=sys.stderr)
        if options.json:
            print(json.dumps({"status": "bad-input", "message": message}))
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="snapo",
        description="Trains a decision rule inside a differentiable simulator, and returns the "
        "value of the rule with its sensitivity to every input.",
        epilog="start with: snapo new gas-storage mystore && snapo solve mystore",
    )
    parser.add_argument("--version", action="version", version=f"snapo {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in (
        _add_new,
        _add_check,
        _add_solve,
        _add_book,
        _add_sweep,
        _add_certify,
        add_past,
        _add_report,
        _add_export,
        _add_open,
        add_compare,
        add_explain,
        add_runs,
        _add_bench,
        add_schema,
        add_cache,
    ):
        add(commands)
    for choice in commands.choices.values():
        choice.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    add_completion(commands)
    return parser


def _add_new(commands) -> None:
    new = commands.add_parser(
        "new",
        help="write a commented case that runs",
        epilog="snapo new, without KIND, lists the kinds that are installed",
    )
    new.add_argument("kind", metavar="KIND", nargs="?", help="kind of case, such as gas-storage")
    new.add_argument(
        "folder",
        metavar="DIR",
        type=Path,
        nargs="?",
        help="folder of the case, which is created if it does not exist; no file is overwritten",
    )
    new.add_argument("--size", metavar="SIZE", help="size of the example, if the kind has several")
    new.add_argument(
        "--xlsx",
        action="store_true",
        help="write a workbook, case.xlsx, instead of TOML and CSV files",
    )


def _add_check(commands) -> None:
    check = commands.add_parser(
        "check", help="validate a case and list its errors, without training"
    )
    _add_case(check)


def _add_solve(commands) -> None:
    solve = commands.add_parser("solve", help="train, evaluate and report")
    _add_case(solve)
    solve.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of the run; an existing run in it is replaced (default: a new folder in "
        "runs, next to the case; the link run points to it)",
    )
    solve.add_argument("--engine", choices=ENGINES, default="auto", help=ENGINE)
    solve.add_argument(
        "--reference",
        action="store_true",
        help="also compute an exact value for comparison, if there is a method for this case",
    )
    solve.add_argument(
        "--ladder",
        action="store_true",
        help="value the contract by all methods, on common paths",
    )
    solve.add_argument(
        "--hedge",
        action="store_true",
        help="simulate profit and loss of the contract with hedges in traded products",
    )
    solve.add_argument(
        "--gamma",
        action="store_true",
        help="measure the change of every delta with the price of every product or month",
    )
    solve.add_argument("--resume", action="store_true", help="continue an interrupted run")
    solve.add_argument(
        "--policy",
        metavar="RUN",
        type=Path,
        help="start from the policy of this run, or of a file that policy.save wrote",
    )
    solve.add_argument(
        "--seeds",
        metavar="N",
        type=seeds,
        help="train with N consecutive seeds, or with the seeds of a list (0,3,7); keep the best "
        "run",
    )
    _add_workers(
        solve, "number of processes on this machine that share the paths of a large problem"
    )


def _add_book(commands) -> None:
    book = commands.add_parser(
        "book", help="value a book of contracts under stresses, on several workers"
    )
    book.add_argument(
        "book", metavar="BOOK", type=Path, help="a TOML file; with --sql, the folder of its results"
    )
    book.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of the results (default: run, next to the file of the book)",
    )
    _add_workers(book, "number of processes on this machine (default: one per core)")
    book.add_argument(
        "--shard",
        metavar="K/N",
        type=shard,
        help="compute part K of N, counted from 1; all parts use the same folder",
    )
    book.add_argument(
        "--resume", action="store_true", help="reuse the results of an earlier run in this folder"
    )
    book.add_argument(
        "--sql", metavar="QUERY", help="run an SQL query on the tables values, deltas and shares"
    )


def _add_workers(parser: argparse.ArgumentParser, processes: str) -> None:
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", metavar="N", type=whole_number, help=processes)
    where.add_argument(
        "--on",
        metavar="WHERE",
        default="",
        help="dask:ADDRESS, ray:ADDRESS, or MODULE:FUNCTION of a function that returns an executor",
    )
    parser.add_argument(
        "--trust-network",
        action="store_true",
        help="use a scheduler on another machine that has neither TLS nor a token",
    )


def _add_sweep(commands) -> None:
    sweep = commands.add_parser(
        "sweep",
        help="value a case over ranges of its numbers; returns a table and a picture",
        epilog="snapo sweep mystore --set contract.injection_cost=0:0.1:5 "
        "--set contract.max_inventory=4000:8000:3",
    )
    sweep.add_argument("case", metavar="CASE", type=Path, help="a TOML file or its folder")
    sweep.add_argument(
        "--set",
        metavar="KEY=FIRST:LAST:N",
        dest="assignments",
        action="append",
        default=[],
        help="a key of the case and its values: N values from FIRST to LAST, a list (1,2,5), or "
        "one value; repeatable: all combinations are valued",
    )
    sweep.add_argument("--seed", metavar="N", type=seed, help="the same as --set training.seed=N")
    sweep.add_argument(
        "--train",
        action="store_true",
        help="train a policy at every point (default: the policy of the case at all points)",
    )
    sweep.add_argument(
        "--sobol",
        metavar="N",
        type=whole_number,
        help="use this number of Sobol points in the ranges FIRST:LAST instead of a grid",
    )
    sweep.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of the results (default: sweep, next to the case)",
    )
    sweep.add_argument(
        "--workers",
        metavar="N",
        type=whole_number,
        help="number of processes on this machine (default: one per core)",
    )
    sweep.add_argument(
        "--resume", action="store_true", help="reuse the results of an earlier run in this folder"
    )


def _add_certify(commands) -> None:
    certify = commands.add_parser("certify", help="bound the value of a run from both sides")
    certify.add_argument("run", metavar="RUN", type=Path, help=RUN)
    certify.add_argument(
        "--paths",
        metavar="N",
        type=even_number,
        help="number of paths for the bound (default: 1024)",
    )
    certify.add_argument(
        "--penalty",
        choices=PENALTIES,
        default="value",
        help="the penalty for foresight: none, a fitted value function, or a fitted value "
        "function scaled to minimise the bound",
    )
    certify.add_argument("--engine", choices=ENGINES, default="auto", help=ENGINE)
    _add_simulator(certify)


def _add_report(commands) -> None:
    report = commands.add_parser("report", help="write the report of a run again")
    report.add_argument("run", metavar="RUN", type=Path, help=RUN)
    report.add_argument(
        "--pdf",
        action="store_true",
        help="also write report.pdf, with an installed Chrome, Chromium or Edge",
    )
    report.add_argument(
        "--xlsx",
        action="store_true",
        help="also write the tables of the run as a workbook, tables.xlsx",
    )


def _add_export(commands) -> None:
    export = commands.add_parser(
        "export",
        help="write the policy of a run in other forms, next to its report",
        epilog="snapo export mine/run --onnx --table",
    )
    export.add_argument("run", metavar="RUN", type=Path, help=RUN)
    export.add_argument("--onnx", action="store_true", help="write an ONNX graph, policy.onnx")
    export.add_argument(
        "--table",
        action="store_true",
        help="write a table of observations and decisions, policy.csv",
    )
    export.add_argument(
        "--python", action="store_true", help="write a Python file that needs NumPy only, policy.py"
    )
    _add_simulator(export)


def _add_open(commands) -> None:
    page = commands.add_parser("open", help="change the inputs of a run and see its value, live")
    page.add_argument("run", metavar="RUN", type=Path, help=RUN)
    page.add_argument(
        "--port",
        metavar="N",
        type=port,
        default=0,
        help="port of this machine (default: a free one)",
    )
    page.add_argument("--no-browser", action="store_true", help="print the address only")
    page.add_argument(
        "--paths",
        metavar="N",
        type=even_number,
        help="number of paths for the value (default: chosen for a small error, 1024 to 12288)",
    )
    page.add_argument("--engine", choices=ENGINES, default="auto", help=ENGINE)
    _add_simulator(page)


def _add_bench(commands) -> None:
    bench = commands.add_parser(
        "bench", help="measure the time of values and gradients on this machine"
    )
    bench.add_argument(
        "kind", metavar="KIND", nargs="?", help="kind of case (default: all that are installed)"
    )
    bench.add_argument("--engine", choices=ENGINES, default="auto", help=ENGINE)


def _add_case(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("case", metavar="CASE", type=Path, help=CASE)
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        dest="assignments",
        action="append",
        default=[],
        help="change a key of the case for this run: contract.inventory=2000, "
        "assets.equity.weight=0.4 (an element of an array by its name or number); repeatable",
    )
    parser.add_argument("--seed", metavar="N", type=seed, help="the same as --set training.seed=N")
    _add_simulator(parser)


def _add_simulator(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--simulator",
        metavar="MODULE:CLASS",
        type=simulator_class,
        help='simulator class of a case of kind "own"; its module is next to the case or in the '
        "current folder",
    )


if __name__ == "__main__":
    sys.exit(main())
