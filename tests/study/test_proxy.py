"""A study behind a proxy that changes Host, puts a prefix before the paths, and takes it off again or not."""

import re
from urllib.parse import urljoin

import pytest
from helpers.prefix_proxy import proxy
from helpers.study_folder import REPORTS, SCREEN, Client, make_study, serving, stop_server

from torchbrdf.study.store import STORE

URL = "https://study.example/fits"


@pytest.mark.parametrize("strips", [True, False])
def test_a_whole_session_behind_a_proxy(tmp_path, strips):
    make_study(tmp_path)
    with serving(tmp_path, url=URL) as (process, port), proxy(port, "/fits", strips) as front:
        client = Client(front)
        client.headers = {"Origin": "https://study.example", "Sec-Fetch-Site": "same-origin"}
        status, page = client.ask("/fits/")
        assert status == 200
        for name in re.findall(r'(?:href|src)="([^"]*)"', page.decode()):
            assert client.ask(urljoin("/fits/", name))[0] == 200
        status, begun = client.tell("/fits/begin", {"agreed": True})
        assert status == 201
        own = urljoin("/fits/", f".{begun['link']}")  # as the page does
        status, page = client.ask(own)
        assert status == 200
        for name in re.findall(r'(?:href|src)="([^"]*)"', page.decode()):
            assert client.ask(urljoin(own, name))[0] == 200
        assert client.tell(f"{own}/profile", REPORTS)[0] == client.tell(f"{own}/screen", SCREEN)[0] == 200
        for trial in range(18):
            assert client.ask(f"{own}/{trial}/left.png")[0] == 200
            said = client.tell(f"{own}/answer", {"trial": trial, "side": "left", "response_time": 1.0})
            assert said[0] == 200
        assert said[1]["state"]["stage"] == "done"
        client.headers = {"Origin": "https://evil.example"}
        assert client.tell("/fits/begin", {"agreed": True})[0] == 403
        client.close()
        assert stop_server(process) == f"stopped: 1 observers, 18 answers in {tmp_path / STORE}\n"


def test_without_its_slash_and_at_its_own_address(tmp_path):
    make_study(tmp_path)
    with serving(tmp_path, url=URL) as (_, port):
        client = Client(port)
        status, where = client.location("/fits")
        assert (status, where) == (308, "/fits/")
        client.headers = {"Origin": f"http://127.0.0.1:{port}"}  # who serves it tries it there
        link = client.ready()
        assert link.startswith("/o/") and client.ask(link)[0] == client.ask(f"/fits{link}")[0] == 200
        client.headers = {"Host": "evil.example", "Origin": "http://evil.example"}
        assert client.ask("/")[0] == 400 and client.ask("/begin", {"agreed": True})[0] == 400
        client.close()


def test_who_is_not_told_of_the_proxy_says_what_to_do(tmp_path, capfd):
    make_study(tmp_path)
    with serving(tmp_path) as (_, port), proxy(port, "/fits") as front:
        client = Client(front)
        client.headers = {"Origin": "https://study.example"}
        for _ in range(3):
            assert client.tell("/fits/begin", {"agreed": True})[0] == 403
        client.close()
    said = capfd.readouterr().err
    assert said.count("'https://study.example'") == said.count("--url") == 1
