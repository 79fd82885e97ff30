"""The TOML tables of a case of control; those of a plant are made from its description."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from snapo.case.table import TITLE, CaseTable, Title

from .plants.plant import Plant, PlantParameter

Width = Annotated[int, Field(ge=1, le=4096)]
Widths = Annotated[list[Width], Field(min_length=1, max_length=8)]
MatrixRows = list[list[float]]
PositiveOrNone = Annotated[float, Field(gt=0)] | None


def _whole_number(low: int, high: int, note: str) -> Any:
    """A key for a whole number from `low` to `high`, or none; with its description."""
    return Field(None, ge=low, le=high, description=f"a whole number from {low} to {high:,}{note}")


class ControlFile(CaseTable):
    """The whole file; the tables in it are read by their own records."""

    kind: str
    title: Title = Field("", description=TITLE)
    plant: dict[str, Any] = Field(description="a table, [plant]")
    cost: dict[str, Any] = Field({}, description="a table, [cost]")
    start: dict[str, Any] = Field({}, description="a table, [start]")
    noise: dict[str, Any] = Field({}, description="a table, [noise]")
    measurement: dict[str, Any] = Field({}, description="a table, [measurement]")
    policy: dict[str, Any] = Field({}, description="a table, [policy]")
    report: dict[str, Any] = Field({}, description="a table, [report]")
    objective: dict[str, Any] = Field({}, description="a table, [objective]")
    training: dict[str, Any] = Field({}, description="a table, [training]")
    evaluation: dict[str, Any] = Field({}, description="a table, [evaluation]")


class ControlPolicyTable(CaseTable):
    """`[policy]`: the network."""

    hidden: Widths | None = Field(
        None, description="a list of widths, [32, 32]; by default chosen from the problem"
    )
    memory: Literal["GRU", "Recent"] | None = Field(
        None,
        description='"GRU" (a recurrent network), "Recent" (the last observations) or left out',
    )
    steps: int | None = _whole_number(2, 1000, 'with memory = "Recent", of observations')


class PlantTable(CaseTable):
    """`[plant]`: the keys of every plant in addition to its parameters."""

    type: str
    horizon: int | None = _whole_number(1, 100_000, " of steps")
    clock: bool | None = Field(
        None, description="true or false: whether the policy observes the remaining time"
    )


def plant_table(plant: type[Plant]) -> type[PlantTable]:
    """`[plant]` of one type."""
    kind: Any = (Literal[plant.type], Field(description=f'"{plant.type}"'))
    fields = {"type": kind, **_fields(plant.parameters)}
    return pydantic.create_model("PlantTable", __base__=PlantTable, **fields)


def cost_table(plant: type[Plant]) -> type[CaseTable]:
    """`[cost]` of one type."""
    return pydantic.create_model("CostTable", __base__=CaseTable, **_fields(plant.weights))


def _fields(parameters: Mapping[str, PlantParameter]) -> dict[str, Any]:
    return {name: (_kind(item), _field(item)) for name, item in parameters.items()}


def _kind(parameter: PlantParameter) -> Any:
    if parameter.value is None:
        return MatrixRows
    return PositiveOrNone if parameter.positive else float | None


def _field(parameter: PlantParameter) -> Any:
    text = (
        f"{parameter.description}, {parameter.unit}"
        if parameter.unit not in ("", "1")
        else parameter.description
    )
    if parameter.value is None:
        return Field(description=f"a list of rows: {parameter.description}")
    above = " above 0" if parameter.positive else ""
    usual = "none" if math.isinf(parameter.value) else f"{parameter.value:g}"
    return Field(None, description=f"a number{above} ({text}; by default {usual})")


class At(CaseTable):
    """A initial state that is known."""

    at: float | list[float] = Field(description="a number, or a list of them")


class UniformStart(CaseTable):
    """A initial state anywhere between two numbers."""

    low: float = Field(description="a number below high")
    high: float = Field(description="a number above low")


class NormalStart(CaseTable):
    """A initial state that is normal, its numbers independent."""

    mean: float | list[float] = Field(description="a number, or a list of them")
    deviation: float | list[float] = Field(description="a number above 0, or a list of them")
