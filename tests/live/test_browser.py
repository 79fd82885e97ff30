"""A real browser on a real run: every kind of control, by mouse and by keyboard alone."""

import json
import os
import re
import shutil
import signal
import time
from contextlib import contextmanager
from itertools import product
from pathlib import Path

import pytest

pytest.importorskip("aiohttp", reason="the page needs the extra `live`")
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser")

from benchmarks import live_browser  # noqa: E402
from tests.report import test_looks  # noqa: E402

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
pytestmark = [
    pytest.mark.prove,
    pytest.mark.skipif(CHROMIUM is None, reason="this machine has no Chromium"),
]
PATIENCE = 45_000  # milliseconds: the machine may be busy
START = 240_000  # of the first page, for which code is compiled


@pytest.fixture(scope="module")
def served(solved, tmp_path_factory):
    """The server of a small store, in a thread of its own."""
    run = tmp_path_factory.mktemp("browser") / "run"
    shutil.copytree(solved("gas-storage") / "run", run)
    with live_browser.served(
        run, title='<img src=x onerror="document.title=1">Small store'
    ) as server:
        yield server


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture
def page(served, browser):
    with opened(served, browser) as page:
        yield page


@contextmanager
def opened(server, browser):
    """A page that is ready; any error of its script, and any request that leaves, fails the test."""
    context = browser.new_context()
    page, wrong = context.new_page(), []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda message: message.type == "error" and wrong.append(message.text))
    home = f"http://127.0.0.1:{server.port}/"
    page.on("request", lambda each: each.url.startswith(home) or wrong.append(each.url))
    page.set_default_timeout(PATIENCE)
    page.goto(server.address)
    page.locator("#status", has_text="the run's numbers").wait_for(timeout=START)
    yield page
    context.close()
    assert wrong == []


def settled(page):
    page.locator("#status", has_text="revalued in").wait_for()
    return page.inner_text("#figure")


def home(page):
    page.click("#reset")
    page.locator("#status", has_text="the run's numbers").wait_for()


def test_a_point_is_dragged(page):
    before = page.inner_text("#figure")
    handle = page.locator("[data-input=forward_curve] .handle").first
    box = handle.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 20, steps=4)
    assert page.inner_text("#error") == "to first order"
    assert page.inner_text("#figure") != before
    page.mouse.up()
    after = settled(page)
    assert after != before and page.inner_text("#error").startswith("±")
    assert "change, revalued" in page.inner_text("#changes")
    page.reload()  # what was moved is still moved
    page.locator("#deltas").wait_for()
    assert settled(page) == after
    home(page)
    assert page.inner_text("#figure") == before


def test_the_keyboard_alone_is_enough(page):
    before = page.inner_text("#figure")
    page.locator("[data-input=forward_curve] .handle").first.focus()
    page.keyboard.press("ArrowUp")
    page.keyboard.press("PageUp")
    assert settled(page) != before
    home(page)
    group = page.locator("details.group", has=page.locator("[data-input=inventory]"))
    group.locator("summary").first.focus()
    page.keyboard.press("Enter")
    slider = page.locator("[data-input=inventory] input[type=range]")
    slider.focus()
    page.keyboard.press("ArrowRight")
    first = settled(page)
    assert first != before
    field = page.locator("[data-input=inventory] input[type=text]")
    field.focus()
    page.keyboard.press("Control+A")
    page.keyboard.type("12,5")
    page.keyboard.press("Enter")
    page.locator("#status", has_text="revaluing").wait_for()
    assert settled(page) not in (before, first)
    home(page)


def test_a_column_is_pasted_and_a_bad_one_changes_nothing(page):
    page.locator("[data-input=forward_curve] details summary").click()
    fields = page.locator("[data-input=forward_curve] table input")
    count, before = fields.count(), fields.first.input_value()

    def paste(text):
        fields.first.evaluate(
            """(box, text) => { const data = new DataTransfer(); data.setData("text", text);
            box.dispatchEvent(new ClipboardEvent("paste", { clipboardData: data, bubbles: true, cancelable: true })); }""",
            text,
        )

    for bad in ("1\ntwo\n3", "1\n" * (count + 1), "=1+1\n2", "<b>1</b>\n2"):
        paste(bad)
        assert "Nothing was pasted" in page.inner_text("[data-input=forward_curve] .bad")
        assert fields.first.input_value() == before
    numbers = [20 + 0.25 * k for k in range(count)]
    paste(
        "month\tprice\n" + "\n".join(f"m{k}\t{x}".replace(".", ",") for k, x in enumerate(numbers))
    )
    settled(page)
    assert [float(fields.nth(k).input_value()) for k in range(count)] == numbers
    home(page)


def test_what_the_case_refuses_is_said_beside_its_control(page):
    page.locator("details.group", has=page.locator("[data-input=inventory]")).locator(
        "summary"
    ).first.click()
    field = page.locator("[data-input=inventory] input[type=text]")
    field.fill("1e6")
    field.press("Enter")
    page.locator("#status", has_text="refused").wait_for()
    assert "limits allow" in page.inner_text("[data-input=inventory] .bad")
    assert page.inner_text("#figure") == "–" and "refused" in page.inner_text("#changes")
    field.fill("many")
    field.press("Enter")
    assert "not a number" in page.inner_text("[data-input=inventory] .bad")
    home(page)


def test_charts_are_chosen_and_every_input_goes_back_by_itself(page):
    before = page.inner_text("#figure")
    for menu, chart in (("#delta-input", "#delta-chart"), ("#fan-name", "#fan-chart")):
        found = [each.get_attribute("value") for each in page.locator(f"{menu} option").all()]
        seen = set()
        for name in found[:3]:
            page.select_option(menu, name)
            seen.add(page.inner_html(chart))
        assert len(seen) == min(3, len(found))
    curve = page.locator("[data-input=forward_curve]")
    curve.locator(".short").fill("2")
    curve.get_by_role("button", name="Shift", exact=True).click()
    assert settled(page) != before
    assert page.inner_text("#groups .moved >> nth=0") == "1 moved"
    curve.get_by_role("button", name="Back to the run's").click()
    page.locator("#status", has_text="the run's numbers").wait_for()
    group = page.locator("details.group", has=page.locator("[data-input=inventory]"))
    group.locator("summary").first.click()
    slider = page.locator("[data-input=inventory] input[type=range]")
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert settled(page) != before
    page.get_by_role("button", name="Inventory: back to the run's number", exact=True).click()
    page.locator("#status", has_text="the run's numbers").wait_for()
    assert page.inner_text("#figure") == before


@pytest.mark.study  # the other choice is compiled
def test_a_choice_is_made_by_its_menu_and_taken_back(page):
    before = page.inner_text("#figure")
    page.locator("details.group", has=page.locator("[data-choice]")).locator("summary").click()
    # Of this store's choices one alone decides its value: ratchets are flat, and rates are zero.
    menu = page.locator("[data-choice='contract.first_decision'] select")
    menu.focus()
    page.keyboard.press("ArrowDown")
    page.locator("#status", has_text="revalued in").wait_for(timeout=START)
    assert page.inner_text("#figure") != before
    assert page.locator("[data-choice].changed").count() == 1
    page.reload()  # a choice is remembered as a number is
    page.locator("#status", has_text="revalued in").wait_for(timeout=START)
    assert page.locator("[data-choice].changed").count() == 1
    home(page)
    assert page.inner_text("#figure") == before


def test_scenarios_are_kept_shown_compared_and_survive_a_killed_worker(page, served):
    assert page.inner_text("#title").startswith("<img src=x")  # a text, and no element
    page.fill("[data-input=forward_curve] .short", "1.5")
    page.locator("[data-input=forward_curve] .short").press("Enter")
    value = settled(page)
    page.fill("#keep-name", "<script>High</script>")
    page.press("#keep-name", "Enter")
    row = page.locator("#kept tr", has_text="<script>High</script>")
    row.locator("a", has_text="Case").wait_for()
    assert value in row.inner_text()
    home(page)

    os.kill(served.workers.process.pid, signal.SIGKILL)
    page.locator("#status", has_text="starting").wait_for()
    assert row.count() == 1
    row.locator("button", has_text="Show").click()
    assert settled(page) == value  # of the new process, to every digit shown
    with page.expect_download() as waiting:
        row.locator("a", has_text="Case").click()
    assert Path(waiting.value.path()).stat().st_size > 200
    record = json.loads(
        (served.scenarios.folder / "script-high-script" / "scenario.json").read_text()
    )
    assert record["name"] == "<script>High</script>"
    row.locator("button", has_text="Forget").click()
    row.wait_for(state="detached")
    home(page)


def test_the_policy_is_trained_again_where_it_was_moved_to(page):
    page.locator("[data-input=forward_curve] .handle").first.focus()
    page.keyboard.press("PageUp")
    settled(page)
    page.click("#train")
    page.locator("#trained", has_text="more steps the value is").wait_for()
    home(page)


def test_two_pages_move_apart(page, served, browser):
    other = browser.new_page()
    other.goto(served.address)
    other.locator("#deltas").wait_for(timeout=PATIENCE)
    before = other.inner_text("#figure")
    page.locator("[data-input=forward_curve] .handle").first.focus()
    page.keyboard.press("PageUp")
    assert settled(page) != before
    assert other.inner_text("#figure") == before
    other.close()
    home(page)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1440, 1024, 390])
def test_nothing_is_cut_at_any_width(page, width, scheme):
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 900})
    page.evaluate(
        "() => document.querySelectorAll('details').forEach((each) => (each.open = true))"
    )
    time.sleep(0.3)
    assert_fits(page, width)


def assert_fits(page, width):
    """Nothing is wider than the window, pale, or a number that no one would write."""
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    assert page.evaluate(test_looks.WIDE) == []
    assert page.evaluate(test_looks.PALE) == []
    assert re.findall(test_looks.RAW, page.inner_text("main")) == []


@pytest.mark.parametrize("kind", ["inventory", "pension", "pharma"])
def test_the_page_of_every_domain_fits_and_can_be_read(kind, solved, browser, tmp_path):
    """As it opens, and with an input moved; wide and narrow, in light and dark."""
    shutil.copytree(solved(kind) / "run", tmp_path / "run")
    with live_browser.served(tmp_path / "run") as server, opened(server, browser) as page:
        for moved, scheme, width in product((False, True), ("light", "dark"), (1440, 390)):
            if moved and (scheme, width) == ("light", 1440):
                page.locator("[data-input] input[type=range], [data-input] .handle").first.focus()
                page.keyboard.press("ArrowRight")
                page.keyboard.press("ArrowUp")
            page.emulate_media(color_scheme=scheme)
            page.set_viewport_size({"width": width, "height": 900})
            time.sleep(0.3)
            assert_fits(page, width)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_state_of_the_page_can_be_read(page, scheme):
    """Numbers to first order, a mistake in a field, a revalued change, and a saved scenario; texts that are
    dimmed have a contrast of 4.5 too."""
    page.emulate_media(color_scheme=scheme)
    page.locator("[data-input=forward_curve] .handle").first.focus()
    page.keyboard.press("PageUp")
    for width in (1440, 390):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate(test_looks.PALE) == []
    settled(page)
    assert page.evaluate(test_looks.PALE) == []
    page.locator("details.group", has=page.locator("[data-input=inventory]")).evaluate(
        "each => (each.open = true)"
    )
    field = page.locator("[data-input=inventory] input[type=text]")
    field.fill("many")
    field.press("Enter")
    assert page.evaluate(test_looks.PALE) == []
    page.set_viewport_size({"width": 1440, "height": 900})
    assert page.evaluate(test_looks.PALE) == []
    home(page)


def test_texts_between_numbers_stand_to_the_left(page):
    page.locator("#today-more summary").click()
    cell = page.locator("#today-table td.text").first
    assert cell.evaluate("each => getComputedStyle(each).textAlign") == "left"


def test_choices_are_named_for_people(page):
    rows = page.locator("[data-choice]")
    names = {each.get_attribute("data-choice"): each.text_content() for each in rows.all()}
    title = "Contract: injection cost settlement"
    assert names["contract.injection_cost_settlement"].startswith(title)
    assert page.locator(f'select[aria-label="{title}"]').count() == 1


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_shaded_edge_hints_at_more_of_a_table(page, scheme):
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": 390, "height": 900})
    page.evaluate(
        """() => {
        document.querySelectorAll("#deltas details").forEach((each) => (each.open = true));
        Object.assign(document.getElementById("delta-table").style, { width: "900px", opacity: 0 });
        }"""
    )
    box = page.locator(".scroll", has=page.locator("#delta-table"))
    assert test_looks.shaded(page, box) == (False, True)
    box.evaluate("each => each.scrollTo({left: 9999, behavior: 'instant'})")
    assert test_looks.shaded(page, box) == (True, False)


def test_numbers_and_units_are_written_as_by_hand(page):
    found = page.evaluate(
        """() => import("./numbers.js").then((m) => [
        m.shown(1.36e-8, 3), m.shown(-0.00006), m.shown(44600000000), m.field(44600000000),
        m.unitWords("kg/m^3"), m.unitWords("1/week^0.5"), m.unitWords("Pa*s"), m.unitWords("EUR/t CO2"), m.unitWords("um/s"),
        m.alike([15.999, 16.03, 15.98])(15.98), m.alike([1, 1e-9])(1), m.signed(5.222e13, 4)])"""
    )
    assert [each.replace("\u00a0", " ") for each in found] == [
        "1.36 × 10⁻⁸", "−0.00006", "44,600,000,000", "4.46e10",
        "kg/m³", "1/√week", "Pa·s", "EUR/t CO2", "µm/s", "15.980", "1", "+5.222 × 10¹³",
    ]  # fmt: skip


def test_how_near_a_policy_is_to_its_best_in_words(page):
    found = page.evaluate(
        """() => import("./numbers.js").then((m) => [[1, 0.1, 1], [3, 0.1, 1], [0, 0.1, 0], [1, 0.1, 0],
        [3, 2, 1]].map(([gradient, noise, at_training]) => m.nearness({ gradient, noise, at_training })))"""
    )
    assert [each["far"] for each in found] == [False, True, False, True, False]
    assert (
        "shows: it is 1 times as large as at the inputs of training, with a noise of 0.1"
        in found[0]["words"]
    )
    assert (
        "its gradient is 3 times as large as at the inputs of training, with a noise of 0.1"
        in found[1]["words"]
    )
    assert "shows: it is no more than noise, as it was at" in found[2]["words"]
    assert "is above its noise" in found[3]["words"]


def test_what_is_shown_is_taken_away_and_the_best_is_bounded(page):
    page.locator("[data-input=forward_curve] .handle").first.focus()
    page.keyboard.press("PageUp")
    settled(page)
    for link, name in (("csv", "shown-"), ("zip", "case.zip"), ("xlsx", "case.xlsx")):
        with page.expect_download() as waiting:
            page.click(f"#take-{link}")
        assert waiting.value.suggested_filename.startswith(name)
        assert Path(waiting.value.path()).stat().st_size > 500
    page.click("#bound")
    page.locator("#bounds", has_text="The optimum is at most").wait_for()
    home(page)
