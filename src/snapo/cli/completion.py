"""Completion in other programs: commands in a shell and the keys of a case in an editor.

`snapo completion SHELL` prints a script for the shell, made from the arguments of the command, and
`snapo schema KIND` the JSON schema of a kind of case, made from the tables of its reader. The
schema has the ranges, options and descriptions of the tables; checks that depend on other keys are
left to `snapo check`.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from snapo.case.error import CaseError

if TYPE_CHECKING:
    from snapo.case.table import CaseTable, Formats

# Kinds of files that are no cases: the modules with their tables.
OTHER_FILES = {
    "book": "snapo.book.file", "calibration": "snapo.domains.gas_storage.history.read"
}  # fmt: skip
DIALECT = "https://json-schema.org/draft/2020-12/schema"
KINDS = (
    "gas-storage",
    "swing",
    "battery",
    "park-and-loan",
    "stores",
    "plant",
    "pension",
    "pharma",
    "inventory",
    "control",
    "own",
)


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script that makes `shell` complete commands, options and their choices."""
    commands = dict(_commands(parser))
    return _fish(commands) if shell == "fish" else _bash(commands, zsh=shell == "zsh")


def _commands(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.items()


def _options(parser: argparse.ArgumentParser) -> dict[str, list[str]]:
    """{option: its possible values}."""
    return {
        text: [str(choice) for choice in action.choices or ()]
        for action in parser._actions
        for text in action.option_strings
        if text.startswith("--")
    }


def _words(parser: argparse.ArgumentParser) -> list[str]:
    """The possible values of an argument."""
    results = [
        str(choice)
        for action in parser._actions
        if not action.option_strings
        for choice in action.choices or ()
    ]
    kinds = any(action.metavar == "KIND" for action in parser._actions)
    return [*results, *(KINDS if kinds else ())]


def _bash(commands: dict[str, argparse.ArgumentParser], zsh: bool) -> str:
    cases = []
    for name, parser in commands.items():
        options = _options(parser)
        after = "".join(
            f"        {name}:{option}) COMPREPLY=($(compgen -W '{' '.join(text)}'"
            ' -- "$word")); return;;\n'
            for option, text in options.items()
            if text
        )
        cases.append(after)
    lists = "\n".join(
        f"        {name}) words='{' '.join([*_words(parser), *_options(parser)])}';;"
        for name, parser in commands.items()
    )
    head = "autoload -U +X bashcompinit && bashcompinit\n" if zsh else ""
    return f"""{head}_snapo() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" words=''
    case "${{COMP_WORDS[1]}}:$before" in
{"".join(cases)}    esac
    if [ "$COMP_CWORD" -eq 1 ]; then words='{" ".join(commands)} --help --version'; else
    case "${{COMP_WORDS[1]}}" in
{lists}
    esac; fi
    COMPREPLY=($(compgen -W "$words" -- "$word"))
    case "$word" in -*) return;; esac
    [ "$COMP_CWORD" -gt 1 ] && COMPREPLY+=($(compgen -f -- "$word"))
}}
complete -o filenames -F _snapo snapo
"""


def _fish(commands: dict[str, argparse.ArgumentParser]) -> str:
    lines = [f"complete -c snapo -n __fish_use_subcommand -f -a '{' '.join(commands)}'"]
    for name, parser in commands.items():
        here = f"complete -c snapo -n '__fish_seen_subcommand_from {name}'"
        if text := _words(parser):
            lines.append(f"{here} -a '{' '.join(text)}'")
        for option, text in _options(parser).items():
            automatic = f" -x -a '{' '.join(text)}'" if text else ""
            lines.append(f"{here} -l {option[2:]}{automatic}")
    return "\n".join(lines) + "\n"


def schema_of_kind(kind: str) -> dict[str, Any]:
    """The JSON schema of the cases of an installed kind, of books, or of calibrations.

    **Raises:** `CaseError` if there is no such kind, or it does not list its tables.
    """
    from snapo.study.domain import find

    if kind in OTHER_FILES:
        return json_schema(kind, import_module(OTHER_FILES[kind]).FORMATS) | {"title": f"A {kind}"}
    domain = find(kind, "KIND", "")
    formats = getattr(domain, "formats", None)
    if formats is None:
        message = "this kind does not list its tables: its domain has no method `formats`"
        raise CaseError("KIND", "", kind, message)
    return json_schema(kind, formats())


def json_schema(kind: str, formats: "Formats") -> dict[str, Any]:
    """The JSON schema of the cases of a kind with these tables."""
    from pydantic.json_schema import models_json_schema

    lists = {name: [x] if isinstance(x, type) else list(x) for name, x in formats.items()}
    models = dict.fromkeys(table for tables in lists.values() for table in tables)
    references, parts = models_json_schema([(model, "validation") for model in models])
    names = {model: references[model, "validation"]["$ref"] for model in models}
    definitions = parts["$defs"]

    def properties(table: "type[CaseTable]") -> dict[str, Any]:
        return definitions[names[table].rpartition("/")[2]].setdefault("properties", {})

    for name, tables in lists.items():
        path = name.removesuffix("[]").removesuffix(".*")
        parent, _, key = path.rpartition(".")
        for table in lists.get(parent, []) if name else []:
            keys = properties(table)
            if keys.get(key, {"type": "string"}).get("type") != "string":  # it may be a table
                value = _nested(name, _either([names[inner] for inner in tables]))
                keys[key] = _about(keys[key]) | _or_plain(keys[key], value)
    for table in lists[""]:
        text = f'Kind of the file. Allowed: "{kind}".'
        properties(table)["kind"] = {"const": kind, "description": text}
    complete = _either([names[table] for table in lists[""]])
    return {"$schema": DIALECT, "title": f"A case of kind {kind}", **complete, "$defs": definitions}


def _either(references: Sequence[str]) -> dict[str, Any]:
    tables = [{"$ref": reference} for reference in references]
    return tables[0] if len(tables) == 1 else {"anyOf": tables}


def _nested(name: str, table: dict[str, Any]) -> dict[str, Any]:
    if name.endswith("[]"):
        return {"type": "array", "items": table}
    if name.endswith(".*"):
        return {"type": "object", "additionalProperties": table}
    return table


def _or_plain(schema: Mapping[str, Any], table: dict[str, Any]) -> dict[str, Any]:
    """The schema of a key that may have a table, or one of the plain values that the schema of the
    key also allows."""
    types = schema.get("type", "")
    others = [] if isinstance(types, str) else [name for name in types if name != "object"]
    return {"anyOf": [{"type": others}, table]} if others else table


def _about(schema: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a key's schema that describes it, without its type."""
    return {"description": schema["description"]}
