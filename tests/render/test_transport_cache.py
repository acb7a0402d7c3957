"""Transports kept on disk: taken from there when the same, made anew when damaged or of other things."""

import logging
import os
from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.painted import MATERIALS
from torch import Tensor

from torchbrdf.reading import read_npz, write_npz
from torchbrdf.render import Camera, DirectionalLight, Environment, PointLight, Scene, blob, sphere
from torchbrdf.render import scene as scenes
from torchbrdf.render.transport import cache as cached

LIGHTS = (DirectionalLight((1, 2, 2), 1.5), PointLight((0, 3, 3), (9.0, 8.0, 7.0)))


def make(size: int = 24, **settings: object) -> Scene:
    return Scene(blob(), Camera(15.0), Environment.default(), size=size, **settings)  # type: ignore[arg-type]


def on(scene: Scene, dtype: torch.dtype = torch.float32) -> Tensor:
    with torch.no_grad():
        pairs = scene.pairs.to(dtype=dtype)
        return torch.cat([material.to(dtype=dtype)(pairs) for material in MATERIALS.values()])


def test_a_transport_is_taken_from_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = make(12, cache=tmp_path)
    expected = first.transport @ on(first)
    monkeypatch.setattr(scenes, "CompactScene", None)  # nothing is made
    again = make(12, cache=tmp_path)
    assert torch.equal(again.transport @ on(again), expected)
    assert len([*tmp_path.iterdir()]) == 1


def test_what_is_made_of_other_things_is_another(tmp_path: Path) -> None:
    """Each of these beside the plain one, and beside each other."""
    plain = {"mesh": blob(), "camera": Camera(15.0), "environment": Environment.default(), "size": 12}
    plain |= {"nodes": 32, "light_samples": 64}
    others = [
        {}, {"light_samples": 512}, {"nodes": 64}, {"resolution": (30, 30, 30)}, {"punctual_lights": LIGHTS},
        {"size": 13}, {"camera": Camera(16.0)}, {"environment": Environment.default(5.0)}, {"mesh": sphere(3)},
    ]  # fmt: skip
    for count, other in enumerate([*others, {}], start=1):
        assert Scene(**{**plain, **other}, cache=tmp_path).transport.in_memory  # type: ignore[arg-type]
        assert len(list(tmp_path.iterdir())) == min(count, len(others)), other


@pytest.mark.parametrize("damage", ["cut", "empty", "bits", "other"])
def test_a_damaged_file_is_made_anew_with_a_word(tmp_path: Path, damage: str, caplog: pytest.LogCaptureFixture) -> None:
    def picture() -> Tensor:
        scene = make(8, nodes=16, light_samples=64, cache=tmp_path)
        return scene.transport @ on(scene)

    expected = picture()
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    if damage == "other":
        np.savez(path, nothing=np.zeros(3))
    else:
        middle = len(whole) // 2
        flipped = whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :]
        path.write_bytes({"cut": whole[:middle], "empty": b"", "bits": flipped}[damage])
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        assert torch.equal(picture(), expected)
    assert "made anew" in caplog.text
    caplog.clear()
    assert torch.equal(picture(), expected)
    assert not caplog.text


def test_a_folder_that_cannot_be_written_is_passed_over(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").touch()
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        assert make(8, cache=tmp_path / "file" / "folder").transport.in_memory
    assert "not kept" in caplog.text


def test_old_files_make_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cached, "_ROOM", 1)
    for lights in (64, 128):
        assert make(8, light_samples=lights, cache=tmp_path).transport.in_memory
    assert len([*tmp_path.iterdir()]) == 1


def test_the_folder_of_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHBRDF_CACHE", "there")
    assert cached.cache_folder() == Path("there")
    monkeypatch.delenv("TORCHBRDF_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "caches")
    assert cached.cache_folder() == Path("caches/torchbrdf")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", lambda: Path("/home/ann"))
    assert cached.cache_folder() == Path("/home/ann/.cache/torchbrdf")


def test_without_a_home_transports_are_not_kept(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """As in a container whose user is in no password file."""

    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("TORCHBRDF_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    scene = make(8, cache=cached.cache_folder())
    assert scene.cache is None and scene.transport.in_memory
    assert [message for message in caplog.messages if "no home folder" in message] == caplog.messages
    assert len(caplog.messages) == 1


Arrays = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def tiny() -> tuple[int, cached.Made]:
    """A transport as the cache keeps it, and how many rows it has."""
    scene = make(6, nodes=8, light_samples=16)
    return len(scene.transport.index), (scene.pairs, list(scene.transport.blocks))


def kept(folder: Path, tiny: tuple[int, cached.Made]) -> cached.Made:
    """What the cache gives, which has it or makes it anew."""
    rows, made = tiny
    return cached.load_or_build(folder, ["of something"], rows, len(made[1]), lambda: made)


def same(one: cached.Made, other: cached.Made) -> bool:
    tensors = [
        [*dict(pairs.items()).values(), *(part for block in blocks for part in astuple(block))]
        for pairs, blocks in (one, other)
    ]
    return all(torch.equal(a, b) for a, b in zip(*tensors, strict=True))


def _with(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {**arrays, name: change(arrays[name].copy())}


def _set(place: object, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(array: np.ndarray) -> np.ndarray:
        array[place] = value
        return array

    return change


@pytest.mark.parametrize(
    "change",
    [
        _with("0.start", _set(0, 1)),
        _with("0.start", _set(5, -1)),
        _with("1.start", _set(-1, 2**31 - 1)),
        _with("0.start", lambda start: start[:-1]),
        _with("0.start", lambda start: start.astype(np.int64)),
        _with("0.column", _set(3, 2**30)),
        _with("0.column", _set(3, -1)),
        _with("0.column", lambda column: column[1:]),
        _with("0.value", _set((1, 3), np.nan)),
        _with("0.value", _set((1, 3), np.inf)),
        _with("0.value", lambda value: value.T),
        _with("0.value", lambda value: value.astype(np.float64)),
        _with("0.rows", lambda rows: rows[::-1]),
        _with("0.rows", lambda rows: rows[:-1]),
        _with("1.rows", lambda rows: rows.astype("U9")),
        _with("pairs.cos_i", lambda value: value[:, :-1]),
        _with("pairs.cos_i", lambda value: value[0]),
        _with("pairs.tan2_h", _set((0, 0), np.nan)),
        _with("pairs.tan2_h", lambda value: value.astype(np.float64)),
        lambda arrays: {name: value for name, value in arrays.items() if name != "pairs.cos_i"},
        lambda arrays: {name: value for name, value in arrays.items() if not name.startswith("1.")},
    ],
)
def test_a_file_with_the_right_sum_and_wrong_arrays_is_made_anew(
    tmp_path: Path, change: Callable[[Arrays], Arrays], tiny: tuple[int, cached.Made], caplog: pytest.LogCaptureFixture
) -> None:
    kept(tmp_path, tiny)
    (path,) = tmp_path.iterdir()
    assert same(kept(tmp_path, tiny), tiny[1]) and not caplog.messages
    write_npz(path, change(read_npz(path, "a transport")))
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        assert kept(tmp_path, tiny) is tiny[1]
    (message,) = caplog.messages
    assert message.startswith(f"torchbrdf: {path}: expected") and message.endswith("; made anew")


def test_what_is_no_file_is_made_anew(
    tmp_path: Path, tiny: tuple[int, cached.Made], caplog: pytest.LogCaptureFixture
) -> None:
    """Nobody writes into a FIFO, and a link to nowhere holds nothing."""
    kept(tmp_path, tiny)
    (path,) = tmp_path.iterdir()
    for replace in (os.mkfifo, lambda path: path.symlink_to("nowhere")):
        path.unlink()
        replace(path)
        with caplog.at_level(logging.WARNING, "torchbrdf"):
            assert kept(tmp_path, tiny) is tiny[1]
        assert path.is_file() and not path.is_symlink() and "made anew" in caplog.messages[-1]


def test_bytes_changed_anywhere_never_change_a_transport(
    tmp_path: Path, tiny: tuple[int, cached.Made], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    kept(tmp_path, tiny)
    (path,) = tmp_path.iterdir()
    whole, generator = path.read_bytes(), np.random.default_rng(0)
    for _ in range(100):
        data = bytearray(whole)
        at = generator.integers(len(data), size=generator.integers(1, 4))
        at[0] = at[0] % 3000 if generator.random() < 0.5 else -1 - at[0] % 3000  # heads of the archive more often
        for place in at:
            data[place] = generator.integers(256)
        path.write_bytes(bytes(data))
        assert same(kept(tmp_path, tiny), tiny[1])
