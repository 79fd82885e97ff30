"""Runs of contracts as `snapo explain` reads them, without a training: the fitted rule decides."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.domains.energy.energy_cases import HOME, case_at, tables_at
from tests.domains.gas_storage.explain.valued import run_at

from snapo.domains.energy.core.policy import UnitValuePolicy
from snapo.domains.energy.explain.parts import curves_of, with_curves
from snapo.domains.energy.setup import make_setup, setup_at
from snapo.domains.gas_storage.explain.runs import ValuedRun
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
    run = run_at(folder, template / "case.toml", data, case, setup, policy)
    return run, setup, policy


def _times(curve: Any, factor: Any) -> Any:
    return replace(curve, values=factor * curve.values)
