"""The pages of docs/: their links lead somewhere, the code that they name exists, examples run."""

import ast
import doctest
import re
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import snapo

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
PAGES += sorted((ROOT / "examples").rglob("*.md")) + sorted((ROOT / "src").rglob("*.md"))
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
# Where a page may count its paths from; rooms.md counts them from the package.
HOMES = [
    ROOT,
    ROOT / "src",
    ROOT / "src" / "snapo",
    ROOT / "docs",
    *(ROOT / "src" / "snapo" / "domains").iterdir(),
]
HOMES += [
    ROOT / "src" / "snapo" / "engine",
    ROOT / "src" / "snapo" / "domains" / "gas_storage" / "bounds",
]


def relative(page: Path) -> str:
    return str(page.relative_to(ROOT))


@cache
def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^(```+).*?^\1", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)


@cache
def places(page: Path) -> set[str]:
    """The targets that headings make, as code hosts name them."""
    heads = re.findall(r"^#+ (.+)$", prose(page), re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def test_links_lead_somewhere():
    for page in PAGES:
        for link in LINK.findall(prose(page)):
            if re.match(r"\w+:", link):
                continue
            path, _, place = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            assert target.exists(), f"{relative(page)}: {link}"
            if place and target.suffix == ".md":
                assert place in places(target), f"{relative(page)}: {link}"


def test_code_that_is_named_exists():
    named_code = re.compile(r"`([^`\n]+)`")
    for page, code in ((each, code) for each in PAGES for code in named_code.findall(prose(each))):
        if re.fullmatch(r"[\w/.]+/[\w.]+\.(py|md|toml|js|css)", code):
            homes = [page.parent, *HOMES]
            found = [each for each in homes if (each / code).exists()]
            assert found or code.startswith(("mine/", "snapo_")), f"{relative(page)}: {code}"
        elif match := re.match(r"snapo((?:\.\w+)+)", code):
            assert named(match[1][1:].split(".")), f"{relative(page)}: {code}"


def named(words: list[str]) -> bool:
    """Whether `snapo.a.b.Name` is a public name or is defined in that module; nothing is imported."""
    if words[0] in snapo.__all__ or words == ["domains"]:
        return True
    home = ROOT / "src" / "snapo"
    for i, word in enumerate(words):
        if (home / word).is_dir():
            home = home / word
        elif (home / f"{word}.py").is_file():
            rest = words[i + 1 :]
            return not rest or rest[0] in defined(home / f"{word}.py")
        else:
            return word in defined(home / "__init__.py")
    return True


@cache
def defined(file: Path) -> set[str]:
    """The names at the top of a module."""
    found = set()
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            found |= {each.asname or each.name for each in node.names}
        elif isinstance(node, ast.Assign):
            found |= {each.id for each in node.targets if isinstance(each, ast.Name)}
        else:
            found.add(getattr(node, "name", "") or getattr(getattr(node, "target", None), "id", ""))
    return found


def test_every_extra_is_told():
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    told = (ROOT / "docs" / "extras.md").read_text()
    assert not [name for name in extras if f"`{name}`" not in told]


def test_every_page_is_on_the_site():
    trees = re.findall(r"```{toctree}(.*?)```", "".join(p.read_text() for p in PAGES), re.S)
    listed = {line.strip("<>").split("/")[-1] for tree in trees for line in tree.split()}
    for page in PAGES:
        orphan = page.name == "index.md" or "\norphan: true\n" in page.read_text()
        if page.is_relative_to(ROOT / "docs") and not orphan:
            assert page.stem in listed, relative(page)


def test_columns_of_tables_have_heads():
    """A reader of a screen, and a reader in a hurry, needs the head of every column."""
    for page in PAGES:
        lines = prose(page).splitlines()
        heads = [head for head, rule in pairwise(lines) if re.match(r"\|(?:-+\|)+$", rule)]
        assert not [head for head in heads if re.search(r"\|\s*\|", head)], relative(page)


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def test_messages_of_the_troubleshooting_page_are_those_of_the_package():
    package = "\n".join(file.read_text() for file in (ROOT / "src").rglob("*.py"))
    package = re.sub(r'"\s*f?"', "", package)
    rows = re.findall(r"^\| (`.+?) \|", (ROOT / "docs" / "troubleshooting.md").read_text(), re.M)
    messages = [code for row in rows for code in re.findall(r"`([^`]+)`", row)]
    assert len(messages) > 15
    assert not [text for text in messages if text.split("[")[0].replace("…", "{") not in package]


@pytest.mark.prove
def test_examples_of_docstrings_run():
    finder, runner = doctest.DocTestFinder(), doctest.DocTestRunner()
    seen = 0
    for name in snapo.__all__:
        thing = getattr(snapo, name)
        if not hasattr(thing, "__module__"):
            continue
        for test in finder.find(thing, name, module=False, globs={"snapo": snapo, "np": np}):
            seen += runner.run(test).attempted
    assert seen > 20 and not runner.failures


def test_large_brackets_have_their_side():
    r"""The site's equations are made by docutils, which knows `\bigl` and `\bigr`, not `\big`."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r"\\[bB]igg?[^a-zA-Z]", text), relative(page)
