"""Any BRDF as an RGL file: read back by ourselves and by Mitsuba."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import read_bsdf, synthetic_raw, write_raw_merl

from torchbrdf.errors import DataError, UsageError
from torchbrdf.export.convert import compared_pairs
from torchbrdf.lobes import GGX, Charlie, Lambert, Lobe, Sum, Ward
from torchbrdf.lobes import LOBES as LOBE_KINDS
from torchbrdf.measured import Measured, load, write_rgl
from torchbrdf.pairs import Pairs

LOBES = {
    "paint": Sum(Lambert(albedo=[0.3, 0.2, 0.1]), GGX(specular=[0.4, 0.4, 0.3], roughness=0.1)),
    "varnish": Sum(Lambert(albedo=0.3), GGX(specular=0.04, roughness=0.005)),
    "mirror": GGX(specular=0.9, roughness=0.005),
    "metal": GGX(specular=[0.9, 0.7, 0.4], roughness=0.3),
    "sheen": Sum(Lambert(albedo=0.2), Charlie(specular=0.3)),
    "ward": Sum(Lambert(albedo=0.1), Ward(specular=0.2, roughness=0.15)),
    "chalk": Lambert(albedo=[0.8, 0.0, 0.4]),
}


def random_pairs(count: int = 4000) -> Pairs:
    """Half of them near the mirror direction; up to 85 degrees."""
    wi, wo = hemisphere(2 * count, seed=1), hemisphere(2 * count, seed=2)
    near = torch.arange(2 * count) % 2 == 0
    wo[near] = wi[near] * torch.tensor([-1.0, -1, 1]) + 0.1 * wo[near]
    wo = wo / wo.norm(dim=-1, keepdim=True)
    low = (wi[:, 2] > math.cos(math.radians(85))) & (wo[:, 2] > math.cos(math.radians(85)))
    return Pairs.from_directions(wi[None, low][:, :count], wo[None, low][:, :count])


def mitsuba_measured(path: Path):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    return mi, mi.load_dict({"type": "measured", "filename": str(path)}), mi.SurfaceInteraction3f()


@pytest.mark.parametrize("name", LOBES)
def test_a_lobe_comes_back(tmp_path: Path, name: str) -> None:
    lobe, path, pairs = LOBES[name], tmp_path / f"{name}.bsdf", random_pairs()
    write_rgl(path, lobe)
    expected, found = lobe(pairs)[0].detach(), load(path, dtype=torch.float64).at(pairs)[0]
    off = (found - expected).abs().amax(-1) / expected.amax(-1)
    assert off.median() < 0.004
    assert ((found - expected).abs() * pairs.cos_o[0, :, None]).sum() < 0.02 * (
        expected * pairs.cos_o[0, :, None]
    ).sum()


@pytest.mark.parametrize("name", LOBES)
def test_mitsuba_has_the_same_values(tmp_path: Path, name: str) -> None:
    path, pairs = tmp_path / f"{name}.bsdf", random_pairs(600)
    write_rgl(path, LOBES[name], description="a µ paint")
    mi, bsdf, at = mitsuba_measured(path)
    context, theirs = mi.BSDFContext(), []
    for wi, wo in zip(pairs.wi[0].tolist(), pairs.wo[0].tolist(), strict=True):
        at.wi = wi
        theirs.append(list(bsdf.eval(context, at, wo)))
    ours = (load(path, dtype=torch.float64).at(pairs)[0] * pairs.cos_o[0, :, None]).numpy()
    off = np.abs(ours - np.array(theirs)).max(-1) / np.abs(theirs).max(-1)
    assert np.median(off) < 3e-6
    assert (off < 1e-3).mean() > 0.99


@pytest.mark.parametrize("degrees", [10, 60, 80])
def test_mitsuba_samples_it_well(tmp_path: Path, degrees: int) -> None:
    """The weights of samples, f cos / density, are all about the albedo."""
    path = tmp_path / "paint.bsdf"
    write_rgl(path, LOBES["paint"])
    mi, bsdf, at = mitsuba_measured(path)
    at.wi = [math.sin(math.radians(degrees)), 0, math.cos(math.radians(degrees))]
    places = np.random.default_rng(0).random((2000, 2)).tolist()
    drawn = [bsdf.sample(mi.BSDFContext(), at, 0.5, place) for place in places]
    light = np.array([sum(weight) for _, weight in drawn])
    assert light.std() < 0.25 * light.mean()
    off = [abs(bsdf.pdf(mi.BSDFContext(), at, one.wo) / one.pdf - 1) for one, weight in drawn if sum(weight) > 0]
    assert np.quantile(off, 0.99) < 1e-3


def test_a_black_material_is_black(tmp_path: Path) -> None:
    path, pairs = tmp_path / "black.bsdf", random_pairs(300)
    write_rgl(path, Lambert(albedo=0.0), angles=4, size=8)
    assert (load(path).at(pairs) == 0).all()
    mi, bsdf, at = mitsuba_measured(path)
    at.wi = [0.6, 0, 0.8]
    sampled, weight = bsdf.sample(mi.BSDFContext(), at, 0.5, [0.4, 0.3])
    assert sampled.pdf > 0 and list(weight) == [0, 0, 0]


class Broken(Lobe):
    """Not finite at grazing, as divisions by cosines are."""

    def forward(self, pairs: Pairs) -> torch.Tensor:
        value = torch.where(pairs.cos_o < 0.3, math.nan, 1e30 / pairs.cos_i.clamp_min(1e-30))
        return torch.where(pairs.cos_i > 0.5, 0.1, value)[..., None].expand(*pairs.shape, 3)


@pytest.mark.parametrize("kind", sorted(name for name, lobe in LOBE_KINDS.items() if not lobe.is_anisotropic))
def test_every_lobe_as_it_starts(tmp_path: Path, kind: str) -> None:
    lobe, path, pairs = LOBE_KINDS[kind](), tmp_path / "x.bsdf", random_pairs(1000)
    write_rgl(path, lobe, angles=24, size=48)
    expected, found = lobe(pairs)[0].detach(), load(path, dtype=torch.float64).at(pairs)[0]
    off = (found - expected).abs().sum(-1) * pairs.cos_o[0]
    assert off.sum() < 0.03 * (expected.abs().sum(-1) * pairs.cos_o[0]).sum()


def test_of_a_grain_there_is_the_mean_over_azimuths(tmp_path: Path) -> None:
    brushed = LOBE_KINDS["ggx_anisotropic"](roughness_x=0.2, roughness_y=0.5)
    write_rgl(tmp_path / "x.bsdf", brushed)
    pairs = compared_pairs(300)
    turns = np.radians(np.arange(0, 360, 5))
    with torch.no_grad():
        every = [brushed(Pairs.from_directions(*(_about(way, turn) for way in (pairs.wi, pairs.wo)))) for turn in turns]
    mean = torch.stack(every).mean(0)
    off = ((load(tmp_path / "x.bsdf", dtype=torch.float64).at(pairs) - mean).abs() / mean).median()
    assert off < 0.01


def _about(way: torch.Tensor, turn: float) -> torch.Tensor:
    cos, sin = np.cos(turn), np.sin(turn)
    return way @ torch.tensor([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]], dtype=way.dtype)


def test_what_is_not_finite_or_beyond_all_measure_does_not_spread(tmp_path: Path) -> None:
    path = tmp_path / "broken.bsdf"
    write_rgl(path, Broken(), angles=8, size=16)
    fields = read_bsdf(path)
    assert all(np.isfinite(field).all() for field in fields.values())
    assert load(path).at(random_pairs(300)).isfinite().all()


def test_a_merl_table_with_holes(tmp_path: Path) -> None:
    measured = load(write_raw_merl(tmp_path / "holes.binary", synthetic_raw()), dtype=torch.float64)
    path, pairs = tmp_path / "holes.bsdf", random_pairs()
    write_rgl(path, measured)
    expected, found = measured.at(pairs)[0], load(path, dtype=torch.float64).at(pairs)[0]
    assert ((found - expected).abs().amax(-1) / expected.amax(-1)).median() < 0.1  # its noise is 20 %


def test_a_written_file_that_is_cut_short_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "cut.bsdf"
    write_rgl(path, LOBES["paint"], angles=4, size=4)
    content = path.read_bytes()
    for end in [*range(1, 400, 7), *np.linspace(400, len(content) - 1, 40).astype(int)]:
        path.write_bytes(content[:end])
        with pytest.raises(DataError, match=r"cut\.bsdf"):
            load(path)


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="expected a file or a new name, found a folder"):
        write_rgl(tmp_path, Lambert(), angles=4, size=4)
    with pytest.raises(UsageError):
        write_rgl(tmp_path / "x.bsdf", Lambert().batched(2), angles=4, size=4)
    assert not any(tmp_path.iterdir())


def test_what_cannot_be_written(tmp_path: Path) -> None:
    path = tmp_path / "x.bsdf"
    pairs = random_pairs(10)
    known = Measured.from_samples(pairs, torch.ones(2, 10, 3))
    with pytest.raises(UsageError, match="expected one material, found 2"):
        write_rgl(path, known)
    nothing = Measured.from_samples(pairs, torch.ones(1, 10, 3), torch.zeros(1, 10, 1), names=["none"])
    with pytest.raises(DataError, match="none: expected valid samples, found none"):
        write_rgl(path, nothing)
    with pytest.raises(UsageError, match="expected one material, found 3"):
        write_rgl(path, Lambert().batched(3))
    with pytest.raises(UsageError, match="size: expected a whole number of at least 4, found 1"):
        write_rgl(path, Lambert(), size=1)
    with pytest.raises(UsageError, match=r"angles: .* at least 4, found 8\.5$"):
        write_rgl(path, Lambert(), angles=8.5)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="expected at most 16777216 nodes, found 32 x 1000 x 1000"):
        write_rgl(path, Lambert(), size=1000)
    with pytest.raises(UsageError, match="expected a lobe or a Measured, found 'paint'"):
        write_rgl(path, "paint")  # type: ignore[arg-type]
    assert not any(tmp_path.iterdir())
