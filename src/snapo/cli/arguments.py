"""Converts texts of the command line to the values of options, and refuses invalid texts.

Also declares the arguments of the commands on past prices and on runs, and of `schema`, `cache` and
`completion`.
"""

import argparse
from pathlib import Path

SHELLS = ("bash", "zsh", "fish")
RUN = "a run folder, or a case, which means its latest run"


def seeds(text: str) -> int | tuple[int, ...]:
    """The seeds, written as their number, "5", or as a list, "0,3,7"."""
    parts = text.split(",")
    if not all(part.isascii() and part.isdigit() and int(part) < 2**63 for part in parts):
        message = "is neither a number of seeds, such as 5, nor a list of them, such as 0,3,7"
        raise argparse.ArgumentTypeError(f"{text!r} {message}")
    seeds = tuple(map(int, parts))
    if len(set(seeds)) < len(seeds):
        raise argparse.ArgumentTypeError(
            f"{text!r} has a seed twice; each seed may occur only once"
        )
    if len(parts) > 1:
        return seeds
    if not int(text):
        raise argparse.ArgumentTypeError(f"{text!r} seeds are too few; use 1 or more")
    return int(text)


def even_number(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) < 2 or int(text) % 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not an even number of at least 2")
    return int(text)


def whole_number(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 1 <= int(text) <= 4096:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to 4096")
    return int(text)


def shard(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    digits = (number + count).isascii() and number.isdigit() and count.isdigit()
    if not digits or not 1 <= int(number) <= int(count):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a part such as 3/100; the first part is 1/100"
        )
    return int(number), int(count)


def port(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 0 to 65535")
    return int(text)


def seed(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) >= 2**63:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 0")
    return int(text)


def simulator_class(text: str) -> tuple[str, str]:
    module, colon, name = text.partition(":")
    if not (colon and name.isidentifier() and all(map(str.isidentifier, module.split(".")))):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not MODULE:CLASS, such as my_module:MySimulator"
        )
    return module, name


def calendar(text: str) -> str | int:
    """The schedule on which a back-test estimates its model again."""
    if text in ("never", "month", "quarter", "year"):
        return text
    try:
        return whole_number(text)
    except argparse.ArgumentTypeError:
        message = f"{text!r} is not never, month, quarter, year or a number of days"
        raise argparse.ArgumentTypeError(message) from None


def add_past(commands) -> None:
    """`snapo calibrate` and `snapo backtest`."""
    calibrate = commands.add_parser(
        "calibrate", help="estimate a price model from history, with intervals"
    )
    calibrate.add_argument(
        "case", metavar="FILE", type=Path, help="a TOML file of kind calibration, or its folder"
    )
    calibrate.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of the results (default: calibration, next to the file)",
    )
    calibrate.add_argument(
        "--run",
        metavar="RUN",
        type=Path,
        help="a run with this model; adds the interval of its value due to the errors of the "
        "estimates",
    )
    backtest = commands.add_parser(
        "backtest",
        help="operate a gas store on past prices, using on each day only the prices up to that day",
        epilog="snapo backtest mystore --history prices",
    )
    backtest.add_argument(
        "case", metavar="CASE", type=Path, help="a TOML file, or a folder with case.toml"
    )
    backtest.add_argument(
        "--history",
        metavar="DIR",
        type=Path,
        required=True,
        help="folder with spot.csv and, if there are any, curves.csv",
    )
    backtest.add_argument(
        "--every",
        metavar="N",
        type=whole_number,
        help="days from one solution to the next; every solution uses the curve of its date "
        "(default: 30, or the schedule of --calibrate)",
    )
    backtest.add_argument(
        "--calibrate",
        metavar="WHEN",
        type=calendar,
        help="when to estimate the model again: never, on the first day of each month, quarter or "
        "year, or after a number of days (default: `calibrate` of [backtest])",
    )
    backtest.add_argument(
        "--hedge",
        action="store_true",
        help="trade hedges in listed products on each day with a curve",
    )
    backtest.add_argument(
        "--policy",
        metavar="RUN",
        type=Path,
        help="use the trained policy of this run for the decisions",
    )
    backtest.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of the results (default: backtest, next to the case)",
    )


def add_explain(commands) -> None:
    """`snapo explain`."""
    explain = commands.add_parser(
        "explain",
        help="split the change of value between two runs of a contract into its causes",
        epilog="snapo explain mystore/runs/2026-11-24T0800-7f3a mystore",
    )
    explain.add_argument("first", metavar="RUN_A", type=Path, help=f"the earlier run: {RUN}")
    explain.add_argument("second", metavar="RUN_B", type=Path, help=f"the later run: {RUN}")
    explain.add_argument(
        "--flows",
        metavar="FILE",
        type=Path,
        help="for a gas store: CSV (date,volume,price) of the flows on the days between the two "
        "valuation dates; volumes into the store are positive (default: from the inventories, at "
        "forward prices)",
    )
    explain.add_argument(
        "--cash",
        metavar="AMOUNT",
        type=float,
        help="for other contracts: cash flow on the days between the two valuation dates "
        "(default: as planned)",
    )
    explain.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of the results (default: explain, in RUN_B)",
    )


def add_compare(commands) -> None:
    """`snapo compare`."""
    compare = commands.add_parser("compare", help="compare runs with the first of them")
    compare.add_argument("runs", metavar="RUN", type=Path, nargs="+", help=RUN)


def add_runs(commands) -> None:
    """`snapo runs`."""
    runs = commands.add_parser("runs", help="list the runs of a case, or remove old runs")
    runs.add_argument(
        "case", metavar="CASE", type=Path, help="a case: its folder, or its TOML file"
    )
    runs.add_argument(
        "--remove",
        metavar="RUN",
        nargs="+",
        default=[],
        help="runs to remove: their names, or the last four characters of the names",
    )
    runs.add_argument(
        "--keep", metavar="N", type=whole_number, help="remove all runs except the last N"
    )


def add_schema(commands) -> None:
    """`snapo schema`."""
    schema = commands.add_parser(
        "schema",
        help="print the JSON schema of a kind of case, or of a book, for editors",
        epilog="snapo schema gas-storage > gas-storage.schema.json",
    )
    schema.add_argument("kind", metavar="KIND", help="kind of case, such as gas-storage")


def add_cache(commands) -> None:
    """`snapo cache`."""
    cache = commands.add_parser(
        "cache", help="show the size of the compiled code stored for later runs, or remove it"
    )
    cache.add_argument("--empty", action="store_true", help="remove all of the stored code")


def add_completion(commands) -> None:
    """`snapo completion`."""
    completion = commands.add_parser(
        "completion",
        help="print a script that completes commands in a shell",
        epilog='bash, zsh: eval "$(snapo completion bash)"; fish: snapo completion fish | source',
    )
    completion.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))
