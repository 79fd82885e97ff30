"""Evidence for the value: the adjoint compared with bumps, and the limits of the simulator."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from snapo.problem.problem import Problem
from snapo.report import evidence
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Missing, Table
from snapo.report.quantity import finite, number, percent, power, readable
from snapo.solver.certificate import certify_derivatives, feasibility, in_the_mean, nudged
from snapo.solver.derivatives.rebuilt import fewer

from ..chapter import Chapter, Number
from ..study import Setup, StudyRun

BUMP_PATHS, LIMIT_PATHS = 256, 4096
ROUND_OFF = 1e-9  # of the largest number among the inputs, at least of one
TITLE = "Certificate: evidence for this number"


@dataclass(frozen=True)
class BumpRow:
    """The adjoint compared with central differences for a family of inputs, per unit of the input.

    - `inputs`: a description of the direction, or the number of bumped inputs.
    - `worst_error`, `allowed`: the largest and the allowed error of the adjoint, in the unit of the
      value.
    - `passed`: None if most paths are at a kink; `crossing`: the share of paths at a kink.
    """

    family: str = ""
    inputs: str | float | None = None
    worst_error: float | None = None
    allowed: float | None = None
    passed: bool | None = None
    kink: Any = None
    crossing: float | None = None


@dataclass(frozen=True)
class LimitRow:
    """The smallest slack of a limit over all paths and steps, and its position."""

    limit: str = ""
    worst: float | None = None
    path: int | None = None
    step: int | None = None
    passed: bool | None = None


@dataclass(frozen=True)
class Certificate:
    """The checks of a run. A domain adds further figures in a subclass."""

    bump_check: tuple[BumpRow, ...] = ()
    feasibility: tuple[LimitRow, ...] = ()
    smoothing_gap: Number = np.nan
    policy_gradient_norm: Number = np.nan

    @property
    def checks(self) -> list[tuple[str, bool]]:
        """(subject, whether the check holds) for every check with a verdict."""
        rows = [(row.family, row.passed) for row in self.bump_check]
        rows += [(row.limit, row.passed) for row in self.feasibility]
        return [(name.replace("_", " "), passed) for name, passed in rows if passed is not None]


def largest(problem: Problem) -> float:
    """The largest absolute value of a number of the inputs, or 1 if that is larger."""
    sizes = [np.max(np.abs(entry.value), initial=1.0) for entry in problem.inputs_by_name.values()]
    return float(max(sizes, default=1.0))


def round_off(problem: Problem) -> float:
    """The allowed violation of a limit by round-off, relative to the largest input."""
    return ROUND_OFF * largest(problem)


def certificate(
    *,
    bump_paths: int = BUMP_PATHS,
    tolerance: Callable[[Problem], float] = round_off,
    near: Callable[[Problem], Problem] = nudged,
    problem_of: Callable[[Setup], Problem] = lambda setup: setup.problem,
    result: type[Certificate] = Certificate,
    more: Callable[[StudyRun], Mapping[str, Any]] = lambda run: {},
    show: Callable[[Any, Any], list[Block]] | None = None,
) -> Chapter[Any]:
    """The chapter "certificate": bumps, limits, the smoothing gap and the policy's gradient.

    Bumps are made at the inputs, and also near them if most paths are at kinks. Inputs whose
    derivative is correct only in the mean are tested by their standard move. The limits are those
    in the simulator's `slack`.

    **Arguments:**

    - `bump_paths`: the number of paths for the differences. - `tolerance`: the allowed violation of
      a limit; `near`: the problem at a small distance from kinks.
    - `problem_of`: the problem to certify.
    - `result`: the class of the result, whose further fields `more` returns.
    - `show`: returns the blocks of the section, by default those of `show_certificate`.
    """

    def measure(run: StudyRun) -> Certificate:
        setup, solution = run.setup, run.solution
        problem, policy, engine = problem_of(setup), solution.policy, setup.engines.evaluate
        if policy is None:
            raise ValueError("the run has no policy")
        paths = fewer(min(LIMIT_PATHS, setup.evaluation.paths), problem.simulator.horizon)
        bumps = certify_derivatives(
            problem, policy, paths=min(bump_paths, paths), near=near, engine=engine
        )
        limits = feasibility(problem, policy, paths=paths, engine=engine)
        verdicts = (solution.sensitivities.verdicts if solution.sensitivities else None) or {}
        rows = [bump.row() for bump in bumps] + in_the_mean(problem, verdicts)
        slack = tolerance(problem)
        return result(
            tuple(BumpRow(**row) for row in rows),
            tuple(LimitRow(**limit.row(slack)) for limit in limits),
            solution.smoothing_gap,
            solution.policy_gradient_norm,
            **more(run),
        )

    blocks = show or show_certificate
    return Chapter("certificate", TITLE, result, measure, blocks, key="certificate")


def show_certificate(run: RunFiles, result: Certificate) -> list[Block]:
    """Shows the tables of bumps and of limits."""
    step = str(run.get("step", "step")).capitalize()
    if not result.feasibility:
        text = "The simulator declares no limits: its method `slack` names none."
        return [bump_table(result, run.unit), Missing(text)]
    return [bump_table(result, run.unit), limit_table(result, "", step)]


def bump_table(
    result: Certificate, unit: str, name_of: Callable[[str], str] = readable
) -> Table | Missing:
    """The adjoint compared with differences, with a row for each family of inputs; errors are in
    `unit`."""
    rows = result.bump_check
    if not rows:
        return Missing("The adjoint was not checked against central differences in this run.")
    body = [
        (
            name_of(row.family),
            _direction(row.inputs),
            evidence.verdict(row.passed, "holds", "fails", "at kinks; see the row “nearby”"),
            power(row.worst_error),
            power(row.allowed),
            percent(row.crossing) if row.crossing else "",
        )
        for row in rows
    ]
    head = [("Family of inputs", ""), ("Bumped", ""), ("", ""), ("Worst error", unit),
            ("Allowed", unit), ("At a kink", "of paths")]  # fmt: skip
    caption = "Adjoint compared with central differences, per unit of the input, on the same paths"
    verdicts = [row.passed for row in rows if row.passed is not None]
    folded = f"Adjoint compared with bumps: {sum(verdicts)} of {len(verdicts)} agree"
    if (worst := _nearest(rows)) is not None:
        error, allowed = quantity_of(worst.worst_error, unit), power(worst.allowed)
        name = name_of(worst.family)
        folded += (
            f"; the error closest to its tolerance is {error}, where {allowed} is allowed ({name})"
        )
    return Table(head, body, caption, 3, folded=folded)


def quantity_of(value: float | None, unit: str) -> str:
    """The size of an error with its unit."""
    return f"{power(value)} {unit}".rstrip()


def _nearest(rows: Sequence[BumpRow]) -> BumpRow | None:
    """The row with the largest share of its tolerance."""

    def share(row: BumpRow) -> float:
        return (row.worst_error or 0.0) / (row.allowed or np.inf)

    measured = [row for row in rows if row.worst_error is not None and row.allowed]
    return max(measured, key=share, default=None)


def limit_table(
    result: Certificate,
    unit: str,
    step: str,
    when: Callable[[Any], str] = lambda step: number(finite(step), 0),
) -> Table | Missing:
    """The smallest slack of every limit, in `unit`; `step`: the noun for a step; `when`: returns
    the label of a step."""
    if not result.feasibility:
        return Missing("The exact simulator's limits were not checked in this run.")
    body = [
        (
            row.limit.replace("_", " ").capitalize(),
            evidence.verdict(row.passed, "holds", "violated"),
            # Of a limit that holds, less than nothing is round-off.
            "0, up to rounding" if row.passed and (row.worst or 0.0) < 0 else power(row.worst),
            number(row.path, 0),
            when(row.step),
        )
        for row in result.feasibility
    ]
    head = [("Limit", ""), ("", ""), ("Smallest slack", unit), ("Path", ""), (step, "")]
    caption = (
        f"Limits over all paths and {step.lower()}s in the exact simulator (slack is the "
        "distance to a limit)"
    )
    verdicts = [row.passed for row in result.feasibility if row.passed is not None]
    folded = (
        f"Limits over all paths and {step.lower()}s: {sum(verdicts)} of {len(verdicts)} are met"
    )
    return Table(head, body, caption, 2, folded=folded)


def _direction(inputs: str | float | None) -> str:
    """The bump as text: a description of the direction, or the number of inputs."""
    count = None if isinstance(inputs, str) else finite(inputs)
    return str(inputs or "") if count is None else number(count, 0)


CERTIFICATE = certificate()


def checks(run: RunFiles) -> list[tuple[str, bool]]:
    """(subject, whether it holds) of every check of the certificate of a run."""
    result = CERTIFICATE.of(run)
    return [] if result is None else result.checks
