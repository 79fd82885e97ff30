"""The report of a storage run: complete, self-contained, reproducible, patient with gaps."""

import json
import re
import shutil
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest
from tests.domains.gas_storage.chapters.sample_run import RESULT, sample_details, write_run

from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.report import SECTIONS, readme_picture
from snapo.study.carry_out import write_report

NAMES = [
    "headline",
    "today",
    "value-ladder",
    "bound",
    "cash-flow",
    "profile",
    "inventory",
    "deltas",
    "risk",
    "what-if",
    "history",
    "certificate",
    "assumptions",
    "making",
]
EMPTY = {"img", "meta", "input", "br", "link", "hr"}


class Outline(HTMLParser):
    """Sections in order, every tag with its attributes, and whether tags close as they open."""

    def __init__(self, text):
        super().__init__()
        self.sections, self.tags, self.open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append((tag, attributes))
        if tag == "section":
            self.sections.append(attributes["id"])
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def page(folder, **changes):
    return write_report(DOMAIN, write_run(folder, **changes)).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    return page(tmp_path_factory.mktemp("run"))


def text_of(html):
    words = re.sub(r"<[^>]+>", " ", html).replace("&nbsp;", " ")
    return re.sub(r"\s+", " ", words.replace("\N{NO-BREAK SPACE}", " "))


def test_every_section_stands_in_its_place(full):
    outline = Outline(full)
    assert outline.sections == NAMES
    # Quotes, traded products, vega, gamma, methods and hedges are there only if the run has them.
    assert len(SECTIONS) - 6 == len(NAMES)
    assert outline.open == []
    assert 'class="missing"' not in full.replace('<noscript><p class="missing">', "")


def test_the_page_needs_nothing_else(full):
    assert not re.search(r"https?:|//[a-z]|@import|url\((?!#)", full)
    for tag, attributes in Outline(full).tags:
        assert tag not in ("link", "img", "iframe", "object", "base", "image")
        for name in ("src", "href", "xlink:href", "srcset"):
            assert attributes.get(name, "#").startswith("#"), (tag, name)
    assert "default-src 'none'" in full


def test_the_drawings_are_named_for_every_reader_and_their_references_resolve(full):
    outline = Outline(full)
    drawings = [attributes for tag, attributes in outline.tags if tag == "svg"]
    assert len(drawings) == 8
    assert all(each["role"] == "img" and len(each["aria-label"]) > 40 for each in drawings)
    identifiers = [attributes["id"] for _, attributes in outline.tags if "id" in attributes]
    assert len(identifiers) == len(set(identifiers))
    used = re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', full)
    assert {first or second for first, second in used} <= set(identifiers)
    # Colours come from the theme alone, so that dark paper and print are served too.
    assert not re.search(r"(fill|stroke): ?#", full)


def test_the_headline_says_value_error_and_what_to_do(full):
    text = text_of(full)
    assert "EUR 78,242 ± 75" in text  # of a standard error of 38.4
    assert "± is half of a 95 % interval, simulation error only" in text
    assert "Withdraw 187.5 MWh" in text
    assert "inject below 16.10 EUR/MWh, withdraw above 16.16 EUR/MWh and hold between" in text
    assert "all 9 checks hold" in text
    assert "EUR 37,250" in text  # extrinsic: 78,241.6 - 40,992.1


def test_a_failed_check_is_told_in_the_headline(tmp_path, sketched):
    certificate = json.loads(json.dumps(sample_details()["certificate"]))
    certificate["bump_check"][2]["passed"] = False
    text = text_of(page(tmp_path, certificate=certificate))
    assert "1 of 9 checks fail: " in text
    assert "✗ fails" in text


def test_the_sliders_hold_the_stored_sensitivities(full):
    inputs = [each for tag, each in Outline(full).tags if tag == "input"]
    slopes = [float(each["data-slope"]) for each in inputs]
    # The whole curve, three volatilities and the rates, twelve months; points are 0.01.
    assert len(slopes) == 17
    assert slopes[0] == pytest.approx(sum(slopes[5:]), rel=1e-12)
    assert slopes[0] == pytest.approx(4201.0, rel=1e-12)
    assert 421.7 in [pytest.approx(slope) for slope in slopes]
    assert "First order only, with the decisions held fixed" in full
    assert "What if: inputs moved, with decisions held fixed" in full


def test_inputs_say_their_meaning_and_move_in_the_unit_of_their_trade(full):
    text = text_of(full)
    # 42,170 per unit of volatility is 421.70 for one point; -13,430 per unit of rate for ten bp.
    assert "Spot volatility some words 1 volatility point +421.7 ± 3.1" in text
    assert "continuous zero rate 10 bp, all 3 numbers together −13.43" in text
    assert "Injection cost per unit injected 0.01 EUR/MWh −169.00 ± 0.30" in text


def test_the_bar_has_seven_links_to_groups_of_sections(full):
    links = re.findall(r'<a href="#([^"]+)">([^<]+)</a>', full.split("<nav")[1].split("</nav>")[0])
    assert [text for _, text in links] == ["Today", "Value", "Store", "Deltas", "Risk", "Checks"]
    assert {name for name, _ in links} <= set(NAMES)


def test_the_dates_of_the_contract_include_both_ends(full):
    assert "Contract 1 April 2021 to 31 March 2022" in text_of(full)


def test_the_values_by_method_are_a_table_without_bars(full):
    section = full.split('<section id="value-ladder"')[1].split("</section>")[0]
    assert "<svg" not in section and "<table>" in section
    assert "± 75" in text_of(section) and "Standard error" not in section


def test_the_change_of_a_delta_in_training_is_folded_and_explained(full):
    section = full.split('<section id="deltas"')[1].split("</section>")[0]
    shown, by_day, folded = section.split("<details>")
    assert "<summary>Deltas by delivery day</summary>" in by_day and "<svg" in by_day
    assert "Moved" not in section and "Late change" not in shown
    assert "Late change" in folded and "the interval includes the error of the policy" in folded
    assert "not the gas in store" in shown


def test_a_parallel_shift_has_its_interval_and_one_around_zero_is_not_significant(
    tmp_path, sketched
):
    rates = {"input": "interest_rate", "value": -13430.0, "low": -14430.0, "high": -12430.0}
    text = text_of(page(tmp_path, parallel_shifts=[rates]))
    assert "continuous zero rate 10 bp, all 3 numbers together −13.4 ± 1.0 " in text
    assert "not significant" not in text.split("all 3 numbers together")[1][:90]
    unsure = text_of(page(tmp_path, parallel_shifts=[rates | {"low": -30000.0, "high": 3140.0}]))
    assert "not significant" in unsure.split("all 3 numbers together")[1][:90]


def test_the_mean_of_the_histogram_is_the_value_of_the_first_screen(full):
    section = text_of(full.split('<section id="cash-flow"')[1].split("</section>")[0])
    assert "mean: EUR 78,242" in full.replace("\N{NO-BREAK SPACE}", " ")
    assert "Standard deviation" in section and "Mean EUR" not in section


def test_the_same_files_give_the_same_page(tmp_path, full):
    assert page(tmp_path / "again") == full


def test_text_of_the_case_is_escaped(tmp_path):
    nasty = "<script>alert('$x^2$')</script> & \"more\""
    ladder = [{"name": nasty, "value": 1.0, "standard_error": None, "note": nasty}]
    html = page(tmp_path, title=nasty, value_ladder=ladder, notes=[nasty], currency="<b>$")
    assert "<script>alert" not in html
    assert "<b>" not in html
    assert "&lt;script&gt;alert" in html
    assert Outline(html).sections == NAMES


@pytest.mark.prove
@pytest.mark.parametrize("key", sorted(sample_details()))
def test_any_key_may_be_missing(tmp_path, sketched, key):
    outline = Outline(page(tmp_path, **{key: None}))
    assert outline.sections == NAMES


def test_what_is_missing_is_said_in_a_sentence(tmp_path):
    (tmp_path / "result.json").write_text(json.dumps({"status": "diverged"}))
    html = write_report(DOMAIN, tmp_path).read_text(encoding="utf-8")
    assert Outline(html).sections == NAMES
    assert html.count('class="missing"') >= len(NAMES)
    assert "status: diverged" in html
    assert "<svg" not in html


def test_nulls_and_numbers_that_are_not_finite_leave_gaps(tmp_path):
    details = sample_details()
    details["trigger_injection"][10:40] = [None] * 30
    details["deltas_monthly"][3] = {"month": "2021-07", "undiscounted": float("nan")}
    details["value_ladder"][0]["value"] = None
    details["today"]["inject_below"] = None
    html = page(tmp_path, **details)
    assert Outline(html).sections == NAMES
    assert not re.search(r"\bnan\b|None|\binf\b", text_of(html))


@pytest.mark.prove
@pytest.mark.parametrize("days", [0, 1, 16, 100])
def test_short_contracts(tmp_path, days):
    details = sample_details()
    for name in ("days", "forward", "trigger_injection", "trigger_withdrawal"):
        details[name] = details[name][:days]
    for name, length in (("inventory", days + 1), ("reachable", days + 1), ("limits", days + 1)):
        details[name] = {key: each[:length] for key, each in details[name].items()}
    for name in ("flow", "deltas_daily"):
        details[name] = {key: each[:days] for key, each in details[name].items()}
    write_run(tmp_path, **details)
    (tmp_path / "profile.csv").unlink()
    assert Outline(write_report(DOMAIN, tmp_path).read_text(encoding="utf-8")).sections == NAMES


def test_long_contracts_name_fewer_months_and_move_quarters(tmp_path):
    months = [f"{2021 + i // 12}-{i % 12 + 1:02d}" for i in range(60)]
    deltas = [{"month": month, "undiscounted": 1.0} for month in months]
    write_run(tmp_path, deltas_monthly=deltas)
    lines = [f"forward_curve,{month},MWh,held,1.0,,,1.0,,,,\n" for month in months]
    head = "input,label,unit,source,value,low,high,held,held_error,smooth,smooth_error,moved\n"
    (tmp_path / "sensitivities.csv").write_text(head + "".join(lines))
    html = write_report(DOMAIN, tmp_path).read_text(encoding="utf-8")
    text = text_of(html)
    assert all(
        f"Q{quarter} {year}" in text for quarter in range(1, 5) for year in range(2021, 2026)
    )
    drawing_of_deltas = html[html.index('id="deltas"') :].split("<details>")[0]
    assert drawing_of_deltas.count(">Jul<") == 5
    assert ">Feb<" not in drawing_of_deltas


@pytest.mark.parametrize("value", [0.0, -156115.5176])
def test_worthless_and_negative_contracts(tmp_path, value):
    rung = {"name": "Any policy", "value": value, "standard_error": 0.0, "note": ""}
    flow = {"edges": [value - 1, value + 1], "counts": [8], "mean": value, "quantiles": {}}
    write_run(tmp_path, value_ladder=[rung], cash_flow=flow)
    (tmp_path / "result.json").write_text(json.dumps({**RESULT, "value": value}))
    text = text_of(write_report(DOMAIN, tmp_path).read_text(encoding="utf-8"))
    assert f"EUR {value:,.0f}".replace("-", "\N{MINUS SIGN}") in text


def test_the_picture_for_the_readme_stands_alone(tmp_path):
    folder = write_run(tmp_path)
    svg = readme_picture(folder)
    root = ElementTree.fromstring(svg)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert re.findall(r"https?:[^\"]*", svg) == ["http://www.w3.org/2000/svg"]
    assert "var(" not in svg
    assert "EUR 78,242 ± 75" in svg.replace("\N{NO-BREAK SPACE}", " ")
    assert svg == readme_picture(folder)
    shutil.rmtree(folder)
    folder.mkdir()
    with pytest.raises(ValueError, match="value_ladder"):
        readme_picture(folder)


def test_the_picture_takes_the_value_of_another_run_by_dynamic_programming(tmp_path):
    rungs = [{"name": name, "value": 78e3} for name in ("Trained policy", "Upper bound")]
    folder = write_run(tmp_path, value_ladder=rungs)
    assert "Dynamic programming" not in readme_picture(folder)
    svg = readme_picture(folder, exact=78_386.0).replace("\N{NO-BREAK SPACE}", " ")
    assert svg.index("Dynamic programming") < svg.index("Upper bound")
    assert "EUR 78,386" in svg
