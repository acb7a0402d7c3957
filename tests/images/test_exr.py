"""OpenEXR pictures: windows, channels and colours of the header, followed or refused by name."""

import logging
import random
import struct
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch

from torchbrdf.errors import DataError
from torchbrdf.images import read_image, write_exr

SCANLINES = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
D65 = (0.3127, 0.3290)
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *D65)
REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65)
XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)
# As others print them: ITU-R BT.2087-0 to BT.2020; SMPTE RP 177 to XYZ; OpenColorIO's configuration for ACES from AP0.
TO_REC2020 = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]
TO_XYZ = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
FROM_AP0 = [[2.52169, -1.13413, -0.38756], [-0.27648, 1.37272, -0.09624], [-0.01538, -0.15298, 1.16835]]


def picture(height: int = 12, width: int = 24) -> np.ndarray:
    return np.random.default_rng(0).random((height, width, 3), np.float32) * 4


def planes(pixels: np.ndarray, names: str = "RGB") -> dict[str, np.ndarray]:
    return {name: np.ascontiguousarray(pixels[..., k], np.float32) for k, name in enumerate(names)}


def write(folder: Path, channels: dict[str, np.ndarray], **header: object) -> Path:
    path = folder / "picture.exr"
    OpenEXR.File({**SCANLINES, **header}, channels).write(str(path))
    return path


def attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


def uncompressed(channels: dict[str, tuple[np.ndarray, int]], width: int, height: int, more: bytes = b"") -> bytes:
    """A file by hand: channels with one sample in so many pixels across and down, which the package does not write."""
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<i4x2i", 2, step, step) for name, (_, step) in sorted(channels.items())
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = b"v/1\x01" + struct.pack("<i", 2) + attribute("channels", "chlist", listed + b"\0")
    head += attribute("compression", "compression", b"\0") + attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("dataWindow", "box2i", window) + attribute("displayWindow", "box2i", window)
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1)) + more
    head += attribute("screenWindowCenter", "v2f", bytes(8)) + attribute("screenWindowWidth", "float", bytes(4)) + b"\0"
    offsets, lines = [], b""
    for y in range(height):
        line = b"".join(
            pixels[y // step].astype("<f4").tobytes() for _, (pixels, step) in sorted(channels.items()) if y % step == 0
        )
        offsets.append(len(head) + 8 * height + len(lines))
        lines += struct.pack("<2i", y, len(line)) + line
    return head + struct.pack(f"<{height}Q", *offsets) + lines


# Windows


@pytest.mark.parametrize("corner", [(0, 0), (7, -5)])
def test_the_picture_is_the_display_window(tmp_path: Path, corner: tuple[int, int]) -> None:
    left, top = corner
    pixels = picture()
    display = ((left, top), (left + 23, top + 11))
    black = np.zeros_like(pixels)

    def read(stored: np.ndarray, x: int, y: int) -> np.ndarray:
        height, width = stored.shape[:2]
        window = ((left + x, top + y), (left + x + width - 1, top + y + height - 1))
        return read_image(write(tmp_path, planes(stored), dataWindow=window, displayWindow=display)).numpy()

    np.testing.assert_array_equal(read(pixels, 0, 0), pixels)
    expected = black.copy()
    expected[3:7, 5:15] = pixels[3:7, 5:15]
    np.testing.assert_array_equal(read(pixels[3:7, 5:15], 5, 3), expected)
    overscan = np.pad(pixels, ((2, 3), (4, 1), (0, 0)), constant_values=9)
    np.testing.assert_array_equal(read(overscan, -4, -2), pixels)
    across = black.copy()  # over two edges
    across[8:, 20:] = pixels[:4, :4]
    np.testing.assert_array_equal(read(pixels, 20, 8), across)
    with pytest.raises(DataError, match="display window"):
        read(pixels, 24, 0)


# Colours


def test_chromaticities_are_converted(tmp_path: Path) -> None:
    pixels = picture()
    wide = pixels @ np.array(TO_REC2020, np.float32).T
    found = read_image(write(tmp_path, planes(wide), chromaticities=REC2020)).numpy()
    np.testing.assert_allclose(found, pixels, atol=2e-3)
    found = read_image(write(tmp_path, planes(pixels), chromaticities=REC709)).numpy()
    np.testing.assert_array_equal(found, pixels)


@pytest.mark.parametrize("header", [{"chromaticities": XYZ}, {}])
def test_tristimulus_values_are_converted(tmp_path: Path, header: dict[str, object]) -> None:
    """In channels R, G and B that say so, and in X, Y and Z."""
    pixels = picture()
    stored = pixels @ np.array(TO_XYZ, np.float32).T
    found = read_image(write(tmp_path, planes(stored, "RGB" if header else "XYZ"), **header)).numpy()
    np.testing.assert_allclose(found, pixels, atol=1e-3)


@pytest.mark.parametrize(
    "header",
    [
        {"chromaticities": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)},
        {"colorInteropID": "lin_ap0_scene"},
        {"acesImageContainerFlag": 1},
    ],
)
def test_another_white_is_adapted(tmp_path: Path, header: dict[str, object]) -> None:
    pixels = picture()
    found = read_image(write(tmp_path, planes(pixels), **header)).numpy()
    np.testing.assert_allclose(found, pixels @ np.array(FROM_AP0).T, atol=0.02)
    grey = np.full_like(pixels, 0.5)
    np.testing.assert_allclose(read_image(write(tmp_path, planes(grey), **header)).numpy(), grey, rtol=1e-4)


def test_an_adopted_neutral_becomes_white(tmp_path: Path) -> None:
    tungsten = (0.44757, 0.40745)
    lamp = np.linalg.solve(TO_XYZ, [tungsten[0] / tungsten[1], 1, (1 - sum(tungsten)) / tungsten[1]])
    path = write(tmp_path, planes(np.tile(lamp, (4, 8, 1))), adoptedNeutral=tungsten)
    np.testing.assert_allclose(read_image(path).numpy(), 1, rtol=2e-3)


@pytest.mark.parametrize("step", [1, 2])
def test_luminance_and_chroma_become_colours(tmp_path: Path, step: int) -> None:
    pixels = np.tile(np.float32([0.8, 0.3, 0.1]), (12, 24, 1))
    pixels[:, 12:] = 0.5, 0.6, 0.9  # the chroma is smooth nowhere near the middle
    light = pixels @ np.float32([0.2126, 0.7152, 0.0722])
    red, blue = ((pixels[..., k] - light) / light for k in (0, 2))
    channels = {"Y": (light, 1), "RY": (red[::step, ::step], step), "BY": (blue[::step, ::step], step)}
    (tmp_path / "yc.exr").write_bytes(uncompressed(channels, 24, 12))
    found = read_image(tmp_path / "yc.exr").numpy()
    apart = slice(None) if step == 1 else [0, 1, 22, 23]
    np.testing.assert_allclose(found[:, apart], pixels[:, apart], atol=1e-3 if step == 1 else 0.03)
    # luminance has every pixel's own sample, whatever the chroma is between two
    np.testing.assert_allclose(found @ [0.2126, 0.7152, 0.0722], light, rtol=1e-3)


def test_smooth_chroma_is_interpolated(tmp_path: Path) -> None:
    across, down = np.meshgrid(np.arange(96), np.arange(64))
    pixels = np.stack([2 + np.sin(across / 9), 2 + np.cos(down / 11), 2 + np.sin((across + down) / 13)], -1)
    light = pixels @ [0.2126, 0.7152, 0.0722]
    channels = {"Y": (light, 1)}
    for name, k in (("RY", 0), ("BY", 2)):
        channels[name] = (((pixels[..., k] - light) / light)[::2, ::2], 2)
    (tmp_path / "yc.exr").write_bytes(uncompressed(channels, 96, 64))
    inside = (slice(14, -14), slice(14, -14))  # the filter's reach
    np.testing.assert_allclose(read_image(tmp_path / "yc.exr").numpy()[inside], pixels[inside], atol=2e-3)


def test_channels_beside_the_colours_change_nothing(tmp_path: Path) -> None:
    pixels = picture()
    more = {name: np.full((12, 24), 7.0, np.float32) for name in ("A", "Z", "diffuse.R")}
    found = read_image(write(tmp_path, {**planes(pixels), **more}))
    np.testing.assert_array_equal(found.numpy(), pixels)
    half = {"R": planes(pixels)["R"], "G": planes(pixels)["G"].astype(np.float16), "B": planes(pixels)["B"]}
    np.testing.assert_allclose(read_image(write(tmp_path, half)).numpy(), pixels, rtol=1e-3)
    grey = read_image(write(tmp_path, {"Y": half["R"]}, chromaticities=REC2020))
    np.testing.assert_array_equal(grey.numpy(), np.repeat(pixels[..., :1], 3, -1))


@pytest.mark.parametrize("kind", [OpenEXR.scanlineimage, OpenEXR.tiledimage])
@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "PIZ", "PXR24"])
def test_storage_changes_nothing(tmp_path: Path, kind: object, compression: str) -> None:
    pixels = picture(40, 80).astype(np.float16).astype(np.float32)
    header = {"type": kind, "compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    if kind == OpenEXR.tiledimage:
        header["tiles"] = OpenEXR.TileDescription()
    found = read_image(write(tmp_path, planes(pixels), **header)).numpy()
    np.testing.assert_array_equal(found, pixels)


def test_colours_that_are_not_finite_stay_what_they_are(tmp_path: Path) -> None:
    pixels = picture()
    pixels[2, 3], pixels[4, 5, 1] = np.inf, np.nan
    found = read_image(write(tmp_path, planes(pixels), chromaticities=REC2020)).numpy()
    assert np.isposinf(found[2, 3]).all()
    assert (np.isnan(found).sum(), np.isinf(found).sum()) == (1, 3)


# What is refused, or said


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        ({"pixelAspectRatio": 2.0}, "pixelAspectRatio 2"),
        ({"envmap": OpenEXR.ENVMAP_CUBE}, "envmap"),
        ({"multiView": ["left", "right"]}, "left.*right"),
        ({"colorInteropID": "srgb_rec709_scene"}, "srgb_rec709_scene"),
        ({"colorInteropID": "lin_ap1_scene", "chromaticities": REC2020}, "colorInteropID"),
        ({"chromaticities": (0.3, 0.3, 0.3, 0.3, 0.3, 0.3, *D65)}, "primaries"),
        ({"chromaticities": (*REC709[:6], 0.3, 0.0)}, "white"),
        ({"chromaticities": (*REC709[:6], float("nan"), 0.3)}, "white"),
        ({"adoptedNeutral": (0.0, 0.0)}, "white"),
    ],
)
def test_what_would_be_passed_over_is_refused_by_name(tmp_path: Path, header: dict[str, object], reason: str) -> None:
    with pytest.raises(DataError, match=reason) as caught:
        read_image(write(tmp_path, planes(picture()), **header))
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize(
    ("channels", "reason"),
    [
        ("Z", "'Z'"),
        (("diffuse.R", "diffuse.G", "diffuse.B"), "diffuse"),
        ("RG", "'G', 'R'"),
        (("Y", "RY"), "'RY', 'Y'"),
    ],
)
def test_pictures_without_colours_are_refused(tmp_path: Path, channels: tuple[str, ...], reason: str) -> None:
    with pytest.raises(DataError, match=f"expected channels.*{reason}"):
        read_image(write(tmp_path, {name: np.ones((3, 4), np.float32) for name in channels}))


def test_whole_numbers_parts_and_samples_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="whole numbers"):
        read_image(write(tmp_path, {name: np.ones((3, 4), np.uint32) for name in "RGB"}))
    parts = [OpenEXR.Part({**SCANLINES, "name": name}, planes(picture()), name) for name in ("left", "right")]
    OpenEXR.File(parts).write(str(tmp_path / "parts.exr"))
    with pytest.raises(DataError, match=r"2 parts: .'left', 'right'"):
        read_image(tmp_path / "parts.exr")
    channels = {"R": (np.ones((6, 12)), 2), "G": (np.ones((12, 24)), 1), "B": (np.ones((12, 24)), 1)}
    (tmp_path / "coarse.exr").write_bytes(uncompressed(channels, 24, 12))
    with pytest.raises(DataError, match="R in every pixel"):
        read_image(tmp_path / "coarse.exr")


def test_deep_pictures_are_refused(tmp_path: Path) -> None:
    data = bytearray(uncompressed({name: (np.ones((4, 8)), 1) for name in "RGB"}, 8, 4))
    data[5] |= 0x8
    (tmp_path / "deep.exr").write_bytes(data)
    with pytest.raises(DataError, match="expected one value"):
        read_image(tmp_path / "deep.exr")


def test_white_luminance_is_spoken_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        found = read_image(write(tmp_path, planes(picture()), whiteLuminance=100.0))
    np.testing.assert_array_equal(found.numpy(), picture())
    assert "whiteLuminance, 100 cd/m2" in caplog.text


# Damage


@pytest.mark.parametrize("length", [4, 8, 40, 200, 400])
def test_truncated_files_are_refused(tmp_path: Path, length: int, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "picture.exr"
    write_exr(path, torch.rand(32, 32, 3))
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(DataError, match=r"expected an? .*OpenEXR picture"):
        read_image(path)
    assert capsys.readouterr().out == ""  # where the library prints what it does not raise


@pytest.mark.parametrize(
    "window",
    [
        (0, 0, 2**31 - 1, 2**31 - 1),
        (-(2**31), -(2**31), 2**31 - 1, 2**31 - 1),
        (0, 0, 2**31 - 1, 0),
        (0, 0, 20_000, 20_000),
        (5, 5, 4, 4),
    ],
)
@pytest.mark.parametrize("name", [b"dataWindow", b"displayWindow"])
def test_sizes_are_looked_at_before_the_library_believes_them(
    tmp_path: Path, name: bytes, window: tuple[int, int, int, int]
) -> None:
    path = tmp_path / "picture.exr"
    write_exr(path, torch.rand(32, 32, 3))
    head = name + b"\0box2i\0" + struct.pack("<i", 16)
    old = head + struct.pack("<4i", 0, 0, 31, 31)
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, head + struct.pack("<4i", *window)))
    start = time.monotonic()
    with pytest.raises(DataError, match=r"sides|unpacked"):
        read_image(path)
    assert time.monotonic() - start < 1


def test_the_limit_of_what_is_unpacked_can_be_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "picture.exr"
    write_exr(path, torch.zeros(300, 300, 3))  # 1,080,000 bytes
    assert path.stat().st_size < 10_000
    monkeypatch.setenv("TORCHBRDF_MAX_BYTES", "1000000")
    with pytest.raises(DataError, match="at most 1000000 bytes unpacked"):
        read_image(path)
    monkeypatch.setenv("TORCHBRDF_MAX_BYTES", "10000000")
    assert read_image(path).shape == (300, 300, 3)


def test_tiles_far_larger_than_their_picture_are_refused(tmp_path: Path) -> None:
    """The library fills all of a tile."""
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    path = write(tmp_path, planes(picture()), **header)
    old = b"tiledesc\0" + struct.pack("<3i", 9, 32, 32)
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, b"tiledesc\0" + struct.pack("<3i", 9, 32, 2**24)))
    with pytest.raises(DataError, match="tiles"):
        read_image(path)


def test_changed_files_are_read_or_refused_at_once(tmp_path: Path) -> None:
    more = attribute("chromaticities", "chromaticities", struct.pack("<8f", *REC2020))
    channels = {"Y": (np.ones((8, 16)), 1), "RY": (np.zeros((4, 8)), 2), "BY": (np.zeros((4, 8)), 2)}
    valid = [uncompressed(channels, 16, 8, more)]
    tiles = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    headers = ({}, tiles, {"compression": OpenEXR.PIZ_COMPRESSION, "dataWindow": ((3, 3), (26, 14))})
    valid += [write(tmp_path, planes(picture()), **header).read_bytes() for header in headers]
    path = tmp_path / "fuzzed.exr"
    refused = 0
    for seed in range(600):
        chance = random.Random(seed)
        data = bytearray(chance.choice(valid))
        for _ in range(chance.choice((1, 1, 3))):
            place = chance.randrange(4, len(data) if seed % 3 else 400)
            if seed % 2:
                data[place] = chance.randrange(256)
            else:
                data[place : place + 4] = struct.pack(
                    "<i", chance.choice((0, 1, -1, 2**31 - 1, -(2**31), 2**16, 2**24))
                )
        path.write_bytes(data[: chance.randrange(4, len(data))] if seed % 5 == 0 else data)
        start = time.monotonic()
        try:
            assert read_image(path).dtype == torch.float32
        except DataError as error:
            refused += 1
            assert str(path) in str(error)
        assert time.monotonic() - start < 5
    assert 100 < refused < 590  # both happened
