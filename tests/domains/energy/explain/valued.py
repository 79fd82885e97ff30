"""Runs of contracts as `snapo explain` reads them, without a training: the fitted rule decides."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tests.domains.energy.energy_cases import HOME, case_at, tables_at

from snapo.domains.energy.core.policy import UnitValuePolicy
from snapo.domains.energy.explain.parts import curves_of, with_curves
from snapo.domains.energy.setup import make_setup, setup_at
from snapo.domains.gas_storage.explain.runs import ValuedRun
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, value_of_groups
from snapo.solver.solution import POLICY
from snapo.study.study import Setup


def valued(
    folder: Path,
    kind: str,
    changes: Mapping[str, Any],
    like: Setup | None = None,
    policy: UnitValuePolicy | None = None,
    curves: Mapping[str, Any] | None = None,
) -> tuple[ValuedRun, Setup, UnitValuePolicy]:
    """The run of a template, its setup and its policy, with other values of keys, and its curves times these factors."""
    template = HOME / f"template_{kind}"
    case, data = case_at(template, dict(changes)), tables_at(template, dict(changes))[1]
    factors, known = curves or {}, curves_of(case)
    moved = {name: _times(known[name], factor) for name, factor in factors.items()}
    case = with_curves(case, moved)
    setup = make_setup(case, "native") if like is None else setup_at(like, case)
    assert isinstance(setup.policy, UnitValuePolicy)
    policy = setup.policy.value_rule if policy is None else policy
    folder.mkdir()
    policy.save(folder / POLICY)
    problem, engine = setup.problem, setup.engines.evaluate
    totals = path_totals(problem, policy, case.evaluation.paths, engine=engine)
    values = problem.objective, totals, problem.sources.evaluation
    shares = value_of_groups(*values, problem.simulator.control_variates())
    total = statistics.of_shares(shares)
    run = ValuedRun(
        folder,
        template / "case.toml",
        data,
        case,
        "native",
        total.value,
        total.standard_error,
        np.asarray(shares),
    )
    run.check()
    return run, setup, policy


def _times(curve: Any, factor: Any) -> Any:
    return replace(curve, values=factor * curve.values)
