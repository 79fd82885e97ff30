"""Compares the adjoint of a problem with differences; returns a list of faults."""

from snapo.engine import Engine
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import EXACT, Exact, Smooth
from snapo.solver.certificate import bump_check, nudged


def wrong_derivatives(
    problem: Problem,
    policy: Policy,
    *,
    paths: int = 32,
    smooth: Smooth | Exact = EXACT,
    engine: Engine | None = None,
    every: bool = False,
) -> list[str]:
    """A line for each input whose adjoint differs from central differences. The inputs are first
    moved away from round numbers, at which two limits may be equal and two derivatives correct. The
    other arguments are those of `snapo.solver.certificate.bump_check`: without `smooth` the
    recorded decisions are held fixed; with `every` all numbers are bumped separately.
    """
    result = bump_check(
        nudged(problem), policy, paths=paths, smooth=smooth, every=every, engine=engine
    )
    return [
        f"{bump.input} ({bump.direction}): {bump.adjoint:.10g} by the adjoint, "
        f"{bump.central:.10g} by differences; {bump.allowed:.2g} is allowed"
        for bump in result
        if not bump.passed
    ]
