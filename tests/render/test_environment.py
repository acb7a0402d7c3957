"""Light from all around: the map, what is looked up in it, and the lights that stand for it."""

import logging
import math
import re
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torchbrdf.assets.make_grove import make_grove
from torchbrdf.color import luminance
from torchbrdf.errors import DataError, UsageError
from torchbrdf.images import read_image, write_exr
from torchbrdf.render import Environment
from torchbrdf.render.light.octahedral import padded, texel_centers, to_sphere, to_square

ANY = torch.tensor(1e-9)


def random_directions(count: int = 2000, seed: int = 0) -> Tensor:
    normal = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.nn.functional.normalize(normal, dim=-1)


def latitude_longitude(height: int) -> Tensor:
    """The direction of every pixel's centre, by Debevec's convention."""
    down = (torch.arange(height) + 0.5) * math.pi / height
    across = (torch.arange(2 * height) + 0.5) * math.pi / height - math.pi
    theta, phi = torch.meshgrid(down, across, indexing="ij")
    return torch.stack([theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos()], -1)


def smooth(directions: Tensor) -> Tensor:
    """Some radiance without edges."""
    x, y, z = directions.unbind(-1)
    return torch.stack([1 + x, 2 + y * z, 1.5 + z * z * x], -1)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: sum(x * x for x in v) > 1e-6))
def test_the_square_and_the_sphere(vector: tuple[float, ...]) -> None:
    direction = torch.nn.functional.normalize(torch.tensor(vector, dtype=torch.float64), dim=0)
    first, second = to_square(direction)
    assert max(abs(first), abs(second)) <= 1 + 1e-15
    torch.testing.assert_close(to_sphere(first, second), direction, atol=1e-12, rtol=0)


def test_every_texel_has_the_same_solid_angle() -> None:
    side = 16
    # each texel as many flat quadrilaterals
    fine = torch.linspace(-1, 1, side * 32 + 1, dtype=torch.float64)
    second, first = torch.meshgrid(fine, fine, indexing="ij")
    corner = to_sphere(first, second)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    area = (torch.linalg.cross(b - a, c - a).norm(dim=-1) + torch.linalg.cross(c - a, d - a).norm(dim=-1)) / 2
    texels = area.reshape(side, 32, side, 32).sum((1, 3))
    torch.testing.assert_close(texels, torch.full_like(texels, 4 * math.pi / side**2), rtol=2e-3, atol=0)


def test_padding_is_what_lies_behind_the_edge() -> None:
    centers = texel_centers(32, torch.float64)
    wide = padded(centers)
    assert wide.shape == (34, 34, 3)
    for near, far in ((wide[0], wide[1]), (wide[-1], wide[-2]), (wide[:, 0], wide[:, 1]), (wide[:, -1], wide[:, -2])):
        assert (near - far).norm(dim=-1).max() < 4 * (4 * math.pi / 32**2) ** 0.5


@pytest.fixture(scope="module")
def evening() -> Environment:
    """Smooth light all around."""
    return Environment.from_image(smooth(latitude_longitude(256)))


@pytest.fixture(scope="module")
def grove() -> Environment:
    """The package's own."""
    return Environment.default()


def test_a_picture_is_found_again_in_every_direction(evening: Environment) -> None:
    directions = random_directions()
    found = evening.lookup(directions.float(), ANY)
    torch.testing.assert_close(found, smooth(directions).float(), atol=0.01, rtol=0)


def test_an_angular_map_shows_the_same() -> None:
    size = 512
    step = (torch.arange(size) + 0.5) * 2 / size - 1
    down, across = torch.meshgrid(-step, step, indexing="ij")
    radius = (across.square() + down.square()).sqrt()
    sine = (math.pi * radius).sin() / radius
    picture = smooth(torch.stack([across * sine, down * sine, -(math.pi * radius).cos()], -1)).clamp_min(0)
    found = Environment.from_image(picture).lookup(random_directions().float(), ANY)
    torch.testing.assert_close(found, smooth(random_directions()).float(), atol=0.03, rtol=0)


@pytest.mark.parametrize("row_column_direction", [(8, 16, (0, 0, -1)), (8, 24, (1, 0, 0)), (8, 8, (-1, 0, 0))])
def test_where_a_bright_spot_shines_from(row_column_direction: tuple[int, int, tuple[int, int, int]]) -> None:
    row, column, expected = row_column_direction
    picture = torch.zeros(17, 34, 3)
    picture[row, column : column + 2] = 1.0
    brightest = Environment.from_image(picture).light_samples(4096)
    direction = brightest.direction[brightest.flux.sum(-1).argmax()]
    assert (direction * torch.tensor(expected, dtype=torch.float32)).sum() > 0.97


def test_the_top_of_a_picture_is_up() -> None:
    picture = torch.full((16, 32, 3), 0.01)
    picture[:4] = 1.0
    environment = Environment.from_image(picture)
    up = torch.tensor([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    found = environment.lookup(up, ANY)[:, 0]
    assert found[0] == pytest.approx(1.0)
    assert found[1] == pytest.approx(0.01)


def test_energy_is_kept() -> None:
    """Also that of a sun that is smaller than a texel."""
    height = 512
    picture = torch.full((height, 2 * height, 3), 0.1)
    picture[150, 350] = 2e5
    weight = ((torch.arange(height) + 0.5) * math.pi / height).sin()[:, None, None]
    total = (picture * weight).sum((0, 1)) * (math.pi / height) ** 2
    environment = Environment.from_image(picture)
    found = environment.texels.mean((0, 1)) * 4 * math.pi
    torch.testing.assert_close(found, total, rtol=0.02, atol=0)
    # the averages and the lights add up to the same to rounding
    for level in environment._pyramid:
        torch.testing.assert_close(level.mean((0, 1)) * 4 * math.pi, found, rtol=1e-5, atol=0)
    torch.testing.assert_close(environment.light_samples(64).flux.sum(0), found, rtol=1e-5, atol=0)


def test_lookups_average_over_their_solid_angle(grove: Environment) -> None:
    directions = random_directions(60).float()
    whole = grove.lookup(directions, torch.tensor(4 * math.pi))
    torch.testing.assert_close(whole, grove.texels.mean((0, 1)).expand_as(whole), rtol=1e-4, atol=0)
    # Against the mean over a cone. Squares are no cones, and interpolation blurs, so that they agree only roughly,
    # but far better than what is seen in the middle.
    solid_angle = 0.1
    inside = directions @ texel_centers(512).reshape(-1, 3).T > 1 - solid_angle / (2 * math.pi)
    cones = torch.stack([grove.texels.reshape(-1, 3)[cone].mean(0) for cone in inside]).log()
    averaged = (grove.lookup(directions, torch.tensor(solid_angle)).log() - cones).square().mean()
    middle = (grove.lookup(directions, ANY).log() - cones).square().mean()
    assert averaged < 0.2 * middle


def test_lookups_have_no_seams(evening: Environment) -> None:
    """Radiance changes by less than 3 a radian, so what is looked up must, too, also over the edges of the map."""
    around = torch.linspace(0, 2 * math.pi, 20_001, dtype=torch.float64)
    for tilt in (0.0, 0.4, 1.2):
        circle = torch.stack([around.cos(), around.sin() * math.sin(tilt), around.sin() * math.cos(tilt)], -1).float()
        for solid_angle in (1e-6, 1e-3, 3e-2, 1.0):
            found = evening.lookup(circle, torch.tensor(solid_angle))
            assert found.diff(dim=0).abs().max() < 3 * 2 * math.pi / 20_000
    levels = torch.logspace(-6, 1, 20_001)
    found = evening.lookup(circle[:1].expand(len(levels), 3), levels)
    assert found.diff(dim=0).abs().max() < 3e-3


@pytest.mark.parametrize("degrees", [90.0, -200.0])
def test_rotation_is_counter_clockwise_from_above(evening: Environment, degrees: float) -> None:
    turned = Environment(evening.texels, evening.rotation + degrees)
    angle = math.radians(degrees)
    # x = cos, z = -sin of the azimuth seen from above
    matrix = torch.tensor([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    directions = random_directions(100).float()
    torch.testing.assert_close(turned.lookup(directions @ matrix.T, ANY), evening.lookup(directions, ANY))
    torch.testing.assert_close(turned.light_samples(64).direction, evening.light_samples(64).direction @ matrix.T)


def test_lights_go_where_the_light_is() -> None:
    picture = torch.full((128, 256, 3), 0.1)
    picture[40:43, 60:63] = 1000.0
    environment = Environment.from_image(picture)
    few, many = environment.light_samples(100), environment.light_samples(1000)
    assert len(few.flux) == 100
    assert len(many.flux) == 1000
    torch.testing.assert_close(many.direction.norm(dim=-1), torch.ones(1000))
    # all of the sun within a degree and a half, as one light or several
    sun = latitude_longitude(128)[41, 61]
    near = many.direction @ sun > math.cos(math.radians(2.5))
    assert near.sum() > 4
    assert many.flux[near].sum() > 0.8 * 3 * 1000 * 9 * (math.pi / 128) ** 2 * math.sin(41.5 * math.pi / 128)
    # a quadratic in the direction is what the split is made for: fewer lights, larger error
    centers = texel_centers(512, torch.float64)
    exact = (environment.texels * centers[..., :1].square()).mean((0, 1)) * 4 * math.pi
    errors = [
        ((lights.flux * lights.direction[:, :1].square()).sum(0) / exact - 1).abs().max() for lights in (few, many)
    ]
    assert errors[1] < 0.005
    assert errors[1] < errors[0]


def test_constant_light_gives_equal_lights() -> None:
    lights = Environment.from_image(torch.full((8, 16, 3), 2.0)).light_samples(256)
    torch.testing.assert_close(lights.flux, torch.full((256, 3), 2 * 4 * math.pi / 256))


def test_dark_parts_give_no_lights() -> None:
    picture = torch.zeros(16, 32, 3)
    picture[:8] = 1.0
    assert (Environment.from_image(picture).light_samples(256).flux.sum(-1) > 0).all()


def many(value: float, count: int) -> Tensor:
    picture = torch.ones(8, 16, 3)
    picture.view(-1)[:count] = value
    return picture


@pytest.mark.parametrize(
    ("value", "counted", "said"),
    [
        (-1e-7, 0.0, r"negative count as 0: 3 of 384 \(-1e-07 at row 0, column 0\)"),
        (math.inf, 2.5, r"not finite count as 2.5, .*: 3 of 384 \(inf at row 0, column 0\)"),
        (math.nan, 0.0, "not finite count as"),
        (-math.inf, 0.0, "not finite count as"),
    ],
)
def test_a_few_odd_values_are_mended_and_counted(
    tmp_path: Path, value: float, counted: float, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    odd, mended = many(value, 3), many(counted, 3)
    odd[4, 4, 0] = mended[4, 4, 0] = 2.5
    write_exr(tmp_path / "light.exr", odd)
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        found = Environment.from_file(tmp_path / "light.exr")
    assert torch.equal(found.texels, Environment.from_image(mended).texels)
    (record,) = caplog.records
    assert re.search(f"light.exr: values that are {said}", record.getMessage())


def test_a_crop_is_no_sphere(tmp_path: Path) -> None:
    """What a file leaves out of its display window is dark, not filled by what it has."""
    pixels = torch.zeros(32, 64, 3)
    pixels[16:24, 20:36] = torch.tensor([1.0, 2.0, 3.0])
    header = {"dataWindow": ((20, 16), (35, 23)), "displayWindow": ((0, 0), (63, 31)), "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": pixels[16:24, 20:36].contiguous().numpy()}).write(str(tmp_path / "crop.exr"))
    found = Environment.from_file(tmp_path / "crop.exr")
    assert torch.equal(found.texels, Environment.from_image(pixels).texels)


@pytest.mark.parametrize(
    ("picture", "reason"),
    [
        (torch.ones(8, 15, 3), "15 x 8"),
        (torch.full((8, 16, 3), math.nan), "black"),
        (many(math.nan, 5), r"at most 1 in 100 values that are not finite, found 5 of 384 \(nan at row 0, column 0\)"),
        (many(math.inf, 5), "not finite"),
        (many(-1e-7, 40), "at most 1 in 10 values that are negative, found 40"),
        (many(2e15, 1), r"below 1e\+15, found up to 2e\+15"),
        (torch.zeros(8, 16, 3), "black"),
        (torch.full((8, 16, 3), -1.0), "black"),
    ],
)
def test_pictures_that_are_no_environment(tmp_path: Path, picture: Tensor, reason: str) -> None:
    path = tmp_path / "light.exr"
    write_exr(path, picture)
    with pytest.raises(DataError, match=reason) as caught:
        Environment.from_file(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_environment_at_all(tmp_path: Path, evening: Environment) -> None:
    (tmp_path / "light.hdr").write_text("dark")
    with pytest.raises(DataError, match="starts with"):
        Environment.from_file(tmp_path / "light.hdr")
    with pytest.raises(DataError, match="expected a picture"):
        Environment.from_image(torch.ones(8, 16))
    with pytest.raises(UsageError, match="rotation"):
        Environment.from_image(torch.ones(8, 16, 3), rotation=math.nan)
    with pytest.raises(UsageError, match="at least 4"):
        evening.light_samples(3)


@pytest.mark.slow
def test_the_default_is_the_generators(grove: Environment) -> None:
    made = make_grove()
    kept = read_image(Path(__file__).parents[2] / "assets" / "grove.exr")
    torch.testing.assert_close(kept, made, rtol=2e-3, atol=1e-6)
    light = luminance(made)
    assert light.max() / light.min() > 1e3
    torch.testing.assert_close(grove.texels, Environment.from_image(kept).texels)


@pytest.mark.slow
def test_the_grove_has_natural_statistics() -> None:
    """The power of log luminance along the horizon falls about as frequency^-2 (amplitude 1 / f)."""
    rows = luminance(make_grove(128)).log()[40:62]
    power = (torch.fft.rfft(rows - rows.mean(1, keepdim=True)).abs() ** 2).mean(0)
    frequency = torch.arange(4, 64, dtype=torch.float32)
    slope = np.polyfit(frequency.log().numpy(), power[4:64].log().numpy(), 1)[0]
    assert -3 < slope < -1


def test_both_forms_of_the_light_probe_agree(data: Path) -> None:
    angular = Environment.from_file(data / "probes" / "rnl_probe.hdr")
    latlong = Environment.from_file(data / "probes" / "rnl_probe_latlong.hdr")
    torch.testing.assert_close(angular.texels.mean((0, 1)), latlong.texels.mean((0, 1)), rtol=1e-3, atol=0)
    coarse = [level.log().flatten() for level in (angular._pyramid[3], latlong._pyramid[3])]
    assert torch.corrcoef(torch.stack(coarse))[0, 1] > 0.999
