"""Name -> thing, found by itself, or offered by another package."""

import importlib
import logging
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from torchbrdf.errors import UsageError
from torchbrdf.fitting import STRATEGIES
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import LOBES
from torchbrdf.losses import LOSSES
from torchbrdf.measured import FORMATS
from torchbrdf.recipe import RECIPES
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


def test_a_name_costs_no_import_and_a_thing_only_its_own(package: str) -> None:
    things = __import__(package).THINGS
    assert things.names() == ["alpha", "beta"] and "alpha" in things and "gamma" not in things
    things.check("beta")
    things.check("gamma", "gamma")
    with pytest.raises(UsageError, match=r"^unknown thing 'alpa'; expected one of alpha, beta; did you mean 'alpha'"):
        things.check("alpa")
    assert not {f"{package}.alpha", f"{package}.beta"} & set(sys.modules)
    assert things["beta"] == "BETA" and f"{package}.alpha" not in sys.modules
    assert things.name_of("BETA") == "beta" and f"{package}.alpha" not in sys.modules
    assert things.name_of("ALPHA") == "alpha"


@pytest.mark.parametrize(
    "line",
    [
        "for name in ('gamma', 'delta'):\n    THINGS.register(name)(name.upper())",
        "THINGS.register(f'{\"gamma\"}')('GAMMA')",
        "THINGS.register(name='gamma')('GAMMA')",
    ],
)
def test_where_sources_do_not_say_everything_is_imported(package: str, tmp_path: Path, line: str) -> None:
    (tmp_path / package / "worked_out.py").write_text(f"from pack_of_things import THINGS\n{line}\n")
    things = __import__(package).THINGS
    assert "gamma" in things and things["gamma"] == "GAMMA" and "alpha" in things.names()


def test_a_name_that_is_registered_now_and_then_is_not_there_otherwise(package: str, tmp_path: Path) -> None:
    text = "from pack_of_things import THINGS\nif False:\n    THINGS.register('gamma')('GAMMA')\n"
    (tmp_path / package / "perhaps.py").write_text(text)
    things = __import__(package).THINGS
    with pytest.raises(UsageError, match=r"^unknown thing 'gamma'; expected one of alpha, beta$"):
        things["gamma"]
    assert list(things) == ["alpha", "beta"]


def test_former_names_are_known_before_their_modules_are_imported(package: str, tmp_path: Path) -> None:
    text = "from pack_of_things import THINGS\nTHINGS.register('gamma')('GAMMA')\nTHINGS.alias('third', 'gamma')\n"
    (tmp_path / package / "gamma.py").write_text(text)
    things = __import__(package).THINGS
    assert things.canonical("third") == "gamma" and "third" in things and "third" not in things.names()
    assert things["third"] == "GAMMA"


def test_a_package_within_the_package_registers_too(package: str, tmp_path: Path) -> None:
    inner = tmp_path / package / "inner"
    inner.mkdir()
    (inner / "__init__.py").write_text("import pack_of_things.inner.gamma\n")
    (inner / "gamma.py").write_text("from pack_of_things import THINGS\nTHINGS.register('gamma')('GAMMA')\n")
    things = __import__(package).THINGS
    assert things.names() == ["alpha", "beta", "gamma"] and things["gamma"] == "GAMMA"


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


def test_an_empty_name_is_no_unknown_one() -> None:
    assert str(unknown("loss", "", ["rms", "log"])) == "loss: expected a name, found ''; expected one of log, rms"


def test_a_name_is_registered_once() -> None:
    things: Registry[int] = Registry("thing", "nowhere")
    things.register("one")(1)
    with pytest.raises(UsageError, match="thing 'one' is registered twice: 1 and 2"):
        things.register("one")(2)


@pytest.mark.parametrize("name", ["", "two words", "../up", "a-b", "1st", "\x1b[31m", "x" * 65, "größe", None, 7])
def test_a_name_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(
        UsageError, match=r"^thing: expected a name of letters, digits and underscores, found "
    ) as caught:
        Registry("thing", "nowhere").register(name)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 200


@pytest.mark.parametrize("registry", [LOBES, LOSSES, DIFFERENCES, FORMATS, STRATEGIES, RECIPES], ids=lambda r: r.kind)
@pytest.mark.parametrize("thing", [3, None, "ward", [1]])
def test_a_thing_of_another_kind_is_refused(registry: Registry, thing: object) -> None:
    with pytest.raises(UsageError, match=rf"^{registry.kind} 'odd': expected a (subclass of|function).*, found "):
        registry.register("odd")(thing)
    assert "odd" not in registry


def test_an_alias_finds_a_thing_but_is_not_listed() -> None:
    things: Registry[int] = Registry("thing", "torchbrdf.assets")
    things.register("one")(1)
    things.alias("uno", "one")
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


def test_a_decorated_class_is_still_itself() -> None:
    assert isinstance(Registry("thing", "nowhere").register("one")(Path), type)


def test_a_former_name_finds_the_thing_and_is_not_listed(package: str) -> None:
    things = __import__(package).THINGS
    things.alias("first", "alpha")
    assert things["first"] == "ALPHA" and "first" in things
    assert list(things) == ["alpha", "beta"]
    with pytest.raises(UsageError, match=r"^unknown thing 'frst'; expected one of alpha, beta$"):
        things["frst"]


def offer(folder: Path, package: str, **entries: str) -> None:
    """What pip leaves of a package that offers things to `pack_of_things`."""
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = [f"{name} = {value}" for name, value in entries.items()]
    (info / "entry_points.txt").write_text("\n".join(["[pack_of_things.things]", *lines]) + "\n")


@pytest.fixture
def offered(package: str, tmp_path: Path) -> Registry[str]:
    """The registry of the package, and others' offers: good, of a taken name, broken, and of one name twice."""
    (tmp_path / "pack_of_things_more.py").write_text(
        "from pack_of_things import THINGS\nGAMMA = 'GAMMA'\nDELTA = THINGS.register('delta')('DELTA')\n"
    )
    (tmp_path / "pack_of_things_bad.py").write_text("raise RuntimeError('nothing\\nworks')\n")
    offer(tmp_path, "apples", gamma="pack_of_things_more:GAMMA", delta="pack_of_things_more:DELTA")
    offer(tmp_path, "berries", alpha="pack_of_things_more:GAMMA", gamma="pack_of_things_more:DELTA")
    offer(tmp_path, "cherries", epsilon="pack_of_things_bad:EPSILON")
    offer(tmp_path, "dates", zeta="pack_of_things_more:NOTHING")
    importlib.invalidate_caches()
    things: Registry[str] = __import__(package).THINGS
    things.group = "pack_of_things.things"
    return things


def test_what_another_package_offers_is_found_by_name(offered: Registry[str]) -> None:
    assert offered["alpha"] == "ALPHA"
    assert "pack_of_things_more" not in sys.modules, "our own names cost no import of others'"
    assert offered["gamma"] == "GAMMA"
    assert "pack_of_things_bad" not in sys.modules, "what nobody asks for is not loaded"
    assert offered["delta"] == "DELTA"  # registered by its module, too
    assert "epsilon" in offered and "omega" not in offered


def test_what_another_package_offers_is_listed_and_the_broken_is_left_out(
    offered: Registry[str], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        assert list(offered) == ["alpha", "beta", "delta", "gamma"]
        assert dict(offered)["gamma"] == "GAMMA" and len(offered) == 4  # and nothing is said again
    assert sorted(caplog.messages) == [
        "torchbrdf: thing 'alpha' of package berries is left out: the name is taken by torchbrdf; "
        "expected another name",
        "torchbrdf: thing 'epsilon' of package cherries cannot be loaded from pack_of_things_bad:EPSILON: "
        "RuntimeError: nothing works",
        "torchbrdf: thing 'gamma' of package berries is left out: the name is taken by apples; expected another name",
        "torchbrdf: thing 'zeta' of package dates cannot be loaded from pack_of_things_more:NOTHING: "
        "AttributeError: module 'pack_of_things_more' has no attribute 'NOTHING'",
    ]


def test_a_thing_that_its_module_registered_before_is_no_clash(
    offered: Registry[str], caplog: pytest.LogCaptureFixture
) -> None:
    importlib.import_module("pack_of_things_more")
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        assert offered["delta"] == "DELTA" and "gamma" in offered
    assert not any("delta" in message for message in caplog.messages)


def test_a_broken_thing_says_why_when_asked_for(offered: Registry[str]) -> None:
    for _ in range(2):
        with pytest.raises(UsageError, match=r"^thing 'epsilon' of package cherries cannot be loaded .*nothing works$"):
            offered["epsilon"]
    with pytest.raises(UsageError, match=r"unknown thing 'gama'; expected one of .*; did you mean 'gamma'\?$"):
        offered["gama"]


def test_a_module_that_ends_python_and_bounds_that_cannot_be_are_said(offered: Registry[str], tmp_path: Path) -> None:
    (tmp_path / "pack_of_things_exit.py").write_text("raise SystemExit(7)\n")
    bounds = "BoundedParameter(start=0.1, lower=0.5, upper=0.2, doc='')"
    (tmp_path / "pack_of_things_bounds.py").write_text(
        f"from torchbrdf.lobes import BoundedParameter, Lobe\n\nclass Odd(Lobe):\n    width = {bounds}\n"
    )
    offer(tmp_path, "figs", eta="pack_of_things_exit:ETA", theta="pack_of_things_bounds:Odd")
    importlib.invalidate_caches()
    with pytest.raises(UsageError, match=r"'eta' of package figs cannot be loaded .* SystemExit: 7"):
        offered["eta"]
    with pytest.raises(UsageError, match=r"'theta' of package figs .* Odd.width: expected lower <= start"):
        offered["theta"]


def test_the_name_of_a_thing_is_found_without_loading_others(offered: Registry[str]) -> None:
    assert offered.name_of(offered["alpha"]) == "alpha" and offered.name_of("NOTHING") is None
    assert "pack_of_things_bad" not in sys.modules and "pack_of_things_more" not in sys.modules
    assert offered.name_of(offered["gamma"]) == "gamma"


def test_what_the_package_brings() -> None:
    assert {"lambert", "ward", "cook_torrance", "ashikhmin_shirley", "distribution_based"} <= set(LOBES)
    assert {"rms", "cosine_rms", "cube_root", "compressed", "log", "solid_angle_cosine_rms"} <= set(LOSSES)


def test_sources_are_not_read_where_all_modules_are_loaded(monkeypatch):
    from torchbrdf import registry

    own = registry.Registry("lobe", "torchbrdf.lobes")
    own._things, own._aliases, own._complete = {"one": print}, {"former": "one"}, True
    monkeypatch.setattr(registry, "registrations", None)
    assert list(own) == ["one"] and own["former"] is print and "two" not in own
