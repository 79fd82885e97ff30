"""The style check finds what it is for, and leaves code, equations and addresses alone."""

import ast
import re

import pytest

from .style import MOST_WORDS, all_findings, findings, help_texts
from .tree import texts, trees

GOOD = """---
orphan: true
---

# A page

The derivative with respect to price is 0.12 ([see](beside.md)), `a .5 beside`, $x^{.5}$, too short to tell.

```python
x = .5  # beside
```

| a | 0.5 |
|---|---|

    indented .5 code, told

See https://example.org/beside and 3.5, 1.2.3, v0.1.
"""


def test_a_plain_page_has_no_finding():
    assert findings("page.md", GOOD) == []


@pytest.mark.parametrize(
    "text",
    [
        "a share of .12", "from -.5 to 1", "the figure beside it", "he is told", "a case of one's own",
        "the derivative by price", "gradients by all inputs", "a cap in place of a floor",
        "by default settings", "this is no limit", "training goes on", "the worth of a unit",
    ],
)  # fmt: skip
def test_a_phrase_is_found_with_its_line(text):
    (found,) = findings("page.md", f"# A page\n\nFirst line,\n{text}.\n")
    assert found.startswith("page.md:4: ")


def test_a_long_sentence_is_found_where_it_begins():
    long = " ".join(["word"] * (MOST_WORDS + 1))
    text = f"# A page\n\nShort.\n\n- item\n- {long}.\n\n| {long} | b |\n"
    assert [each.split(" a sentence")[0] for each in findings("p", text)] == ["p:6:", "p:8:"]
    half = " ".join(["word"] * MOST_WORDS)
    assert findings("p", f"{half}. Then {half[:-5]}.\n") == []
    # In a list of keys semicolons separate.
    assert findings("docs/pension_case.md", f"`a` {half[:-5]}; `b` {half[:-5]}.\n") == []


def test_pages_and_help_texts_are_plain():
    assert {"snapo", "snapo solve", "snapo open"} <= {name for name, _ in help_texts()}
    assert all_findings() == []


def unformatted(tree):
    """Sentences with the name of a variable in braces, which no `f` before them replaces."""
    parts = {
        id(x) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for x in node.values
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
            written = re.search(r"(?<!\$)\{[A-Za-z_][^{}\n]*\}", node.value)
            if written and len(node.value.split()) > 3 and node.value not in _docstrings(tree):
                yield node.value


def _docstrings(tree):
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    return {ast.get_docstring(x, clean=False) for x in ast.walk(tree) if isinstance(x, kinds)}


def test_every_sentence_with_a_variable_is_formatted():
    plain = ast.parse(
        'x = "more than four words of {noun} here"; f"not these words of {noun} here"'
    )
    assert len(list(unformatted(plain))) == 1
    for name, tree in trees().items():
        assert ".format(" in texts()[name] or not list(unformatted(tree)), name
