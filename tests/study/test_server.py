"""The server of a study: who may see and say what, and that nothing else is recorded or told."""

import json
import re
import sqlite3
import time
from urllib.parse import urljoin

import pytest
from helpers.study_folder import (
    BAD_ANSWERS,
    BAD_BODIES,
    BAD_REPORTS,
    BAD_SCREENS,
    EXPERIMENT,
    GOOD,
    REPORTS,
    SCREEN,
    SECRETS,
    answer,
    begin,
    chunks_of,
    pixels_of,
    ready,
)

from torchbrdf.errors import DataError
from torchbrdf.study import trials
from torchbrdf.study.database import SHUT
from torchbrdf.study.guard import Begins, Site
from torchbrdf.study.server import AHEAD, make_app, plain_png
from torchbrdf.study.store import STORE, Store

WHAT = ("reference", "left", "right")


def everything(response):
    """All that a browser gets, as text."""
    return f"{response.status} {response.headers} {response.get_data().decode('latin-1')}".lower()


def test_a_whole_session_tells_no_names(client, store, plan, folder):
    link = begin(client)
    number = store.profiles()[-1]["number"]
    shown = trials(plan, plan.experiment(EXPERIMENT), number)
    got = [client.get("/"), client.get(link), client.get(f"{link}/state")]
    assert [response.status_code for response in got] == [200, 200, 200]
    assert got[-1].json == {"state": {"stage": "questions", "trial": 0, "of": 18}}
    got.append(client.post(f"{link}/profile", json=REPORTS))
    assert got[-1].json["state"]["stage"] == "screen"
    got.append(client.post(f"{link}/screen", json=SCREEN))
    assert got[-1].json["state"]["stage"] == "trials"
    for k, trial in enumerate(shown):
        material = plan.material(trial.material)
        pictures = [material.reference] + [material.stimuli[name].picture for name in (trial.left, trial.right)]
        for what, picture in zip(WHAT, pictures, strict=True):
            got.append(client.get(f"{link}/{k}/{what}.png"))
            assert got[-1].status_code == 200 and got[-1].content_type == "image/png"
            assert (pixels_of(got[-1].data) == pixels_of((folder / picture).read_bytes())).all()
            assert chunks_of(got[-1].data) == [b"IHDR", b"IDAT", b"IEND"]
        got.append(answer(client, link, k, ("left", "right")[k % 2], 0.25 * k))
        assert got[-1].status_code == 200
        stage = "done" if k == 17 else "trials"
        assert got[-1].json == {"state": {"stage": stage, "trial": k + 1, "of": 18}}
    got += [client.get(f"/page/{name}") for name in ("study.js", "trials.js", "send.js", "study.css", "icon.svg")]
    assert {response.status_code for response in got} == {200}
    mine = [one for one in store.answers() if one.observer == store.profiles()[-1]["observer"]]
    assert [one.chosen for one in mine] == [(one.left, one.right)[k % 2] for k, one in enumerate(shown)]
    assert [one.response_time for one in mine] == [0.25 * k for k in range(18)]
    for response in got:
        for secret in SECRETS:
            assert secret not in everything(response)
        assert not {"ETag", "Last-Modified", "Content-Disposition", "Set-Cookie", "Location"} & set(response.headers)


def test_a_picture_keeps_its_colours_and_loses_its_texts(folder, plan):
    path = folder / plan.materials[0].reference
    data = path.read_bytes()
    assert plan.materials[0].name.encode() in data
    assert {b"tEXt", b"zTXt", b"pHYs"} <= set(chunks_of(data))
    plain = plain_png(data, path)
    assert plan.materials[0].name.encode() not in plain and (pixels_of(plain) == pixels_of(data)).all()
    gamma = data[:33] + bytes.fromhex("0000000467414d410000b18f0bfc6105") + data[33:]  # a gAMA chunk after the head
    assert chunks_of(plain_png(gamma, path))[:2] == [b"IHDR", b"gAMA"]
    for bad in (data[:-5], data + b"x", b"GIF89a" + data[6:], data[:8], b""):
        with pytest.raises(DataError, match=r"cobalt\.png: expected a whole PNG, found something else$"):
            plain_png(bad, path)


def test_every_answer_is_guarded(client):
    link = ready(client)
    paths = [
        "/",
        link,
        f"{link}/state",
        f"{link}/0/left.png",
        "/page/study.js",
        "/nothing",
        "/o/forged",
        f"{link}/9/left.png",
    ]
    responses = [client.get(path) for path in paths] + [
        client.put(link),
        answer(client, link, 5),
        client.post("/begin"),
    ]
    assert [response.status_code for response in responses] == [200] * 5 + [404, 404, 403, 405, 409, 415]
    for response in responses:
        policy = dict(part.strip().split(" ", 1) for part in response.headers["Content-Security-Policy"].split(";"))
        assert policy["default-src"] == policy["frame-ancestors"] == policy["form-action"] == "'none'"
        assert {policy[f"{what}-src"] for what in ("script", "style", "img", "connect")} == {"'self'"}
        assert response.headers["X-Content-Type-Options"] == "nosniff"
        assert response.headers["Referrer-Policy"] == "no-referrer"
        assert response.headers["Cache-Control"] in ("no-store", "private, max-age=3600")
    page = client.get(link).text
    assert "http:" not in page and "https:" not in page and " style=" not in page and "<script>" not in page


def test_pictures_are_seen_only_near_their_trial(client):
    link = begin(client)
    assert client.get(f"{link}/0/left.png").status_code == 403  # before the questions
    client.post(f"{link}/profile", json=REPORTS)
    assert client.get(f"{link}/0/left.png").status_code == 403
    client.post(f"{link}/screen", json=SCREEN)
    for at in range(19):
        for what in WHAT:
            seen = [k for k in range(21) if client.get(f"{link}/{k}/{what}.png").status_code == 200]
            assert seen == list(range(at, min(at + AHEAD + 1, 18)))
        assert client.get(f"{link}/{10**30}/left.png").status_code == 403
        if at < 18:
            answer(client, link, at)
    for path in ("/0/middle.png", "/-1/left.png", "/0/left.jpg", "/0/left", "/one/left.png", "/0/", "/"):
        assert client.get(link + path).status_code == 404


def test_only_the_current_trial_is_answered(client, store):
    link = ready(client)
    before = len(store.answers())
    assert answer(client, link, 0).status_code == 200
    for trial in (0, 2, 17, 18, -1, 10**30):
        response = answer(client, link, trial, "right")
        assert response.status_code == 409
        assert response.json["state"] == {"stage": "trials", "trial": 1, "of": 18}  # so that a page goes on
    assert len(store.answers()) == before + 1
    assert answer(client, begin(client), 0).status_code == 409
    for trial in range(1, 18):
        answer(client, link, trial)
    assert answer(client, link, 18).status_code == 409
    assert answer(client, link, 17).json["state"]["stage"] == "done"
    assert len(store.answers()) == before + 18


@pytest.mark.parametrize("token", ["forged", "A" * 22, "%00", "%ff%fe", "a" * 5000, "..", "'; DROP TABLE answers; --"])
def test_a_forged_link_is_not_known(client, token):
    gets = [client.get(f"/o/{token}{rest}") for rest in ("", "/state", "/0/left.png")]
    bodies = {"profile": REPORTS, "screen": SCREEN, "answer": {"trial": 0, "side": "left", "response_time": 1}}
    posts = [client.post(f"/o/{token}/{what}", json=body) for what, body in bodies.items()]
    assert {response.status_code for response in gets + posts} == {404}


def test_screening(client, store):
    link = begin(client)
    for vision in ("deficient", "not sure"):
        link = begin(client)
        said = client.post(f"{link}/profile", json={**REPORTS, "colour_vision": vision})
        assert said.status_code == 200 and said.json["state"]["stage"] == "screened"
        assert client.get(f"{link}/0/reference.png").status_code == 403
        assert answer(client, link, 0).status_code == 403
        assert client.post(f"{link}/profile", json=REPORTS).status_code == 409  # no second try
        assert client.post(f"{link}/screen", json=SCREEN).status_code == 409
        assert client.get(f"{link}/state").json["state"]["stage"] == "screened"
        assert store.profiles()[-1]["let_in"] is False
        assert store.profiles()[-1]["reports"]["colour_vision"] == vision


def test_what_is_said_is_recorded_once(client, store):
    link = begin(client)
    assert client.post(f"{link}/screen", json=SCREEN).status_code == 409
    assert client.post(f"{link}/profile", json=REPORTS).status_code == 200
    again = client.post(f"{link}/profile", json={**REPORTS, "room": "dark"})
    assert again.status_code == 409 and again.json["state"]["stage"] == "screen"
    assert client.post(f"{link}/screen", json={**SCREEN, "card": None}).status_code == 200
    assert client.post(f"{link}/screen", json=SCREEN).status_code == 409
    profile = store.profiles()[-1]
    assert profile["reports"] == REPORTS and profile["screen"] == {**SCREEN, "card": None}


@pytest.mark.parametrize("body", [json.dumps(bad).encode() for bad in BAD_ANSWERS] + BAD_BODIES)
def test_bad_answers_are_refused(client, store, body):
    link = ready(client)
    before = len(store.answers())
    response = client.post(f"{link}/answer", data=body, content_type="application/json")
    assert response.status_code == 400 and response.json["error"]
    assert len(store.answers()) == before and client.get(f"{link}/state").json["state"]["trial"] == 0


@pytest.mark.parametrize("time", [0, 0.0, 1, 3.25, 86_400])
def test_good_response_times(client, store, time):
    link = ready(client)
    assert answer(client, link, 0, "right", time).status_code == 200
    assert store.answers()[-1].response_time == time


@pytest.mark.parametrize(
    ("what", "body"), [("profile", bad) for bad in BAD_REPORTS] + [("screen", bad) for bad in BAD_SCREENS]
)
def test_bad_profiles_are_refused(client, store, what, body):
    link = begin(client)
    if what == "screen":
        client.post(f"{link}/profile", json=REPORTS)
    before = store.profiles()[-1]
    assert client.post(f"{link}/{what}", data=json.dumps(body), content_type="application/json").status_code == 400
    assert store.profiles()[-1] == before


@pytest.mark.parametrize("body", [{"agreed": False}, {"agreed": 1}, {"agreed": "yes"}, {}, {"agreed": True, "x": 1}])
def test_nobody_begins_without_consent(client, store, body):
    before = len(store.profiles())
    assert client.post("/begin", json=body).status_code == 400
    assert len(store.profiles()) == before


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Content-Type": "text/plain"}, 415),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 415),
        ({"Content-Type": "multipart/form-data; boundary=x"}, 415),
        ({"Content-Type": ""}, 415),
        ({"Content-Type": "application/json; charset=utf-8"}, 200),
        ({"Origin": "http://localhost"}, 200),
        ({"Origin": "https://localhost"}, 200),  # behind a proxy that speaks TLS
        ({"Origin": "http://localhost:81"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "http://localhost.evil.example"}, 403),
        ({"Origin": "http://localhost@evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://[bad"}, 403),
        ({"Origin": ""}, 403),
    ],
)
def test_headers_of_posts(client, store, headers, status):
    link = ready(client)
    before = len(store.answers())
    posted = client.post(
        f"{link}/answer", data=json.dumps(GOOD), headers={"Content-Type": "application/json"} | headers
    )
    assert posted.status_code == status
    assert len(store.answers()) == before + (status == 200)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "127.0.0.1:8000", "Origin": "https://study.example"}, 200),
        ({"Host": "study.example", "Origin": "https://study.example", "Sec-Fetch-Site": "same-origin"}, 200),
        ({"Host": "localhost:9000", "Origin": "http://localhost:9000"}, 200),
        ({"Host": "study.example", "Origin": "null", "Sec-Fetch-Site": "same-origin"}, 200),
        ({"Host": "study.example", "Origin": "null"}, 403),
        ({"Host": "study.example", "Sec-Fetch-Site": "cross-site"}, 403),
        ({"Host": "study.example", "Origin": "https://evil.example"}, 403),
        ({"Host": "evil.example:8000", "Origin": "http://evil.example:8000", "Sec-Fetch-Site": "same-origin"}, 400),
        ({"Host": "evil.example"}, 400),
    ],
)
def test_pages_and_names_behind_a_proxy(folder, store, headers, status):
    site = Site.of("127.0.0.1", "https://study.example/fits")
    client = make_app(folder, EXPERIMENT, store, site).test_client()
    link = ready(client)
    before = len(store.answers())
    assert client.post(f"{link}/answer", json=GOOD, headers=headers).status_code == status
    assert len(store.answers()) == before + (status == 200)
    read = client.get(link, headers={"Host": headers["Host"]})
    assert read.status_code == (400 if status == 400 else 200)


def test_links_are_relative(client):
    link = ready(client)
    for path, page in (("/fits/", client.get("/").text), (f"/fits{link}", client.get(link).text)):
        found = re.findall(r'(?:href|src|action)="([^"]*)"', page)
        assert {urljoin(path, one) for one in found} == {
            f"/fits/page/{name}" for name in ("icon.svg", "study.css", "study.js")
        }
        assert not [one for one in found if one.startswith("/")]
    for script in ("study.js", "trials.js", "send.js"):
        assert not re.search(r"""["'`]/[a-z]""", client.get(f"/page/{script}").text)


def test_a_locked_database_stops_only_what_writes(folder, plan, tmp_path):
    store = Store(tmp_path / STORE, plan)
    client = make_app(folder, EXPERIMENT, store).test_client()
    link = ready(client)
    other = sqlite3.connect(store.path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    refused = [answer(client, link, 0), client.post("/begin", json={"agreed": True})]
    assert [(one.status_code, one.headers["Retry-After"]) for one in refused] == [(503, "1")] * 2
    for path in ("/", link, f"{link}/state", f"{link}/0/left.png", "/page/study.js"):
        assert client.get(path).status_code == 200
    other.execute("ROLLBACK")
    other.close()
    time.sleep(SHUT)
    assert answer(client, link, 0).json["state"]["trial"] == 1
    store.close()


def test_what_cannot_be_recorded_is_told_once(folder, plan, tmp_path, caplog):
    store = Store(tmp_path / STORE, plan)
    client = make_app(folder, EXPERIMENT, store).test_client()
    link = ready(client)
    assert answer(client, link, 0).status_code == 200
    store.path.rename(tmp_path / "away")
    for _ in range(20):
        response = answer(client, link, 1)
        assert response.status_code == 503 and str(tmp_path) not in response.text
    (said,) = [record.getMessage() for record in caplog.records if record.name == "torchbrdf.study.server"]
    assert said.startswith(f"{store.path}: removed or replaced while in use, so nothing is recorded")
    (tmp_path / "away").rename(store.path)
    assert answer(client, link, 1).json["state"]["trial"] == 2
    assert len(store.answers()) == 2
    store.close()


def test_a_flood_fills_nothing(folder, plan, tmp_path):
    store = Store(tmp_path / STORE, plan)
    app = make_app(folder, EXPERIMENT, store, observers=9, begins=Begins((5, 1), (20, 1)))
    client = app.test_client()

    def begun(where):
        return client.post("/begin", json={"agreed": True}, environ_overrides={"REMOTE_ADDR": where})

    flood = [begun("192.0.2.1") for _ in range(50)]
    assert [one.status_code for one in flood] == [201] * 5 + [429] * 45
    assert 55 <= int(flood[-1].headers["Retry-After"]) <= 60 and "try again" in flood[-1].json["error"]
    assert [begun(f"192.0.2.{k}").status_code for k in range(2, 8)] == [201] * 4 + [403] * 2
    assert len(store.profiles()) == 9
    store.close()


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "TRACE", "PROPFIND", "FROB"])
def test_unknown_methods(client, store, method):
    link = ready(client)
    before = len(store.answers()), len(store.profiles())
    for path in ("/", "/begin", link, f"{link}/state", f"{link}/answer", f"{link}/0/left.png", "/page/study.js"):
        assert client.open(path, method=method, json=GOOD).status_code == 405
    for path in ("/", link, f"{link}/state", f"{link}/0/left.png"):
        assert client.post(path, json=GOOD).status_code == 405
    for path in ("/begin", f"{link}/answer", f"{link}/profile", f"{link}/screen"):
        assert client.get(path).status_code == 405
    assert (len(store.answers()), len(store.profiles())) == before
