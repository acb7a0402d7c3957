"""A person at the page of a study, in a real browser: looks at pixels, chooses, leaves, comes back."""

import sqlite3
import time

import pytest
from helpers.prefix_proxy import proxy
from helpers.study_folder import Client, make_study, pixels_of, serving
from helpers.study_page import NAMES, answers_of, shown, start

from torchbrdf.study.connections import listening
from torchbrdf.study.store import STORE

pytestmark = pytest.mark.slow

# As if the person went to another tab.
HIDE = """() => {
  Object.defineProperty(document, "hidden", { value: true });
  document.dispatchEvent(new Event("visibilitychange"));
}"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    make_study(folder, size=25)
    return folder


@pytest.fixture(scope="module")
def home(folder):
    """Where a server of a small study is."""
    with serving(folder) as (_, port):
        yield f"http://127.0.0.1:{port}"


@pytest.fixture
def link(home):
    """The link of someone who is about to read the instructions."""
    client = Client(int(home.rpartition(":")[2]))
    yield home + client.ready()
    client.close()


@pytest.mark.parametrize("ratio", [1, 1.25, 1.5, 2, 3])
def test_one_pixel_of_a_picture_is_one_of_the_screen(launch, link, ratio):
    # A real screen's ratio: where it is emulated, Chromium rounds to CSS pixels.
    with launch(f"--force-device-scale-factor={ratio}", "--window-size=901,641") as browser:
        page = browser.new_context(no_viewport=True).new_page()
        start(page, link)
        assert page.evaluate("devicePixelRatio") == ratio and not page.locator("#tight").is_visible()
        page.mouse.move(1, 300)
        screen = pixels_of(page.screenshot())
        middles = {}
        for name in NAMES:
            box = {side: ratio * length for side, length in page.locator(f"#{name} img").bounding_box().items()}
            x, y = round(box["x"]), round(box["y"])
            assert list(box.values()) == pytest.approx([x, y, 25, 25], abs=0.01)  # edges between pixels
            wanted = pixels_of(page.request.get(f"{link}/0/{name}.png").body())
            assert (screen[y : y + 25, x : x + 25] == wanted).all()
            around = screen[y - 3 : y + 28, x - 3 : x + 28].copy()
            around[3:-3, 3:-3] = 0x3A
            assert (around == 0x3A).all()
            middles[name] = x + 12, y + 12
        assert middles["left"][1] == middles["right"][1] > middles["reference"][1] + 25
        assert abs(middles["left"][0] + middles["right"][0] - 2 * middles["reference"][0]) <= 2
        assert abs(middles["reference"][0] - screen.shape[1] / 2) <= 2


def test_a_screen_with_two_pixels_a_css_pixel(browser, link):
    with browser.new_context(device_scale_factor=2, viewport={"width": 801, "height": 601}) as context:
        page = context.new_page()
        start(page, link)
        for size in ({"width": 801, "height": 601}, {"width": 640, "height": 477}):
            page.set_viewport_size(size)
            page.wait_for_function("size => innerWidth === size.width && innerHeight === size.height", arg=size)
            # The page is laid out anew in a frame after the window's size has changed.
            page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            boxes = [page.locator(f"#{name} img").bounding_box() for name in NAMES]
            assert all(page.locator(f"#{name} img").evaluate("it => it.naturalWidth") == 25 for name in NAMES)
            assert {(box["width"], box["height"]) for box in boxes} == {(12.5, 12.5)}
            assert all(2 * box[side] % 1 == 0 for box in boxes for side in ("x", "y"))
            assert abs(boxes[0]["x"] + 6.25 - size["width"] / 2) <= 1


def test_pause_and_held_keys(page, link, folder):
    before = start(page, link)
    page.keyboard.press("Space")
    assert page.get_by_role("dialog", name="Pause").is_visible()
    assert not page.locator("#left img").is_visible() and not page.locator("#reference img").is_visible()
    for key in ("ArrowLeft", "ArrowRight"):
        page.keyboard.press(key)
    time.sleep(1)
    page.keyboard.press("Space")
    assert (shown(page, 1) == before).all()
    page.keyboard.press("ArrowRight")  # the clock was set back
    shown(page, 2)
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Continue").press("Enter")
    shown(page, 2)
    page.get_by_role("button", name="Pause").press("Space")  # which pauses once, and not again when it is let go
    assert page.get_by_role("dialog").is_visible()
    page.get_by_role("button", name="Continue").press("Space")
    shown(page, 2)
    page.evaluate(HIDE)
    assert page.get_by_role("dialog").is_visible()
    page.keyboard.press("Space")
    shown(page, 2)
    page.keyboard.down("ArrowLeft")
    shown(page, 3)
    for _ in range(20):  # as a key that is held down says again and again
        page.keyboard.down("ArrowLeft")
    page.keyboard.up("ArrowLeft")
    page.locator("#right").focus()
    page.keyboard.down("Enter")
    shown(page, 4)
    for _ in range(20):
        page.keyboard.down("Enter")
    page.keyboard.up("Enter")
    for key in ("Control+ArrowLeft", "Shift+Tab", "a", "ArrowUp", "0"):
        page.keyboard.press(key)
    time.sleep(0.4)
    shown(page, 4)
    found = answers_of(folder, link)
    assert [one.chosen == one.left for one in found] == [False, True, False]
    assert found[0].response_time < 1


def test_pause_in_the_blank(page, link, folder):
    start(page, link)
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Space")
    time.sleep(0.5)
    assert page.get_by_role("dialog").is_visible() and page.locator("#count").text_content() == "2 of 18"
    assert not page.locator("#left").is_visible()
    page.keyboard.press("Space")
    shown(page, 2)
    page.keyboard.press("ArrowLeft")
    shown(page, 3)
    assert len(answers_of(folder, link)) == 2


def test_nothing_counts_before_the_pictures_are_there(page, link, folder):
    held = []
    page.route("**/0/right.png", lambda route: held.append(route))
    page.goto(link)
    page.get_by_role("button", name="Start").click()
    page.wait_for_selector("#trials:not([hidden])")
    for key in ("ArrowLeft", "ArrowRight"):
        page.keyboard.press(key)
    time.sleep(0.8)
    assert not page.locator("#reference img").is_visible()
    page.keyboard.press("ArrowLeft")
    assert answers_of(folder, link) == []
    held[0].continue_()
    shown(page, 1)
    page.keyboard.press("ArrowRight")
    shown(page, 2)
    (found,) = answers_of(folder, link)
    assert found.chosen == found.right and found.response_time < 0.8


def test_a_server_that_is_away(page, link, folder):
    start(page, link)
    page.route("**/answer", lambda route: route.abort())
    page.keyboard.press("ArrowRight")
    page.get_by_text("The server cannot be reached").wait_for()
    page.keyboard.press("ArrowLeft")  # the answer is given already
    assert answers_of(folder, link) == [] and page.locator("#count").text_content() == "1 of 18"
    page.unroute("**/answer")
    shown(page, 2)
    assert not page.locator("#trouble").is_visible()

    def loses(route):
        route.fetch()  # it is recorded, but the page does not hear of it
        route.abort()

    page.route("**/answer", loses, times=1)
    page.keyboard.press("ArrowLeft")
    shown(page, 3)
    page.route("**/answer", lambda route: route.fulfill(status=502, body="<h1>Bad gateway</h1>"), times=1)
    page.keyboard.press("ArrowLeft")
    shown(page, 4)
    page.route("**/5/left.png", lambda route: route.abort(), times=1)
    for trial in (4, 5):
        page.keyboard.press("ArrowRight")
        shown(page, trial + 1)
    found = answers_of(folder, link)
    assert [one.chosen == one.right for one in found] == [True, False, False, True, True]


def test_a_busy_server(page, link, folder):
    start(page, link)
    page.route("**/answer", lambda route: route.fulfill(status=503, headers={"Retry-After": "2"}, body="{}"), times=1)
    page.wait_for_timeout(300)  # a key that comes with the pictures may come before them
    began = time.monotonic()
    page.keyboard.press("ArrowRight")
    page.get_by_text("The server is busy. Nothing is lost; trying again").wait_for()
    shown(page, 2)
    assert time.monotonic() - began > 2 and not page.locator("#trouble").is_visible()
    (found,) = answers_of(folder, link)
    assert found.chosen == found.right


def test_a_database_that_is_locked_for_a_while(page, link, folder):
    start(page, link)
    other = sqlite3.connect(folder / STORE, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    page.keyboard.press("ArrowLeft")
    page.get_by_text("The server is busy").wait_for()
    with page.expect_response("**/0/left.png") as heard:
        page.evaluate("fetch(`${location.pathname}/0/left.png`, { cache: 'reload' })")
    assert heard.value.status == 200
    other.execute("ROLLBACK")
    other.close()
    shown(page, 2)
    (found,) = answers_of(folder, link)
    assert found.chosen == found.left


@pytest.mark.parametrize("strips", [True, False])
def test_behind_a_prefix(page, tmp_path, strips):
    make_study(tmp_path, size=25)
    with listening("127.0.0.1", 0) as free:
        port = free.getsockname()[1]
    with proxy(port, "/fits", strips) as front, serving(tmp_path, port=port, url=f"http://127.0.0.1:{front}/fits"):
        heard = []
        page.on("response", lambda response: heard.append((response.status, response.url)))
        page.route(
            "**/begin",
            lambda route: route.fulfill(status=429, headers={"Retry-After": "1"}, body='{"error": "later"}'),
            times=1,
        )
        page.goto(f"http://127.0.0.1:{front}/fits/")
        page.get_by_role("checkbox").check()
        page.get_by_role("button", name="Begin").click()
        page.get_by_text("Many people begin just now").wait_for()
        page.wait_for_url("**/fits/o/*")
        for label in ("Normal", "Yes", "Dim"):
            page.get_by_label(label, exact=True).check()
        page.get_by_role("button", name="Continue").click()
        page.get_by_label("How many squares").fill("6")
        page.get_by_label("And how many").fill("8")
        page.get_by_label("I have no card").check()
        page.locator("#screen form > button").click()
        page.get_by_role("button", name="Start").click()
        for trial in (1, 2, 3):
            shown(page, trial)
            page.keyboard.press("ArrowLeft")
        shown(page, 4)
        page.reload()
        page.get_by_role("button", name="Continue").click()
        shown(page, 4)
        assert len(answers_of(tmp_path, page.url)) == 3
        assert [status for status, _ in heard if status >= 400] == [429]
        assert {url.partition(f":{front}")[2][:6] for _, url in heard} == {"/fits/"}


def test_two_windows(page, browser, link, folder):
    start(page, link)
    with browser.new_context() as context:
        other = context.new_page()
        start(other, link)
        for trial in range(1, 8):
            other.keyboard.press("ArrowLeft")
            shown(other, trial + 1)
    page.keyboard.press("ArrowRight")  # to a trial that is over
    shown(page, 8)
    page.keyboard.press("ArrowRight")
    shown(page, 9)
    assert [one.chosen == one.left for one in answers_of(folder, link)] == [True] * 7 + [False]


def test_who_is_screened_out(page, home, folder):
    page.goto(home)
    page.get_by_role("checkbox").press("Space")
    page.get_by_role("button", name="Begin").press("Enter")
    page.get_by_label("Deficient").check()
    for label in ("No", "Dark"):
        page.get_by_label(label, exact=True).check()
    page.get_by_role("button", name="Continue").click()
    page.get_by_text("This study needs other conditions").wait_for()
    page.reload()
    page.get_by_text("This study needs other conditions").wait_for()
    assert page.locator("main:visible").count() == 1 and answers_of(folder, page.url) == []


def test_a_small_window_is_told(page, home):
    page.set_viewport_size({"width": 150, "height": 120})
    page.goto(home)
    page.get_by_role("checkbox").check()
    page.get_by_role("button", name="Begin").click()
    for label in ("Normal", "Yes", "Bright"):
        page.get_by_label(label, exact=True).check()
    page.get_by_role("button", name="Continue").click()
    page.get_by_text("Your window is too small").wait_for()
    page.set_viewport_size({"width": 300, "height": 300})
    page.get_by_text("Your window is too small").wait_for(state="hidden")
    page.set_viewport_size({"width": 150, "height": 120})
    page.get_by_label("How many squares").fill("0")
    page.get_by_label("And how many").fill("0")
    page.get_by_label("I have no card").check()
    page.locator("#screen form > button").click()
    page.get_by_role("button", name="Start").click()
    shown(page, 1)
    assert page.locator("#tight").is_visible()
    for name in NAMES:
        assert page.locator(f"#{name} img").bounding_box()["width"] == 25  # never scaled
    page.set_viewport_size({"width": 600, "height": 500})
    page.locator("#tight").wait_for(state="hidden")
