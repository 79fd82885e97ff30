"""`make docs` refuses a page whose plots are text, or whose output no reader may believe."""

import importlib.util
from pathlib import Path

LINKS = Path(__file__).parents[1] / "docs" / "site" / "links.py"
PAGE = """# Page

```{code-cell}
x = 1
```

```{code-cell}
:tags: [hide-input]
solution.plot.fan("x")
```

Text.

```{code-cell}
solution.plot.tornado()
```
"""
SHOWN = '<div class="cell_output"><img alt="x" src="y.png"></div>'
TEXT = '<div class="cell_output"><pre>&lt;Figure size 720x360 with 1 Axes&gt;</pre></div>'


def mistakes(tmp_path, html):
    spec = importlib.util.spec_from_file_location("links", LINKS)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / "docs").mkdir(exist_ok=True)
    (tmp_path / "docs" / "page.md").write_text(PAGE)
    (tmp_path / "page.html").write_text(html)
    return module.missing_pictures(tmp_path, tmp_path / "docs")


def test_every_plot_is_a_picture(tmp_path):
    assert not mistakes(tmp_path, SHOWN + SHOWN)
    assert mistakes(tmp_path, SHOWN) == ["page.html: 1 pictures of 2 plots"]
    assert mistakes(tmp_path, SHOWN + TEXT) == [
        "page.html: 1 pictures of 2 plots",
        "page.html: prints '&lt;Figure size'",
    ]


def test_a_tutorial_does_not_end_below_a_classical_rule(tmp_path):
    note = "<p>The classical rule does better than the trained policy, by 1</p>"
    assert len(mistakes(tmp_path, SHOWN + SHOWN + note)) == 1
