"""The page of a report: sections of blocks that are rendered into one file, and a PDF of it made by
a browser."""

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from markupsafe import Markup, escape

from .drawing import DARK, LIGHT, variables
from .quantity import SPACE, unit_words

LONG = 22  # letters of a cell above which its column is kept from growing narrow


@dataclass(frozen=True)
class Text:
    """A paragraph; a caveat has a smaller and paler font."""

    kind: ClassVar[str] = "text"
    text: str
    caveat: bool = False


@dataclass(frozen=True)
class Missing:
    """One sentence that names a missing result, and how to get it."""

    kind: ClassVar[str] = "missing"
    text: str


@dataclass(frozen=True)
class Chart:
    """A drawing with a caption on how to read it; `folded` as in a `Table`."""

    kind: ClassVar[str] = "chart"
    svg: Markup
    caption: str
    folded: str = ""


@dataclass(frozen=True)
class Table:
    """Rows of text; the columns after the first `texts` are numbers and are aligned to the right.

    If texts and numbers alternate, `texts` is the set of the columns of texts.

    **Attributes:**

    - `caption`: the subject of the table; may be empty.
    - `head`: (name, unit) of every column; empty for a table without a header.
    - `rows`: the cells as text; a cell may be a `Mark`.
    - `strong`: rows that are emphasised.
    - `folded`: the text to click on to show the table, which is always shown in print.
    """

    kind: ClassVar[str] = "table"
    head: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    texts: int | frozenset[int] = 1
    strong: frozenset[int] = frozenset()
    folded: str = ""

    def right(self, column: int) -> bool:
        """Whether a column holds numbers."""
        if isinstance(self.texts, int):
            return column >= self.texts
        return column not in self.texts


@dataclass(frozen=True)
class Mark:
    """A verdict, shown by a sign and a text, not only by its colour."""

    good: bool
    text: str


@dataclass(frozen=True)
class Facts:
    """Key figures in a row of tiles: (name, value, note)."""

    kind: ClassVar[str] = "facts"
    facts: Sequence[tuple[str, str, str]]


@dataclass(frozen=True)
class Headline:
    """The main number of the report, with one sentence on it.

    `context`: a comparison, such as a bound or the gain over another policy.
    """

    kind: ClassVar[str] = "headline"
    label: str
    value: str
    error: str
    note: str
    action: str = ""  # inject, withdraw or hold, as the domain calls it
    sentence: str = ""
    when: str = "What to do today"
    tone: str = "main"  # a colour of the theme
    marks: Sequence[Mark] = ()
    context: str = ""


@dataclass(frozen=True)
class Slider:
    """An input that a reader may move by up to `span`, in `unit`; the value changes by `slope`
    times the move."""

    name: str
    unit: str
    slope: float
    span: float
    step: float
    places: int


@dataclass(frozen=True)
class Sliders:
    """Sliders for the change of one value in `currency`, to first order; `groups` are (name,
    sliders)."""

    kind: ClassVar[str] = "sliders"
    value: float
    currency: str
    places: int
    groups: Sequence[tuple[str, Sequence[Slider]]]
    caveat: str


Block = Text | Missing | Chart | Table | Facts | Headline | Sliders


@dataclass(frozen=True)
class Section:
    """A part of the page; `name` is its anchor, `title` its heading, `short` is its entry in the
    menu."""

    name: str
    title: str
    short: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A whole report; `about` are (name, value) pairs below the title, `logo` the address of an
    image without references to other files, `menu` the links in its navigation bar, (anchor, text):
    by default one to every section."""

    title: str
    about: Sequence[tuple[str, str]]
    sections: Sequence[Section]
    footer: str = ""
    logo: str = ""
    menu: Sequence[tuple[str, str]] = ()


def render(page: Page) -> str:
    """The page as HTML with embedded styles, charts and scripts; text is escaped. Sections without
    blocks and empty columns of tables are omitted.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    sections = [
        replace(section, blocks=[_filled(b) if isinstance(b, Table) else b for b in section.blocks])
        for section in page.sections
        if section.blocks
    ]
    menu = page.menu or [(section.name, section.short) for section in sections if section.short]
    page = replace(page, sections=sections, menu=menu)
    environment = Environment(
        loader=PackageLoader("snapo.report"),
        autoescape=select_autoescape(default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["coded"] = coded
    environment.filters["classes"] = classes
    environment.filters["unit_words"] = unit_words
    template = environment.get_template("page.html")
    light, dark = Markup(variables(LIGHT)), Markup(variables(DARK))
    return template.render(page=page, light=light, dark=dark, moving=_moving(page))


def coded(text: str) -> Markup:
    """An escaped text, in which text between backticks is set as code and no line ends in ±."""
    selected = str(escape(text)).replace("± ", f"±{SPACE}")
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", selected))


def classes(cell: Any, right: bool) -> Markup:
    """The classes of a cell as an attribute: for numbers aligned to the `right`, and for long
    texts."""
    long = isinstance(cell, str) and len(cell) > LONG
    results = [name for name, so in (("n", right), ("long", long)) if so]
    return Markup(f' class="{" ".join(results)}"') if results else Markup("")


def _filled(table: Table) -> Table:
    """The table without columns that are empty below their header."""
    wide = max(map(len, table.rows), default=0)
    if not table.rows or any(
        len(row) != wide for row in (*table.rows, table.head or table.rows[0])
    ):
        return table
    selected = [i for i in range(wide) if i == 0 or any(row[i] != "" for row in table.rows)]
    texts = frozenset(new for new, i in enumerate(selected) if not table.right(i))
    rows = [tuple(row[i] for i in selected) for row in table.rows]
    head = [table.head[i] for i in selected] if table.head else table.head
    return replace(table, head=head, rows=rows, texts=texts)


def _moving(page: Page) -> bool:
    return any(block.kind == "sliders" for section in page.sections for block in section.blocks)


VARIABLE = "SNAPO_BROWSER"  # of the environment: a browser to take before all others
BROWSERS = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome",
    "microsoft-edge", "msedge", "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)  # fmt: skip
SECONDS = 120  # after which a browser is given up


def browser() -> str | None:
    """The path of a browser that can print without a window; None if there is none."""
    by_name = os.environ.get(VARIABLE)
    names = (by_name,) if by_name else BROWSERS
    return next((path for name in names if (path := shutil.which(name))), None)


def print_page(page: Path, file: Path, browser: str) -> None:
    """Prints an HTML `page` to the PDF `file`; styles are those of the page for print.

    The page is a file without external references, so nothing is sent over the network.

    **Raises:** `OSError` if the browser fails or takes too long.
    """
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "page.pdf"
        command = [
            browser, "--headless", "--disable-gpu", "--no-first-run", "--disable-sync",
            "--disable-background-networking", "--disable-component-update",
            f"--user-data-dir={folder}/profile", "--no-pdf-header-footer",
            "--print-to-pdf-no-header", f"--print-to-pdf={made}", page.resolve().as_uri(),
        ]  # fmt: skip
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.insert(1, "--no-sandbox")  # which a browser refuses to have as root
        try:
            done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
        except subprocess.TimeoutExpired:
            raise OSError(f"{browser} has not printed the page within {SECONDS} s") from None
        if not made.exists() or not made.read_bytes().startswith(b"%PDF"):
            metadata = done.stderr.decode(errors="replace").strip().splitlines()
            raise OSError(
                f"{browser} ended with {done.returncode}: {metadata[-1] if metadata else ''}"
            )
        file.write_bytes(made.read_bytes())
