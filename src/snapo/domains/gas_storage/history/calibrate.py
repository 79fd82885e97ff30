"""`snapo calibrate`: estimates a model from price history, and writes a table for a case."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError, counted
from snapo.case.toml import one_value
from snapo.report.folder import RunFiles
from snapo.solver.statistics import half_width
from snapo.solver.tables import write_csv, write_text
from snapo.study.run_folder import read as read_run

from .maximum import HistoryEstimate, HistoryFit, fit
from .read import Calibration, read_calibration

FOLDER = "calibration"  # next to the file, if nothing else is named
TABLE, PARAMETERS = "model.toml", "parameters.csv"
COVARIANCE, STATES = "covariance.csv", "states.csv"
DIGITS = 8
PERFECT = 0.9999  # a case has no factors that move as one
# {(input, label) of a run: the parameter of the history}.
INPUTS = {
    ("mean_reversion", ""): "mean_reversion",
    ("volatility", ""): "volatility",
    ("mean_reversion", "1"): "mean_reversion",
    ("volatility", "1"): "volatility",
    ("volatility", "2"): "long_volatility",
    ("correlation", "2,1"): "correlation",
}


def calibrate(
    path: Path, progress, *, out: Path | None = None, run: Path | None = None
) -> dict[str, Any]:
    """Estimates the model of a calibration file, and writes the folder `out`.

    `model.toml` has the table `[model]` of a case, `parameters.csv` the estimates with standard
    errors and 95 % intervals, `covariance.csv` their covariance, `states.csv` the filtered factors
    of each date. `run`: a run of a case with such a model; the interval of its value that the
    errors of the parameters cause is then computed. Returns all results as plain data.

    **Raises:** `CaseError` if the file, its prices or the run are wrong; nothing is written.
    """
    calibration = read_calibration(path)
    for note in calibration.notes:
        progress(f"note: {note}")
    derivatives = None if run is None else derivatives_of(run, calibration.model.kind)
    progress(
        f"{calibration.prices:,} prices on {len(calibration.days):,} dates; estimating "
        f"{counted(len(calibration.model.names), 'parameter')} of {calibration.model.kind}"
    )
    result = fit(calibration)
    folder = calibration.file.parent / FOLDER if out is None else out
    answer = _answer(calibration, result)
    if derivatives is not None:
        answer["value"] = value_interval(result, derivatives)
    _write(folder, calibration, result)
    return answer | {"folder": folder}


def _answer(calibration: Calibration, result: HistoryFit) -> dict[str, Any]:
    estimate = result.estimate
    return {
        "status": "ok" if estimate.converged else "not converged",
        "kind": calibration.model.kind,
        "first": calibration.days[0].isoformat(),
        "last": calibration.days[-1].isoformat(),
        "dates": len(calibration.days),
        "prices": calibration.prices,
        "log_likelihood": estimate.log_likelihood,
        "parameters": [row._asdict() for row in parameter_rows(estimate)],
        "exact": list(result.model.exact),
        "vanished": list(result.vanished),
        "model": model_table(result),
    }


class ParameterRow(NamedTuple):
    """An estimate with its error and 95 % interval; `unknown`: the history does not determine
    it."""

    parameter: str
    estimate: float
    standard_error: float
    low: float
    high: float
    unknown: bool


def parameter_rows(estimate: HistoryEstimate) -> tuple[ParameterRow, ...]:
    """The rows of all parameters."""
    columns = (estimate.numbers, estimate.errors, estimate.low, estimate.high)
    rows = zip(estimate.names, *(column.tolist() for column in columns), estimate.unknown.tolist())
    return tuple(ParameterRow(*row) for row in rows)


def model_table(result: HistoryFit) -> dict[str, Any]:
    """The table `[model]` of a case with the estimates."""
    p = {name: _rounded(x) for name, x in zip(result.estimate.names, result.estimate.numbers)}
    short = {"mean_reversion": p["mean_reversion"], "volatility": p["volatility"]}
    table: dict[str, Any] = {"kind": result.model.kind}
    if result.model.factors == 1:
        shift = {"shift": result.model.shift} if result.model.shift else {}
        return table | short | shift
    long = {"mean_reversion": 0.0, "volatility": p["long_volatility"]}
    both = min(max(p["correlation"], -PERFECT), PERFECT)
    return table | {"factors": [short, long], "correlation": [[1.0, both], [both, 1.0]]}


def _rounded(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")


def _write(folder: Path, calibration: Calibration, result: HistoryFit) -> None:
    estimate, states = result.estimate, result.states
    header = ("parameter", "estimate", "standard_error", "low", "high", "unknown")
    columns = (estimate.numbers, estimate.errors, estimate.low, estimate.high)
    rows = zip(estimate.names, *columns, ["yes" if x else "no" for x in estimate.unknown])
    factors = ("short_term", "long_term")[: result.model.factors]
    deviations = np.sqrt(np.maximum(np.diagonal(states.covariance, axis1=1, axis2=2), 0.0))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / TABLE, _toml(calibration, result))
        write_csv(folder / PARAMETERS, header, rows)
        matrix = ((name, *row) for name, row in zip(estimate.names, estimate.covariance))
        write_csv(folder / COVARIANCE, ("parameter", *estimate.names), matrix)
        head = ("date", *factors, *(f"{name}_error" for name in factors))
        lines = zip(calibration.days, states.mean, deviations)
        write_csv(folder / STATES, head, ((day, *mean, *error) for day, mean, error in lines))
    except OSError as error:
        message = f"the folder cannot be written ({error.strerror})"
        raise CaseError(str(folder), "", None, message) from None


def _toml(calibration: Calibration, result: HistoryFit) -> str:
    """The table `[model]`, with the intervals of the estimates as comments."""
    days, estimate = calibration.days, result.estimate
    lines = [
        f"# From {calibration.prices} prices of {days[0]} to {days[-1]}; "
        f"log-likelihood {estimate.log_likelihood:.6f}."
    ]
    for name, number, low, high, unknown in zip(
        estimate.names, estimate.numbers, estimate.low, estimate.high, estimate.unknown
    ):
        end = "; unknown: the history does not determine it" if unknown else ""
        lines.append(f"# {name} {number:.6g}, 95 % from {low:.6g} to {high:.6g}{end}")
    table = model_table(result)
    lines += ["", "[model]", *(f"{key} = {one_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def derivatives_of(run: Path, kind: str) -> dict[str, float]:
    """{parameter: derivative of the value of a run with respect to this parameter}.

    **Raises:** `CaseError` if the run has a model of another kind, or no derivative with respect
    to any parameter.
    """
    model = read_run(run)["decides"]["case"].get("model")
    other = model.get("kind") if isinstance(model, Mapping) else None
    if other != kind:
        raise CaseError(str(run), "model.kind", other, f'the calibration is of kind "{kind}"')
    table: dict[str, float] = {}
    for row in RunFiles.read(run).sensitivities:
        name = INPUTS.get((row.input, row.label))
        if name is not None and row.value is not None:
            table[name] = row.value
    if not table:
        message = (
            "the run has no derivative with respect to one mean_reversion or one volatility; "
            "it must be a run of a case with a model that snapo calibrate estimates"
        )
        raise CaseError(str(run), "", None, message)
    return table


def value_interval(result: HistoryFit, derivatives: Mapping[str, float]) -> dict[str, Any]:
    """The standard error of a run's value that the errors of the parameters cause.

    With the derivatives d of the value and the covariance C of the estimates the standard error is
    sqrt(d C d), to first order (the delta method). `shares`: the standard error that the error of
    each single parameter causes.
    """
    names = result.estimate.names
    slope = np.array([derivatives.get(name, 0.0) for name in names])
    covariance = result.estimate.covariance
    error = math.sqrt(max(float(slope @ covariance @ slope), 0.0))
    single = np.abs(slope) * result.estimate.errors
    shares = {name: float(x) for name, x in zip(names, single) if name in derivatives}
    return {"standard_error": error, "half_width": half_width(error), "shares": shares}


def summary(answer: Mapping[str, Any]) -> str:
    """The answer for a reader."""
    return "\n".join(_lines(answer))


def _lines(answer: Mapping[str, Any]) -> Iterator[str]:
    yield (
        f"{answer['kind']}: {answer['prices']:,} prices on {answer['dates']:,} dates from "
        f"{answer['first']} to {answer['last']}, log-likelihood {answer['log_likelihood']:,.4f}"
    )
    if answer["status"] != "ok":
        yield "the search did not reach a maximum; the numbers below are its last point"
    yield f"{'parameter':<20}{'estimate':>12}{'error':>12}   95 % interval"
    for row in answer["parameters"]:
        numbers = f"{row['estimate']:>12.5g}{row['standard_error']:>12.3g}"
        interval = f"{row['low']:.5g} to {row['high']:.5g}"
        end = "   unknown: the history does not determine it" if row["unknown"] else ""
        yield f"{row['parameter']:<20}{numbers}   {interval}{end}"
    if answer["exact"]:
        end = ", as estimated" if answer["vanished"] else ""
        yield f"without a measurement error: {', '.join(answer['exact'])}{end}"
    if "value" in answer:
        value = answer["value"]
        yield (
            f"value of the run: ± {value['half_width']:,.4g} (95 %) from the errors of these "
            "parameters"
        )
    yield f"table [model] for a case: {answer['folder'] / TABLE}"
