"""RGL measurements: against Mitsuba's `measured` plugin, a plain reading, and physics; and files that are none."""

import itertools
import math

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import read_bsdf, synthetic_bsdf, tensor_file
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from torchbrdf.errors import DataError
from torchbrdf.measured import load
from torchbrdf.measured.warp import Warp
from torchbrdf.pairs import Pairs


@pytest.fixture
def synthetic_file(tmp_path):
    path = tmp_path / "made-up_rgb.bsdf"
    path.write_bytes(tensor_file(synthetic_bsdf()))
    return path


def written(tmp_path, **changes):
    fields = {**synthetic_bsdf(), **changes}
    path = tmp_path / "changed.bsdf"
    path.write_bytes(tensor_file({name: value for name, value in fields.items() if value is not None}))
    return path


def mitsuba_values(path, wi, wo):
    """f cos_o, as Mitsuba has it, in float32."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    context, at = mi.BSDFContext(), mi.SurfaceInteraction3f()
    found = []
    for a, b in zip(wi.tolist(), wo.tolist(), strict=True):
        at.wi = a
        found.append(list(bsdf.eval(context, at, b)))
    return np.array(found)


def check_with_mitsuba(path, count, seed):
    wi, wo = hemisphere(count, seed=seed), hemisphere(count, seed=seed + 1)
    wi[: count // 4], wo[: count // 4, 0] = wo[: count // 4], -wo[: count // 4, 0]
    wo[: count // 4] += 0.03 * hemisphere(count // 4, seed=seed + 2)  # a quarter of them near the mirror direction
    wi, wo = (d / d.norm(dim=-1, keepdim=True) for d in (wi, wo))
    high = (wi[:, 2] > 1e-3) & (wo[:, 2] > math.cos(math.radians(89)))
    wi, wo = wi[high], wo[high]
    expected = mitsuba_values(path, wi, wo) / wo[:, 2:].numpy()
    found = load(path, dtype=torch.float64).at(Pairs.from_directions(wi[None], wo[None]))[0].numpy()
    lit = np.abs(expected).max(-1) > 0
    assert (found[~lit] == 0).all()
    off = (np.abs(found - expected)[lit] / np.abs(expected[lit]).max(-1, keepdims=True)).max(-1)
    assert np.median(off) < 3e-6
    off = off[torch.minimum(wi[:, 2], wo[:, 2]).numpy()[lit] > math.cos(math.radians(85))]
    assert len(off) > count / 2
    assert (off < 1e-3).mean() > 0.995  # Mitsuba computes in float32, which steep warps magnify


@pytest.mark.parametrize("factor", [1, 0])
def test_synthetic_file_against_mitsuba(tmp_path, factor):
    check_with_mitsuba(written(tmp_path, jacobian=np.array([factor], "u1")), 600, seed=10)


@pytest.mark.parametrize("name", ["paper_white", "cg_sunflower", "vch_ultra_pink", "chm_light_blue", "ilm_l3_37_matte"])
def test_real_files_against_mitsuba(data, name):
    check_with_mitsuba(data / "rgl" / f"{name}_rgb.bsdf", 600, seed=20)


def check_samples(path):
    """Stored values, by wi and wo of the samples, with the factors from one-dimensional tables."""
    fields = read_bsdf(path)
    measured = load(path, dtype=torch.float64)
    slices, size = fields["rgb"].shape[1], fields["rgb"].shape[-1]
    wi, wo = measured.pairs.wi[0].numpy(), measured.pairs.wo[0].numpy()
    assert wi.shape == (slices * size * size, 3)
    theta_i = np.repeat(fields["theta_i"].astype(float), size * size)
    np.testing.assert_allclose(wi, np.stack([np.sin(theta_i), 0 * theta_i, np.cos(theta_i)], -1), atol=1e-12)
    half = wi + wo
    theta_h = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
    for name in ("ndf", "sigma"):
        assert np.ptp(fields[name], axis=0).max() < 1e-6 * fields[name].max()
    nodes = np.linspace(0, 1, fields["ndf"].shape[1])
    normals = np.interp(np.sqrt(theta_h * 2 / np.pi), nodes, fields["ndf"][0])
    visible = np.interp(np.sqrt(theta_i * 2 / np.pi), nodes, fields["sigma"][0])
    stored = np.moveaxis(fields["rgb"][0], 1, -1).reshape(-1, 3)
    valid = measured.weight[0, :, 0].numpy() > 0
    expected = stored * (normals / (4 * visible * np.maximum(wo[:, 2], math.cos(math.radians(89)))))[:, None]
    np.testing.assert_allclose(measured.values[0].numpy()[valid], expected[valid], rtol=1e-5)
    assert (measured.values[0].numpy()[~valid] == 0).all()
    above = (theta_i < np.radians(89.9)) & (wo[:, 2] > 0)
    assert (valid == above).all()
    return fields, measured, valid


def test_samples_of_a_synthetic_file(synthetic_file):
    check_samples(synthetic_file)


@pytest.mark.parametrize("name", ["paper_white", "cg_sunflower", "vch_ultra_pink", "satin_purple"])
def test_samples_of_real_files(data, name):
    path = data / "rgl" / f"{name}_rgb.bsdf"
    fields, _, valid = check_samples(path)
    slices, size = fields["rgb"].shape[1], fields["rgb"].shape[-1]
    # The files say which samples are above the horizon, one bit each (some files: which are not): the warp agrees.
    bits = np.unpackbits(fields["valid"]).reshape(slices, -1).astype(bool)
    bits = bits if bits.mean() > 0.5 else ~bits
    assert (bits[:-1] == valid.reshape(slices, size * size)[:-1]).all()  # the last theta_i is 90 degrees


@pytest.mark.parametrize("seed", range(3))
def test_at_the_samples_it_is_the_samples(tmp_path, seed):
    path = tmp_path / "x.bsdf"
    path.write_bytes(tensor_file(synthetic_bsdf(seed)))
    check_at_samples(path, 1e-6)


def test_at_the_samples_of_a_real_file(data):
    # Where the density of visible normals is almost 0, near the horizon, the position in the grid is badly determined.
    check_at_samples(data / "rgl" / "aurora_white_rgb.bsdf", 1e-5)


def check_at_samples(path, worst):
    measured = load(path, dtype=torch.float64)
    size = measured.source._files[0].spectrum.shape[1]
    node = torch.arange(len(measured.pairs))
    # At u = 0 all nodes are the mirror direction, and the first and last row have the same directions.
    inside = (node % size > 0) & (node // size % size > 0) & (node // size % size < size - 1)
    use = inside & (measured.weight[0, :, 0] > 0)
    pairs = measured.pairs.select(samples=use.nonzero()[:, 0])
    expected = measured.values[:, use]
    scale = expected.abs().amax(-1, keepdim=True).clamp_min(1e-9)
    for interpolation in ("linear", "nearest"):
        found = measured.lookup(pairs, interpolation)
        off = (found.values - expected).abs() / scale
        assert off.max() < worst
        assert off.median() < 1e-11
        assert found.filled.tolist() == [0]


def test_values_have_no_cosine(data):
    """Reciprocity fails by the quotient of the cosines if they have; white paper's albedo is at most 1, and high."""
    measured = load([data / "rgl" / f"{n}_rgb.bsdf" for n in ("paper_white", "colodur_connemara_4c", "satin_purple")])
    phi = torch.linspace(0.5, math.pi, 50)
    a = torch.tensor([math.sin(0.26), 0, math.cos(0.26)]).expand(50, 3)
    b = torch.stack([math.sin(1.13) * phi.cos(), math.sin(1.13) * phi.sin(), torch.full_like(phi, math.cos(1.13))], -1)
    there, back = (measured.at(Pairs.from_directions(*pair)) for pair in ((a[None], b[None]), (b[None], a[None])))
    quotient = (there / back).median(1).values
    assert ((quotient - 1).abs() < 0.03).all()
    wo = hemisphere(1, 5_000, seed=5, dtype=torch.float32)
    for theta in (0.1, 0.6, 1.0):
        wi = torch.tensor([math.sin(theta), 0, math.cos(theta)]).expand_as(wo)
        albedo = (measured.at(Pairs.from_directions(wi, wo)) * wo[..., 2:]).mean(1) * 2 * math.pi
        assert (albedo[0] > 0.7).all()
        assert (albedo < 1).all()


def test_all_real_files(data):
    measured = load(data / "rgl", dtype=torch.float64)
    assert len(measured) == 16
    assert "paper_white" in measured.names
    assert measured.values.shape == (16, 8 * 64 * 64, 3)
    sunflower = measured.names.index("cg_sunflower")
    small = [k for k in range(16) if k != sunflower]
    assert (measured.weight[small, 8 * 32 * 32 :] == 0).all()
    assert measured.weight[sunflower].mean() > 0.75
    assert (measured.pairs.wi.norm(dim=-1) - 1).abs().max() < 1e-12
    luminance = measured.values @ torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    assert (luminance >= 0).all()
    details = measured.source.details(sunflower)
    assert details["share of stored values that are negative"] == pytest.approx([0, 0, 0.79], abs=0.005)
    negative = (measured.values[sunflower] < 0).any(-1).sum()
    assert details["samples with a negative channel"] == negative > 20_000
    pairs = Pairs.from_directions(
        hemisphere(1, 500, dtype=torch.float32), hemisphere(1, 500, seed=1, dtype=torch.float32)
    )
    together = measured.at(pairs)
    assert together.dtype == torch.float32
    alone = load(measured.source.paths[3]).at(pairs)
    assert torch.equal(together[3], alone[0])
    each = Pairs(**{name: value.expand(2, *value.shape[1:]) for name, value in pairs.items()})
    assert torch.equal(measured.batch([3, 5]).at(each), together[[3, 5]])


def test_values_that_are_not_finite_are_holes(tmp_path):
    rgb = synthetic_bsdf()["rgb"].copy()
    rgb[0, 1, 2, 3, 4] = np.nan
    rgb[0, 2, :, 2:6, 2:6] = np.inf
    measured = load(written(tmp_path, rgb=rgb), dtype=torch.float64)
    weight = measured.weight[0, :, 0].reshape(5, 8, 8)
    assert weight[1, 3, 4] == 0
    assert (weight[2, 2:6, 2:6] == 0).all()
    whole = load(written(tmp_path), dtype=torch.float64)
    pairs = whole.pairs.select(samples=torch.tensor([2 * 64 + 3 * 8 + 3]))
    looked = measured.lookup(pairs, "nearest")
    assert looked.filled.tolist() == [1]
    assert looked.values.isfinite().all()
    assert measured.values.isfinite().all()


def test_zero_below_the_horizon_and_bounded_at_it(synthetic_file):
    measured = load(synthetic_file)
    wi = hemisphere(1, 200, dtype=torch.float32)
    below = wi * torch.tensor([1.0, 1, -1])
    for pair in ((wi, below), (below, wi), (wi, -wi)):
        assert (measured.at(Pairs.from_directions(*pair)) == 0).all()
    edge = wi.clone()
    edge[..., 2] = 1e-30
    assert measured.at(Pairs.from_directions(wi, edge)).abs().max() < 1e3


def test_pairs_whose_azimuth_is_folded_to_half_a_turn(synthetic_file):
    """As scenes have them: their cosines alone say which direction is the light's."""
    measured = load(synthetic_file)
    pairs = Pairs.from_directions(hemisphere(1, 500), hemisphere(1, 500, seed=1))
    names = ("theta_h", "theta_d", "cos_h", "cos_d", "cos_i", "cos_o", "tan2_h")
    folded = Pairs(phi_d=pairs.phi_d % math.pi, **{name: getattr(pairs, name) for name in names})
    unfolded = Pairs.from_half_diff(folded.theta_h, folded.theta_d, folded.phi_d)
    assert ((unfolded.wi - pairs.wi)[..., 2].abs() > 0.1).double().mean() > 0.2
    torch.testing.assert_close(folded.wi[..., 2], pairs.cos_i, rtol=0, atol=1e-6)
    torch.testing.assert_close(measured.at(folded), measured.at(pairs), rtol=1e-6, atol=1e-9)


BAD = {
    "phi_i has two": ({"phi_i": np.zeros(3, "f4")}, r"phi_i: expected one, or three and more"),
    "only spectra": ({"rgb": None, "spectra": np.zeros(3, "f4")}, r"expected a field 'wavelengths', found"),
    "wavelengths that fall": (
        {"rgb": None, "spectra": np.zeros((1, 5, 2, 8, 8), "f4"), "wavelengths": np.array([500, 400], "f4")},
        r"wavelengths: expected numbers that grow, in nm, found \(500",
    ),
    "other wavelengths": (
        {"rgb": None, "spectra": np.zeros((1, 5, 3, 8, 8), "f4"), "wavelengths": np.array([400, 500], "f4")},
        r"field 'spectra': expected \(1, 5, 2, n, n\)",
    ),
    "no values": ({"rgb": None}, r"expected a field 'rgb', found"),
    "theta_i falls": ({"theta_i": np.linspace(1, 0, 5).astype("f4")}, r"theta_i: expected angles that grow"),
    "theta_i is nan": ({"theta_i": np.full(5, np.nan, "f4")}, r"theta_i: expected angles that grow"),
    "theta_i in degrees": ({"theta_i": np.linspace(0, 90, 5).astype("f4")}, r"theta_i: expected angles that grow"),
    "theta_i has one": ({"theta_i": np.zeros(1, "f4")}, r"theta_i: expected angles that grow"),
    "no ndf": ({"ndf": None}, r"expected a field 'ndf', found 'version', 'description', 'phi_i'"),
    "vndf shape": ({"vndf": np.ones((1, 4, 8, 8), "f4")}, r"field 'vndf': expected \(1, 5, n, n\) .* \(1, 4, 8, 8\)"),
    "vndf empty": ({"vndf": np.ones((1, 5, 0, 8), "f4")}, r"field 'vndf': expected \(1, 5, n, n\)"),
    "vndf row": ({"vndf": np.ones((1, 5, 1, 8), "f4")}, r"vndf: expected a grid of 2 x 2 or more, found \(1, 8\)"),
    "vndf zero": ({"vndf": np.zeros((1, 5, 8, 8), "f4")}, r"vndf: expected a sum above 0, found only zeros"),
    "ndf negative": ({"ndf": -np.ones((2, 8), "f4")}, r"ndf: expected values from 0 to 1e.08, found -"),
    "sigma nan": ({"sigma": np.full((2, 8), np.nan, "f4")}, r"sigma: expected values from 1e-06 to 1e.08, found nan"),
    "sigma zero": ({"sigma": np.zeros((2, 8), "f4")}, r"sigma: expected values from 1e-06 to 1e.08, found 0.0"),
    "ndf huge": ({"ndf": np.full((2, 8), 1e30, "f4")}, r"ndf: expected values from 0 to 1e.08, found 1.0000000150"),
    "theta_i stands still": ({"theta_i": np.array([0, 1, 1 + 1e-6, 1.2, 1.5])}, r"theta_i: expected angles that grow"),
    "theta_i inf": (
        {"theta_i": np.array([0, -np.inf, 1, 1.2, 1.5], "f4")},
        r"theta_i: .*, found 0, -inf, 1, 1.2, 1.5$",
    ),
    "rgb huge": ({"rgb": np.full((1, 5, 3, 8, 8), 1e30, "f4")}, r"values: no finite value of at most 1e.06"),
    "rgb nan": ({"rgb": np.full((1, 5, 3, 8, 8), np.nan, "f4")}, r"values: no finite value"),
    "rgb has 4": ({"rgb": np.ones((1, 5, 4, 8, 8), "f4")}, r"field 'rgb': expected \(1, 5, 3, n, n\)"),
    "rgb of bytes": ({"rgb": np.ones((1, 5, 3, 8, 8), "u1")}, r"of kind 'f', found .* of uint8"),
    "rgb one node": ({"rgb": np.ones((1, 5, 3, 1, 1), "f4")}, r"values: expected a grid of 2 x 2"),
    "jacobian": ({"jacobian": np.ones(1, "f4")}, r"field 'jacobian': expected \(1\) of kind 'u'"),
}


@pytest.mark.parametrize("case", BAD)
def test_fields_that_do_not_fit(tmp_path, case):
    changes, says = BAD[case]
    with pytest.raises(DataError, match=says) as caught:
        load(written(tmp_path, **changes))
    assert "changed.bsdf" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_truncation_is_an_error(tmp_path):
    content = tensor_file(synthetic_bsdf(size=2, density=2, angles=2))
    path = tmp_path / "cut.bsdf"
    for end in [*range(400), *range(400, len(content), 7), len(content) - 1]:
        path.write_bytes(content[:end])
        with pytest.raises(DataError, match=r"cut\.bsdf"):
            load(path)


SMALL = tensor_file(synthetic_bsdf(size=2, density=3, angles=3))
HEADER = SMALL.index(b"made up")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=300)
@given(st.lists(st.tuples(st.integers(12, HEADER), st.integers(0, 255)), min_size=1, max_size=4), st.binary(max_size=3))
def test_changed_bytes_in_the_header_load_or_are_an_error(tmp_path, changes, behind):
    check_fuzzed(tmp_path, changes, behind)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
@given(st.lists(st.tuples(st.integers(0, len(SMALL) - 1), st.integers(0, 255)), min_size=1, max_size=30))
def test_changed_bytes_anywhere_load_or_are_an_error(tmp_path, changes):
    check_fuzzed(tmp_path, changes, b"")


def check_fuzzed(tmp_path, changes, behind):
    content = bytearray(SMALL)
    for where, byte in changes:
        content[where] = byte
    path = tmp_path / "fuzzed.bsdf"
    path.write_bytes(bytes(content) + behind)
    try:
        measured = load(path, dtype=torch.float64)
    except DataError as error:
        assert "fuzzed.bsdf" in str(error)
        assert "\n" not in str(error)
        return
    assert measured.values.isfinite().all()
    measured.at(Pairs.from_directions(hemisphere(1, 20), hemisphere(1, 20, seed=1)))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300))
def test_any_bytes_behind_the_magic_are_an_error(tmp_path, content):
    path = tmp_path / "fuzzed.bsdf"
    path.write_bytes(b"tensor_file\0\x01\0" + content)
    with pytest.raises(DataError, match=r"fuzzed\.bsdf"):
        load(path)


densities = hnp.arrays(
    float,
    st.tuples(st.integers(1, 3), st.integers(2, 6), st.integers(2, 6)),
    elements=st.floats(0, 1000, allow_subnormal=False) | st.just(0.0),
).map(lambda density: density + 1e-3)


@given(densities, st.integers(0, 1000))
def test_warp_and_back(density, seed):
    warp = Warp(torch.from_numpy(density))
    u, v = torch.rand(2, 6, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    where = warp.sample(u, v)
    assert ((where >= 0) & (where <= 1)).all()
    wanted = torch.stack([u.expand(6, 6), v[:, None].expand(6, 6)], -1)
    for k in range(len(density)):
        place = torch.full((36,), float(k), dtype=torch.float64)
        back = torch.stack(warp.invert(warp.cells(), [place], *where[k].flatten(0, 1).unbind(-1)), -1)
        assert (back - wanted.flatten(0, 1)).abs().max() < 1e-8


def test_inverse_warp_is_the_integral_of_the_density():
    """Marginal and conditional distributions by adding up many small cells."""
    density = np.random.default_rng(0).uniform(0.1, 2, (2, 4, 5))
    warp = Warp(torch.from_numpy(density))
    fine = 400
    x, y = (np.arange(fine) + 0.5) / fine * 4, (np.arange(fine) + 0.5) / fine * 3
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - i, (y - j)[:, None]

    def bilinear(d):
        low = d[j][:, i] * (1 - fx) + d[j][:, i + 1] * fx
        high = d[j + 1][:, i] * (1 - fx) + d[j + 1][:, i + 1] * fx
        return low * (1 - fy) + high * fy

    mixed = sum(share * bilinear(d) / bilinear(d).sum() for share, d in zip((0.25, 0.75), density, strict=True))
    for row, column in itertools.product((40, 200, 333), repeat=2):
        where = [torch.tensor([(k + 1) / fine], dtype=torch.float64) for k in (column, row)]
        u, v = warp.invert(warp.cells(), [torch.tensor([0.75], dtype=torch.float64)], *where)
        assert v.item() == pytest.approx(mixed[: row + 1].sum(), abs=1e-5)
        line = (mixed[row] + mixed[row + 1]) / 2
        assert u.item() == pytest.approx(line[: column + 1].sum() / line.sum(), abs=1e-5)
