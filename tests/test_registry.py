"""Name -> thing, found by itself."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from torchbrdf.errors import UsageError
from torchbrdf.lobes import LOBES
from torchbrdf.losses import LOSSES
from torchbrdf.registry import Registry, unknown


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A package with a registry and a module that its __init__ does not import."""
    folder = tmp_path / "pack_of_things"
    folder.mkdir()
    start = "from torchbrdf.registry import Registry\nTHINGS = Registry('thing', 'pack_of_things')\n"
    (folder / "__init__.py").write_text(start)
    for name in ("beta", "alpha"):
        text = f"from pack_of_things import THINGS\nTHINGS.register('{name}')({name!r}.upper())\n"
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    yield "pack_of_things"
    for name in [name for name in sys.modules if name.startswith("pack_of_things")]:
        del sys.modules[name]


def test_a_file_in_the_folder_is_found(package: str) -> None:
    things = __import__(package).THINGS
    assert list(things) == ["alpha", "beta"]
    assert (len(things), things["beta"], dict(things)) == (2, "BETA", {"alpha": "ALPHA", "beta": "BETA"})


def test_membership_does_not_raise(package: str) -> None:
    things = __import__(package).THINGS
    assert "alpha" in things
    assert "gamma" not in things
    assert 3 not in things


def test_an_unknown_name_is_refused_with_the_nearest(package: str) -> None:
    with pytest.raises(
        UsageError, match=r"^unknown thing 'alpa'; expected one of alpha, beta; did you mean 'alpha'\?$"
    ):
        __import__(package).THINGS["alpa"]


def test_no_hint_where_nothing_is_near() -> None:
    assert str(unknown("loss", "xyzzy", ["rms", "log"])) == "unknown loss 'xyzzy'; expected one of log, rms"


def test_a_name_is_registered_once() -> None:
    things: Registry[int] = Registry("thing", "nowhere")
    things.register("one")(1)
    with pytest.raises(UsageError, match="thing 'one' is registered twice: 1 and 2"):
        things.register("one")(2)


def test_an_alias_finds_a_thing_but_is_not_listed() -> None:
    things: Registry[int] = Registry("thing", "torchbrdf.assets", {"uno": "one"})
    things.register("one")(1)
    assert things["uno"] == 1 and "uno" in things and list(things) == ["one"]
    assert (things.canonical("uno"), things.canonical("one"), things.canonical("two")) == ("one", "one", "two")


def test_losses_are_found_by_the_names_that_they_had() -> None:
    for old, new in (
        ("cosine", "cosine_rms"),
        ("cuberoot", "cube_root"),
        ("solid_angle_cosine", "solid_angle_cosine_rms"),
    ):
        assert LOSSES[old] is LOSSES[new] and old not in list(LOSSES)


def test_a_thing_is_returned_as_it_was() -> None:
    thing = object()
    assert Registry("thing", "nowhere").register("one")(thing) is thing


def test_what_the_package_brings() -> None:
    assert {"lambert", "ward", "cook_torrance", "ashikhmin_shirley", "distribution_based"} <= set(LOBES)
    assert {"rms", "cosine_rms", "cube_root", "compressed", "log", "solid_angle_cosine_rms"} <= set(LOSSES)
