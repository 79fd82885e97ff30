"""The page in a browser, with a worker that computes a plain formula, so that every state of the
page can be held still."""

import re
import shutil
import sys
from pathlib import Path

import pytest

pytest.importorskip("aiohttp", reason="the page needs the extra `live`")
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser")

from benchmarks import live_browser  # noqa: E402

from snapo.live.server import Server  # noqa: E402

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
pytestmark = [
    pytest.mark.prove,
    pytest.mark.skipif(CHROMIUM is None, reason="this machine has no Chromium"),
]
WORKER = Path(__file__).with_name("page_worker.py")
ABOUT = {
    "title": "Item", "kind": "inventory", "folder": "mine/run", "days": None, "step": "week",
    "restart": 'Start it again with "snapo open mine/run".',
    "trains": True, "meaning": "", "result": {"value": 455.0, "standard_error": 0.5},
}  # fmt: skip
REASON = "for the previous inputs"
CARDS = ("value", "best", "today", "deltas", "fans")  # and the sections of the domain


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture
def held(tmp_path):
    """A file: while it exists, the worker does not answer."""
    return tmp_path / "held"


@pytest.fixture
def server(tmp_path, held):
    with serving(tmp_path, held) as found:
        yield found


def serving(run, held, **result):
    about = ABOUT | {"result": ABOUT["result"] | result}
    return live_browser.running(Server(run, about, [sys.executable, "-S", str(WORKER), str(held)]))


@pytest.fixture
def page(browser, server):
    with opened(browser, server) as found:
        yield found


class opened:
    """A page that is ready; an error of its script fails the test."""

    def __init__(self, browser, server, state=""):
        self.context = browser.new_context()
        self.page, self.wrong = self.context.new_page(), []
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.set_default_timeout(20_000)
        self.page.goto(server.address + state)
        self.page.locator("#deltas").wait_for()

    def __enter__(self):
        return self.page

    def __exit__(self, *error):
        self.context.close()
        assert self.wrong == []


def enter(page, name, text):
    """Types a number into the field of an input."""
    field = page.locator(f"[data-input={name}] input[type=text]:not(.short)").first
    if not field.is_visible():
        page.locator(f"[data-input={name}] details summary").click()
    field.fill(text)
    field.press("Enter")


def settled(page):
    page.locator("#status", has_text="revalued in").wait_for()
    page.locator(".reason").first.wait_for(state="detached")
    return page.inner_text("#figure")


def dimmed(page):
    """The cards whose numbers are pale, each with a reason on its edge."""
    found = page.locator(".card.stale:visible")
    for card in found.all():
        assert card.locator(".reason").inner_text().startswith(REASON)
        pale = card.locator(":scope > :not(.reason):not(dl)").first
        assert pale.evaluate("each => getComputedStyle(each).filter") == "grayscale(1)"
    return {card.get_attribute("id") or card.locator("h2").inner_text() for card in found.all()}


def test_numbers_of_other_inputs_are_dimmed_with_the_reason(page, held):
    assert dimmed(page) == set()
    held.touch()
    enter(page, "cost", "6")
    page.locator("#status", has_text="revaluing").wait_for()
    # The value is shown to first order, and is therefore of the inputs shown.
    assert page.inner_text("#figure") == "456" and page.inner_text("#error") == "to first order"
    assert dimmed(page) == {"best", "today", "deltas", "fans", "Service"}
    assert "being valued" in page.inner_text("#today .reason")
    held.unlink()
    assert settled(page) == "456" and dimmed(page) == set()


def test_after_a_refusal_every_number_is_dimmed_and_buttons_say_why(page):
    enter(page, "cost", "500")
    page.locator("#status", has_text="refused").wait_for()
    assert page.inner_text("#figure") == "–"
    assert dimmed(page) == {*CARDS, "Service"}
    assert "the present inputs are refused" in page.inner_text("#deltas .reason")
    for name in ("#train", "#bound", "#keep-now"):
        assert page.locator(name).is_disabled()
    assert "refused" in page.inner_text("#again-why") and "refused" in page.inner_text("#keep-why")
    enter(page, "cost", "7")
    assert settled(page) == "457" and dimmed(page) == set()
    assert page.locator("#train").is_enabled() and page.inner_text("#again-why") == ""


def test_first_order_starts_from_the_point_that_was_valued_last(page, held):
    """100 + 2 p²: the derivative is 40 at the run's price of 10, and 80 at 20."""
    enter(page, "price", "20")
    assert settled(page) == "1,055"
    held.touch()
    enter(page, "price", "21")
    page.locator("#status", has_text="revaluing").wait_for()
    assert page.inner_text("#figure") == "1,135"
    assert "+680" in page.inner_text("#changes")  # from the run, to first order
    held.unlink()
    assert settled(page) == "1,137"
    page.click("#reset")
    held.touch()
    enter(page, "price", "11")
    assert page.inner_text("#figure") == "495"
    held.unlink()


def test_a_choice_shows_how_long_it_is_compiled(page, held):
    page.locator("summary", has_text="Choices").click() if not page.locator(
        "[data-choice] select"
    ).is_visible() else None
    held.touch()
    page.select_option("[data-choice] select", "1")
    page.locator("#working").wait_for()
    assert "compiled, once" in page.inner_text("#value .reason")
    assert "value" in dimmed(page) and page.inner_text("#figure") == "455"
    note = page.locator("[data-choice] [role=status]")
    assert "this may take a minute (0 s" in note.inner_text()
    page.locator("[data-choice] [role=status]", has_text=re.compile("[1-9] s so far")).wait_for()
    held.unlink()
    assert settled(page) == "505"
    assert page.locator("#working").is_hidden() and note.is_hidden()
    # A number moves from here at once, without compiling.
    held.touch()
    enter(page, "cost", "8")
    assert page.inner_text("#figure") == "508" and page.inner_text("#error") == "to first order"
    held.unlink()
    assert settled(page) == "508"


@pytest.mark.parametrize(
    ("result", "words", "far"),
    [
        ({"convergence": "converged"}, "is near its best here", False),
        ({"convergence": "still improving"}, "the training is “still improving”.", True),
        ({"convergence": "converged", "verdict": "The rule does better."}, "rule does better", False),
    ],
)  # fmt: skip
def test_health_is_compared_with_the_verdict_on_the_run(
    browser, tmp_path, held, result, words, far
):
    with serving(tmp_path, held, **result) as server, opened(browser, server) as page:
        assert words in page.inner_text("#health")
        assert ("far" in (page.get_attribute("#health", "class") or "")) == far
        assert ("not certain" in page.inner_text("#health")) == far


def test_moves_are_undone_and_done_again(page):
    assert page.locator("#undo").is_disabled() and page.locator("#redo").is_disabled()
    for cost in ("6", "7"):
        enter(page, "cost", cost)
        settled(page)
    page.click("#undo")
    assert settled(page) == "456"
    page.locator("#title").click()
    page.keyboard.press("Control+z")
    page.locator("#status", has_text="the run's numbers").wait_for()
    assert page.inner_text("#figure") == "455" and page.locator("#undo").is_disabled()
    for value in ("456", "457"):
        page.click("#redo")
        assert settled(page) == value
    assert page.locator("#redo").is_disabled()


def test_the_address_has_the_state(page, browser, server):
    enter(page, "price", "20")
    settled(page)
    state = page.evaluate("location.hash")
    assert state == "#price=0%3A20"
    page.reload()
    assert settled(page) == "1,055"
    with opened(browser, server, "#price=0%3A20&cost=0:6&nothing=0:1&~item.unmet=waits") as other:
        assert settled(other) == "1,106"
        assert other.locator("[data-choice].changed").count() == 1
    for bad in ("#price=9:1,x,0:,0:1e999,:", "#%", "#~item.unmet=%3Cb%3E"):
        with opened(browser, server, bad) as other:
            other.locator("#status", has_text="the run's numbers").wait_for()


def test_a_download_that_fails_says_why(page):
    page.click("#scenarios a >> text=the run's report")
    page.locator("#download-trouble", has_text="`snapo report` writes one").wait_for()
    enter(page, "price", "20")
    settled(page)
    page.click("#take-xlsx")
    page.locator("#download-trouble", has_text="openpyxl is missing").wait_for()
    with page.expect_download() as waiting:
        page.click("#take-csv")
    assert waiting.value.suggested_filename.endswith(".csv")
    assert "1055" in Path(waiting.value.path()).read_text()
    assert page.inner_text("#download-trouble") == ""


def test_the_policy_that_training_found_is_adopted_and_kept(page, server):
    enter(page, "cost", "6")
    settled(page)
    assert page.locator("#adopt").is_hidden()
    page.click("#train")
    page.locator("#trained", has_text="a gain of 7").wait_for()
    page.click("#adopt")
    assert settled(page) == "463" and "trained again here" in page.inner_text("#changes")
    page.fill("#keep-name", "Better")
    page.press("#keep-name", "Enter")
    page.locator("#kept tr", has_text="Better").locator("a", has_text="Case").wait_for()
    page.click("#run-policy")
    assert settled(page) == "456" and page.locator("#run-policy").is_hidden()
    page.click("#kept button >> text=Show")
    assert settled(page) == "463" and "from the scenario" in page.inner_text("#changes")
    # A number of a policy ends with its worker, that of a scenario is in its file.
    server.workers.process.kill()
    page.locator("#status", has_text="revalued in").wait_for()
    assert settled(page) == "463"


def test_a_server_that_starts_again_offers_the_inputs_of_before(browser, tmp_path, held):
    with serving(tmp_path, held) as server, opened(browser, server) as page:
        assert page.locator("#offer").is_hidden()
        enter(page, "cost", "6")
        settled(page)
        running = server.address
    with serving(tmp_path, held) as server, opened(browser, server) as page:
        assert "one input or choice" in page.inner_text("#offer")
        page.click("#offer-take")
        assert settled(page) == "456" and page.locator("#offer").is_hidden()
        page.goto(server.address.rstrip("/"))  # an address without its last slash
        page.locator("#deltas").wait_for()
        page.goto(f"http://127.0.0.1:{server.port}/{running.split('/')[3]}/")
        assert "Run `snapo open RUN` again" in page.inner_text("body")


def test_a_page_whose_server_has_ended_says_what_to_do(browser, tmp_path, held):
    with serving(tmp_path, held) as server:
        page = opened(browser, server)
    page.page.locator("#trouble", has_text="snapo open mine/run").wait_for()
    assert page.page.locator("#keep-now").is_disabled()
    assert "starting" in page.page.inner_text("#keep-why")
    page.context.close()


def test_a_change_is_explained_by_input(page):
    enter(page, "price", "20")
    settled(page)
    enter(page, "cost", "3")
    settled(page)
    page.click("#explain")
    page.locator("#explained").wait_for()
    texts = page.locator("#explained-chart text").all_text_contents()
    assert texts == ["The run", "455", "Price", "+600", "Cost", "−2", "Here", "1,053"]
    assert page.locator("#explained-chart rect.fall").count() == 1
    for width in (1440, 390):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    enter(page, "cost", "4")
    assert page.locator("#explained").is_hidden()  # it is of other inputs


@pytest.mark.parametrize("width", [1440, 390])
def test_the_page_speaks_the_language_of_its_domain(browser, tmp_path, held, width):
    with serving(tmp_path, held) as server:
        server.about |= {"follows": True, "meaning": "Certainty-equivalent funding ratio"}
        with opened(browser, server) as page:
            page.set_viewport_size({"width": width, "height": 900})
            assert page.inner_text("#value-head") == "Certainty-equivalent funding ratio"
            assert page.inner_text("#figure") == "455"
            tiles = page.locator("#sections dl div").all_inner_texts()
            assert [tile.split() for tile in tiles] == [
                ["Yield", "45.5", "%"],
                ["Temperature", "40.5", "°C"],
            ]
            names = page.locator("#fan-name option").all_inner_texts()
            shares = "Equities, share of the assets"
            assert names == ["Stock (state)", shares, "Decision", "Stock (output of one step)"]
            drawn = set()
            for i in range(len(names)):
                page.select_option("#fan-name", str(i))
                drawn.add(page.inner_html("#fan-chart"))
            assert len(drawn) == len(names)
            wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
            assert page.evaluate(wide) <= 0  # nothing is cut


def test_scenarios_stand_side_by_side_with_what_moved_and_by_how_much(page):
    def keep(name):
        settled(page)
        page.fill("#keep-name", name)
        page.press("#keep-name", "Enter")
        page.locator("#kept tr", has_text=name).wait_for()

    enter(page, "cost", "6")
    keep("Dear")
    page.fill("[data-input=price] .short", "1.5")
    page.press("[data-input=price] .short", "Enter")
    keep("All")
    enter(page, "price", "14")
    keep("Some")
    assert "Price all +1.5 EUR/t; Cost 5 to 6 EUR/t" in page.inner_text("#kept tr >> nth=2")
    page.locator("#beside summary").click()
    rows = [row.inner_text().split("\t") for row in page.locator("#beside-table tr").all()]
    assert rows[0] == ["", "Dear", "All", "Some"]
    assert rows[1][1] == "456 ± 0.98" and rows[2][1] == "+1 ± 0.49"  # of 0.5 and 0.25
    assert ["Price", "as in the run", "all +1.5 EUR/t", "3 of 3: +1.5 to +4 EUR/t"] in rows


def test_the_page_starts_from_the_value_of_the_run_and_says_which_paths_are_its_own(
    browser, tmp_path, held
):
    with (
        serving(tmp_path, held, value=455.25, standard_error=0.1) as server,
        opened(browser, server) as page,
    ):
        assert page.inner_text("#figure") == "455.25" and page.inner_text("#error") == "± 0.2"
        changes = page.inner_text("#changes")
        assert "on the 64 paths of this page" in changes.lower() and "455 ± 0.98" in changes
        assert "± is half of a 95 % interval, simulation error only." in page.inner_text("#value")
        enter(page, "cost", "6")
        assert settled(page) == "456"
