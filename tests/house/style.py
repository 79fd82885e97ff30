"""Style of README, docs, changelog and help texts: patterns of style.tsv, and long sentences.

    python -m tests.house.style          every finding with file and line

Code, equations and addresses are left out. Spelling is checked by codespell in `make lint`.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
MOST_WORDS = 35
LISTS = ("docs/pension_case.md", "docs/pharma_case.md")  # of keys, which semicolons separate
BLANK = re.compile(
    r"^[ \t]*(`{3,}|\$\$).*?^[ \t]*\1|\A---\n.*?^---|<!--.*?-->|\]\([^)]*\)|^\[.*?\]: .*?$|https?://\S+",
    re.M | re.S,
)
WORD = re.compile(r"[\w'’%.,-]*\w[\w'’%.,-]*")
INLINE = re.compile(r"`[^`]*`|\$[^$\n]+\$")


def pages() -> list[Path]:
    """The pages that are checked."""
    top = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")]
    return [*top, *sorted((ROOT / "docs").rglob("*.md"))]


def patterns() -> list[tuple[re.Pattern[str], str]]:
    """Each pattern with what to write instead."""
    rows = (HERE / "style.tsv").read_text(encoding="utf-8").splitlines()
    pairs = (row.split("\t") for row in rows if row and row[0] != "#")
    return [(re.compile(pattern), better) for pattern, better in pairs]


def prose(text: str) -> str:
    """A page of the same lines, with an X for each piece of code and nothing for the rest."""
    text = BLANK.sub(lambda m: "\n" * m[0].count("\n"), text)
    text = re.sub(r"(?<=\n\n)(?: {4}.*\n|\n)+", lambda m: "\n" * m[0].count("\n"), text)
    return INLINE.sub("X", text)


def sentences(text: str) -> Iterator[tuple[int, str]]:
    """(line, sentence) of a page: paragraphs, items and cells of tables end a sentence."""
    start, block = 1, []
    for number, line in enumerate([*text.splitlines(), ""], 1):
        begins = re.match(r"\s*([-*#|>]|\d+\.) ?|\s*$", line)
        if begins and block:
            yield from ((start, each) for each in _split(" ".join(block)))
            block = []
        if line.lstrip().startswith("|"):
            yield from ((number, each) for cell in line.split("|") for each in _split(cell))
        elif line.strip():
            start = start if block else number
            block.append(line.strip())


def _split(text: str) -> list[str]:
    return re.split(r"(?:(?<=[.:;?!])|(?<=[.?!]\)))\s+(?=[A-Z\d*\[(\"]|snapo )", text)


def findings(name: str, text: str) -> list[str]:
    """`name:line: what is wrong` for one text."""
    plain = prose(text)
    found = []
    for pattern, better in patterns():
        for match in pattern.finditer(plain):
            line = plain.count("\n", 0, match.start()) + 1
            shown = " ".join(match[0].split())
            found.append(f"{name}:{line}: {shown!r}: {better}")
    for line, sentence in sentences(plain):
        parts = re.split(r"[;:] ", sentence) if name in LISTS else [sentence]
        if (words := max(len(WORD.findall(part)) for part in parts)) > MOST_WORDS:
            found.append(f"{name}:{line}: a sentence of {words} words: {sentence[:60]} …")
    return found


def help_texts() -> Iterator[tuple[str, str]]:
    """(command, its help) of the command line."""
    from snapo.cli.main import _parser

    parser = _parser()
    commands = next(x for x in parser._actions if isinstance(x, argparse._SubParsersAction))
    about = [parser.description, parser.epilog, *(x.help for x in commands._choices_actions)]
    yield "snapo", "\n\n".join(text or "" for text in about)
    for name, command in commands.choices.items():
        yield f"snapo {name}", "\n\n".join(x.help or "" for x in command._actions)


def all_findings() -> list[str]:
    """Every finding of pages and help texts."""
    texts = [(str(p.relative_to(ROOT)), p.read_text(encoding="utf-8")) for p in pages()]
    return [each for name, text in [*texts, *help_texts()] for each in findings(name, text)]


if __name__ == "__main__":
    wrong = all_findings()
    print("\n".join(wrong) or "the style is as agreed")
    sys.exit(bool(wrong))
