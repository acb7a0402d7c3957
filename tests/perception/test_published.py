"""Published fits: read with the right conventions, against plain formulas and against tables they were made for."""

import json
import math
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
import torch
from helpers.published_formulas import PLAIN, Angles, directions

from torchbrdf.errors import DataError, UsageError
from torchbrdf.fitting import fit
from torchbrdf.lobes import (
    FitRecord,
    Lambert,
    ShiftedGamma,
    Sum,
    make_model,
    model_name,
    model_of,
    parameters,
    read_fits,
    write_fits,
)
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.losses import CompressedLoss
from torchbrdf.measured import Measured, load, standins
from torchbrdf.pairs import Pairs
from torchbrdf.perception.datasets.published import SETS, PublishedFits, read_published

Array = np.ndarray
COUNTS = {"ngan_ward": 86, "ngan_blinnphong": 86, "ngan_cooktorrance": 86, "ngan_ashikhminshirley": 86} | {
    "ngan_lafortune": 86,
    "ngan_he": 86,
    "ngan_wardduer": 86,
    "low_cooktorrance_E1": 100,
    "low_cooktorrance_E2": 100,
    "low_ashikhminshirley_E1": 100,
    "low_ashikhminshirley_E2": 100,
    "low_lowmicrofacet_E2": 100,
    "low_lowsmooth_E2": 100,
    "bagher_sgd": 100,
}


@pytest.fixture(scope="session")
def file(data: Path) -> Path:
    """The collected fits, which are no part of the project."""
    path = data / "fits" / "published_fits.json"
    if not path.is_file():
        pytest.skip(f"needs published fits: no file {path}")
    return path


@pytest.fixture(scope="session")
def published(file: Path) -> dict[str, PublishedFits]:
    return read_published(file, dtype=torch.float64)


def test_every_set_has_a_formula_here() -> None:
    assert set(PLAIN) == set(SETS)


def test_every_published_set_is_read(file: Path, published: dict[str, PublishedFits]) -> None:
    assert set(published) == set(json.loads(file.read_text())) == set(SETS)


@pytest.mark.parametrize("name", PLAIN)
def test_values_are_those_of_the_tables_formulas(name: str, file: Path, published: dict[str, PublishedFits]) -> None:
    """Every material, from the numbers in the file: albedos, conventions, and Ngan's channels."""
    raw = json.loads(file.read_text())[name]
    wi, wo = directions()
    g = Angles(wi, wo)
    found = published[name].model(Pairs.from_directions(torch.from_numpy(wi), torch.from_numpy(wo))).detach().numpy()
    assert published[name].materials == list(raw) and len(raw) == COUNTS[name]
    for row, numbers in zip(found, raw.values(), strict=True):
        factor = np.array((1, 1.15, 1.66) if name.startswith("ngan") else (1, 1, 1))
        expected = factor * (np.array(numbers["diffuse"]) / math.pi + PLAIN[name](g, numbers))
        # 1 - zh and zh^n of the plain formulas lose digits where lobes are sharp.
        np.testing.assert_allclose(row, expected, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("name", PLAIN)
def test_float32_holds_what_was_published(name: str, file: Path, published: dict[str, PublishedFits]) -> None:
    """c up to 1e109, k up to 856 and exponents up to 121000 in single precision."""
    single = read_published(file, dtype=torch.float32)[name].model
    wi, wo = (torch.from_numpy(x).float() for x in directions())
    exact = published[name].model(Pairs.from_directions(wi.double(), wo.double())).detach()
    found = single(Pairs.from_directions(wi, wo)).detach()
    assert found.dtype == torch.float32
    error = (found.double() - exact).abs() / (exact + 1e-6 * exact.amax(1, keepdim=True))
    assert error.max() < 2e-3
    assert error.flatten().quantile(0.99) < 2e-5


def test_published_k_is_the_normalization(published: dict[str, PublishedFits]) -> None:
    """All 300 K of Bagher et al. are 1 / (alpha Gamma(1 - p, alpha)): the distribution is the one that we have."""
    lobe = published["bagher_sgd"].model.components()[1]
    assert isinstance(lobe, ShiftedGamma)
    columns = (value.flatten().tolist() for value in (lobe.alpha, lobe.p, lobe.normalization))
    for alpha, p, k in zip(*columns, strict=True):
        assert k == pytest.approx(1 / (alpha * float(mpmath.gammainc(1 - p, alpha))), rel=1e-4)


def test_blinn_phong_is_of_the_half_vector(published: dict[str, PublishedFits]) -> None:
    """n is about 2 / alpha^2 of Ward's fit of the same material; of the mirror direction it would be a quarter."""
    ward, phong = published["ngan_ward"], published["ngan_blinnphong"]
    assert ward.materials == phong.materials
    alpha, n = ward.model.components()[1].roughness, phong.model.components()[1].exponent
    assert 0.8 < (n * alpha.square() / 2).median() < 1.6
    for widths in (0.0, 0.25, 0.5, 1.0):  # the lobes themselves, near the normal
        theta_h = torch.atan(widths * alpha)
        pairs = Pairs.from_half_diff(theta_h, torch.full_like(theta_h, 0.1), torch.full_like(theta_h, math.pi / 2))
        value, other = (fits.model.components()[1](pairs) for fits in (phong, ward))
        assert 0.7 < (value / other).median() < 1.4


def test_ngan_lacks_the_channels(file: Path, published: dict[str, PublishedFits]) -> None:
    """The diffuse albedos of others for the same materials, which came with the scales, say so."""
    raw = read_published(file, dtype=torch.float64, channel_scales=False)["ngan_cooktorrance"]
    other = published["bagher_sgd"].of(raw.materials).components()[0].albedo
    for fits, expected in ((raw, (1, 1.15, 1.66)), (published["ngan_cooktorrance"], (1, 1, 1))):
        albedo = fits.model.components()[0].albedo
        bright = (albedo > 0.05).all(-1)
        ratio = (other / albedo)[bright]
        found = (ratio / ratio[:, :1]).median(0).values
        torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), rtol=0.06, atol=0)
    for fits in (published["bagher_sgd"], published["low_lowmicrofacet_E2"]):
        bare = read_published(file, dtype=torch.float64, channel_scales=False)[fits.name]
        torch.testing.assert_close(get_parameters(bare.model), get_parameters(fits.model), rtol=0, atol=0)


def stand_ins() -> Measured:
    """The bundled stand-ins at random pairs within 80 degrees, half of them near the mirror direction."""
    wi, wo = (torch.from_numpy(x) for x in directions())
    keep = (wi[:, 2] > 0.174) & (wo[:, 2] > 0.174)
    pairs = Pairs.from_directions(wi[keep][None], wo[keep][None])
    tables = load(standins(), dtype=torch.float64)
    return Measured.from_samples(pairs, tables.at(pairs), names=tables.names)


@pytest.mark.parametrize("name", SETS)
def test_they_come_close_to_the_materials(name: str, file: Path, published: dict[str, PublishedFits]) -> None:
    """Errors are of the order of our own fits' with one Ward lobe, which minimise this very error on these pairs."""
    measured = stand_ins()
    measured = measured.batch([k for k, one in enumerate(measured.names) if one in published[name].materials])
    loss = CompressedLoss(reduction="none")

    def error(values: torch.Tensor) -> torch.Tensor:
        return loss(values, measured.values, measured.pairs).detach()

    ward = make_model("ward", 1, dtype=torch.float64)
    own = fit(ward, measured, CompressedLoss(), diffuse="fit", samples=None)
    found = error(published[name].of(measured.names)(measured.pairs))
    assert len(found) >= 8
    assert 0.1 < (found / own.error).median() < 2.5
    if SETS[name].raw:
        bare = read_published(file, dtype=torch.float64, channel_scales=False)[name]
        assert (found < error(bare.of(measured.names)(measured.pairs))).double().mean() > 0.7
    else:  # a pi too many or too few is what conventions differ by
        diffuse, specular = (part(measured.pairs) for part in published[name].of(measured.names).components())
        for factor in (math.pi, 1 / math.pi):
            assert (found < error(diffuse + factor * specular)).double().mean() > 0.7


@pytest.mark.slow
def test_shifted_gamma_is_fitted() -> None:
    """By the general solver, from its start, in values of another model: better than Ward, which has no such tails."""
    measured = stand_ins().batch([0])
    errors = {
        name: fit(make_model(name, 1, dtype=torch.float64), measured, CompressedLoss(), diffuse="fit").error.item()
        for name in ("ward", "shifted_gamma")
    }
    assert errors["shifted_gamma"] < 0.6 * errors["ward"]


@pytest.mark.parametrize("name", PLAIN)
def test_they_go_through_fits_json(name: str, published: dict[str, PublishedFits], tmp_path: Path) -> None:
    fits = published[name]
    kind, lobes = model_name(fits.model)
    records = [FitRecord(material, kind, lobes, parameters(fits.model, k)) for k, material in enumerate(fits.materials)]
    write_fits(tmp_path / "fits.json", records)
    again = model_of(read_fits(tmp_path / "fits.json"))
    torch.testing.assert_close(get_parameters(again.double()), get_parameters(fits.model), rtol=1e-7, atol=1e-30)


def synthetic_sets() -> dict[str, Any]:
    """Two sets, one of them not known."""
    fit = {"diffuse": [0.1, 0.2, 0.3], "model": "NganWard", "specular": [0.01, 0.02, 0.03], "roughness": 0.1}
    return {"ngan_ward": {"tin": fit, "zinc": {**fit, "roughness": 1}}, "low_somebody": {"tin": {}}}


def write(folder: Path, content: Any) -> Path:
    path = folder / "fits.json"
    path.write_text(json.dumps(content))
    return path


def test_a_set(tmp_path: Path) -> None:
    (fits,) = read_published(write(tmp_path, synthetic_sets())).values()
    assert (fits.name, fits.materials, len(fits)) == ("ngan_ward", ["tin", "zinc"], 2)
    assert "Ngan" in fits.source
    assert isinstance(fits.model, Sum) and isinstance(fits.model.components()[0], Lambert)
    values = get_parameters(fits.model)
    expected = {
        "lobes.0.albedo": [[0.1, 0.23, 0.498]] * 2,
        "lobes.1.specular": [[0.01, 0.023, 0.0498]] * 2,
        "lobes.1.roughness": [[0.1], [1.0]],
    }
    torch.testing.assert_close(values, {name: torch.tensor(value) for name, value in expected.items()})
    torch.testing.assert_close(
        get_parameters(fits.of(["zinc", "tin", "zinc"])), {name: value[[1, 0, 1]] for name, value in values.items()}
    )
    with pytest.raises(UsageError, match=r"^ngan_ward: expected one of its 2 materials, found 'lead'$"):
        fits.of(["tin", "lead"])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("roughness", None, "roughness: expected a number, found None"),
        ("roughness", [0.1], r"roughness: expected a number, found \[0.1\]"),
        ("roughness", True, "roughness: expected a number, found True"),
        ("roughness", 0.0, r"roughness: expected numbers from 1e-12 to 1e\+10, found 0.0"),
        ("roughness", 10**18, r"roughness: expected numbers from 1e-12 to 1e\+10, found 1000000000000000000"),
        ("specular", [0.1, 0.2], r"specular: expected 3 numbers, found \[0.1, 0.2\]"),
        ("specular", [0.1, 0.2, "0.3"], r"specular: expected 3 numbers, found \[0.1, 0.2, '0.3'\]"),
        ("diffuse", [0.1, -0.3, 0.2], r"diffuse: expected numbers from 0 to 1e\+10, found \[0.1, -0.3, 0.2\]"),
        ("diffuse", ..., "diffuse: expected 3 numbers, found no such field"),
        ("model", "NganHe", "model: expected 'NganWard', found 'NganHe'"),
    ],
)
def test_bad_fields_are_named(field: str, value: Any, message: str, tmp_path: Path) -> None:
    content = synthetic_sets()
    if value is ...:
        del content["ngan_ward"]["zinc"][field]
    else:
        content["ngan_ward"]["zinc"] = {**content["ngan_ward"]["zinc"], field: value}
    path = write(tmp_path, content)
    with pytest.raises(DataError, match=rf"^{path}: ngan_ward, zinc, {message}$"):
        read_published(path)


def test_a_reflectance_is_one(tmp_path: Path) -> None:
    fit = {"diffuse": [0.1] * 3, "model": "NganCookTorrance", "specular": [0.1] * 3, "roughness": 0.1, "eta": 1.5}
    with pytest.raises(DataError, match=r"tin, eta: expected numbers from 0 to 1, found 1\.5"):
        read_published(write(tmp_path, {"ngan_cooktorrance": {"tin": fit}}))


def test_numbers_that_make_no_finite_parameter_are_named(tmp_path: Path) -> None:
    fit = {"diffuse": [0.1] * 3, "model": "Bagher", "eta": [[0.1] * 3] * 2}
    fit |= {name: [0.5] * 3 for name in ("specular", "alpha", "p", "K", "Lambda", "c", "k", "theta0")}
    path = write(tmp_path, {"bagher_sgd": {"tin": fit, "zinc": {**fit, "k": [0.5, 1e-9, 0.5]}}})
    with pytest.raises(DataError, match=rf"^{path}: bagher_sgd, zinc: expected numbers that make a finite reach$"):
        read_published(path)


def test_bad_files_are_named(tmp_path: Path) -> None:
    missing = tmp_path / "none.json"
    with pytest.raises(
        DataError, match=rf"^{missing}: no such file; expected the fits of https://github.com/bsdfbench"
    ):
        read_published(missing)
    for content in ({}, {"low_somebody": {}}):
        with pytest.raises(DataError, match=r"expected the fits of .*, found none of the .*bagher_sgd$"):
            read_published(write(tmp_path, content))
    for content in ([], 3, {"ngan_ward": {"tin": {"roughness": math.nan}}}):
        with pytest.raises(DataError, match=r"^[^\n]*fits\.json: expected the fits of [^\n]*, found [^\n]*$"):
            read_published(write(tmp_path, content))
    with pytest.raises(DataError, match="ngan_ward: expected a name"):
        read_published(write(tmp_path, {"ngan_ward": {"../tin": {}}}))
    for content, found in ({"ngan_ward": {}}, "{}"), ({"ngan_ward": 3}, "3"):
        with pytest.raises(DataError, match=rf": ngan_ward: expected fits by material, found {found}$"):
            read_published(write(tmp_path, content))
    with pytest.raises(DataError, match=r"ngan_ward, tin: expected the fields of a fit, found \[1\]$"):
        read_published(write(tmp_path, {"ngan_ward": {"tin": [1]}}))
    (tmp_path / "fits.json").write_text("[" * 100_000)
    with pytest.raises(DataError, match=r"^[^\n]*fits\.json: expected the fits of [^\n]*, found [^\n]*$"):
        read_published(tmp_path / "fits.json")
