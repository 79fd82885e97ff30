"""The directive `case-tables`: the keys of a case format, from the descriptions in its own tables.

    ```{case-tables} snapo.domains.pension
    ```

Meanings, and the texts that error messages quote as allowed, are written once, in the code.
"""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from docutils import nodes
from pydantic_core import PydanticUndefined
from sphinx.util.docutils import SphinxDirective

from snapo.case.meaning import conditions
from snapo.case.table import CaseTable


class CaseTables(SphinxDirective):
    """A section for each table of a package, in the order of its modules."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        lines = [line for table in tables(self.arguments[0]) for line in described(table)]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


def tables(package: str) -> Iterator[type[CaseTable]]:
    """The tables that a package, or a module, defines."""
    top = importlib.import_module(package)
    names = [
        each.name for each in pkgutil.walk_packages(getattr(top, "__path__", []), package + ".")
    ]
    for name in [package, *names]:
        if "template" in name:
            continue
        module = importlib.import_module(name)
        for found in vars(module).values():
            if inspect.isclass(found) and found.__module__ == name:
                # A record has its table from the declarations of its fields.
                table = found.table if "heading" in vars(found) else found
                if issubclass(table, CaseTable):
                    yield table


def described(table: type[CaseTable]) -> Iterator[str]:
    """Title, sentence and keys of one table, as Markdown."""
    title, _, words = _flat(inspect.getdoc(table) or table.__name__).partition(": ")
    yield from (f"## {title}", "", words[:1].upper() + words[1:], "")
    yield from ("| key | meaning | allowed | default |", "|---|---|---|---|")
    for key, field in table.model_fields.items():
        allowed = field.description or _kind(field.annotation)
        if only := ", and ".join(each.when for each in conditions(field)):
            allowed += f"; only {only}"
        allowed = _cell(allowed)
        meaning = _cell(field.title or "")
        yield f"| `{field.alias or key}` | {meaning} | {allowed} | {_default(field)} |"
    yield ""


def _flat(text: str) -> str:
    return re.sub(r"\s+", " ", text).strip()


def _cell(text: str) -> str:
    """Words in a cell of a table: braces and pipes are no markup."""
    return re.sub(r"([|*_<{\[\]])", r"\\\1", _flat(text))


def _kind(annotation: Any) -> str:
    """The words for a key that has no description: its type."""
    if get_origin(annotation) is Literal:
        return " or ".join(f'"{each}"' for each in get_args(annotation))
    inner = [each for each in get_args(annotation) if each is not type(None)]
    for each in [annotation, *inner]:
        if isinstance(each, type):
            if issubclass(each, CaseTable):
                return "a table"
            words = {str: "a text", float: "a number", int: "a whole number", bool: "true or false"}
            words |= {list: "a list", dict: "a table"}
            if each in words:
                return words[each]
    origin = {list: "a list", dict: "a table"}.get(get_origin(annotation) or object)
    return origin or (_kind(inner[0]) if inner else "see the template")


def _default(field) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if value is PydanticUndefined or value is None or value == () or isinstance(value, CaseTable):
        return ""
    shown = str(value).lower() if isinstance(value, bool) else value
    return f'`"{shown}"`' if isinstance(value, str) else f"`{shown}`"


def setup(app):
    """Registers the directive."""
    app.add_directive("case-tables", CaseTables)
    return {"parallel_read_safe": True}
