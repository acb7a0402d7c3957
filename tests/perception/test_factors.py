"""Non-parametric factor fits: the formula against plain loops, the order of the names, and files that are no such."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from torchbrdf.errors import DataError, UsageError
from torchbrdf.measured import load, standins
from torchbrdf.measured.catalogue import MERL_NAMES
from torchbrdf.pairs import Pairs
from torchbrdf.perception import FactorFits, FactorModel, read_factors, uniform_pairs

Array = np.ndarray
SIZE = 256 * 512 * 3 * 4


def synthetic_factors(seed: int = 0) -> Array:
    """What a file holds: 100 rows of made-up factors."""
    content = np.zeros((256, 512, 3), "<f4")
    content[:100, :272] = np.random.default_rng(seed).uniform(0.1, 1, (100, 272, 3))
    return content


def write(folder: Path, content: Array | bytes) -> Path:
    path = folder / "npf.bin"
    path.write_bytes(content if isinstance(content, bytes) else content.tobytes())
    return path


def slanted(theta_i: float, theta_o: float, azimuth: float = 180.0) -> Pairs:
    """One pair `(1, 1)` at these angles in degrees, float64."""
    i, o, phi = (math.radians(angle) for angle in (theta_i, theta_o, azimuth))
    wi = torch.tensor([math.sin(i), 0, math.cos(i)], dtype=torch.float64)
    wo = torch.tensor([math.sin(o) * math.cos(phi), math.sin(o) * math.sin(phi), math.cos(o)], dtype=torch.float64)
    return Pairs.from_directions(wi[None, None], wo[None, None])


def row(**factors: float | list[float]) -> FactorModel:
    """One material, grey: diffuse, specular, d, g and f, each a number or 90 of them."""
    content = torch.zeros(1, 272, 3, dtype=torch.float64)
    content[0, 0], content[0, 1] = factors.get("diffuse", 0.0), factors.get("specular", 1.0)
    for part, name in zip(content[0, 2:].split(90), "dgf", strict=True):
        part[:] = torch.as_tensor(factors.get(name, 1.0), dtype=torch.float64).reshape(-1, 1)
    return FactorModel(content)


ALL_BINS = list(range(90))


def test_constant_factors_are_lambert_and_a_quotient() -> None:
    assert row(diffuse=0.3, specular=0)(slanted(50, 70)).tolist() == pytest.approx(np.full((1, 1, 3), 0.3 / math.pi))
    found = row(diffuse=0.3, specular=0.2, d=5.0, g=0.5, f=0.7)(slanted(60, 30))
    expected = (0.3 + 0.2 * 5 * 0.7 * 0.25 / (0.5 * math.sqrt(0.75))) / math.pi
    torch.testing.assert_close(found, torch.full((1, 1, 3), expected, dtype=torch.float64), rtol=1e-12, atol=0)


@pytest.mark.parametrize(("theta_h", "bin_"), [(0, 0), (0.01, 0), (0.05, 2), (10.1, 30), (44.9, 63), (50, 67)])
def test_the_distribution_has_narrow_bins_about_the_normal(theta_h: float, bin_: int) -> None:
    """sqrt(theta_h / 90 * 90 * 90), rounded down; by hand."""
    pairs = slanted(theta_h, theta_h, azimuth=0.0)
    value = float(row(d=ALL_BINS)(pairs)[0, 0, 0]) * math.pi * math.cos(math.radians(theta_h)) ** 2
    assert value == pytest.approx(bin_, abs=1e-9)


@pytest.mark.parametrize(("theta_d", "bin_"), [(0, 0), (0.9, 0), (1.1, 1), (45.5, 45), (89.5, 89)])
def test_the_fresnel_factor_has_bins_of_a_degree(theta_d: float, bin_: int) -> None:
    value = float(row(f=ALL_BINS)(slanted(theta_d, theta_d))[0, 0, 0]) * math.pi * math.cos(math.radians(theta_d)) ** 2
    assert value == pytest.approx(bin_, abs=1e-9)


@pytest.mark.parametrize(
    ("theta", "expected"),
    # Bins 1 and 2 in the place of 0 and 1, from -0.5 and from 0.5 degrees on; then between the centres k + 0.5; and
    # towards nothing behind the last.
    [(0, 1.5), (0.25, 1.75), (0.75, 1.25), (1.25, 1.75), (2, 1.5), (45.75, 45.25), (89.75, 0.75 * 89)],
)
def test_masking_is_linear_between_centres(theta: float, expected: float) -> None:
    value = float(row(g=ALL_BINS)(slanted(theta, theta))[0, 0, 0]) * math.pi * math.cos(math.radians(theta)) ** 2
    assert value == pytest.approx(expected**2, rel=1e-9)


def plain(entries: Array, wi: Array, wo: Array) -> Array:
    """One value `(3,)`, a formula at a time."""
    half = (wi + wo) / np.linalg.norm(wi + wo)
    theta_h, theta_d = math.acos(min(half[2], 1)), math.acos(min(wi @ half, 1))

    def masking(theta: float) -> Array:
        g, place = entries[92:182], theta / (math.pi / 2) * 90
        below = math.floor(place - 0.5)
        share = place - (below + 0.5)
        low, high = max(1, below), max(2, below + 1)
        return (1 - share) * g[low] + (share * g[high] if high < 90 else 0)

    d = entries[2:92][min(int(math.sqrt(theta_h / (math.pi / 2) * 8100)), 89)]
    f = entries[182:272][min(int(theta_d / (math.pi / 2) * 90), 89)]
    quotient = masking(math.acos(wi[2])) * masking(math.acos(wo[2])) / (wi[2] * wo[2])
    return (entries[0] + entries[1] * d * f * quotient) / math.pi


def listed(name: str) -> str:
    """By this, an English locale sorts the file NAME.binary."""
    return name.replace("-", "") + "binary"


def test_values_are_those_of_plain_loops(tmp_path: Path) -> None:
    content = synthetic_factors()
    fits = read_factors(write(tmp_path, content))
    names = ["chrome", "brass", "chrome"]
    rows = [sorted(MERL_NAMES, key=listed).index(name) for name in names]
    wi, wo = (hemisphere(300, seed=seed) for seed in (1, 2))
    model = fits.of(names).to(dtype=torch.float64)
    found = model(Pairs.from_directions(wi, wo))
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    for k, own in enumerate(rows):
        for n in above.nonzero()[:, 0].tolist():
            expected = plain(content[own].astype(float), wi[n].numpy(), wo[n].numpy())
            np.testing.assert_allclose(found[k, n].numpy(), expected, rtol=1e-9)
    assert torch.equal(found[0], found[2])
    shared, each = Pairs.from_directions(wi[None], wo[None]), Pairs.from_directions(wi.expand(3, -1, 3), wo[None])
    assert torch.equal(model(shared), found) and torch.equal(model(each), found)


def test_what_is_below_the_horizon_is_black() -> None:
    assert row(diffuse=1)(slanted(100, 30)).tolist() == [[[0, 0, 0]]]
    assert row(diffuse=1)(slanted(30, 100)).tolist() == [[[0, 0, 0]]]
    assert bool(row(diffuse=1)(slanted(90, 90, 10)).isfinite().all())


def test_float32_is_close_where_no_bin_ends(tmp_path: Path) -> None:
    """A direction at the border of two bins may fall into either; there are few."""
    model = read_factors(write(tmp_path, synthetic_factors())).of(["brass"])
    pairs = uniform_pairs(4000)
    found = model(pairs.to(dtype=torch.float32))
    exact = model.to(dtype=torch.float64)(pairs)
    assert found.dtype == torch.float32 and exact.dtype == torch.float64
    close = torch.isclose(found.double(), exact, rtol=1e-4, atol=0).all(-1)
    assert close.double().mean() > 0.995


def test_names_are_ordered_without_their_marks(tmp_path: Path) -> None:
    content = synthetic_factors()
    content[:100, 0] = np.arange(100)[:, None]
    fits = read_factors(write(tmp_path, content))
    assert isinstance(fits, FactorFits) and fits.materials == sorted(MERL_NAMES, key=listed)
    place = fits.materials.index
    assert place("chrome") + 1 == place("chrome-steel")
    assert place("blue-metallic-paint2") + 1 == place("blue-metallic-paint")
    assert place("alum-bronze") == 0 and place("yellow-plastic") == 99
    assert fits.of(["chrome-steel", "alum-bronze"]).rows[:, 0, 0].tolist() == [place("chrome-steel"), 0]
    with pytest.raises(UsageError, match=r"^factors: expected one of 100 materials, found 'lead'$"):
        fits.of(["brass", "lead"])


def test_a_missing_file_says_where_it_comes_from(tmp_path: Path) -> None:
    said = "no such file; expected .*10.1145/2907941.*jdupuy/opengl-framework"
    with pytest.raises(DataError, match=rf"^{tmp_path}/none: {said}"):
        read_factors(tmp_path / "none")
    with pytest.raises(DataError, match="expected non-parametric factors, found Is a directory"):
        read_factors(tmp_path)


@pytest.mark.parametrize(
    ("place", "value", "name"),
    [
        ((0, 100, 1), math.nan, "alum-bronze"),
        ((99, 271, 2), math.inf, "yellow-plastic"),
        ((1, 0, 0), -0.1, "alumina-oxide"),
        ((2,), 0, "aluminium"),
    ],
)
def test_bad_rows_are_named(place: tuple[int, ...], value: float, name: str, tmp_path: Path) -> None:
    content = synthetic_factors()
    content[place] = value
    path = write(tmp_path, content)
    said = rf"row {place[0]} \({name}\): expected finite factors of at least 0, not all 0"
    with pytest.raises(DataError, match=rf"^{path}: {said}$"):
        read_factors(path)


@given(size=st.integers(0, SIZE + 100).filter(lambda size: size != SIZE))
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_files_of_another_size_are_refused(size: int, tmp_path: Path) -> None:
    path = write(tmp_path, (synthetic_factors().tobytes() + bytes(100))[:size])
    with pytest.raises(DataError, match=rf"^{path}: expected 1572864 bytes, found {size}$"):
        read_factors(path)


@given(noise=st.binary(min_size=1, max_size=64), place=st.integers(0, SIZE - 64))
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_is_in_a_file_gives_finite_rows_or_an_error(noise: bytes, place: int, tmp_path: Path) -> None:
    content = bytearray(synthetic_factors().tobytes())
    content[place : place + len(noise)] = noise
    path = write(tmp_path, bytes(content))
    try:
        fits = read_factors(path)
    except DataError as error:
        assert str(error).startswith(f"{path}: row ") and "\n" not in str(error)
    else:
        assert bool(fits.rows.isfinite().all())


@pytest.fixture(scope="session")
def factors(data: Path) -> FactorFits:
    """The published factors, which are no part of the project."""
    path = data / "merl" / "npf.bin"
    if not path.is_file():
        pytest.skip(f"needs the factors of Bagher et al. 2016: no file {path}")
    return read_factors(path)


def test_rows_are_those_of_their_materials(factors: FactorFits) -> None:
    """Of 100 rows, a stand-in's own is among the four nearest to it, and for most the nearest."""
    pairs = uniform_pairs(2000, 75.0)
    tables = load(standins(), dtype=torch.float64)
    rows = factors.of(factors.materials).to(dtype=torch.float64)(pairs).clamp_min(0)
    assert rows.shape == (100, 2000, 3) and bool(rows.isfinite().all())
    away = ((tables.at(pairs)[:, None] + 1e-3).log() - (rows + 1e-3).log()).square().mean((2, 3)).sqrt()
    own = torch.tensor([factors.materials.index(name) for name in tables.names])
    distance = away.gather(1, own[:, None])
    place = (away < distance).sum(1)
    assert int(place.max()) < 4
    assert int((place == 0).sum()) >= 8
    assert float(distance.median()) < 0.3


def test_units_are_those_of_the_tables(factors: FactorFits) -> None:
    """A factor of pi more or less would be farther from every stand-in."""
    pairs = uniform_pairs(2000, 75.0)
    tables = load(standins(), dtype=torch.float64)
    values = factors.of(tables.names).to(dtype=torch.float64)(pairs).clamp_min(0)
    away = {
        scale: ((tables.at(pairs) + 1e-3).log() - (scale * values + 1e-3).log()).square().mean((1, 2))
        for scale in (1, math.pi, 1 / math.pi)
    }
    assert bool((away[1] < away[math.pi]).all()) and bool((away[1] < away[1 / math.pi]).all())
