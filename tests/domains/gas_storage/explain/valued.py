"""Run folders as `snapo explain` reads them, without a training: the rule of the value table decides."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tests.domains.gas_storage.storage_cases import CASES, tables_of

from snapo.domains.gas_storage.explain.runs import ValuedRun, with_curve
from snapo.domains.gas_storage.read.case import read_case
from snapo.domains.gas_storage.setup import bare_problem, fitted_value, make_setup, setup_at
from snapo.problem.policy import Policy
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, value_of_groups
from snapo.solver.solution import POLICY
from snapo.study.study import Setup


def valued(
    folder: Path,
    name: str,
    like: Setup | None = None,
    policy: Policy | None = None,
    curve: float = 1.0,
    tables: Mapping[str, dict[str, Any]] | None = None,
) -> tuple[ValuedRun, Setup]:
    """The run of a case with keys of its tables changed, and its curve times a factor."""
    file, data = tables_of(CASES / name, **(tables or {}))
    case = read_case(file, data)
    if curve != 1:
        case = with_curve(case, curve * case.market.forward_curve.used())
    if like is None:
        setup = make_setup(case, "native", fitted_value(bare_problem(case)))
    else:
        setup = setup_at(like, case)
    policy = setup.policy if policy is None else policy
    return run_at(folder, file, data, case, setup, policy), setup


def run_at(
    folder: Path, file: Path, data: dict[str, Any], case: Any, setup: Setup, policy: Policy
) -> ValuedRun:
    """The run of a case whose policy is valued on the paths of its evaluation, saved in a folder."""
    folder.mkdir()
    policy.save(folder / POLICY)
    problem, engine = setup.problem, setup.engines.evaluate
    totals = path_totals(problem, policy, case.evaluation.paths, engine=engine)
    values = problem.objective, totals, problem.sources.evaluation
    shares = value_of_groups(*values, problem.simulator.control_variates())
    total = statistics.of_shares(shares)
    run = ValuedRun(
        folder, file, data, case, "native", total.value, total.standard_error, np.asarray(shares)
    )
    run.check()
    return run
