"""What a server is told before anybody comes: pictures, screening, words."""

from dataclasses import replace

import pytest
from helpers.study_folder import EXPERIMENT, begin, make_study

from torchbrdf.errors import DataError, UsageError
from torchbrdf.study.server import make_app
from torchbrdf.study.store import STORE, Store


@pytest.mark.parametrize(
    ("screening", "said"),
    [
        ({"color_vision": ("normal",)}, "unknown self-report to screen by 'color_vision'.*'colour_vision'"),
        ({"colour_vision": ("perfect",)}, "unknown answer to colour_vision 'perfect'"),
        ({"display": ("laptop",)}, "unknown self-report to screen by 'display'"),
    ],
)
def test_screening_that_lets_nobody_in(folder, plan, tmp_path, screening, said):
    store = Store(tmp_path / STORE, replace(plan, screening=screening))
    with pytest.raises(UsageError, match=said):
        make_app(folder, EXPERIMENT, store)
    store.close()


def _turned(data, at):
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


DAMAGES = {
    "short": lambda data: data[: len(data) // 2],
    "no end": lambda data: data[:-12],
    "more": lambda data: data + b"x",
    "size": lambda data: _turned(data, 19),
    "pixels": lambda data: _turned(data, data.index(b"IDAT") + 20),
    "kind": lambda data: data.replace(b"IDAT", b"IDAX"),
    "only a head": lambda data: data[:33],
    "only a start": lambda data: data[:8],
    "empty": lambda data: b"",
    "another": lambda data: b"\xff\xd8\xff\xe0" + data,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_pictures_are_told_before_anybody_comes(tmp_path, damage):
    plan = make_study(tmp_path)
    picture = tmp_path / plan.materials[1].stimuli["wren"].picture
    picture.write_bytes(DAMAGES[damage](picture.read_bytes()))
    store = Store(tmp_path / STORE, plan)
    with pytest.raises(DataError, match=rf"{picture.name}: expected a (whole )?PNG, found ") as caught:
        make_app(tmp_path, EXPERIMENT, store)
    assert len(str(caught.value)) <= 300
    store.close()


def test_words_of_a_plan(folder, plan, tmp_path):
    texts = {"title": "A <b>bold</b> title", "consent": "One.\n\nTwo & three.\n \nFour.", "thanks": "Ta."}
    store = Store(tmp_path / STORE, replace(plan, texts=texts))
    client = make_app(folder, EXPERIMENT, store).test_client()
    page = client.get("/").text
    assert page.count("A &lt;b&gt;bold&lt;/b&gt; title") == 2 and "<b>" not in page
    assert "<p>One.</p><p>Two &amp; three.</p><p>Four.</p>" in page
    assert "<p>Ta.</p>" in client.get(begin(client)).text
    store.close()
