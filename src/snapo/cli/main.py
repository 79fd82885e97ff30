"""`snapo`: reads the arguments; imports neither NumPy nor JAX before there is work to do."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

KINDS = {
    "gas-storage": "snapo.domains.gas_storage",
    "pension": "snapo.domains.pension",
    "pharma": "snapo.domains.pharma",
}
# Examples of several sizes, the first is the default; a kind that is not here has one example.
SIZES = {"pension": ("small", "medium", "large")}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code: 0, 1 for a failure, 2 for bad input."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.command == "new":
        options.size = _size(parser, options)
    from .commands import run

    return run(options)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="snapo",
        description="Trains a decision rule inside a differentiable simulator, and returns its "
        "value with the sensitivity to every input.",
        epilog="start with: snapo new gas-storage mystore && snapo solve mystore",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    new = commands.add_parser("new", help="write a commented case that runs")
    new.add_argument("kind", metavar="KIND", choices=sorted(KINDS), help=", ".join(sorted(KINDS)))
    new.add_argument("folder", metavar="DIR", type=Path, help="made if missing; overwrites nothing")
    sizes = sorted({size for each in SIZES.values() for size in each})
    new.add_argument("--size", choices=sizes, help="of the example (pension; default: small)")

    check = commands.add_parser("check", help="read a case and say what is wrong with it")
    _add_case(check)

    solve = commands.add_parser("solve", help="train, evaluate and report")
    _add_case(solve)
    solve.add_argument(
        "--out", metavar="DIR", type=Path, help="folder of the run (default: run, beside the case)"
    )
    solve.add_argument("--seed", metavar="N", type=_seed, help="instead of training.seed")
    solve.add_argument("--engine", choices=("auto", "xla", "native"), default="auto")
    solve.add_argument(
        "--reference", action="store_true", help="compute the exact references as well"
    )
    solve.add_argument("--resume", action="store_true", help="go on with an interrupted run")
    solve.add_argument("--json", action="store_true", help="print one JSON object on stdout")

    report = commands.add_parser("report", help="write the report of a run again")
    report.add_argument("run", metavar="RUN", type=Path, help="the folder that solve wrote")

    bench = commands.add_parser("bench", help="time values and gradients on this machine")
    bench.add_argument("--engine", choices=("auto", "xla", "native"), default="auto")
    return parser


def _add_case(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "case", metavar="CASE", type=Path, help="a TOML file, or a folder with case.toml"
    )
    parser.add_argument(
        "--simulator", metavar="MODULE:CLASS", type=_simulator, help="a simulator of your own"
    )


def _size(parser: argparse.ArgumentParser, options: argparse.Namespace) -> str | None:
    """The size of the example, where the kind has several."""
    known = SIZES.get(options.kind, ())
    if options.size is not None and options.size not in known:
        parser.error(f"argument --size: {options.kind} has one example only")
    return options.size or (known[0] if known else None)


def _seed(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) >= 2**63:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, 0 or more")
    return int(text)


def _simulator(text: str) -> tuple[str, str]:
    module, colon, name = text.partition(":")
    if not (colon and name.isidentifier() and all(map(str.isidentifier, module.split(".")))):
        raise argparse.ArgumentTypeError(f"{text!r} is not like my_module:MySimulator")
    return module, name


if __name__ == "__main__":
    sys.exit(main())
