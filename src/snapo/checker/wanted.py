"""The outputs that objective and constraints name, against those that there are."""

from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

from snapo.problem.objective import Limit, Objective, as_constraints

from .findings import Notes


class Unknown(NamedTuple):
    """What is wrong with `of`, the objective or a limit: the name or thing that it has in place of
    an output."""

    of: str
    got: str
    subject: str


def unknown_outputs(
    objective: Any, constraints: Sequence[Any] | Limit, outputs: Collection[str]
) -> Iterator[Unknown]:
    """Every output that is named and is not there; what is no objective or limit at all.

    None is an objective that is not known yet.
    """
    if objective is None:
        pass
    elif not isinstance(objective, Objective):
        yield Unknown("objective", repr(objective), "It is no objective, such as Mean(output).")
    else:
        yield from _missing("objective", objective, outputs)
    for k, limit in enumerate(as_constraints(constraints)):
        if not isinstance(limit, Limit):
            message = "It is no constraint, such as Mean(output) <= level."
            yield Unknown(f"constraints[{k}]", repr(limit), message)
        else:
            yield from _missing(f"constraints[{k}]", limit.measure, outputs)


def _missing(of: str, measure: Objective, outputs: Collection[str]) -> Iterator[Unknown]:
    for name in dict.fromkeys(measure.outputs):
        if name not in outputs:
            yield Unknown(of, repr(name), f"There is no output {name!r}.")


def require(
    notes: Notes, objective: Any, constraints: Sequence[Any] | Limit, outputs: Collection[str]
) -> None:
    """Writes them down, and stops where there are any."""
    for unknown_output in unknown_outputs(objective, constraints, outputs):
        metadata = (
            unknown_output.subject
            if unknown_output.got in unknown_output.subject
            else f"{unknown_output.subject[:-1]}: {unknown_output.got}."
        )
        notes.error(unknown_output.of, metadata, f"The outputs are {sorted(outputs)}.")
    notes.stop_on_errors()
