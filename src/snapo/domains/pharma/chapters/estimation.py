"""Estimation: numbers fitted to measurements, and the model against batches held out of the fit."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import jax
import numpy as np
from scipy.special import chdtrc, stdtrit

from snapo.case.quantity import numbers_in
from snapo.report.drawing import draw
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Mark, Missing, Section, Table, Text
from snapo.report.quantity import finite, number, percent, power, with_unit
from snapo.study.chapter import Chapter, Floats, Number
from snapo.study.study import StudyRun

from ..derivatives.mode import of_method
from ..flowsheet.case import PharmaCase
from ..flowsheet.process import PharmaProcess
from ..quality.boundary import interval
from ..quality.estimation import MISFIT, ParameterFit, fit, model_of, numbers_of, variables_of
from ..quality.records import Estimation
from ..read.entries import EntryNumbers
from ..read.fitted import COLUMNS
from ..shared import SOUND, open_loop
from . import pictures

FITTED = "fitted.csv"
DIFFERENT = 0.01  # p-value below which a batch held out is not as the model expects


@dataclass(frozen=True)
class Agreement:
    """One batch: the number of `points`, of which `inside` lie in their intervals; `chi2` of all of
    them together, and `tail`, the probability of a larger chi2."""

    experiment: str
    points: int
    inside: int
    chi2: Number
    tail: Number


@dataclass(frozen=True, eq=False)
class Validation:
    """[n] held-out measurements, in the domain's units.

    - `measured`, `predicted`; `deviation` of the prediction due to the uncertainty of the fit;
      `half`: half width of the prediction interval for a measurement.
    - `coverage`: share inside, with its 95 % interval `low` to `high` for independent points.
    """

    measured: Floats
    predicted: Floats
    deviation: Floats
    half: Floats
    coverage: Number
    low: Number
    high: Number
    batches: tuple[Agreement, ...]


def validate(
    process: "PharmaProcess", estimation: Estimation, fit: ParameterFit
) -> Validation | None:
    """The test of the fit on the batches that were held out of it; None if there are none."""
    if not estimation.held_out:
        return None
    model = model_of(process, estimation, estimation.held_out)
    log = np.array(estimation.logarithm)

    def both(x):
        results = model(numbers_of(x, log))
        return results, results

    derivative = of_method(process.case.numerics.method)
    with jax.enable_x64(True):
        slope, result = jax.jit(derivative(both, has_aux=True))(variables_of(fit.values, log))
    slope, predicted = np.asarray(slope), np.asarray(result)
    measured = np.concatenate([entry.value for entry in estimation.held_out])
    error = np.concatenate([value.error for value in estimation.held_out])
    if estimation.errors == "relative":
        error = error * np.sqrt(fit.scale)
    spread = slope @ fit.covariance @ slope.T
    deviation = np.sqrt(np.diag(spread))
    factor = stdtrit(max(fit.freedom, 1), (1 + estimation.level) / 2)
    half = factor * np.sqrt(deviation**2 + error**2)
    inside = np.abs(measured - predicted) <= half
    low, high = interval(inside.mean(), inside.size)
    batches, start = [], 0
    for item in estimation.held_out:
        at = slice(start, start + len(item.time))
        off, complete = (measured - predicted)[at], spread[at, at] + np.diag(error[at] ** 2)
        size = float(off @ np.linalg.solve(complete, off))
        tail = float(chdtrc(len(off), size))
        batches.append(Agreement(item.name, len(off), int(inside[at].sum()), size, tail))
        start += len(item.time)
    share = float(inside.mean())
    return Validation(
        measured, predicted, deviation, half, share, float(low), float(high), tuple(batches)
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimates(ParameterFit):
    """A fit with the further entries of its report.

    - `measured_own`, `fitted_own`: measured and fitted values of a `state` at a `time` of an
      `experiment`, in the case's unit `state_unit`. `start`: the case's numbers; `units`, `scales`:
      the units of the fitted numbers and their conversion.
    - `level`: the level of the intervals; `errors`: whether the errors of the measurements are
      "known" or "relative".
    """

    measured_own: Floats
    fitted_own: Floats
    start: Floats
    level: Number
    validation: Validation | None
    errors: str
    units: tuple[str, ...]
    scales: tuple[tuple[float, float], ...]
    state: tuple[str, ...]
    state_unit: tuple[str, ...]
    time: Floats
    experiment: tuple[str, ...]


def measure(run: StudyRun) -> Estimates:
    """The fit, and a file with which a case can use it."""
    loop = open_loop(run)
    result = estimates(loop.process)
    rows = fitted_rows(loop.case, result)
    if rows:
        run.write_csv(FITTED, COLUMNS, rows)
    return result


def estimates(process: PharmaProcess) -> Estimates:
    """The fit requested in a case."""
    request = process.case.estimation
    assert request is not None
    result, experiments = fit(process, request), request.experiments
    scale, offset = np.array([x for experiment in experiments for x in experiment.scales]).T
    return Estimates(
        **{x.name: getattr(result, x.name) for x in fields(result)},
        measured_own=(np.asarray(result.measured) - offset) / scale,
        fitted_own=(np.asarray(result.fitted_values) - offset) / scale,
        start=np.array([process.inputs[x][i] for x, i in zip(request.inputs, request.entries)]),
        level=request.level, validation=validate(process, request, result), errors=request.errors,
        units=tuple(request.units), scales=tuple((float(a), float(b)) for a, b in request.scales),
        state=tuple(state for x in experiments for state in x.state),
        state_unit=tuple(unit for x in experiments for unit in x.units),
        time=np.concatenate([x.time for x in experiments]),
        experiment=tuple(x.name for x in experiments for _ in x.time),
    )  # fmt: skip


def not_handed_on(result: ParameterFit) -> list[str]:
    """Sentences on why the numbers of a fit cannot be used in other runs with their covariance."""
    reasons = [] if result.converged else [f"The fit did not converge: {result.message}."]
    reasons += [f"{text[:1].upper()}{text[1:]}." for text in result.unidentified]
    for name, bound in zip(result.names, result.at_bound):
        if bound:
            end = "lower" if bound == "low" else "upper"
            reasons.append(
                f"{name} is at its {end} bound, and chi² would decrease beyond it. The interval of "
                "this number is one-sided, and the intervals of the others hold it at this bound."
            )
    for numbers, size in zip(result.minima, result.minima_chi2):
        listed = ", ".join(f"{name} {x:.6g}" for name, x in zip(result.names, numbers))
        reasons.append(
            f"Other numbers, far from the fitted ones, fit as well (chi² {size:.4g}): {listed}, in "
            "the units of the computation. Narrower bounds, or further data, would exclude one of "
            "them."
        )
    return reasons


def fitted_rows(case: PharmaCase, result: ParameterFit) -> list[tuple]:
    """Rows of `fitted.csv`, which a case may use under `fitted`; none if the fit is not usable."""
    request = case.estimation
    if request is None or not_handed_on(result):
        return []
    inputs = numbers_in((case.network, case.feeds, case.units))
    numbers = EntryNumbers({x.name: x for x in inputs}, case.network)
    deviation = np.sqrt(np.diag(np.asarray(result.covariance, float)))
    rows = []
    for i, entry in enumerate(zip(request.inputs, request.entries)):
        unit = numbers.unit(*entry)
        unit = "" if unit == "1" else f" {unit}"
        log = request.logarithm[i]
        size = f"{float(deviation[i])!r}{'' if log else unit}"
        correlation = " ".join(repr(float(x)) for x in result.correlation[i])
        value = f"{float(result.values[i])!r}{unit}"
        rows.append((result.names[i], value, "true" if log else "false", size, correlation))
    return rows


def show(run: RunFiles, result: Estimates) -> list[Block]:
    """Fitted numbers with intervals, their correlation, and agreement with the data."""
    rows, level, names = [], percent(result.level, 0), result.names
    for i, (name, unit, (scale, offset)) in enumerate(zip(names, result.units, result.scales)):
        columns = (result.start, result.values, result.low, result.high)
        cells = (number((column[i] - offset) / scale) for column in columns)
        rows.append((name, "" if unit == "1" else unit, *cells))
    head = ("Number", "Unit", "Before", "Fitted", f"{level} from", "to")
    blocks: list[Block] = [
        Text(
            f"Weighted least squares, {'converged' if result.converged else result.message}: "
            f"chi² {number(result.chi2)} at {number(result.freedom, 0)} degrees of freedom, "
            f"condition number {power(result.condition)}; the best of {number(result.starts, 0)} "
            f"starts. {_weighed(result)}"
        ),
        Table([(name, "") for name in head], rows, "Fitted numbers", 2),
    ]
    reasons = not_handed_on(result)
    blocks += [Text(text) for text in reasons]
    if len(names) > 1:
        rows = [
            (name, *(number(x, 2) for x in row)) for name, row in zip(names, result.correlation)
        ]
        head = [("", ""), *((name, "") for name in names)]
        blocks.append(Table(head, rows, "Correlation of the fit"))
    return [*blocks, _agreement(result), Text(_use(reasons))]


def _agreement(result: Estimates) -> Chart:
    """Fitted against measured values, with one panel for each unit of measure."""
    rows = np.asarray(result.state_unit)
    units = list(dict.fromkeys(result.state_unit))

    def paint(*panels):
        for axes, unit in zip(panels, units):
            states = dict.fromkeys(s for s, x in zip(result.state, rows) if x == unit)
            label = ", ".join(states) if len(states) <= 2 else f"{len(states)} states"
            measured, resolved = result.measured_own[rows == unit], result.fitted_own[rows == unit]
            pictures.agreement(axes, measured, resolved, f"{label}{with_unit('', unit)}")

    svg = draw("agreement", "Fitted against measured values.", paint, 60 + 220 * len(units),
               [1.0] * len(units))  # fmt: skip
    worst = float(np.abs(result.residuals).max())
    caption = f"The largest residual is {number(worst, 1)} standard deviations of its measurement."
    return Chart(svg, caption)


def _weighed(result: ParameterFit) -> str:
    """A sentence on the covariance and the errors of the measurements."""
    scale = number(result.scale)
    if finite(result.tail) is None:
        return (
            "Errors are known only up to a factor, so the covariance for the stated errors is "
            f"multiplied by chi² per degree of freedom, {scale}."
        )
    text = f"A correct model exceeds this chi² with probability {percent(result.tail)}"
    if result.scale == 1:
        return f"{text}; the covariance is that of the stated errors."
    return (
        f"{text}: the model does not describe the data, or the stated errors are too small. The "
        f"covariance was multiplied by chi² per degree of freedom, {scale}."
    )


def _use(reasons: Sequence[str]) -> str:
    """A sentence on how the fit can be used."""
    if reasons:
        return "For the reasons above, no fitted.csv is written."
    return (
        "The other parts of this run use the numbers of the case. The fitted numbers and their "
        "covariance are in the file fitted.csv of this run. To use them, copy this file to the "
        'folder of the case, add fitted = "fitted.csv" to the case, and remove the '
        "[[uncertainty]] of these numbers."
    )


ESTIMATION = Chapter(
    "estimation", "Estimation", Estimates, measure, show, needs=(SOUND,), key="estimation",
    table="estimation"
)  # fmt: skip


def validation(run: RunFiles) -> Section:
    """Coverage of the prediction intervals, batch by batch, and every point."""
    title, short = "Model validation", "Validation"
    result = ESTIMATION.of(run)
    if result is None:
        reason = why_missing(run, ESTIMATION.name, ESTIMATION.table)
        return Section("validation", title, short, [reason])
    if result.validation is None:
        text = (
            "No batch was held out of the fit: set `held_out = true` for an experiment "
            "under `[[estimation.experiments]]`."
        )
        return Section("validation", title, short, [Missing(text)])
    tests, level = result.validation, percent(result.level, 0)
    low, high = percent(tests.low, 0), percent(tests.high, 0)
    blocks: list[Block] = [
        Text(
            f"Of {len(tests.measured)} measurements of batches held out of the fit, "
            f"{percent(tests.coverage)} lie within their {level} prediction intervals (95 % "
            f"interval of this share: {low} to {high} for independent points). An interval "
            "combines the measurement error and the uncertainty of the fit. The errors of the "
            "points of one batch are correlated, which the chi² of the batch takes into account."
        ),
        _batches(tests.batches),
        _points(tests),
    ]
    if finite(result.tail) is not None:
        blocks.append(Text(_of_fit(result.tail)))
    return Section("validation", title, short, blocks)


def _of_fit(tail: float) -> str:
    """Whether the chi² of the fit is that of a correct model, at the limit of the fit itself."""
    text = f"A correct model exceeds the chi² of the fit with probability {percent(tail)}"
    inadequate = tail < MISFIT
    return (
        f"{text}: the errors of the measurements, or the model, are inadequate."
        if inadequate
        else f"{text}."
    )


def _batches(batches: Sequence[Agreement]) -> Table:
    rows = [
        (
            x.experiment, f"{x.inside} of {x.points}", number(x.chi2), percent(x.tail),
            Mark(x.tail >= DIFFERENT, "as expected" if x.tail >= DIFFERENT else "differs"),
        )
        for x in batches
    ]  # fmt: skip
    head = [("Batch held out", ""), ("Inside", ""), ("Chi²", ""), ("p-value", ""), ("", "")]
    return Table(head, rows, "Chi² of all points of a batch together", 1)


def _points(tests: Validation) -> Chart:
    """Measured minus predicted, divided by the half width of the interval; inside are -1 to 1."""
    share = (tests.measured - tests.predicted) / tests.half
    svg = draw("validation", "Prediction errors of the batches that were held out.",
               lambda axes: pictures.residuals(axes, share), 200)  # fmt: skip
    worst = number(float(np.abs(share).max()), 2)
    caption = (
        "Measured minus predicted, divided by the half-width of the interval, in the order of "
        "the data: "
        f"values from −1 to 1 are inside the interval; the largest size is {worst}."
    )
    return Chart(svg, caption)
