"""Who may ask a server, by names, pages and how often."""

import socket

import pytest

from torchbrdf.errors import UsageError
from torchbrdf.study import guard
from torchbrdf.study.guard import Allowance, Begins, Site


@pytest.mark.parametrize(
    ("url", "origin", "prefix"),
    [
        ("https://study.example", "https://study.example", ""),
        ("https://study.example/", "https://study.example", ""),
        ("HTTPS://Study.Example:443/fits/", "https://study.example", "/fits"),
        ("http://study.example:80", "http://study.example", ""),
        ("https://study.example:8443/a/b-1", "https://study.example:8443", "/a/b-1"),
        ("http://[2001:DB8::1]:81/x", "http://[2001:db8::1]:81", "/x"),
        ("https://bücher.example/fits", "https://xn--bcher-kva.example", "/fits"),
    ],
)
def test_a_url_is_an_origin_and_a_prefix(url, origin, prefix):
    site = Site.of("127.0.0.1", url)
    assert (site.origin, site.prefix) == (origin, prefix)
    assert site.knows(origin.partition("://")[2])
    assert site.sent("127.0.0.1:8000", origin, None)


@pytest.mark.parametrize(
    "url",
    ["", "study.example", "ftp://study.example", "https://", "https://study.example?x", "https://study.example/#x"]
    + ["https://me:secret@study.example", "https://study.example:port", "https://[::1", "https://a..b"]
    + [f"https://study.example{path}" for path in ("/a//b", "/a/../b", "/o", "/page/x", "/begin", "/a b", "/ä")]
    + [f"https://{'a' * 400}.example"],
)
def test_what_is_no_url_gets_one_line(url):
    with pytest.raises(UsageError, match=r"^--url: expected (such as https://|a path of letters)") as caught:
        Site.of("127.0.0.1", url)
    assert len(str(caught.value)) <= 300 and caught.value.args[0].isprintable()


OWN = socket.gethostname().lower()
LOCAL = ["localhost", "LOCALHOST:9000", "127.0.0.1", "127.0.0.1:1", "[::1]:8000", "192.0.2.7:8000", "[2001:db8::1]"]
EVIL = ["evil.example", "evil.example:8000", "localhost.evil.example", "127.0.0.1.evil.example", "", ":8000"]
EVIL += ["localhost@evil.example", "evil.example#localhost", "localhost/x", "a b", "[::1", "localhost:x", "1.2.3"]


@pytest.mark.parametrize(
    ("site", "known"),
    [
        (Site(), LOCAL),
        (Site.of("127.0.0.1"), LOCAL),
        (Site.of("lab.example"), [*LOCAL, "lab.example", "Lab.Example:8000", "lab.example.:8000"]),
        (Site.of("0.0.0.0"), [*LOCAL, OWN, f"{OWN}:8000", f"{OWN}.local"]),
        (Site.of("127.0.0.1", "https://study.example/fits"), [*LOCAL, "study.example", "study.example:443"]),
    ],
)
def test_names_of_a_server(site, known):
    for host in known:
        assert site.knows(host), host
    for host in {*EVIL, "lab.example", "study.example", OWN} - {host.partition(":")[0] for host in known}:
        assert not site.knows(host), host


HERE, THERE = "http://127.0.0.1:8000", "https://study.example"


@pytest.mark.parametrize(
    ("origin", "fetched", "sent"),
    [
        (None, None, True),  # no browser
        (HERE, None, True),
        (THERE, None, True),
        (HERE, "same-origin", True),
        (THERE, "same-origin", True),
        (None, "none", True),
        (HERE, "cross-site", False),
        (THERE, "same-site", False),
        (None, "cross-site", False),
        (THERE, "", False),
        ("null", None, False),
        ("null", "same-origin", True),  # as the browser itself says
        ("null", "cross-site", False),
        ("null", "none", False),
        ("http://study.example", None, False),
        (f"{THERE}:8443", None, False),
        (f"{THERE}.evil.example", None, False),
        ("https://evil.example", "same-origin", False),
        ("", None, False),
    ],
)
def test_what_a_page_sends(origin, fetched, sent):
    site = Site.of("127.0.0.1", f"{THERE}/fits")
    assert site.sent("127.0.0.1:8000", origin, fetched) is sent
    if origin == THERE:
        assert not Site().sent("127.0.0.1:8000", origin, fetched)  # which was not told


@pytest.fixture
def clock(monkeypatch):
    """The time, to be set."""
    now = [1000.0]
    monkeypatch.setattr(guard.time, "monotonic", lambda: now[0])
    return now


def test_so_many_at_once_and_then_so_many_a_minute(clock):
    allowance = Allowance(3, 6)
    assert [allowance.take("a") for _ in range(4)] == [0, 0, 0, 10]
    assert allowance.take("b") == 0
    clock[0] += 9
    assert allowance.take("a") == pytest.approx(1)
    clock[0] += 1
    assert [allowance.take("a") for _ in range(2)] == [0, 10]
    clock[0] += 3600  # no more than so many at once, however long nobody came
    assert [allowance.take("a") for _ in range(4)] == [0, 0, 0, 10]


def test_who_came_long_ago_is_forgotten(clock, monkeypatch):
    monkeypatch.setattr(guard, "KEYS", 50)
    allowance = Allowance(1, 60)
    for k in range(500):
        clock[0] += 0.1
        assert allowance.take(f"{k}") == 0
        assert len(allowance._until) <= 50
    assert allowance.take("499") > 0


def test_one_address_leaves_room_for_others(clock):
    begins = Begins((5, 1), (20, 1))
    taken = [begins.wait("flood") for _ in range(100)]
    assert taken.count(0) == 5 and min(taken[5:]) > 0
    assert [begins.wait(f"{k}") for k in range(16)][:15] == [0] * 15
    assert begins.wait("another") > 0  # as many as may
    assert [Begins(None, (20, 1)).wait("proxy") for _ in range(20)] == [0] * 20
