"""Pictures in files and the tone map, against formulas written out here."""

import logging
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from torchbrdf.color import luminance
from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.images import ToneMap, composite, read_image, to_bytes, write_exr, write_png


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32])
def test_exr_round_trip(tmp_path: Path, dtype: torch.dtype) -> None:
    image = (torch.rand(5, 9, 3, generator=torch.Generator().manual_seed(0)) * 1000 - 3).to(dtype)
    path = tmp_path / "picture.exr"
    write_exr(path, image)
    assert torch.equal(read_image(path), image.float())
    assert [p.name for p in tmp_path.iterdir()] == ["picture.exr"]


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="found no such file"):
        read_image(tmp_path / "nothing.exr")


def test_png_rounds_display_values(tmp_path: Path) -> None:
    image = torch.tensor([[[0.0, 0.5, 1.0], [-1.0, 2.0, 100.4 / 255]]])
    write_png(tmp_path / "picture.png", image)
    shown = np.asarray(Image.open(tmp_path / "picture.png"))
    np.testing.assert_array_equal(shown, [[[0, 128, 255], [0, 255, 100]]])


def test_png_shows_what_is_not_finite(tmp_path: Path) -> None:
    write_png(tmp_path / "picture.png", torch.tensor([[[math.inf, -math.inf, 0.2], [0.0, math.nan, 0.0]]]))
    shown = np.asarray(Image.open(tmp_path / "picture.png"))
    np.testing.assert_array_equal(shown, [[[255, 0, 51], [255, 0, 255]]])


@pytest.mark.skipif(sys.platform == "win32", reason="limits of processes are POSIX's")
@pytest.mark.parametrize("write", [write_exr, write_png])
def test_a_full_disk_is_met_with_one_line(tmp_path: Path, write) -> None:
    """Files of at most 1000 bytes, in a process of its own; Python ignores the signal that comes with it."""
    script = f"""
import resource, torch
from torchbrdf.errors import DataError
from torchbrdf.images import {write.__name__}
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    {write.__name__}({str(tmp_path / "picture")!r}, torch.rand(50, 50, 3))
except DataError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout == f"{tmp_path / 'picture'}: cannot be written (File too large)\n"
    assert (done.returncode, done.stderr) == (0, "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_to(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(DataError, match="cannot be written"):
        write_png(tmp_path / "picture.png", torch.zeros(2, 2, 3))


@pytest.mark.parametrize("write", [write_exr, write_png])
def test_writing_where_a_folder_is(tmp_path: Path, write) -> None:
    (tmp_path / "picture").mkdir()
    with pytest.raises(DataError, match="expected a file or a new name, found a folder"):
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
    for gamma in (0, math.nan, math.inf, 1e200):
        with pytest.raises(UsageError, match="gamma"):
            ToneMap.from_images(pictures(), gamma=gamma)


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


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_what_is_infinite_is_white_and_what_is_no_number_is_none(dtype: torch.dtype) -> None:
    tone = ToneMap.from_images(pictures())
    most = torch.finfo(dtype).max
    image = torch.tensor(
        [[math.inf] * 3, [most] * 3, [math.inf, 0.5, 0.0], [-math.inf, 0.5, 0.0], [math.nan, 0.5, 0.0]], dtype=dtype
    )
    shown = tone(image.requires_grad_())
    assert (shown[:2] == 1).all()
    assert shown[2, 0] == 1
    assert 0 < shown[2, 1] < 1
    # as its limit
    limit = tone(torch.tensor([1e300, 0.5, 0.0], dtype=torch.float64))
    np.testing.assert_allclose(shown[2].detach().double().numpy(), limit.numpy(), atol=1e-3)
    assert torch.equal(shown[3], tone(torch.tensor([0.0, 0.5, 0.0], dtype=dtype)))
    # a loss must not take it for a colour; files show it magenta
    assert shown[4].isnan().all()
    assert to_bytes(shown)[3:].tolist() == [to_bytes(shown[3]).tolist(), [255, 0, 255]]
    shown[:4].sum().backward()
    assert image.grad is not None
    assert image.grad[:4].isfinite().all()


def test_a_tone_map_is_measured_on_what_is_finite(caplog: pytest.LogCaptureFixture) -> None:
    images = pictures()
    images[0, 2, 3], images[1, 0, 0, 1] = math.inf, math.nan
    there = images.isfinite().all(-1)
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        assert ToneMap.from_images(images) == ToneMap.from_images(pictures(), there)
    assert "2 of 60 pixels are not finite" in caplog.text


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
