"""Whatever is sent to the server of a study, it answers, and records nothing that is none."""

import json

from helpers.study_folder import (
    GOOD,
    REPORTS,
    SCREEN,
    begin,
    ready,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


def nearly(good):
    """Objects with most of the right fields, right or wrong."""
    fields = {key: st.just(value) | ANYTHING for key, value in good.items()}
    return st.fixed_dictionaries({}, optional=fields | {"else": ANYTHING})


def bodies(good):
    text = (nearly(good) | ANYTHING).map(lambda record: json.dumps(record).encode())
    return text | st.binary(max_size=200)


FUZZ = settings(max_examples=100, suppress_health_check=[HealthCheck.too_slow])


@FUZZ
@given(body=bodies(GOOD), content_type=st.sampled_from(["application/json"] * 5 + ["text/plain", "x", ""]))
def test_fuzzed_answers(client, store, body, content_type):
    link = ready(client)
    before = len(store.answers())
    status = client.post(f"{link}/answer", data=body, content_type=content_type).status_code
    assert status in (200, 400, 409, 415)
    assert len(store.answers()) == before + (status == 200)
    if status == 200:
        record = json.loads(body)
        assert set(record) == set(GOOD) and record["trial"] == 0 and record["side"] in ("left", "right")
        assert store.answers()[-1].response_time == record["response_time"]


@FUZZ
@given(body=bodies(REPORTS), other=bodies(SCREEN))
def test_fuzzed_profiles(client, store, body, other):
    link = begin(client)
    status = client.post(f"{link}/profile", data=body, content_type="application/json").status_code
    assert status in (200, 400)
    profile = store.profiles()[-1]
    assert profile["reports"] == (json.loads(body) if status == 200 else None)
    if status == 400:
        client.post(f"{link}/profile", json=REPORTS)
    if client.get(f"{link}/state").json["state"]["stage"] == "screen":
        status = client.post(f"{link}/screen", data=other, content_type="application/json").status_code
        assert status in (200, 400)
        assert store.profiles()[-1]["screen"] == (json.loads(other) if status == 200 else None)


@FUZZ
@given(
    path=st.text(st.characters(exclude_categories=("Cc", "Cs")), max_size=30),  # a client leaves out line breaks
    parts=st.lists(st.sampled_from(["..", "%2e%2e", "/", "o", "page", "0", "\\"]), max_size=6),
)
def test_fuzzed_paths(client, path, parts):
    for tried in (f"/{path}", "/" + "/".join(parts), f"/page/{path}", f"/o/{path}/0/left.png"):
        if tried.startswith("//"):  # what the client takes for a host
            continue
        response = client.get(tried)
        assert response.status_code in (200, 400, 404, 405)
        if response.status_code == 200:
            assert tried.split("?")[0].split("#")[0].strip("/") == "" or tried.startswith("/page/")
