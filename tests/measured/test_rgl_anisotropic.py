"""RGL files with several phi_i: a known BRDF comes back, Mitsuba agrees, and what does not fit is refused."""

import math
import pickle

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import anisotropic_bsdf, brushed, tensor_file

from torchbrdf.errors import DataError
from torchbrdf.measured import describe, load
from torchbrdf.pairs import Pairs

COLOR = torch.tensor([1.0, 0.5, 0.25], dtype=torch.float64)


def written(folder, fields, name="brushed_rgb.bsdf"):
    path = folder / name
    path.write_bytes(tensor_file(fields))
    return path


def known(wi, wo):
    return torch.from_numpy(brushed(wi.numpy(), wo.numpy()))[..., None] * COLOR


@pytest.mark.parametrize("parts", [1, 2, 4])
def test_a_known_brdf_comes_back(parts, tmp_path):
    path = written(tmp_path, anisotropic_bsdf(parts, azimuths=1 + 16 // parts))
    measured = load(path, dtype=torch.float64)
    assert measured.is_anisotropic and measured.names == ["brushed"]
    good = (measured.weight[0, :, 0] > 0) & (measured.pairs.cos_o[0] > 0.02)  # nearer to the horizon f is bounded
    assert good.double().mean() > 0.3
    pairs = measured.pairs.select(samples=good.nonzero()[:, 0])
    torch.testing.assert_close(measured.values[:, good], known(pairs.wi, pairs.wo), rtol=2e-3, atol=2e-3)
    # At the samples it is the samples, up to how D is interpolated; all around, between them, it is near.
    low = (pairs.cos_o[0] > 0.1) & (pairs.cos_i[0] > 0.1)
    low &= pairs.wi[0, :, 1].abs() > 1e-3  # at an end of the azimuths it is the samples of the other end, turned
    torch.testing.assert_close(measured.at(pairs)[0, low], measured.values[0, good][low], rtol=1e-4, atol=1e-4)
    wi, wo = (hemisphere(1, 3000, seed=seed).double() for seed in (0, 1))
    keep = (wi[0, :, 2] > 0.3) & (wo[0, :, 2] > 0.3)
    wi, wo = wi[:, keep], wo[:, keep]
    off = (measured.at(Pairs.from_directions(wi, wo)) / known(wi, wo) - 1).abs()
    assert off.median() < 0.04 and off.quantile(0.95) < 0.2
    far = measured.distance_at(Pairs.from_directions(wi, wo))[0]
    assert far.median() < 6 and far.quantile(0.95) < 15
    # Not of a turned surface.
    turned = (
        torch.stack([-wi[..., 1], wi[..., 0], wi[..., 2]], -1),
        torch.stack([-wo[..., 1], wo[..., 0], wo[..., 2]], -1),
    )
    assert (measured.at(Pairs.from_directions(*turned)) / known(wi, wo) - 1).abs().median() > 0.1
    assert f"{1 + 16 // parts} azimuths of the light over {360 // parts} degrees" in describe(path)["anisotropic"]
    assert len(pickle.dumps(measured)) < 20_000


@pytest.mark.parametrize("parts", [1, 2, 4])
def test_as_mitsuba_has_it(parts, tmp_path):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    path = written(tmp_path, anisotropic_bsdf(parts))
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    context, at = mi.BSDFContext(), mi.SurfaceInteraction3f()
    wi, wo = hemisphere(400, seed=3), hemisphere(400, seed=4)
    # Where one is 0, Mitsuba's own turns are not consistent.
    wi[:4] = torch.tensor([[0.6, 1e-6, 0.8], [-0.6, -1e-6, 0.8], [1e-6, 0.6, 0.8], [-1e-6, -0.6, 0.8]])
    high = (wi[:, 2] > 0.05) & (wo[:, 2] > 0.05)
    wi, wo = wi[high], wo[high]
    expected = []
    for a, b in zip(wi.tolist(), wo.tolist(), strict=True):
        at.wi = a
        expected.append(list(bsdf.eval(context, at, b)))
    expected = np.array(expected) / wo[:, 2:].numpy()
    found = load(path, dtype=torch.float64).at(Pairs.from_directions(wi[None], wo[None]))[0].numpy()
    off = np.abs(found - expected).max(-1) / np.abs(expected).max(-1)
    assert np.median(off) < 3e-6 and off.max() < 1e-3


def test_holes_and_the_nearest(tmp_path):
    fields = anisotropic_bsdf()
    fields["rgb"][3, :, 1] = np.nan
    measured = load(written(tmp_path, fields), dtype=torch.float64)
    wi, wo = hemisphere(1, 500).double(), hemisphere(1, 500, seed=1).double()
    for interpolation in ("linear", "nearest"):
        assert measured.lookup(Pairs.from_directions(wi, wo), interpolation).values.isfinite().all()


@pytest.mark.parametrize(
    ("phi", "says"),
    [
        ([-math.pi, 0], "phi_i: expected one, or three and more that grow from -pi on, found -3.142, 0"),
        (np.linspace(0, -math.pi, 9), "phi_i: expected one, or three and more that grow"),
        (np.linspace(-math.pi, -1, 9), "phi_i: expected a whole, a half or a quarter turn from -pi on"),
        (np.linspace(0, math.pi, 9), "found 0 to 3.142"),
        (np.linspace(-180, 0, 9), "phi_i: expected one, or three and more"),
        (np.linspace(-math.pi, 0, 8), "field 'vndf': expected (8, 8, n, n)"),
    ],
)
def test_azimuths_that_are_none(phi, says, tmp_path):
    fields = {**anisotropic_bsdf(), "phi_i": np.array(phi, "f4")}
    with pytest.raises(DataError) as caught:
        load(written(tmp_path, fields))
    assert says in str(caught.value) and "brushed_rgb.bsdf" in str(caught.value)
