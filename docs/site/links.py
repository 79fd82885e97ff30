"""`python docs/site/links.py HTML`: every local link of a built site leads somewhere, no page asks
another machine for anything, and every cell that plots has its picture."""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

PLOT = re.compile(r"^```\{code-cell\}.*?\n(?:(?!```).*\n)*?.*\.plot\.\w+\(.*\)\n```", re.M)
UNTRUE = ("&lt;Figure size", "does better than the trained policy", "diverged")  # of a tutorial
LOADS = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src"}


class Page(HTMLParser):
    """The targets, links and loaded files of one page."""

    def __init__(self, file: Path):
        super().__init__()
        self.ids, self.links, self.loads = set(), set(), set()
        self.feed(file.read_text(encoding="utf-8"))

    def has(self, fragment: str) -> bool:
        """Whether a link with this fragment finds its place."""
        return unquote(fragment) in self.ids

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids |= {given[key] for key in ("id", "name") if given.get(key)}
        if tag == "a" and given.get("href"):
            self.links.add(given["href"])
        if tag in LOADS and given.get(LOADS[tag]) and given.get("rel") != "canonical":
            self.loads.add(given[LOADS[tag]])


def mistakes(top: Path) -> list[str]:
    """Sentences on links that lead nowhere and on files from elsewhere."""
    files = [each for each in sorted(top.rglob("*.html")) if "_static" not in each.parts]
    pages = {file.resolve(): Page(file) for file in files}
    found = []
    for file, page in pages.items():
        name = file.relative_to(top.resolve())
        for link in sorted(page.links | page.loads):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if link in page.loads and parts.scheme != "data":
                    found.append(f"{name} loads {link}")
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            target = target / "index.html" if target.is_dir() else target
            if not target.exists():
                found.append(f"{name}: {link} does not exist")
            elif parts.fragment and target in pages and not pages[target].has(parts.fragment):
                found.append(f"{name}: {link} names no place there")
    return found


def missing_pictures(top: Path, docs: Path) -> list[str]:
    """Sentences on executed pages whose plots are text, or whose outputs no reader may believe."""
    found = []
    for source in sorted(docs.rglob("*.md")):
        text = source.read_text(encoding="utf-8")
        page = top / source.relative_to(docs).with_suffix(".html")
        if "{code-cell}" not in text or not page.exists():
            continue
        html = page.read_text(encoding="utf-8")
        plots, outputs = len(PLOT.findall(text)), re.findall(r"cell_output.*?<img ", html, re.S)
        if plots != len(outputs):
            found.append(f"{page.relative_to(top)}: {len(outputs)} pictures of {plots} plots")
        found += [f"{page.relative_to(top)}: prints {each!r}" for each in UNTRUE if each in html]
    return found


if __name__ == "__main__":
    site = Path(sys.argv[1])
    wrong = mistakes(site) + missing_pictures(site, Path(__file__).parents[1])
    print("\n".join(wrong) or "all links lead somewhere, nothing comes from elsewhere, plots show")
    sys.exit(bool(wrong))
