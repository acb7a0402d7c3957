"""Pictures as sparse products on compact pairs, against the quadrature that they are made of."""

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.painted import MATERIALS
from torch import Tensor

from torchbrdf import memory
from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.lobes import Lambert, Ward
from torchbrdf.measured import load, merl_values, write_merl
from torchbrdf.pairs import Pairs
from torchbrdf.render import Camera, DirectionalLight, Environment, PointLight, Scene, blob, render, sphere
from torchbrdf.render.draw import render_by_transport, render_directly
from torchbrdf.render.transport import quadrature
from torchbrdf.render.transport.transport import Transport

LIGHTS = (DirectionalLight((1, 2, 2), 1.5), PointLight((0, 3, 3), (9.0, 8.0, 7.0)))


def make(size: int = 24, **settings: object) -> Scene:
    return Scene(blob(), Camera(15.0), Environment.default(), size=size, **settings)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def small() -> Scene:
    return make()


@pytest.fixture(scope="module")
def lit() -> Scene:
    return make(punctual_lights=LIGHTS)


def on(scene: Scene, dtype: torch.dtype = torch.float32) -> Tensor:
    with torch.no_grad():
        pairs = scene.pairs.to(dtype=dtype)
        return torch.cat([material.to(dtype=dtype)(pairs) for material in MATERIALS.values()])


def dense(transport: Transport) -> Tensor:
    """The matrix, `(3, P, N)`, entry by entry."""
    matrix = torch.zeros(3, len(transport.index), transport.count)
    for block in transport.blocks:
        for k, row in enumerate(block.rows.tolist()):
            for entry in range(int(block.start[k]), int(block.start[k + 1])):
                matrix[:, row, block.column[entry]] += block.value[:, entry]
    return matrix


@pytest.mark.parametrize("punctual_lights", [(), LIGHTS])
def test_the_picture_is_that_of_the_quadrature(punctual_lights: tuple[DirectionalLight | PointLight, ...]) -> None:
    """Within what bins cost, dB after tone mapping, and in all energy."""
    scene = make(48, punctual_lights=punctual_lights)
    assert scene.pairs.above_horizon.all()
    found, expected = scene.transport @ on(scene), render_directly([*MATERIALS.values()], scene)
    for name, one, other in zip(MATERIALS, found, expected, strict=True):
        tone = ToneMap.from_images(other, scene.mask)
        quality = DIFFERENCES["psnr"]()(tone(one)[None], tone(other)[None], scene.mask).item()
        assert quality > 45, name
        assert one.sum().item() == pytest.approx(other.sum().item(), rel=2e-3), name
        assert not one[~scene.mask].any()


def test_punctual_lights_alone_have_pairs_of_their_own() -> None:
    scene = Scene(sphere(4), Camera(), size=16, punctual_lights=LIGHTS)
    expected = render_directly([*MATERIALS.values()], scene)
    torch.testing.assert_close(scene.transport @ on(scene), expected, rtol=1e-3, atol=1e-5)


def test_what_the_pairs_know_fits_together(lit: Scene) -> None:
    known = lit.pairs.to(dtype=torch.float64)
    derived = Pairs.from_half_diff(known.theta_h, known.theta_d, known.phi_d)
    for name in ("cos_h", "cos_d"):
        torch.testing.assert_close(getattr(known, name), getattr(derived, name), atol=1e-6, rtol=0)
    # phi_d is folded by reciprocity, which exchanges the directions
    cosines = [torch.stack([one.cos_i, one.cos_o]).sort(0).values for one in (known, derived)]
    torch.testing.assert_close(*cosines, atol=1e-5, rtol=0)
    torch.testing.assert_close(known.tan2_h, derived.tan2_h, atol=1e-6, rtol=1e-3)


def test_few_pairs_serve_many_pixels(small: Scene) -> None:
    assert len(small.pairs) < small.transport.entries / 3


def test_products_are_those_of_the_matrix(lit: Scene) -> None:
    transport, generator = lit.transport, torch.Generator().manual_seed(0)
    values = torch.rand(2, transport.count, 3, generator=generator)
    matrix = dense(transport)
    torch.testing.assert_close(transport.pixels(values), torch.einsum("cpn,mnc->mpc", matrix, values))
    shapes = torch.rand(11, transport.count, generator=generator)
    torch.testing.assert_close(transport.columns(shapes), torch.einsum("cpn,kn->kcp", matrix, shapes))
    gradient = torch.rand(2, len(transport.index), 3, generator=generator)
    torch.testing.assert_close(transport.backward(gradient), torch.einsum("cpn,mpc->mnc", matrix, gradient))
    thin, kept = transport.select_rows(torch.tensor([5, 3, 100]))
    torch.testing.assert_close(dense(thin), matrix[:, [5, 3, 100]][..., kept])
    assert not matrix[:, [5, 3, 100]].sum(0)[:, np.setdiff1d(np.arange(transport.count), kept)].any()
    assert torch.equal(thin.index, transport.index[[5, 3, 100]])


def test_it_is_differentiable() -> None:
    scene = Scene(
        sphere(3), Camera(), size=3, nodes=8, light_samples=16, resolution=(8, 8, 8), punctual_lights=LIGHTS[:1]
    )
    values = torch.rand(2, len(scene.pairs), 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert torch.autograd.gradcheck(lambda one: scene.transport @ one, values.requires_grad_())
    lobe = Ward(specular=0.5, roughness=torch.tensor([0.2], dtype=torch.float64))
    pairs = scene.pairs.to(dtype=torch.float64)

    def picture(roughness: Tensor) -> Tensor:
        return scene.transport @ Ward.function(pairs, lobe.specular.detach().double(), roughness)[None].squeeze(1)

    assert torch.autograd.gradcheck(picture, lobe.roughness)


def test_too_large_a_transport_is_made_anew_for_each_product(lit: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    assert lit.transport.in_memory  # made now, before what follows
    monkeypatch.setattr(memory, "limit", lambda: 0)
    monkeypatch.setattr(quadrature, "CHUNK", 20_000)
    streamed = make(punctual_lights=LIGHTS)
    assert not streamed.transport.in_memory
    values = on(lit).requires_grad_()
    found, expected = streamed.transport @ values, lit.transport @ values
    torch.testing.assert_close(found, expected)
    weight = torch.rand(found.shape, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(*(torch.autograd.grad((one * weight).sum(), values)[0] for one in (found, expected)))
    torch.testing.assert_close(streamed.transport.columns(values[0].T), lit.transport.columns(values[0].T))
    rows = torch.arange(0, 90, 7)
    (thin, kept), (other, same) = (one.transport.select_rows(rows) for one in (streamed, lit))
    assert torch.equal(kept, same)
    torch.testing.assert_close(thin @ values[:, kept], other @ values[:, kept])


# --- many pictures ----------------------------------------------------------------------------------------------------


def test_pictures_are_the_same_whether_entries_are_kept_or_not() -> None:
    """And as the matrix has them, but for the rounding of weights to half precision."""
    kept, streamed = make(punctual_lights=LIGHTS).compact, make(punctual_lights=LIGHTS).compact
    streamed.room = 0
    values = on(make(punctual_lights=LIGHTS))
    first = kept.pixels(values)
    assert kept._kept is not None and torch.equal(kept.pixels(values), first)
    kept.forget()
    assert torch.equal(kept.pixels(values), first)
    assert torch.equal(streamed.pixels(values), first) and streamed._kept is None
    single = torch.cat([streamed.pixels(one[None]) for one in values])
    torch.testing.assert_close(single, first, rtol=1e-5, atol=1e-6)
    exact = make(punctual_lights=LIGHTS).transport.pixels(values)
    torch.testing.assert_close(first, exact, rtol=1e-3, atol=1e-4)
    assert ((first - exact).square().mean() / exact.square().mean()).log10() < -8  # 80 dB


def test_a_picture_does_not_depend_on_those_beside_it() -> None:
    """To the last bit: a fit that is its material has no difference from it."""
    compact = make().compact
    one = torch.rand(1, len(compact.pairs), 3, generator=torch.Generator().manual_seed(0))
    alone = compact.pixels(one)
    for count in (2, 5, 16, 21, 33, 50):
        every = compact.pixels(one.expand(count, -1, -1))
        assert all(torch.equal(picture, alone[0]) for picture in every), count


def test_entries_take_no_more_room_than_they_may() -> None:
    compact = make(16).compact
    values = torch.rand(1, len(compact.pairs), 3)
    compact.pixels(values)
    assert compact._kept is not None
    taken = sum(block.nbytes for blocks in compact._kept for block in blocks)
    compact.forget()
    compact.room = taken - 1
    compact.pixels(values)
    assert compact._kept is None


@pytest.mark.parametrize("asked", [8192, 64])
def test_few_pixels_say_where_pairs_are(asked: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sharp lobes included, 45 dB from every pair by itself; of 64 pixels, too, which fill half of the bins."""
    monkeypatch.setattr(quadrature, "_ASKED", asked)
    scene = make(48)
    found = render_by_transport([*MATERIALS.values()], scene)
    for name, one, other in zip(MATERIALS, found, render_directly([*MATERIALS.values()], scene), strict=True):
        tone = ToneMap.from_images(other, scene.mask)
        assert DIFFERENCES["psnr"]()(tone(one)[None], tone(other)[None], scene.mask).item() > 45, name


def test_the_coordinates_of_bins_are_those_of_their_pairs(small: Scene) -> None:
    lights = small._quadratures[1]
    assert isinstance(lights, quadrature.LightQuadrature)
    rows = torch.arange(0, len(small._pixels), 7)
    places, counted, _ = lights._places(rows)
    pairs, weight = lights.samples(rows)
    heavy = counted.flatten() > 1e-3
    assert heavy.sum() > 1000
    torch.testing.assert_close(weight.sum(-1).flatten() > 0, counted.flatten() > 0)
    found = quadrature._pairs_at(torch.stack([place.flatten() for place in places]).double())
    for name in ("theta_h", "theta_d", "phi_d"):
        away = (getattr(found, name)[0] - getattr(pairs, name)[0].double())[heavy]
        assert (away.sin() if name == "phi_d" else away).abs().max() < 2e-3, name


def test_a_table_is_drawn_by_a_transport_and_what_follows_in_its_scene_too(tmp_path: Path) -> None:
    path, ward = tmp_path / "ward.binary", Ward(roughness=0.2)
    write_merl(path, merl_values(ward).clamp(0))
    scene = make()
    assert torch.equal(render(ward, scene), render_directly([ward], scene)) and not scene.is_compact
    table = render(load(path), scene)
    assert scene.is_compact and torch.equal(table, render_by_transport([load(path)], scene))
    assert torch.equal(render(ward, scene), render_by_transport([ward], scene))
    plain = Lambert(albedo=0.5), lambda pairs: Lambert(albedo=0.5)(pairs)[0]
    assert torch.equal(render(list(plain), scene)[0], render_directly(plain[:1], scene)[0])


def test_memory_is_limited() -> None:
    with memory.limited(0.125):
        assert make(8).compact.room == 2**26


def test_shapes_that_do_not_fit(small: Scene) -> None:
    values = on(small)
    for wrong in (values[:, 1:], values[0], values[..., :2]):
        with pytest.raises(ShapeError, match=r"transport: expected values"):
            small.transport @ wrong
    with pytest.raises(ShapeError, match=r"transport: expected functions"):
        small.transport.columns(values[0])
    with pytest.raises(UsageError, match="resolution"):
        make(resolution=(2, 45, 30))
