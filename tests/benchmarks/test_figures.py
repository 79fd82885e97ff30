"""Figures stand once, in docs/figures.toml; README, docs and pictures say the same."""

import re

import pytest
from benchmarks.figures import MARKED, ROOT, TAKEN, figures, filled, pages, taken

TABLES = figures()
FLAGSHIP = re.compile(r"\b78,\d{3}\b")  # any value of the contract of `make demo`


def relative(page):
    return str(page.relative_to(ROOT))


def plain(page):
    """A page without its marked figures and its code."""
    text = MARKED.sub("", page.read_text(encoding="utf-8"))
    return re.sub(r"^(```+).*?^\1", "", text, flags=re.M | re.S)


@pytest.mark.parametrize("page", pages(), ids=relative)
def test_a_page_says_the_figures_of_the_file(page):
    text = page.read_text(encoding="utf-8")
    assert filled(text, TABLES) == text, "run `python -m benchmarks.figures`"
    assert not FLAGSHIP.search(plain(page)), "a value of the flagship case stands outside of a mark"
    # A line that begins with a comment is no text on a code host.
    assert not re.search(r"^<!--[\w.]+-->[^\n]", text, re.M)


def test_the_readme_has_no_figure_of_its_own():
    text = plain(ROOT / "README.md")
    assert not re.search(r"\d ± |± \d", text)
    rows = text[text.index("## Speed") : text.index("## Citing")].splitlines()
    cells = [cell for row in rows if row.startswith("|") for cell in row.split("|")[2:]]
    assert cells and not [cell for cell in cells if re.search(r"\d", cell)]


def test_a_figure_that_is_changed_by_hand_is_noticed():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    value = TABLES["demo"]["value"]
    assert value in text
    changed = text.replace(value, "78,375 ± 2")
    assert filled(changed, TABLES) == text
    moved = {**TABLES, "demo": TABLES["demo"] | {"value": "1"}}
    assert filled(text, moved) != text


def test_pictures_say_the_figures_of_the_file():
    store = (ROOT / "docs" / "storage.svg").read_text(encoding="utf-8").replace("\xa0", " ")
    drawn = set(re.findall(r">EUR ([^<]+)<", store))
    names = ("value", "starting_rule", "intrinsic", "upper_bound")
    assert drawn == {TABLES["demo"][name] for name in names} | {TABLES["exact"]["value"]}
    fund = (ROOT / "docs" / "pension_speed.svg").read_text(encoding="utf-8")
    for size in ("small", "medium", "large"):
        assert f"{TABLES['pension'][size]} times" in fund


def test_every_table_has_its_machine_date_and_command():
    for name, table in TABLES.items():
        assert re.fullmatch(r"20\d\d-\d\d-\d\d", table["date"]), name
        assert table["machine"] and table["command"], name


def test_figures_are_taken_from_what_the_benchmark_prints():
    lines = [
        "engine  derivative    inputs     value  with all   ratio",
        "Native  smooth            12    0.128s    0.370s    2.89",
        "Native  smooth          3650    0.137s    0.407s   10.97",
        "Native  held            3650    0.120s    0.185s    1.57",
        "  batch                          0.188 ms a sample,    1.9 s for 10,000",
        "small       32    120      0.100s      0.200s    2.09         4.0s       17",
    ]
    assert taken("gas_storage", lines) == {"total": "2.89 to 10.97", "held": "1.57"}
    assert taken("pharma", lines) == {"batches": "1.9 s"}
    assert taken("pension", lines) == {"ratio": "2.09", "small": "17"}
    # What is quoted is known to the command that measures it.
    for name, patterns in TAKEN.items():
        assert TABLES[name].keys() - {"command", "machine", "date"} <= patterns.keys()
