"""Conditions under which a key of a case has an effect. They are declared with the key and checked
when all tables have been read.

    spouse_share: Annotated[Share, COHORTS] = Field(0.0, description=SHARE)

A key without any effect in a case is a mistake of the user, and is refused.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic.fields import FieldInfo

from .error import CaseError
from .given import CaseInput

Tables = Mapping[str, Any]


@dataclass(frozen=True)
class Only:
    """A key that has an effect only under a condition.

    - `applies`: the condition, from the tables of a case by name ("" is the whole file).
    - `when`: the condition as a clause after "only". `instead`: the alternative that the case uses.
    """

    applies: Callable[[Tables], bool]
    when: str
    instead: Callable[[Tables], str] | None = None

    def why(self, tables: Tables) -> str:
        """The reason why the key is refused."""
        reason = f"this key is used only {self.when}"
        if self.instead is None:
            return reason
        return f"{self.instead(tables)} does not use this key; it is used only {self.when}"


def conditions(field: FieldInfo) -> Iterator[Only]:
    """All conditions under which a key has an effect."""
    return (item for item in field.metadata if isinstance(item, Only))


def check_meanings(file: str, tables: Tables) -> None:
    """Refuses the keys of a case that have no effect.

    **Raises:** `CaseError` with all of them.
    """
    mistakes = []
    for name, table in tables.items():
        for key in type(table).model_fields:
            if key not in table.model_fields_set:
                continue
            for only in conditions(type(table).model_fields[key]):
                if not only.applies(tables):
                    value = getattr(table, key)
                    value = value.written if isinstance(value, CaseInput) else value
                    displayed = None if isinstance(value, dict | list) else value
                    where = f"{name}.{key}" if name else key
                    mistakes.append(CaseError(file, where, displayed, only.why(tables)))
                    break
    if mistakes:
        first, *rest = mistakes
        raise CaseError(first.file, first.where, first.value, first.allowed, rest)
