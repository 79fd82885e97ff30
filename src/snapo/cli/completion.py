"""`snapo completion SHELL`: a script for the shell, made from the command's own arguments."""

import argparse
from collections.abc import Iterator

KINDS = ("gas-storage", "pension", "pharma", "inventory", "control", "own")


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script that makes `shell` complete commands, options and their choices."""
    commands = dict(_commands(parser))
    return _fish(commands) if shell == "fish" else _bash(commands, zsh=shell == "zsh")


def _commands(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.items()


def _options(parser: argparse.ArgumentParser) -> dict[str, list[str]]:
    """{option: the words that may follow it}."""
    return {
        text: [str(each) for each in action.choices or ()]
        for action in parser._actions
        for text in action.option_strings
        if text.startswith("--")
    }


def _words(parser: argparse.ArgumentParser) -> list[str]:
    """The words that may stand in the place of an argument."""
    found = [
        str(each)
        for action in parser._actions
        if not action.option_strings
        for each in action.choices or ()
    ]
    kinds = any(action.metavar == "KIND" for action in parser._actions)
    return [*found, *(KINDS if kinds else ())]


def _bash(commands: dict[str, argparse.ArgumentParser], zsh: bool) -> str:
    cases = []
    for name, parser in commands.items():
        options = _options(parser)
        after = "".join(
            f"        {name}:{option}) COMPREPLY=($(compgen -W '{' '.join(words)}'"
            ' -- "$word")); return;;\n'
            for option, words in options.items()
            if words
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
        if words := _words(parser):
            lines.append(f"{here} -a '{' '.join(words)}'")
        for option, words in _options(parser).items():
            follows = f" -x -a '{' '.join(words)}'" if words else ""
            lines.append(f"{here} -l {option[2:]}{follows}")
    return "\n".join(lines) + "\n"
