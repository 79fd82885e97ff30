"""A kind of case whose modules are imported when they are first needed."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from importlib.resources import files
from inspect import isfunction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snapo.case.error import CaseError

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

    from snapo.case.table import Formats

    from .domain import Case, Options, Report
    from .study import ProgressCallback, Study


@dataclass(frozen=True, eq=False)
class Kind:
    """A domain (see `snapo.study.domain.Domain`) by the names of its functions.

    - `kind`, `description`: the word in a case's `kind`, and a phrase for the list of `snapo new`.
    - `package`: the name of its package; `sizes`: {size: folder in it that `snapo new` copies}.
    - `reader`, `summary`, `maker`, `page`, `timer`: "MODULE:NAME" in the package, for `read(file,
      data)`, `check(case)`, `study(case, options)`, a `Report`, and `bench(engine, progress)`;
      without a timer, there are no separate times for the kind.
    - `tables`: the name of the `Formats` of its tables, or of a function that returns them; `snapo
      schema` makes its schema from them.
    - `relaxed`: the name of a function that returns a case's tables without the checks that apply
      to its present numbers only, so that the numbers can be changed; "" if there are no such
      checks.
    - `explainer`: the name of a function that splits the change of value between two runs into
      parts; "" if there is none.
    """

    kind: str
    description: str
    package: str
    sizes: Mapping[str, str]
    reader: str = "read.case:read_case"
    summary: str = "study:lines"
    maker: str = "study:study"
    page: str = "report:REPORT"
    timer: str = ""
    tables: str = "read.case:FORMATS"
    relaxed: str = ""
    explainer: str = ""

    @cached_property
    def templates(self) -> "dict[str, Traversable]":
        return {size: files(self.package) / folder for size, folder in self.sizes.items()}

    def read(self, file: Path, data: Mapping[str, Any]) -> "Case":
        return self.loaded(self.reader)(file, data)

    def check(self, case: Any) -> list[str]:
        return self.loaded(self.summary)(case)

    def study(self, case: Any, options: "Options") -> "Study":
        return self.loaded(self.maker)(case, options)

    def report(self) -> "Report":
        return self.loaded(self.page)

    def formats(self) -> "Formats":
        tables: Any = self.loaded(self.tables)
        return tables() if isfunction(tables) else tables

    def bench(self, engine: str, progress: "ProgressCallback") -> str:
        if not self.timer:
            allowed = (
                "there are no separate times for this kind; `snapo solve` reports the times of a "
                "case"
            )
            raise CaseError("KIND", "", self.kind, allowed)
        return self.loaded(self.timer)(engine, progress)

    def with_other_numbers(self, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """The tables of a case whose numbers are moved, without the checks that apply to the
        numbers in its file only."""
        return self.loaded(self.relaxed)(data) if self.relaxed else data

    def loaded(self, name: str) -> Any:
        """The object "MODULE:NAME" of the package."""
        module, _, attribute = name.partition(":")
        return getattr(import_module(f"{self.package}.{module}"), attribute)


def inputs_line(sizes: Collection[int]) -> str:
    """The line of a summary on the inputs of a case; `sizes`: the numbers of entries of the
    inputs."""
    return f"{len(sizes)} inputs with {sum(sizes)} numbers, each with a sensitivity"


def with_other_numbers(domain: Any, data: Mapping[str, Any]) -> Mapping[str, Any]:
    """`Kind.with_other_numbers`; for a domain that is not a `Kind`, the tables themselves."""
    return domain.with_other_numbers(data) if isinstance(domain, Kind) else data
