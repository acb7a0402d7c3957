"""A small study and its server without a network, for the tests of a module."""

import shutil

import pytest
from helpers.study_folder import EXPERIMENT, make_study

from torchbrdf.study.server import make_app
from torchbrdf.study.store import STORE, Store


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    make_study(folder)
    return folder


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    return make_study(tmp_path_factory.mktemp("plan"))


@pytest.fixture(scope="module")
def store(folder, plan):
    made = Store(folder / STORE, plan)
    yield made
    made.close()


@pytest.fixture(scope="module")
def client(folder, store):
    return make_app(folder, EXPERIMENT, store).test_client()


@pytest.fixture(scope="module")
def launch():
    """Starts Chromium, with more flags."""
    api = pytest.importorskip("playwright.sync_api", reason="needs Playwright: pip install playwright")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("needs Chromium: no program chromium or chromium-browser")
    flags = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--force-color-profile=srgb"]
    with api.sync_playwright() as playwright:
        yield lambda *more: playwright.chromium.launch(executable_path=program, args=[*flags, *more])


@pytest.fixture(scope="module")
def browser(launch):
    with launch() as started:
        yield started


@pytest.fixture
def page(browser):
    """A new window, with nothing kept from others; errors of its scripts fail the test."""
    with browser.new_context(viewport={"width": 1000, "height": 700}) as context:
        made = context.new_page()
        made.set_default_timeout(10_000)
        errors = []
        made.on("pageerror", lambda error: errors.append(error))
        yield made
        assert not errors
