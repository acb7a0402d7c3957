"""Radiance pictures: every form that the format has, made here byte by byte, gives what its bytes stand for."""

import contextlib
import logging
import math
import random
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from torchbrdf.errors import DataError
from torchbrdf.images import read_image

FORMAT = "FORMAT=32-bit_rle_rgbe\n"
# SMPTE RP 177 for the primaries of BT.709 and D65.
XYZ_TO_REC709 = [
    [3.2404542, -1.5371385, -0.4985314],
    [-0.969266, 1.8760108, 0.041556],
    [0.0556434, -0.2040259, 1.0572252],
]


def rgbe(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Pixels as bytes `(H, W, 4)`, with runs in them, some black."""
    generator = np.random.default_rng(seed)
    pixels = generator.integers(2, 256, (height, width, 4), np.uint8)
    pixels[..., 3] = generator.integers(120, 136, (height, width))
    pixels[:, width // 3 : width // 2] = pixels[:, width // 3, None]
    pixels[0, :2] = 0
    return pixels


def decoded(pixels: np.ndarray) -> np.ndarray:
    """What RGBE stands for, one pixel at a time."""
    values = np.zeros((*pixels.shape[:2], 3))
    for place in np.ndindex(*pixels.shape[:2]):
        *mantissas, exponent = (int(x) for x in pixels[place])
        values[place] = [math.ldexp(m, exponent - 136) if exponent else 0.0 for m in mantissas]
    return values.astype(np.float32)


def flat(line: np.ndarray) -> bytes:
    return line.tobytes()


def repeated(line: np.ndarray) -> bytes:
    """The oldest encoding: 1, 1, 1, n repeats the pixel before n times."""
    data, place = b"", 0
    while place < len(line):
        run = 1
        while place + run < len(line) and (line[place + run] == line[place]).all():
            run += 1
        data += line[place].tobytes()
        if run > 1:
            digits = [(run - 1) >> 8 * k & 255 for k in range(3)]
            while digits[-1] == 0:
                digits.pop()
            data += b"".join(bytes((1, 1, 1, digit)) for digit in digits)
        place += run
    return data


def runs(line: np.ndarray) -> bytes:
    """Run lengths of each channel, as the format's writers make them."""
    width = len(line)
    data = bytearray((2, 2, width >> 8, width & 255))
    for channel in line.T:
        start = 0
        while start < width:
            run = 1
            while start + run < width and run < 127 and channel[start + run] == channel[start]:
                run += 1
            if run > 2:
                data += bytes((128 + run, channel[start]))
            else:
                run = min(width - start, 5)
                data += bytes((run, *channel[start : start + run]))
            start += run
    return bytes(data)


def encoded(pixels: np.ndarray, header: str = FORMAT, line=runs, resolution: str | None = None) -> bytes:
    """A file of scan lines."""
    height, width = pixels.shape[:2]
    head = f"#?RADIANCE\n{header}\n{resolution or f'-Y {height} +X {width}'}\n"
    return head.encode() + b"".join(line(one) for one in pixels)


def read(folder: Path, data: bytes) -> np.ndarray:
    path = folder / "picture.hdr"
    path.write_bytes(data)
    return read_image(path).numpy()


@pytest.mark.parametrize(
    ("width", "line"), [(40, runs), (300, runs), (40, flat), (5, flat), (40, repeated), (700, repeated)]
)
def test_encodings_give_what_their_bytes_stand_for(tmp_path: Path, width: int, line) -> None:
    pixels = rgbe(7, width)
    pixels[3] = pixels[3, 0]
    image = read(tmp_path, encoded(pixels, line=line))
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image, decoded(pixels))


@pytest.mark.parametrize("first", range(3))
def test_each_line_says_for_itself_how_it_is_encoded(tmp_path: Path, first: int) -> None:
    pixels = rgbe(7, 40)
    lines = iter([(runs, flat, repeated)[(first + k) % 3] for k in range(7)])
    image = read(tmp_path, encoded(pixels, line=lambda one: next(lines)(one)))
    np.testing.assert_array_equal(image, decoded(pixels))


def test_a_flat_file_may_hold_what_repeats_elsewhere(tmp_path: Path) -> None:
    pixels = rgbe(3, 10)
    pixels[1, 4] = 1, 1, 1, 130
    np.testing.assert_array_equal(read(tmp_path, encoded(pixels, line=flat)), decoded(pixels))


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("down", "-+")
@pytest.mark.parametrize("across", "+-")
@pytest.mark.parametrize("line", [runs, flat])
def test_orientations_show_the_same_picture(tmp_path: Path, turned: bool, down: str, across: str, line) -> None:
    pixels = rgbe(11, 20)
    stored = pixels[:: 1 if down == "-" else -1, :: 1 if across == "+" else -1]
    resolution = f"{down}Y 11 {across}X 20"
    if turned:
        stored, resolution = stored.transpose(1, 0, 2), f"{across}X 20 {down}Y 11"
    data = encoded(np.ascontiguousarray(stored), line=line, resolution=resolution)
    np.testing.assert_array_equal(read(tmp_path, data), decoded(pixels))


def test_lines_of_the_header_may_end_as_on_windows(tmp_path: Path) -> None:
    data = encoded(rgbe(5, 20))
    end = data.index(b"\n", data.index(b"\n\n") + 2) + 1
    found = read(tmp_path, data[:end].replace(b"\n", b"\r\n") + data[end:])
    np.testing.assert_array_equal(found, decoded(rgbe(5, 20)))


def test_padding_is_passed_over_and_the_log_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        found = read(tmp_path, encoded(rgbe(5, 20)) + bytes(7))
    np.testing.assert_array_equal(found, decoded(rgbe(5, 20)))
    assert "7 bytes behind the picture" in caplog.text


@pytest.mark.parametrize(
    ("header", "factors"),
    [
        ("EXPOSURE=2\nEXPOSURE= 4.0\n", (8, 8, 8)),
        ("COLORCORR=2 4 8\n", (2, 4, 8)),
        ("COLORCORR= 2 4 8\nEXPOSURE=0.5\nCOLORCORR=0.5 1 2\n", (0.5, 2, 8)),
        ("GAMMA=1\nPIXASPECT=1.0\n\tEXPOSURE=7\n# EXPOSURE=7\nVIEW= -vtv\n", (1, 1, 1)),
        ("exposure =7\n", (7, 7, 7)),
    ],
)
def test_factors_of_the_header_are_taken_out(tmp_path: Path, header: str, factors: tuple[float, ...]) -> None:
    found = read(tmp_path, encoded(rgbe(3, 20), header + FORMAT))
    np.testing.assert_array_equal(found, decoded(rgbe(3, 20)) / np.array(factors, np.float32))


def test_xyz_is_converted(tmp_path: Path) -> None:
    found = read(tmp_path, encoded(rgbe(3, 20), FORMAT.replace("rgbe", "xyze")))
    expected = decoded(rgbe(3, 20)) @ np.array(XYZ_TO_REC709).T
    np.testing.assert_allclose(found, expected, atol=2e-3 * expected.max())


def test_primaries_are_converted(tmp_path: Path) -> None:
    rec2020 = "PRIMARIES= 0.708 0.292 0.170 0.797 0.131 0.046 0.3127 0.3290\n"
    found = read(tmp_path, encoded(rgbe(3, 20), rec2020 + FORMAT))
    # ITU-R BT.2087's inverse
    matrix = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]
    np.testing.assert_allclose(found, decoded(rgbe(3, 20)) @ np.array(matrix).T, atol=1e-3 * found.max())
    # Radiance's own have the white of equal energy, which becomes that of the display
    grey = np.full((2, 10, 4), 130, np.uint8)
    own = "PRIMARIES= 0.640 0.330 0.290 0.600 0.150 0.060 0.3333 0.3333\n"
    np.testing.assert_allclose(read(tmp_path, encoded(grey, own + FORMAT)), decoded(grey), rtol=1e-3)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda data: data[:-1], "run lengths"),
        (lambda data: data[:60], "run lengths"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 30000 +X 32000"), "unpacked"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 2000000000 +X 1"), "resolution"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 99999 +X 1"), "sides"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 32000 +X 20"), "expected 20 pixels|run lengths"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 6 -Y 20"), "resolution"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 0 +X 20"), "sides"),
        (lambda data: data.replace(b"rgbe", b"cmyk"), "FORMAT"),
        (lambda data: data.replace(b"FORMAT", b"EXPOSURE=0\nFORMAT"), "EXPOSURE"),
        (lambda data: data.replace(b"FORMAT", b"EXPOSURE=nan\nFORMAT"), "EXPOSURE"),
        (lambda data: data.replace(b"FORMAT", b"COLORCORR=1 2\nFORMAT"), "COLORCORR"),
        (lambda data: data.replace(b"FORMAT", b"GAMMA=2.2\nFORMAT"), "GAMMA"),
        (lambda data: data.replace(b"FORMAT", b"PIXASPECT=0.5\nFORMAT"), "PIXASPECT"),
        (lambda data: data.replace(b"FORMAT", b"PRIMARIES=1 0 1 0 1 0 .3 .3\nFORMAT"), "primaries"),
        (lambda data: data.replace(b"FORMAT", b"PRIMARIES=.64 .33 .3 .6 .15 .06 .3 0\nFORMAT"), "white"),
        (lambda data: data.replace(b"\n\n", b"\n"), "header"),
        (lambda data: b"P6" + data, "expected an OpenEXR or a Radiance"),
        (lambda data: b"", "expected an OpenEXR or a Radiance"),
    ],
)
def test_what_is_damaged_or_not_understood_is_refused_in_one_line(tmp_path: Path, change, reason: str) -> None:
    with pytest.raises(DataError, match=reason) as caught:
        read(tmp_path, change(encoded(rgbe(6, 20))))
    assert str(tmp_path) in str(caught.value)


def test_repeats_that_do_not_add_up_are_refused(tmp_path: Path) -> None:
    for line in (b"\1\1\1\7", bytes((9, 9, 9, 130, 1, 1, 1, 255)), bytes((9, 9, 9, 130)) + bytes((1, 1, 1, 255)) * 9):
        with pytest.raises(DataError, match="add up"):
            read(tmp_path, encoded(rgbe(1, 20), line=lambda _, line=line: line + bytes(80 - len(line) + 4)))


def test_values_that_float32_does_not_hold_are_refused(tmp_path: Path) -> None:
    pixels = np.full((2, 10, 4), 255, np.uint8)
    with pytest.raises(DataError, match="float32"):
        read(tmp_path, encoded(pixels, "EXPOSURE=1e-9\n" + FORMAT))


def test_changed_files_are_read_or_refused_at_once(tmp_path: Path) -> None:
    """No other exception, nothing that is not finite, nothing that takes long."""
    lines = iter([runs, flat, repeated] * 100)
    valid = [encoded(rgbe(6, 20), line=line) for line in (runs, flat, repeated)]
    valid.append(encoded(rgbe(6, 20), f"EXPOSURE=2\nCOLORCORR=1 2 3\n{FORMAT}", line=lambda one: next(lines)(one)))
    path = tmp_path / "fuzzed.hdr"
    refused = 0
    for seed in range(600):
        chance = random.Random(seed)
        data = bytearray(chance.choice(valid))
        for _ in range(chance.choice((1, 1, 3))):
            data[chance.randrange(2, len(data))] = chance.choice((0, 1, 2, 255, chance.randrange(256)))
        path.write_bytes(data[: chance.randrange(2, len(data))] if seed % 4 == 0 else data)
        start = time.monotonic()
        with contextlib.suppress(DataError):
            refused += 1
            assert read_image(path).isfinite().all()
            refused -= 1
        assert time.monotonic() - start < 5
    assert 100 < refused < 550  # both happened


def test_both_forms_of_a_picture_are_float32_and_contiguous(tmp_path: Path) -> None:
    (tmp_path / "picture.hdr").write_bytes(encoded(rgbe(3, 20), resolution="+Y 3 -X 20"))
    assert read_image(tmp_path / "picture.hdr").is_contiguous()
    assert read_image(tmp_path / "picture.hdr").dtype == torch.float32
