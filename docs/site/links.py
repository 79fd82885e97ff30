"""`python docs/site/links.py HTML`: every local link of a built site leads somewhere, and no page
asks another machine for anything."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

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


if __name__ == "__main__":
    wrong = mistakes(Path(sys.argv[1]))
    print("\n".join(wrong) or "all links lead somewhere, and nothing comes from elsewhere")
    sys.exit(bool(wrong))
