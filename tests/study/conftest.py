"""A small study and its server without a network, for the tests of a module."""

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
