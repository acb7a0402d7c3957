"""Files for BRDF Explorer: their GLSL gives the values of the lobes."""

import math
from pathlib import Path

import pytest
import torch
from helpers.directions import hemisphere
from helpers.glsl import BrdfFile, evaluate_all

from torchbrdf.errors import DataError
from torchbrdf.export import export
from torchbrdf.export.brdf import glsl
from torchbrdf.lobes import LOBES, Lobe, Sum
from torchbrdf.pairs import Pairs
from torchbrdf.render.raster.backends import find_opengl

WITH_GLSL = [name for name in LOBES if glsl(name)]
OPENGL = pytest.mark.skipif(not find_opengl().renderer, reason=f"needs OpenGL: {find_opengl().reason}")


def directions(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Some anywhere, some around the mirror's direction, some about the horizon; of single precision."""
    wi = hemisphere(count, seed=1)
    mirror = wi * torch.tensor([-1.0, -1.0, 1.0]) + 0.1 * hemisphere(count, seed=2)
    wo = torch.where(torch.arange(count)[:, None] % 2 == 0, mirror, hemisphere(count, seed=3))
    low = torch.arange(count) % 10 == 1
    wo[low, 2] *= -0.05
    return tuple((one / one.norm(dim=-1, keepdim=True)).float().double() for one in (wi, wo))  # type: ignore[return-value]


def materials(name: str) -> list[Lobe]:
    """A lobe with its start, and with others of its bounds."""
    kind = LOBES[name]
    generator = torch.Generator().manual_seed(len(name))
    found = [kind(dtype=torch.float64)]
    for _ in range(3):
        values = {}
        for own, spec in kind.parameter_specs.items():
            share = 0.1 + 0.8 * torch.rand(spec.shape, generator=generator, dtype=torch.float64)
            ends = (math.log(spec.lower), math.log(spec.upper)) if spec.log else (spec.lower, spec.upper)
            value = ends[0] + share * (ends[1] - ends[0])
            values[own] = (value.exp() if spec.log else value).float().double()
        found.append(kind(**values))
    return found


@OPENGL
@pytest.mark.parametrize("name", WITH_GLSL)
def test_the_shader_gives_the_values(name: str, tmp_path: Path) -> None:
    wi, wo = directions(1000)
    pairs, models, files = Pairs.from_directions(wi, wo), materials(name), []
    for model in models:
        done = export(model, "brdf", tmp_path, name=name)
        assert done.exact and done.shown is not None
        files.append(BrdfFile.read(done.files[0]))
    for model, found in zip(models, evaluate_all(files, wi, wo), strict=True):
        with torch.no_grad():
            values = model(pairs)
        assert (found[~pairs.above_horizon] == 0).all() and (~pairs.above_horizon).sum() > 50
        torch.testing.assert_close(found, values, rtol=1e-4, atol=1e-7)


@OPENGL
def test_the_lobes_of_a_sum_are_added(tmp_path: Path) -> None:
    model = Sum(*(materials(name)[1] for name in ("oren_nayar", "ggx", "ggx", "ward")))
    path = export(model, "brdf", tmp_path).files[0]
    found = BrdfFile.read(path)
    names = [name for _, name, _ in found.parameters]
    assert names[:2] == ["albedo_1", "roughness_1"] and "f0_3" in names and names[-1] == "roughness_4"
    wi, wo = directions(1000)
    with torch.no_grad():
        values = model(Pairs.from_directions(wi, wo))
    torch.testing.assert_close(found.evaluate(wi, wo), values, rtol=1e-4, atol=1e-7)


def test_parameters_have_the_bounds_of_the_lobe(tmp_path: Path) -> None:
    kind = LOBES["ggx"]
    path = export(kind(specular=[0.1, 0.2, 0.3], roughness=0.25, f0=0.04), "brdf", tmp_path).files[0]
    assert BrdfFile.read(path).parameters == [
        ("color", "specular_1", [0.1, 0.2, 0.3]),
        ("float", "roughness_1", [0.001, 1.0, 0.25]),
        ("float", "f0_1", [0.02, 1.0, 0.04]),
    ]


def test_every_file_of_glsl_is_of_a_lobe() -> None:
    from torchbrdf.export import brdf

    files = {path.stem for path in (Path(brdf.__file__).parent / brdf.SHADERS).glob("*.glsl")}
    assert files - {brdf.COMMON} == set(WITH_GLSL)


class Unknown(Lobe):
    """A lobe without GLSL."""

    def forward(self, pairs: Pairs) -> torch.Tensor:
        return (0.1 * pairs.cos_h)[..., None].expand(*pairs.shape, 3)


def test_anything_else_is_a_merl_table(tmp_path: Path) -> None:
    done = export(Unknown(), "brdf", tmp_path, name="paint")
    assert not done.exact and [path.name for path in done.files] == ["paint.binary"]
    again = export(done.files[0], "brdf", tmp_path / "again")
    assert again.exact and again.files[0].read_bytes() == done.files[0].read_bytes()
    with pytest.raises(DataError, match="found the file that is exported"):
        export(done.files[0], "brdf", tmp_path)
