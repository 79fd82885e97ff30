"""A process without a policy, computed at other inputs for the live page.

Every number is bit for bit that of a run of the changed case, because the same functions use the
same draws.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.record import Input
from snapo.report.quantity import unit_words
from snapo.study.study import CalculatedOutput, LiveTable

from .chapters.capability import BATCHES
from .derivatives.jacobian import matrix
from .flowsheet.case import PharmaCase
from .flowsheet.inputs import pharma_inputs
from .flowsheet.process import PharmaProcess
from .flowsheet.stiffness import with_steps
from .given import Form, every_entry
from .quality import batches
from .quality.batches import AttributeLimits
from .quality.capability import Capability, from_values
from .quality.sampling import sampler

PARTS = (
    "network", "feeds", "units", "connections", "parameters", "attributes", "uncertainty", "held",
    "numerics",
)  # fmt: skip


def _form(case: PharmaCase) -> Form:
    return Form.of(tuple(getattr(case, name) for name in PARTS), case.held)


COLUMNS = (
    ("attribute", ""), ("limits", ""), ("unit", ""), ("at the set point", ""),
    ("mean of batches", ""),
    ("standard deviation", ""), ("within limits", "%"), ("±", "%"),
)  # fmt: skip


FORMS = 8  # whose compiled functions a process of the machine has at most
_compiled: dict[Form, PharmaProcess] = {}


def process_of(case: PharmaCase) -> PharmaProcess:
    """The process of a case, with the functions that were compiled for an earlier process of the
    same form, if there is one; the results are equal bit for bit."""
    case = with_steps(case)
    form = _form(case)
    if form not in _compiled:
        if len(_compiled) == FORMS:
            del _compiled[next(iter(_compiled))]
        _compiled[form] = PharmaProcess(case)
    return _with(_compiled[form], case)


class RecipeCalculation:
    """The recipe, at any numbers of its inputs; nothing is compiled twice."""

    def __init__(self, case: PharmaCase):
        self.case, self._named = case, pharma_inputs(case)

    @property
    def inputs_by_name(self) -> Mapping[str, Input]:
        return self._named

    @cached_property
    def _process(self) -> PharmaProcess:
        return process_of(self.case)

    def stages(self, case: PharmaCase) -> Iterator[tuple[str, Any]]:
        """ "value", "sections" and "deltas"; see `snapo.study.study.Recalculated`.

        **Raises:** `CaseError` if the batch cannot be integrated.
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
        at = np.array([one.attributes[attribute.name] for attribute in case.attributes])
        within = 1 - result.outside
        outputs = [
            CalculatedOutput(x.name, x.unit, values[:, i], float(at[i]), float(within[i]))
            for i, x in enumerate(case.attributes)
        ]
        yield (
            "value",
            {
                "value": 1 - result.joint,
                "standard_error": result.joint_error,
                "paths": result.batches,
                "kept": selected,
                "outputs": outputs,
            },
        )
        yield "sections", [attributes(case, result, at)._asdict()]
        yield "deltas", list(_deltas(process))

    def _at(self, case: PharmaCase) -> PharmaProcess:
        """The process of a case, on as many steps as the first one."""
        steps = self._process.case.numerics.steps
        return process_of(replace(case, numerics=replace(case.numerics, steps=steps, open=False)))

    def _sampled(self, process: PharmaProcess) -> PharmaProcess:
        """On the mesh for statistics."""
        coarse, _ = sampler(process, _on_steps)
        return coarse


def _on_steps(process: PharmaProcess, steps: int) -> PharmaProcess:
    numerics = replace(process.case.numerics, steps=steps)
    return process_of(replace(process.case, numerics=numerics))


def _with(process: PharmaProcess, case: PharmaCase) -> PharmaProcess:
    """A process of `case` with the compiled functions of another that is the same program."""
    new = object.__new__(PharmaProcess)
    new.__dict__.update(process.__dict__)
    new.case = case
    new.inputs = {name: entry.value for name, entry in pharma_inputs(case).items()}
    return new


def limits(low: float | None, high: float | None, unit: str) -> str:
    """The limits as text: "at least 75 %", "70 to 100 µm"."""
    local = "" if unit in ("", "1") else f"\u00a0{unit_words(unit)}".replace(" ", "\u00a0")
    if low is not None and high is not None:
        return f"{low:.6g} to {high:.6g}{local}"
    if low is not None:
        return f"at least {low:.6g}{local}"
    return f"at most {high:.6g}{local}" if high is not None else "none"


def attributes(case: PharmaCase, capability: Capability, at: np.ndarray) -> LiveTable:
    """Every attribute with its limits, and how often batches meet these."""
    rows: list[Sequence[Any]] = [
        (
            attribute.name, limits(attribute.low, attribute.high, attribute.unit),
            "" if attribute.unit == "1" else unit_words(attribute.unit), at[i],
            capability.mean[i], capability.deviation[i], 100 * (1 - capability.outside[i]),
            100 * capability.error[i],
        )
        for i, attribute in enumerate(case.attributes)
    ]  # fmt: skip
    text = f"{100 * (1 - capability.joint):.4g} % of {capability.batches:,} batches meet all limits"
    facts = [(f"{row[0]}, at the set point", float(row[3]), str(row[2])) for row in rows]
    return LiveTable("Attributes and their limits", COLUMNS, rows, text, facts)


def _deltas(process: PharmaProcess) -> Iterator[dict[str, Any]]:
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
