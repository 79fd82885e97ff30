"""The TOML tables of a case with a simulator of the user's own."""

from typing import Annotated, Any

from pydantic import Field

from snapo.case.table import TITLE, CaseTable, Positive, Title

NumberArray = float | list[float] | list[list[float]]


class OwnTable(CaseTable):
    """The whole file; the tables in it are read by their own records."""

    kind: str
    title: Title = Field("", description=TITLE)
    step: str = Field("step", description='the word for one step of the simulator, like "week"')
    objective: dict[str, Any] | list[dict[str, Any]] = Field(
        {}, description="a table, [objective], or several, [[objective]]"
    )
    inputs: dict[str, Any] = Field({}, description="a table, [inputs]")
    units: dict[str, str] = Field(
        {}, description="a table of units by name of a state, of the action or of an output"
    )
    training: dict[str, Any] = Field({}, description="a table, [training]")
    evaluation: dict[str, Any] = Field({}, description="a table, [evaluation]")
    simulator: dict[str, Any] = Field({}, description="a table, [simulator]")


class InputTable(CaseTable):
    """One entry of `[inputs]`: numbers in the file or a column of a CSV, and their meaning."""

    value: NumberArray | None = Field(None, description="a number, or an array of numbers")
    file: str | None = Field(None, description="the name of a .csv file beside the case")
    column: str | None = Field(None, description="the name of a column of the file")
    label: str | None = Field(None, description="the name of the column that labels the numbers")
    labels: list[str] | None = Field(None, description="one text per number")
    unit: str = Field("", description='text, like "EUR/MWh"')
    words: str = Field("", description="text: the meaning of the input")
    group: str = Field("", description="text: the family of risk")
    bump: Positive | None = Field(None, description="a number above 0, in the unit")
    move: float | None = Field(None, description="a number other than 0, in the unit")
    trade_unit: str = Field("", description="text: the unit in which its owner thinks")
    trade_factor: Annotated[float, Field(gt=0)] = Field(
        1.0, description="a number above 0: how many trade units make one unit"
    )
