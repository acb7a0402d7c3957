"""Pictures in files and the tone map, against formulas written out here."""

import contextlib
import math
import os
import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from torchbrdf.color import luminance
from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.images import ToneMap, composite, read_image, write_exr, write_png


def rgbe(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Pixels as bytes `(H, W, 4)`, with runs in them, some black."""
    generator = np.random.default_rng(seed)
    pixels = generator.integers(0, 256, (height, width, 4), np.uint8)
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
    return values


def encoded(pixels: np.ndarray, header: str = "FORMAT=32-bit_rle_rgbe\n", flat: bool = False) -> bytes:
    """A Radiance file: flat, or run lengths as the format's writers make them."""
    height, width = pixels.shape[:2]
    data = bytearray(f"#?RADIANCE\n{header}\n-Y {height} +X {width}\n".encode())
    if flat:
        return bytes(data) + pixels.tobytes()
    for row in pixels:
        data += bytes((2, 2, width >> 8, width & 255))
        for channel in row.T:
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


@pytest.mark.parametrize(("width", "flat"), [(40, False), (300, False), (40, True), (5, True)])
def test_radiance_files_give_what_their_bytes_stand_for(tmp_path: Path, width: int, flat: bool) -> None:
    pixels = rgbe(7, width)
    path = tmp_path / "picture.hdr"
    path.write_bytes(encoded(pixels, flat=flat))
    image = read_image(path)
    assert image.dtype == torch.float32
    np.testing.assert_array_equal(image.numpy(), decoded(pixels).astype(np.float32))


def test_exposure_is_taken_out(tmp_path: Path) -> None:
    pixels = rgbe(3, 20)
    path = tmp_path / "picture.hdr"
    path.write_bytes(encoded(pixels, "EXPOSURE=2\nFORMAT=32-bit_rle_rgbe\nEXPOSURE= 4.0\n"))
    np.testing.assert_array_equal(read_image(path).numpy(), (decoded(pixels) / 8).astype(np.float32))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda data: data[:-1], "run lengths"),
        (lambda data: data + b"\0", "left over"),
        (lambda data: data[:60], "run lengths"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 5 +X 20"), "left over"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 30000 +X 32000"), "pixels"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 32000 +X 20"), "start of a row"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"+Y 6 +X 20"), "resolution"),
        (lambda data: data.replace(b"-Y 6 +X 20", b"-Y 0 +X 20"), "size"),
        (lambda data: data.replace(b"rgbe", b"xyze"), "FORMAT"),
        (lambda data: data.replace(b"FORMAT", b"EXPOSURE=0\nFORMAT"), "EXPOSURE"),
        (lambda data: data.replace(b"\n\n", b"\n"), "header"),
        (lambda data: b"P6" + data, "expected an OpenEXR or a Radiance"),
        (lambda data: b"", "expected an OpenEXR or a Radiance"),
    ],
)
def test_damaged_radiance_files_are_refused_in_one_line(tmp_path: Path, change, reason: str) -> None:
    path = tmp_path / "picture.hdr"
    path.write_bytes(change(encoded(rgbe(6, 20))))
    with pytest.raises(DataError, match=reason) as caught:
        read_image(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@given(place=st.integers(0, 10_000), byte=st.integers(0, 255), length=st.integers(0, 10_000))
def test_no_byte_of_a_radiance_file_crashes_the_reader(
    tmp_path_factory: pytest.TempPathFactory, place: int, byte: int, length: int
) -> None:
    data = bytearray(encoded(rgbe(6, 20)))
    data[place % len(data)] = byte
    path = tmp_path_factory.getbasetemp() / "fuzzed.hdr"
    path.write_bytes(data[: 2 + length % len(data)] if length % 2 else data)
    with contextlib.suppress(DataError):
        assert read_image(path).isfinite().all()


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32])
def test_exr_round_trip(tmp_path: Path, dtype: torch.dtype) -> None:
    image = (torch.rand(5, 9, 3, generator=torch.Generator().manual_seed(0)) * 1000 - 3).to(dtype)
    path = tmp_path / "picture.exr"
    write_exr(path, image)
    assert torch.equal(read_image(path), image.float())
    assert [p.name for p in tmp_path.iterdir()] == ["picture.exr"]


@pytest.mark.parametrize("channels", [{"Y": 1}, {"R": 1, "G": 1, "B": 1, "A": 1}])
def test_exr_channels(tmp_path: Path, channels: dict[str, int]) -> None:
    planes = {name: np.full((3, 4), k + 0.5, np.float16) for k, name in enumerate(channels)}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(tmp_path / "picture.exr"))
    expected = [0.5, 0.5, 0.5] if "Y" in channels else [0.5, 1.5, 2.5]
    assert read_image(tmp_path / "picture.exr")[2, 3].tolist() == expected


@pytest.mark.parametrize(
    ("planes", "reason"),
    [
        ({"Z": np.zeros((3, 4), np.float32)}, "found Z"),
        ({name: np.zeros((3, 4), np.uint32) for name in "RGB"}, "half or float"),
    ],
)
def test_exr_without_colours_is_refused(tmp_path: Path, planes: dict[str, np.ndarray], reason: str) -> None:
    OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(tmp_path / "picture.exr"))
    with pytest.raises(DataError, match=reason):
        read_image(tmp_path / "picture.exr")


@pytest.mark.parametrize("length", [4, 8, 40, 200, 400])
def test_truncated_exr_is_refused_in_one_line(tmp_path: Path, length: int) -> None:
    path = tmp_path / "picture.exr"
    write_exr(path, torch.rand(32, 32, 3))
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(DataError) as caught:
        read_image(path)
    assert "\n" not in str(caught.value)


def test_exr_that_claims_to_be_huge_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "picture.exr"
    write_exr(path, torch.rand(32, 32, 3))
    data = path.read_bytes()
    window = struct.pack("<4i", 0, 0, 31, 31)
    assert window in data
    path.write_bytes(data.replace(window, struct.pack("<4i", 0, 0, 2**20, 2**20)))
    with pytest.raises(DataError, match="pixels"):
        read_image(path)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read"):
        read_image(tmp_path / "nothing.exr")


def test_png_rounds_display_values(tmp_path: Path) -> None:
    image = torch.tensor([[[0.0, 0.5, 1.0], [-1.0, 2.0, 100.4 / 255]]])
    write_png(tmp_path / "picture.png", image)
    shown = np.asarray(Image.open(tmp_path / "picture.png"))
    np.testing.assert_array_equal(shown, [[[0, 128, 255], [0, 255, 100]]])


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_to(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(DataError, match="cannot be written"):
        write_png(tmp_path / "picture.png", torch.zeros(2, 2, 3))


@pytest.mark.parametrize("write", [write_exr, write_png])
def test_writing_where_a_folder_is(tmp_path: Path, write) -> None:
    (tmp_path / "picture").mkdir()
    with pytest.raises(DataError, match="cannot be written"):
        write(tmp_path / "picture", torch.zeros(2, 2, 3))
    assert [p.name for p in tmp_path.iterdir()] == ["picture"]
    with pytest.raises(ShapeError):
        write(tmp_path / "other", torch.zeros(2, 2))


# Tone map


def pictures() -> torch.Tensor:
    return torch.rand(2, 6, 5, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) ** 4 * 50


def test_tone_map_against_numpy() -> None:
    images = pictures()
    mask = images[..., 0] > 0.1
    tone = ToneMap.from_images(images, mask)
    rgb = images.numpy()
    light = rgb @ [0.2126, 0.7152, 0.0722]
    average = np.exp(np.log(1e-5 + light[mask.numpy()]).mean())
    scaled = 0.18 * light / average
    white = scaled[mask.numpy()].max()
    shown = scaled * (1 + scaled / white**2) / (1 + scaled)
    expected = np.clip(rgb * (shown / light)[..., None], 0, 1) ** (1 / 2.2)
    np.testing.assert_allclose(tone(images).numpy(), expected, rtol=1e-12)
    assert math.isclose(tone.log_average, average, rel_tol=1e-12)
    # the brightest grey of the composite is white
    grey = torch.full((3,), tone.white * tone.log_average / tone.key, dtype=torch.float64)
    np.testing.assert_allclose(tone(grey).numpy(), 1, rtol=1e-12)


def test_tone_map_is_frozen_and_recorded() -> None:
    tone = ToneMap.from_images(pictures(), key=0.3)
    assert ToneMap(**tone.to_dict()) == tone
    assert torch.allclose(tone(pictures()[:1]), tone(pictures())[:1], rtol=1e-14)
    # phi is recorded and changes nothing
    other = ToneMap.from_images(pictures(), key=0.3, phi=8.0)
    assert other.phi == 8.0
    assert torch.equal(other(pictures()), tone(pictures()))
    with pytest.raises(UsageError, match="gamma"):
        ToneMap.from_images(pictures(), gamma=0)


def test_tone_map_has_finite_gradients_everywhere() -> None:
    tone = ToneMap.from_images(pictures())
    image = pictures()
    image[0, 0] = 0
    image[0, 1, :, 1] = 0
    image[0, 2] = -1
    image[0, 3] = 1e6
    image.requires_grad_()
    shown = tone(image)
    shown.sum().backward()
    assert image.grad is not None
    assert image.grad.isfinite().all()
    assert shown.min() >= 0
    assert shown.max() <= 1
    inside = pictures() + 0.1
    assert torch.autograd.gradcheck(tone, inside.requires_grad_())


@pytest.mark.parametrize(
    ("image", "mask"),
    [
        (torch.zeros(1, 4, 4, 3), None),
        (torch.full((1, 4, 4, 3), math.inf), None),
        (torch.full((1, 4, 4, 3), math.nan), None),
        (torch.ones(1, 4, 4, 3), torch.zeros(4, 4)),
    ],
)
def test_pictures_without_a_tone_map(image: torch.Tensor, mask: torch.Tensor | None) -> None:
    with pytest.raises(DataError):
        ToneMap.from_images(image, mask)


def test_over_blends_by_coverage() -> None:
    shown = composite(torch.ones(2, 1, 3, 3), torch.tensor([[0.0, 0.5, 1.0]]), background=0.2)
    np.testing.assert_allclose(shown[1, 0, :, 0].numpy(), [0.2, 0.6, 1.0], rtol=1e-6)


def test_luminance_of_white_is_one() -> None:
    assert math.isclose(float(luminance(torch.ones(3, dtype=torch.float64))), 1.0)
