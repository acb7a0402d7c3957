"""A whole session at the page of a study, in a real browser, and its figures."""

import time
from collections import Counter

import numpy as np
import pytest
from helpers.study_folder import BIRDS, EXPERIMENT, SECRETS, Ears, make_study, serving, stop_server
from helpers.study_page import shown

from torchbrdf.psychophysics import Comparisons, scale
from torchbrdf.study import read_answers, write_answers
from torchbrdf.study.store import STORE, Store

pytestmark = pytest.mark.slow


@pytest.fixture
def large(tmp_path):
    """The paper's second experiment: 60 trials. Its plan, server and port."""
    plan = make_study(tmp_path, materials=10)
    with serving(tmp_path) as (process, port):
        yield plan, process, port


def test_a_whole_session(browser, large, tmp_path):
    plan, process, port = large
    ears, pressed, began = Ears(), [], time.monotonic()

    def look_and_choose(page, trial):
        reference, *pair = shown(page, trial, 60)
        left = bool(np.linalg.norm(pair[0] - reference) < np.linalg.norm(pair[1] - reference))
        pressed.append("left" if left else "right")
        if trial % 10 == 5:
            time.sleep(0.4)
        if trial % 3:
            page.keyboard.press("ArrowLeft" if left else "ArrowRight")
        else:
            page.locator("#left" if left else "#right").click()
        ears.catch_up()

    with browser.new_context() as context:
        page = context.new_page()
        ears.listen(page)
        page.goto(f"http://127.0.0.1:{port}/")
        assert page.title() == plan.text("title")
        page.get_by_role("button", name="Begin").click()
        assert page.url.endswith(f":{port}/")  # not without consent
        page.get_by_role("checkbox").check()
        ears.catch_up()
        page.get_by_role("button", name="Begin").click()
        page.wait_for_url("**/o/*")
        link = page.url
        page.get_by_role("heading", name="About you").wait_for()
        assert page.locator("#questions .link").input_value() == link
        for label in ("Normal", "Yes", "Dim"):
            page.get_by_label(label, exact=True).check()
        page.get_by_label("Your display").fill("laptop")
        page.get_by_role("button", name="Continue").click()
        page.get_by_label("How many squares").fill("6")
        page.get_by_label("And how many").fill("8")
        page.locator("#screen form > button").click()
        assert page.get_by_role("heading", name="About your screen").is_visible()  # not without the card
        page.get_by_label("Width of the box").press("ArrowRight")
        page.locator("#screen form > button").click()
        page.get_by_role("button", name="Start").press("Enter")
        for trial in range(1, 26):
            look_and_choose(page, trial)
        shown(page, 26, 60)
        page.wait_for_load_state("networkidle")
        ears.catch_up()
    with browser.new_context() as context:
        page = context.new_page()
        ears.listen(page)
        page.goto(link)
        page.get_by_text(plan.text("pause")).wait_for()
        page.get_by_role("button", name="Continue").click()
        for trial in range(26, 61):
            look_and_choose(page, trial)
        page.get_by_text(plan.text("thanks")).wait_for()
        ears.catch_up()
        page.reload()
        page.get_by_text(plan.text("thanks")).wait_for()
        ears.catch_up()
    took = time.monotonic() - began
    assert stop_server(process).startswith("stopped: 1 observers, 60 answers")

    store = Store(tmp_path / STORE, plan)
    write_answers(tmp_path / "answers.csv", store.answers(EXPERIMENT))
    (profile,) = store.profiles()
    store.close()
    answers = read_answers(tmp_path / "answers.csv")
    assert len(answers) == 60
    assert len({(one.material, frozenset((one.left, one.right))) for one in answers}) == 60
    assert ["left" if one.chosen == one.left else "right" for one in answers] == pressed
    assert {"left", "right"} == set(pressed)
    wins = Counter(one.chosen for one in answers)
    assert [wins[bird] for bird in BIRDS] == [30, 20, 10, 0]
    scales = scale(Comparisons.from_answers(answers))
    for names, values in zip(scales.stimuli, scales.value.tolist(), strict=True):
        assert sorted(names, key=dict(zip(names, values, strict=True)).__getitem__, reverse=True) == list(BIRDS)
    times = [one.response_time for one in answers]
    slow = times[4::10]
    assert all(0 < seconds < 5 for seconds in times) and sum(times) + 58 * 0.25 < took
    assert min(slow) >= 0.39 and np.median(times) < 1
    assert profile["reports"] == {"colour_vision": "normal", "acuity": "yes", "room": "dim", "display": "laptop"}
    assert profile["screen"] == {
        "dark_steps": 6,
        "bright_steps": 8,
        "card": 321,
        "pixel_ratio": 1,
        "window_width": 1280,
        "window_height": 720,
        "screen_width": 1280,
        "screen_height": 720,
        "colour_depth": 24,
    }
    # Three pictures a trial, each asked for once, and those around the break twice.
    assert 180 <= sum(".png " in heard for heard in ears.heard) <= 189
    for secret in SECRETS:
        assert not [heard for heard in ears.heard if secret in heard]
