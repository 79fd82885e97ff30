"""The arguments of the commands that read past prices."""

from pathlib import Path

from .arguments import whole_number


def add_calibrate(commands) -> None:
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
        help="a run with this model, whose value gets the interval due to the estimates",
    )


def add_backtest(commands) -> None:
    backtest = commands.add_parser(
        "backtest",
        help="decide a gas store on past prices, with the prices until each day",
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
        default=30,
        help="days from one solution to the next, with the curve of its date (default: 30)",
    )
    backtest.add_argument(
        "--policy", metavar="RUN", type=Path, help="decide with the trained policy of this run"
    )
    backtest.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of the results (default: backtest, next to the case)",
    )
