"""What a reader sees: numbers and units by hand, names that do not collide, pages that fit."""

import io
import json
import re
import shutil
from itertools import combinations

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text
from tests.miniatures import MINIATURES

from snapo.report.bands import Swing, scatter, tornado
from snapo.report.charts import histogram
from snapo.report.drawing import DARK, DARKEST, LIGHT, STYLE, WIDTH, number_axis
from snapo.report.page import Page, Section, Table, coded, render
from snapo.report.quantity import (
    measured,
    number,
    part_of,
    percent,
    plus_minus,
    quantity,
    rough,
    seconds,
    unit_words,
    with_unit,
)
from snapo.study.carry_out import write_report

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
RAW = r"\*\*|\{\{|\}\}|\bnan\b|\bNone\b(?! is kept)|\bundefined\b|\[object|&[a-z]+;|</?[a-z]+>"


@pytest.mark.parametrize(
    ("unit", "written"),
    [("kg/m^3", "kg/m³"), ("m3/kmol/s", "m³/kmol/s"), ("um", "µm"), ("Pa*s", "Pa·s"),
     ("1/(N m)2", "1/(N m)²"), ("s2/rad2", "s²/rad²"), ("hm3", "hm³"), ("EUR/MWh", "EUR/MWh"),
     ("EUR/t CO2", "EUR/t CO2"), ("1/sqrt(year)", "1/√year"), ("1/week^0.5", "1/√week"), ("kg/m3/K^k", "kg/m³/Kᵏ"), ("% w/w", "% w/w"), ("1", "1")],
)  # fmt: skip
def test_units_are_written_by_hand(unit, written):
    assert unit_words(unit) == written


def test_numbers_that_would_be_noughts_are_powers_of_ten():
    assert number(1.578e-6).replace("\u00a0", " ") == "1.578 × 10⁻⁶"
    assert number(-3.5e-8, 9).replace("\u00a0", " ") == "−3.5 × 10⁻⁸"
    assert number(0.0, 9) == "0"  # beside them on an axis
    assert number(3.5e-8, 3) == "0.000"  # a column of few decimals stays one
    assert number(0.00006918) == "0.00006918" and number(0.0) == "0"
    assert (part_of(2.5e-5), part_of(0.0)) == (f"less than {percent(1e-4, 2)}", percent(0.0, 2))
    assert [seconds(x)[:-2] for x in (0.001, 0.03, 0.4)] == ["0", "0.03", "0.4"]
    assert quantity(87.96, "um") == "87.96\u00a0µm"
    assert (with_unit("W", "1"), with_unit("Size", "um")) == ("W", "Size, µm")


@pytest.mark.parametrize(
    ("error", "places", "written"),
    [(0.00004, 3, "± 0.00008"), (0.0002, 3, "± 0.0004"), (0.0006, 3, "± 0.001"),
     (0.04, 3, "± 0.078"), (41.2, 0, "± 81"), (0.15, 0, "± 0.3"), (0.0, 3, "± 0.000"),
     (3.46e-8, 3, "± 7 × 10⁻⁸"), (None, 3, "")],
)  # fmt: skip
def test_half_of_the_interval_is_never_rounded_to_nothing(error, places, written):
    assert plus_minus(error, places).replace("\u00a0", " ") == written


def test_a_value_has_the_digits_that_its_error_reaches():
    pairs = [
        measured(0.00018, 0.00004, 3, True), measured(0.1234, 0.002, 3), measured(-7.0, None, 1),
        measured(0.5, 2e-9, 3), measured(None, 0.00004, 3), measured(1.46e-6, 3e-10, 2, True),
        measured(4995.0, 3e-10, 0),
    ]  # fmt: skip
    assert [[x.replace("\u00a0", " ") for x in pair] for pair in pairs] == [
        ["+0.00018", "± 0.00008"], ["0.123", "± 0.004"], ["−7.0", ""], ["0.500", "± 4 × 10⁻⁹"],
        ["–", "± 0.00008"], ["+1.5 × 10⁻⁶", "± 6 × 10⁻¹⁰"], ["4,995", "± 0"],
    ]  # fmt: skip
    assert [rough(x).replace("\u00a0", " ") for x in (9.1365, -616.38, 1.9206e-8, 0, None)] == [
        "9.1", "−616", "1.9 × 10⁻⁸", "0", "–",
    ]  # fmt: skip


def test_an_axis_of_tiny_numbers_has_powers_of_ten():
    axes = Figure().add_subplot()
    axes.set_xlim(9e-7, 4e-6)
    number_axis(axes.xaxis)
    texts = [each.get_text() for each in axes.get_xticklabels()]
    assert "2 × 10⁻⁶".replace(" ", "\u00a0") in texts and not any("0.0" in each for each in texts)


def test_no_line_ends_in_plus_minus():
    assert coded("value, ± one `error`") == "value, ±\u00a0one <code>error</code>"


def test_texts_between_numbers_stand_to_the_left():
    head, rows = [("Part", ""), ("Share", ""), ("", ""), ("Corner", "")], [("a", "1", "", "low")]
    table = Table(head, rows, texts=frozenset({0, 2, 3}))
    html = render(Page("t", [], [Section("s", "S", "S", [table])]))
    assert re.findall(r'<t[hd][^>]*class="n"[^>]*>(.*?)<', html) == ["Share", "1"]


def test_a_column_without_anything_is_left_out():
    head = [("Part", ""), ("Note", ""), ("Time", "s")]
    table = Table(head, [("a", "", "1"), ("b", "", "2")], texts=2)
    html = render(Page("t", [], [Section("s", "S", "S", [table])]))
    assert "Note" not in html and html.count('class="n"') == 3  # a header and two numbers


def boxes(paint, height=230.0):
    """The texts that a chart draws, with their boxes in points."""
    with matplotlib.rc_context(STYLE):
        return _boxes(paint, height)


def _boxes(paint, height):
    figure = Figure((WIDTH / 72, height / 72), dpi=72, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots()
    paint(axes)
    canvas.draw()
    texts = [*axes.texts, *axes.get_yticklabels(), *axes.get_xticklabels()]
    return [
        (each.get_text(), Text.get_window_extent(each)) for each in texts if each.get_text()
    ], figure


def apart(found):
    return [
        (a, b) for (a, one), (b, other) in combinations(found, 2)
        if one.shrunk(0.96, 0.8).overlaps(other.shrunk(0.96, 0.8))
    ]  # fmt: skip


@pytest.mark.parametrize(
    "effects",
    [(-0.1082, -0.0624, 0.0005), (158_013.0, 100_979.0, -2_016.0), (-1.0, 0.9, 0.0), (3.0, 2.0)],
)
def test_the_numbers_of_a_tornado_stay_off_its_names(effects):
    swings = [
        Swing(f"Deviation of demand {i} +1 %", e, f"{e:+,.4f} EUR/week", 0.1 * abs(e))
        for i, e in enumerate(effects)
    ]
    found, figure = boxes(lambda axes: tornado(axes, swings, ""), 32 + 26 * len(swings))
    assert apart(found) == []
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.width for _, box in found)


def test_the_names_of_points_that_are_close_stand_apart():
    points = [
        ("Learned policy", 1.290, 117.6, True), ("Constant mix", 1.283, 115.5, False),
        ("Glide path", 1.2845, 117.3, False), ("Liability-driven split", 1.2825, 116.8, False),
        ("Present mix", 1.338, 77.9, False), ("Present mix, rebalanced yearly", 1.3379, 78.6, False),
    ]  # fmt: skip
    found, figure = boxes(lambda axes: scatter(axes, points, ("Contributions", "%")))
    named = [each for each in found if each[0] in {name for name, *_ in points}]
    assert len(named) == len(points) and apart(named) == []
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.width for _, box in named)


def test_the_mark_of_a_mean_at_the_edge_stays_and_is_the_bold_one():
    edges = np.linspace(0.0, 45.0, 46)
    counts = np.r_[920.0, np.full(44, 2.0)]

    def paint(axes):
        histogram(axes, edges, counts, [("mean", 0.8), ("95 %", 5.0)], "Spill, hm³")

    found, _ = boxes(paint)
    assert {"mean", "95 %"} <= {text for text, _ in found} and apart(found) == []


# A page that must scroll sideways is cut; so is a box whose text is wider than itself.
WIDE = """() => [...document.querySelectorAll("body *")].filter((each) => {
  const box = each.getBoundingClientRect();
  return box.width && box.right > innerWidth + 1 && !each.closest(".scroll, .drawing, .skip");
}).map((each) => each.outerHTML.slice(0, 80))"""
# The contrast of every text with what lies behind it, seen through its opacity (WCAG 2: 4.5, and 3 for
# large type; a control that is switched off is free of it). Letters in a chart lie on the page, or on
# the last shape drawn before them that holds their middle.
PALE = """() => {
  const parse = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const over = (top, under) => {
    const share = top[3] ?? 1;
    return [0, 1, 2].map((i) => share * top[i] + (1 - share) * under[i]);
  };
  const light = (rgb) => rgb.slice(0, 3).map((c) => c / 255)
    .map((c) => (c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4))
    .reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
  const solid = (each) => {
    let share = 1;
    for (let at = each; at; at = at.parentElement) share *= Number(getComputedStyle(at).opacity);
    return share;
  };
  const behind = (each) => {
    const layers = [];
    for (let at = each; at; at = at.parentElement) {
      const found = parse(getComputedStyle(at).backgroundColor);
      if (found.length === 3 || found[3] > 0) layers.push(found);
      if (found.length === 3 || found[3] === 1) break;
    }
    return layers.reduceRight((under, top) => over(top, under), [255, 255, 255]);
  };
  const drawn = (each) => {
    const box = each.getBoundingClientRect(), x = (box.left + box.right) / 2, y = (box.top + box.bottom) / 2;
    let under = behind(each.closest("svg"));
    for (const shape of each.closest("svg").querySelectorAll("path, rect, polygon, circle, use, text")) {
      if (shape === each) break;
      const style = getComputedStyle(shape), filled = parse(style.fill), area = shape.getBoundingClientRect();
      if (shape.tagName === "text" || !filled.length || x < area.left || x > area.right || y < area.top || y > area.bottom) continue;
      if (shape.closest("defs, clipPath") || !shape.isPointInFill) continue;
      const point = new DOMPoint(x, y).matrixTransform(shape.getScreenCTM().inverse());
      if (!shape.isPointInFill(point)) continue;
      under = over([...filled.slice(0, 3), (filled[3] ?? 1) * Number(style.fillOpacity) * solid(shape)], under);
    }
    return under;
  };
  const everything = "body *:not(svg *):not(script):not(style), svg text:not(:has(tspan)), svg tspan";
  return [...document.querySelectorAll(everything)].filter((each) => {
    const own = [...each.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
    if (!own || !each.getClientRects().length || each.closest(":disabled")) return false;
    const style = getComputedStyle(each), chart = each.closest("svg");
    if (style.visibility === "hidden") return false;
    const under = chart ? drawn(each.closest("text")) : behind(each);
    const ink = parse(chart ? style.fill : style.color), share = (ink[3] ?? 1) * solid(each);
    const [a, b] = [light(over([...ink.slice(0, 3), share], under)), light(under)];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    return ratio < (parseFloat(style.fontSize) >= 24 ? 3 : 4.5);
  }).map((each) => each.outerHTML.slice(0, 80));
}"""


def luminance(colour):
    """WCAG 2.2, relative luminance of three shares."""
    linear = [x / 12.92 if x <= 0.03928 else ((x + 0.055) / 1.055) ** 2.4 for x in colour]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_letters_can_be_read_in_the_deepest_cell_of_a_map(theme):
    """In the dark it was 3.96: above 4.5 for every depth up to the deepest."""
    ink, main, paper = (
        np.array([int(theme[name][i : i + 2], 16) / 255 for i in (1, 3, 5)])
        for name in ("ink", "main", "paper")
    )
    for depth in np.linspace(0.0, DARKEST, 9):
        under, top = luminance(depth * main + (1 - depth) * paper), luminance(ink)
        assert (max(under, top) + 0.05) / (min(under, top) + 0.05) >= 4.5


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser")
    with sync_api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


def reported(kind, folder):
    """The report of a sample run: no simulation, its files alone."""
    if kind == "store":
        from tests.domains.gas_storage.chapters.sample_run import write_run

        from snapo.domains.gas_storage import DOMAIN

        return write_report(DOMAIN, write_run(folder / "run"))
    if kind == "back-test":
        from tests.domains.gas_storage.history.test_report import html_of, result_of

        file = folder / "report.html"
        file.write_text(html_of(result_of()), encoding="utf-8")
        return file
    from tests.domains.pension.sections import test_report as fund

    (folder / "run" / "parts").mkdir(parents=True)
    (folder / "run" / "result.json").write_text(json.dumps(fund.RESULT))
    (folder / "run" / "history.csv").write_text(fund.HISTORY)
    fund.keep(folder / "run", fund.sample())
    return fund.write_report(folder / "run")


@pytest.mark.prove
@pytest.mark.skipif(CHROMIUM is None, reason="this machine has no Chromium")
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("kind", ["store", "fund", "back-test"])
def test_a_report_fits_every_screen_and_can_be_read(kind, scheme, browser, tmp_path):
    fits_and_can_be_read(reported(kind, tmp_path), scheme, browser)


@pytest.mark.prove
@pytest.mark.skipif(CHROMIUM is None, reason="this machine has no Chromium")
@pytest.mark.parametrize("kind", sorted(MINIATURES))
def test_the_report_of_every_kind_fits_every_screen_and_can_be_read(kind, solved, browser):
    for scheme in ("light", "dark"):
        fits_and_can_be_read(solved(kind) / "run" / "report.html", scheme, browser)


def fits_and_can_be_read(file, scheme, browser):
    context = browser.new_context(color_scheme=scheme)
    page = context.new_page()
    page.goto(file.as_uri())
    page.evaluate("document.querySelectorAll('details').forEach((each) => (each.open = true))")
    for width in (1440, 1024, 390):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(WIDE) == []
        assert page.evaluate(PALE) == []
    text = page.inner_text("body")
    assert re.findall(RAW, text) == []
    context.close()


def shaded(page, box):
    """Whether the left and the right edge of a box are shaded; its content is left out."""
    picture = imread(io.BytesIO(box.screenshot()))[..., :3].mean(-1)
    line = picture[len(picture) // 2]
    return tuple(abs(float(line[i] - line[line.size // 2])) > 0.03 for i in (1, -2))


@pytest.mark.prove
@pytest.mark.skipif(CHROMIUM is None, reason="this machine has no Chromium")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_shaded_edge_hints_at_more(scheme, browser, tmp_path):
    context = browser.new_context(color_scheme=scheme, viewport={"width": 390, "height": 900})
    page = context.new_page()
    page.goto(reported("store", tmp_path).as_uri())
    page.add_style_tag(content=".drawing > * { visibility: hidden; }")
    box = page.locator(".drawing").first
    assert shaded(page, box) == (False, True)
    box.evaluate("each => each.scrollTo({left: 60, behavior: 'instant'})")
    assert shaded(page, box) == (True, True)
    box.evaluate("each => each.scrollTo({left: 9999, behavior: 'instant'})")
    assert shaded(page, box) == (True, False)
    page.set_viewport_size({"width": 1440, "height": 900})
    assert shaded(page, box) == (False, False)
    context.close()


@pytest.mark.prove
@pytest.mark.skipif(CHROMIUM is None, reason="this machine has no Chromium")
@pytest.mark.parametrize("kind", ["store", "fund"])
def test_a_printed_report_fits_the_paper(kind, browser, tmp_path):
    page = browser.new_page(viewport={"width": 703, "height": 1024})  # A4 less its margins
    page.goto(reported(kind, tmp_path).as_uri())
    page.emulate_media(media="print")
    page.evaluate("document.querySelectorAll('details').forEach((each) => (each.open = true))")
    # Wider than that, a browser prints everything smaller.
    assert page.evaluate("document.documentElement.scrollWidth") <= 703
    page.close()
