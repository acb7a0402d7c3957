"""The page of a study as someone sees it in a browser."""

import numpy as np

from helpers.study_folder import LOOK
from torchbrdf.study import Plan
from torchbrdf.study.store import STORE, Store

NAMES = ("reference", "left", "right")


def shown(page, trial, of=18):
    """Wait for the pictures of a trial, from 1; gives their mean colours."""
    return np.array(page.wait_for_function(LOOK, arg=f"{trial} of {of}").json_value())


def start(page, link):
    page.goto(link)
    page.get_by_role("button", name="Start").click()
    return shown(page, 1)


def answers_of(folder, link):
    """What is recorded of an observer."""
    store = Store(folder / STORE, Plan.load(folder))
    token = link.rpartition("/")[2]
    (number,) = store._database.connection().execute("SELECT id FROM observers WHERE token = ?", (token,)).fetchone()
    found = [answer for answer in store.answers() if answer.observer == f"observer-{number:03d}"]
    store.close()
    return found
