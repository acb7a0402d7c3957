"""Materials for pbrt-v4, whose text is read back by its grammar."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.pbrt_files import materials_of

from torchbrdf.export import Exported, export
from torchbrdf.export.pbrt import PbrtConductor
from torchbrdf.export.spectra import BASIS, WAVELENGTHS
from torchbrdf.lobes import GGX, Lambert, Lobe, Sum, Ward
from torchbrdf.measured import load
from torchbrdf.measured.tensor_file import TensorFile
from torchbrdf.pairs import Pairs


def parsed(path: Path) -> tuple[str, dict[str, Any]]:
    """The name and the parameters of a file with one named material."""
    (material,) = materials_of(path)
    return material


def table_of(done: Exported) -> dict[str, np.ndarray]:
    """The fields of the table that a material names."""
    file = TensorFile(done.files[0].parent / parsed(done.files[0])[1]["string filename"][0])
    return {name: file.array(name, field.shape, field.dtype.kind) for name, field in file.fields.items()}


def test_lambert_is_diffuse(tmp_path: Path) -> None:
    black = GGX(specular=0.0)
    done = export(Sum(Lambert(albedo=[0.3, 0.2, 0.1]), black), "pbrt", tmp_path, name='a "paint" #1')
    name, parameters = parsed(done.files[0])
    assert done.exact and len(done.files) == 1
    assert name == 'a "paint" #1'
    assert parameters == {"string type": ["diffuse"], "rgb reflectance": [0.3, 0.2, 0.1]}


def test_a_metal_is_a_conductor(tmp_path: Path) -> None:
    metal = GGX(specular=0.9, roughness=0.25, f0=0.9)
    done = export(Sum(Lambert(albedo=0.0), metal), "pbrt", tmp_path)
    _, parameters = parsed(done.files[0])
    assert not done.exact and done.notes[0].startswith("refitted: pbrt's conductor")
    assert parameters == {
        "string type": ["conductor"],
        "rgb reflectance": [pytest.approx(0.81)] * 3,
        "float roughness": [0.25],
        "bool remaproughness": [False],
    }
    assert isinstance(done.shown, PbrtConductor)
    wi, wo = (hemisphere(500, seed=seed) for seed in (1, 2))
    with torch.no_grad():
        shown = done.shown.double()(Pairs.from_directions(wi, wo))
    torch.testing.assert_close(shown[:, 0], pbrt_conductor(wi, wo, 0.81, 0.25), rtol=1e-5, atol=1e-9)


def pbrt_conductor(wi: torch.Tensor, wo: torch.Tensor, reflectance: float, alpha: float) -> torch.Tensor:
    """By the formulas of the book, 9.16 and 9.6, with complex numbers."""
    half = (wi + wo) / (wi + wo).norm(dim=-1, keepdim=True)
    cos_d = (wi * half).sum(-1).numpy()
    k = 2 * np.sqrt(reflectance) / np.sqrt(1 - reflectance)
    index = 1 + 1j * k
    cos_t = np.sqrt(1 - (1 - cos_d**2) / index**2)
    along = (index * cos_d - cos_t) / (index * cos_d + cos_t)
    across = (cos_d - index * cos_t) / (cos_d + index * cos_t)
    fresnel = (abs(along) ** 2 + abs(across) ** 2) / 2

    def lambda_of(w: torch.Tensor) -> torch.Tensor:
        tan2 = (w[:, 0] ** 2 + w[:, 1] ** 2) / w[:, 2] ** 2
        return ((1 + alpha**2 * tan2).sqrt() - 1) / 2

    tan2 = (half[:, 0] ** 2 + half[:, 1] ** 2) / half[:, 2] ** 2
    facets = 1 / (np.pi * alpha**2 * half[:, 2] ** 4 * (1 + tan2 / alpha**2) ** 2)
    visible = 1 / (1 + lambda_of(wi) + lambda_of(wo))
    return facets * visible * torch.from_numpy(fresnel) / (4 * wi[:, 2] * wo[:, 2])


@pytest.mark.parametrize(
    "model",
    [
        Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.1, roughness=0.2)),
        GGX(specular=0.5, f0=0.04),  # of a dielectric, whose Fresnel term is no metal's
        Sum(Lambert(albedo=0.1), GGX(specular=0.9, f0=0.9)),
    ],
)
def test_anything_else_is_measured(model: Lobe, tmp_path: Path) -> None:
    done = export(model, "pbrt", tmp_path, name="paint")
    name, parameters = parsed(done.files[0])
    assert name == "paint" and [path.name for path in done.files] == ["paint.pbrt", "paint_spec.bsdf"]
    assert parameters == {"string type": ["measured"], "string filename": ["paint_spec.bsdf"]}
    fields = table_of(done)
    phi, theta = len(fields["phi_i"]), len(fields["theta_i"])
    size = fields["luminance"].shape[-1]
    # What pbrt expects of a file.
    assert fields["description"].dtype == "u1" and fields["jacobian"].tolist() == [1]
    assert fields["spectra"].shape == (phi, theta, len(fields["wavelengths"]), size, size)
    assert fields["vndf"].shape[:2] == fields["luminance"].shape[:2] == (phi, theta)
    assert fields["ndf"].ndim == fields["sigma"].ndim == 2
    assert "rgb" not in fields


def test_the_spectra_are_the_colours_of_the_table(tmp_path: Path) -> None:
    model = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.1, roughness=0.2))
    spectra = table_of(export(model, "pbrt", tmp_path))["spectra"]
    rgb = table_of_file(export(model, "rgl", tmp_path).files[0])
    seen = np.einsum("ck,btkxy->btcxy", white_light(), spectra)
    np.testing.assert_allclose(seen, rgb, rtol=1e-3, atol=1e-3 * np.abs(rgb).mean())


def table_of_file(path: Path) -> np.ndarray:
    file = TensorFile(path)
    return file.array("rgb", file.fields["rgb"].shape)


def white_light() -> np.ndarray:
    """What a spectrum on the wavelengths is in linear sRGB, lit by D65: a row a channel."""
    colour = pytest.importorskip("colour", reason="needs colour-science")
    shape = colour.SpectralShape(360, 780, 1)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values[:, None] * observer
    nodes = [np.interp(shape.wavelengths, WAVELENGTHS, row) for row in np.eye(len(WAVELENGTHS))]
    rgb = np.linalg.inv(colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ) @ (light.T @ np.stack(nodes, 1))
    return rgb / rgb.sum(1, keepdims=True)


def test_a_basis_of_spectra_gives_the_primaries() -> None:
    np.testing.assert_allclose(white_light() @ BASIS.T, np.eye(3), atol=1e-4)
    np.testing.assert_allclose(BASIS.sum(0), 1, atol=1e-9)
    assert BASIS.min() >= 0


def test_a_table_is_what_is_shown(tmp_path: Path) -> None:
    model = Ward(specular=[0.1, 0.2, 0.1], roughness=0.3)
    shown = export(model, "pbrt", tmp_path).shown
    pairs = Pairs.from_directions(*(hemisphere(200, seed=seed)[None] for seed in (1, 2)))
    expected = load(export(model, "rgl", tmp_path).files[0]).at(pairs)
    torch.testing.assert_close(shown.at(pairs), expected)  # type: ignore[union-attr]
