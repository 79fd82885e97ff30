"""A process without a policy, calculated at other inputs for the live page.

Every number is that of a run of the moved case, to the bits: the same functions on the same draws.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.inputs import Input
from snapo.report.quantity import unit_words
from snapo.study.study import LiveTable

from .chapters.capability import BATCHES
from .derivatives.jacobian import matrix
from .flowsheet.case import PharmaCase
from .flowsheet.inputs import pharma_inputs
from .flowsheet.process import Process
from .flowsheet.stiffness import with_stiff_steps
from .given import Form, every_entry
from .quality import batches
from .quality.capability import Capability, from_values
from .quality.limits import AttributeLimits
from .quality.sampling import sampler

PARTS = (
    "network", "feeds", "units", "connections", "parameters", "attributes", "uncertainty", "held",
    "numerics",
)  # fmt: skip


def same_form(one: PharmaCase, other: PharmaCase) -> bool:
    """Whether the cases differ only in numbers of their inputs."""
    return _form(one) == _form(other)


def _form(case: PharmaCase) -> Form:
    return Form.of(tuple(getattr(case, name) for name in PARTS), case.held)


COLUMNS = (
    ("attribute", ""), ("limits", ""), ("unit", ""), ("at the set point", ""),
    ("mean of batches", ""),
    ("standard deviation", ""), ("within limits", "%"), ("± standard error", "%"),
)  # fmt: skip


class RecipeCalculation:
    """The recipe, at any numbers of its inputs; nothing is compiled twice."""

    def __init__(self, case: PharmaCase):
        self.case, self._named = case, pharma_inputs(case)

    @property
    def inputs_by_name(self) -> Mapping[str, Input]:
        return self._named

    @cached_property
    def _process(self) -> Process:
        return Process(self.case)

    @cached_property
    def _meshes(self) -> dict[int, Process]:
        """The processes for statistics by their steps: they differ in nothing else."""
        return {}

    def stages(self, case: PharmaCase) -> Iterator[tuple[str, Any]]:
        """ "value", "sections" and "deltas"; see `snapo.study.study.Recalculated`.

        **Raises:** `CaseError` where the batch cannot be integrated.
        """
        process = self._at(case)
        one = process.run()
        if one.status != "ok":
            raise CaseError("the batch", "", None, one.status)
        sampled = self._sampled(process)
        count = min(case.evaluation.paths, BATCHES)
        rows = batches.drawn(sampled, {}, count, case.training.seed + 1)
        values = batches.attributes(sampled, rows)
        result = from_values(sampled.case, values)
        selected = AttributeLimits.of(case).hold(values).all(-1).astype(float)
        yield (
            "value",
            {
                "value": 1 - result.joint,
                "standard_error": result.joint_error,
                "paths": result.batches,
                "kept": selected,
            },
        )
        at = np.array([one.attributes[attribute.name] for attribute in case.attributes])
        yield "sections", [attributes(case, result, at)._asdict()]
        yield "deltas", list(_deltas(process))

    def _at(self, case: PharmaCase) -> Process:
        """The process of a case, with the code of the first one where they are one program."""
        first = self._process
        numerics = replace(case.numerics, steps=first.case.numerics.steps, open=False)
        case = with_stiff_steps(replace(case, numerics=numerics))
        return _with(first, case) if same_form(first.case, case) else Process(case)

    def _sampled(self, process: Process) -> Process:
        """On the mesh for statistics; its code is kept where the process's is."""
        coarse, _ = sampler(process, self._coarser if self._shares(process) else None)
        return coarse

    def _shares(self, process: Process) -> bool:
        return process._compiled is self._process._compiled

    def _coarser(self, process: Process, steps: int) -> Process:
        numerics = replace(process.case.numerics, steps=steps)
        case = with_stiff_steps(replace(process.case, numerics=numerics))
        available = self._meshes.setdefault(steps, Process(case))
        return _with(available, case) if same_form(available.case, case) else Process(case)


def _with(process: Process, case: PharmaCase) -> Process:
    """A process of `case` with the compiled functions of another that is the same program."""
    new = object.__new__(Process)
    new.__dict__.update(process.__dict__)
    new.case = case
    new.inputs = {name: entry.value for name, entry in pharma_inputs(case).items()}
    return new


def limits(low: float | None, high: float | None, unit: str) -> str:
    """As "at least 75 %", "70 to 100 µm"."""
    local = "" if unit in ("", "1") else f"\u00a0{unit_words(unit)}".replace(" ", "\u00a0")
    if low is not None and high is not None:
        return f"{low:.6g} to {high:.6g}{local}"
    if low is not None:
        return f"at least {low:.6g}{local}"
    return f"at most {high:.6g}{local}" if high is not None else "none"


def attributes(case: PharmaCase, capability: Capability, at: np.ndarray) -> LiveTable:
    """Every attribute with its limits, and how often batches keep them."""
    rows: list[Sequence[Any]] = [
        (
            attribute.name, limits(attribute.low, attribute.high, attribute.unit),
            "" if attribute.unit == "1" else unit_words(attribute.unit), at[i],
            capability.mean[i], capability.deviation[i], 100 * (1 - capability.outside[i]),
            100 * capability.error[i],
        )
        for i, attribute in enumerate(case.attributes)
    ]  # fmt: skip
    text = f"{100 * (1 - capability.joint):.4g} % of {capability.batches:,} batches keep all limits"
    return LiveTable("Attributes and their limits", COLUMNS, rows, text)


def _deltas(process: Process) -> Iterator[dict[str, Any]]:
    """Derivatives of every attribute with respect to every number, per unit, at the set point."""
    entries = every_entry(process.inputs)
    jacobian = matrix(process, entries=entries, mode="adjoint").jacobian
    values = pharma_inputs(process.case)
    for attribute, row in zip(process.case.attributes, jacobian):
        by = dict(zip(entries, row.tolist()))
        for name, item in values.items():
            slope = np.array([by[name, i] for i in range(item.value.size)])
            move = 0.01 * item.value if item.move is None else np.full(item.value.size, item.move)
            rows = [
                {"label": label, "value": value, "low": None, "high": None}
                for label, value in zip(item.names(), slope.tolist())
            ]
            yield {
                "of": attribute.name, "of_unit": attribute.unit, "input": name,
                "effect": float(slope @ move.ravel()), "low": None, "high": None, "rows": rows,
            }  # fmt: skip
