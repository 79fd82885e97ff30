"""The tables of `[optimise]` as they stand in the TOML file, each key with its meaning."""

from typing import Annotated, Any, Literal

from pydantic import Field

from snapo.case.table import Table

from .fields import Text, quantity, word


class TermTable(Table):
    """`[[optimise.terms]]`, `[[optimise.per]]`"""

    of: Text = Field(description='a measure or a number, such as "process.product.C"')
    unit: str = Field("1", description='the unit in which it counts, such as "kg"')
    weight: float = Field(1.0, description="a number")


class DecisionTable(Table):
    """`[[optimise.decisions]]`"""

    of: Text = Field(description='a number of the case, such as "crystalliser.temperature[1]"')
    low: Any = quantity('"273 K"')
    high: Any = quantity('"313 K"')


class OptimiseTable(Table):
    """`[optimise]`"""

    sense: Literal["maximise", "minimise"] = word("maximise", "minimise", default="maximise")
    terms: Annotated[list[dict], Field(min_length=1)] = Field(
        description="tables [[optimise.terms]]"
    )
    per: list[dict] = Field([], description="tables [[optimise.per]]")
    decisions: Annotated[list[dict], Field(min_length=1)] = Field(
        description="tables [[optimise.decisions]]"
    )
    reserve: Annotated[float, Field(ge=0)] = Field(
        0.0, description="a number of margins, 0 or more"
    )
    starts: Annotated[int, Field(ge=1, le=1000)] = Field(1, description="a whole number, 1 or more")
