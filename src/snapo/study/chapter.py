"""A chapter: one analysis of a run, from its measurement to its section of the report.

    BASELINES = Chapter("baselines", "Classical rules", Baselines, measure, show)

`BASELINES.part` is a part of a study, and `BASELINES` a section of its report. `measure` returns a
frozen dataclass, which is saved as JSON and read back as the same type. Other code reads
`BASELINES.of(run).optimum`, so a type checker finds a misspelt name.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import Annotated, Any, Generic, TypeVar

import numpy as np
from pydantic import BeforeValidator, PlainValidator, TypeAdapter, ValidationError

from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Section

from .study import Part, StudyRun
from .training import TRAINING

Result = TypeVar("Result")
Number = Annotated[float, BeforeValidator(lambda x: np.nan if x is None else x)]  # null is NaN
Floats = Annotated[np.ndarray, PlainValidator(lambda x: np.array(x, np.float64))]


def floats() -> Any:
    """A field of `Floats` that is empty by default."""
    return field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class Chapter(Generic[Result]):
    """One analysis of a run.

    - `name`: the name of its part, its file and the anchor of its section.
    - `title`: the title of the section, or a function of the files of the run; `short`: its text in
      the menu, by default the name; `anchor`: the anchor, if it differs from the name.
    - `result`: a frozen dataclass of `Number`, `Floats`, texts and other such dataclasses; with a
      `key`, also a `tuple[Row, ...]` of them.
    - `measure`: takes the run; `show`: takes the files of the run and the result, and returns
      blocks.
    - `needs`: names of the parts that must be done first.
    - `key`: the key of the result in the file of the part; with "" the fields of the result are
      keys of the file.
    - `table`: a table of the case; the study has the part only if the case has this table.
    - `optional`: whether the section is omitted if a run does not have the part; otherwise the
      section gives the reason.

    No two chapters of a study may write the same key.
    """

    name: str
    title: str | Callable[[Any], str]
    result: type[Result]
    measure: Callable[[StudyRun], Result]
    show: Callable[[Any, Result], Sequence[Block]]
    short: str = ""
    needs: tuple[str, ...] = (TRAINING.name,)
    key: str = ""
    anchor: str = ""
    table: str = ""
    optional: bool = False

    @property
    def part(self) -> Part:
        """The part of a study for this chapter."""
        return Part(self.name, lambda run: self.data(self.measure(run)), self.needs)

    def data(self, result: Result) -> dict[str, Any]:
        """The result by the keys in the file of the part; arrays are unchanged."""
        plain: Any = asdict  # of a type that is a dataclass, which no type variable can express
        if isinstance(result, tuple):
            return {self.key: [plain(record) for record in result]}
        entries = plain(result)
        return {self.key: entries} if self.key else entries

    def of(self, run: StudyRun | RunFiles) -> Result | None:
        """The result, during the run or from its files; None if there is none."""
        if self.key:
            entries = run.get(self.key)
        else:
            # A field missing in the file has its default; a number without one is null.
            values = {name: run.get(name) for name in self._defaults}
            entries = {k: x for k, x in values.items() if x is not None or not self._defaults[k]}
            entries = None if all(x is None for x in values.values()) else entries
        if entries is None:
            return None
        try:
            return self._adapter.validate_python(entries)
        except ValidationError:  # the file of another release, or a damaged one
            return None

    def section(
        self,
        anchor: str,
        title: str | Callable[[Any], str],
        short: str,
        show: Callable[[Any, Result], Sequence[Block]],
    ) -> "Chapter[Result]":
        """A further section of the report that shows the same result."""
        return replace(self, anchor=anchor, title=title, short=short, show=show)

    def __call__(self, run: RunFiles) -> Section:
        """The section of the report; if there is no result, the section gives the reason."""
        anchor = self.anchor or re.sub(r"\W", "-", self.name)
        short = self.short or self.name.capitalize()
        if run.left_out(self.name) or (self.optional and self.name not in run.parts):
            return Section(anchor, "", "", [])
        result = self.of(run)
        blocks = (
            [why_missing(run, self.name, self.table)] if result is None else self.show(run, result)
        )
        title = self.title if isinstance(self.title, str) else self.title(run)
        return Section(anchor, title, short, list(blocks))

    @cached_property
    def _defaults(self) -> dict[str, bool]:
        """{name of a field: whether it has a default, which is used for a missing key}."""
        names = fields(self.result)  # pyright: ignore[reportArgumentType]
        return {x.name: (x.default, x.default_factory) != (MISSING, MISSING) for x in names}

    @cached_property
    def _adapter(self) -> TypeAdapter[Result]:
        return TypeAdapter(self.result)
