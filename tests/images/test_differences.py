"""Image differences: a contract that each keeps by itself."""

import copy
import math
import pickle
from collections.abc import Callable

import pytest
import torch
from helpers.picture_pairs import NAMES, gradient, pictures
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torchbrdf import images
from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.images import DIFFERENCES, Difference, PixelDifference
from torchbrdf.images.differences.compressed_hdr import CompressedHDR
from torchbrdf.images.differences.delta_e_itp import DeltaEITP, DeltaEITPHDR
from torchbrdf.images.differences.flip import FLIP
from torchbrdf.images.differences.log_hdr import LogHDR
from torchbrdf.images.differences.pu21 import PUPSNR, PUSSIM

PIXELWISE = [name for name in NAMES if issubclass(DIFFERENCES[name], PixelDifference)]
SMALL = [name for name in NAMES if DIFFERENCES[name].least_side <= 8]
# Figures of equal pictures that are not 0.
BEST = {"psnr": math.inf, "pu_psnr": math.inf, "ssim": 1.0, "pu_ssim": 1.0, "ms_ssim": 1.0}


# What every difference keeps


@pytest.mark.parametrize("name", NAMES)
def test_every_difference_keeps_the_contract(name: str) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = pictures(difference)
    near = torch.lerp(reference, image, 0.3)
    far, close = difference(image, reference, mask), difference(near, reference, mask)
    assert far.shape == (2,)
    assert ((close > far) == difference.higher_is_better).all()
    # each picture by itself, pixels outside the mask without effect
    assert torch.allclose(difference(image[1:], reference[1:], mask), far[1:])
    elsewhere = torch.where(mask[..., None], image, 0.7)
    assert torch.equal(difference(elsewhere, reference, mask), far)
    same = difference(reference, reference, mask)
    assert torch.allclose(same, torch.full_like(same, BEST.get(name, 0.0)))
    per_picture = mask.expand(2, -1, -1)
    assert torch.equal(difference(image, reference, per_picture), far)
    whole = difference(image, reference)
    assert whole.isfinite().all()
    assert torch.allclose(difference(image, reference, torch.ones_like(mask)), whole)
    assert difference(image, reference, torch.zeros_like(mask)).isnan().all()
    assert difference.registered_name == name


@pytest.mark.parametrize("name", NAMES)
def test_a_function_and_a_reduction_say_the_same(name: str) -> None:
    kind = DIFFERENCES[name]
    image, reference, mask = pictures(kind())
    each = kind()(image, reference, mask)
    function = getattr(images, name)
    assert torch.equal(function(image, reference, mask), each)
    assert torch.equal(function(image, reference, mask, reduction="mean"), each.mean())
    for reduction, reduce in (("mean", torch.mean), ("sum", torch.sum)):
        reduced = kind(reduction=reduction)
        assert isinstance(reduced, torch.nn.Module) and f"reduction='{reduction}'" in repr(reduced)
        assert torch.equal(reduced(image, reference, mask), reduce(each))
        assert torch.equal(reduced.loss(image, reference, mask), reduce(kind().loss(image, reference, mask)))
        copied = pickle.loads(pickle.dumps(copy.deepcopy(reduced)))
        assert torch.equal(copied(image, reference, mask), reduce(each))
    with pytest.raises(UsageError, match=rf"^{kind.__name__}: expected reduction none, mean or sum, found 'max'$"):
        kind(reduction="max")  # type: ignore[arg-type]


def test_settings_reach_the_function() -> None:
    image, reference, mask = pictures(LogHDR())
    assert torch.equal(images.log_hdr(image, reference, eps=0.3), LogHDR(0.3)(image, reference))
    compressed = CompressedHDR(0.7, 0.2)
    assert torch.equal(images.compressed_hdr(image, reference, exponent=0.7, eps=0.2), compressed(image, reference))
    image, reference, mask = pictures(FLIP())
    assert torch.equal(images.flip(image, reference, mask, pixels_per_degree=9), FLIP(9)(image, reference, mask))
    assert torch.equal(images.delta_e_itp(image, reference, peak=300), DeltaEITP(300)(image, reference))
    for name, kind in (("delta_e_itp_hdr", DeltaEITPHDR), ("pu_psnr", PUPSNR), ("pu_ssim", PUSSIM)):
        found = getattr(images, name)(image, reference, white=99)
        assert torch.equal(found, kind(99)(image, reference)) and not torch.equal(found, kind()(image, reference))
        assert repr(kind(99)) == f"{kind.__name__}(white=99, reduction='none')"
    assert repr(CompressedHDR(0.5)) == "CompressedHDR(exponent=0.5, eps=0.001, reduction='none')"


def test_a_former_name_is_found_and_not_listed() -> None:
    assert DIFFERENCES["delta_e"] is DIFFERENCES["delta_e76"]
    assert "delta_e" not in NAMES and DIFFERENCES["delta_e"]().registered_name == "delta_e76"


@pytest.mark.parametrize("name", NAMES)
def test_every_loss_keeps_the_contract(name: str) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = pictures(difference)
    steps = torch.linspace(1, 0, 5, dtype=torch.float64)
    losses = torch.stack([difference.loss(torch.lerp(reference, image, t), reference, mask) for t in steps])
    assert losses.shape == (5, 2)
    assert (losses.diff(dim=0) < 0).all()
    assert (losses[-1] == 0).all()
    assert torch.allclose(difference.loss(image[1:], reference[1:], mask), losses[0, 1:])
    # a step against the gradient lowers it
    slope = gradient(difference, image, reference, mask)
    assert slope.isfinite().all()
    assert (slope[:, ~mask] == 0).all()
    step = 1e-4 / slope.abs().amax((1, 2, 3), keepdim=True)
    assert (difference.loss(image - step * slope, reference, mask) < losses[0]).all()
    assert difference.loss(image, reference, torch.zeros_like(mask)).isnan().all()


@pytest.mark.parametrize("name", NAMES)
def test_what_lies_outside_the_mask_may_be_anything(name: str) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = pictures(difference, batch=1)
    rubbish = torch.where(mask[..., None], image, math.nan)
    assert torch.equal(
        difference(rubbish, reference + ~mask[..., None] * 1e9, mask), difference(image, reference, mask)
    )
    assert gradient(difference, rubbish, reference, mask).isfinite().all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_where_slopes_are_not(name: str, dtype: torch.dtype) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = (x.to(dtype) if x.is_floating_point() else x for x in pictures(difference, batch=1))
    black, white = torch.zeros_like(image), torch.ones_like(image)
    grey = image[..., :1].expand_as(image)
    pairs = [(reference, reference), (black, black), (white, white), (black, white), (black, reference), (image, black)]
    pairs += [(grey, grey), (grey, reference), (black, grey), (reference + 1e-7 * image, reference)]
    for first, second in pairs:
        assert gradient(difference, first, second, mask).isfinite().all()
        loss = difference.loss(first, second, mask)
        assert loss.dtype == dtype
        assert (loss >= 0).all()
        assert (loss == 0).all() or not torch.equal(first, second)


@pytest.mark.parametrize("name", NAMES)
def test_float32_is_enough(name: str) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = pictures(difference)
    figure, loss = difference(image, reference, mask), difference.loss(image, reference, mask)
    slope = gradient(difference, image, reference, mask)
    image, reference = image.float(), reference.float()
    assert torch.allclose(difference(image, reference, mask).double(), figure, rtol=2e-5)
    assert torch.allclose(difference.loss(image, reference, mask).double(), loss, rtol=2e-5)
    error = gradient(difference, image, reference, mask).double() - slope
    assert error.abs().max() < 1e-3 * slope.abs().max()
    # a picture in another precision than its reference is compared in the finer one
    assert difference(image, reference.double(), mask).dtype == torch.float64


@pytest.mark.parametrize("name", NAMES)
def test_the_order_does_not_matter(name: str) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = pictures(difference)
    assert torch.allclose(difference.loss(image, reference, mask), difference.loss(reference, image, mask), rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_pictures_that_do_not_fit_are_refused_in_one_line(name: str) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = pictures(difference)
    kind = type(difference).__name__
    wrong: list[tuple[Tensor, Tensor, Tensor, str]] = [
        (image[0], reference[0], mask, "two pictures"),
        (image[:, :, :-1], reference, mask, "two pictures"),
        (image[:1], reference, mask, "two pictures"),
        (image[..., :2], reference[..., :2], mask, "two pictures"),
        (image, (255 * reference).to(torch.uint8), mask, "floats, found torch.float64 and torch.uint8"),
        (image, reference, mask[:-1], "mask"),
        (image, reference, mask.expand(3, -1, -1), "mask"),
    ]
    if difference.least_side > 1:
        small = difference.least_side - 1
        wrong.append((image[:, :small], reference[:, :small], mask[:small], f"at least {small + 1} x {small + 1}"))
    for first, second, where, reason in wrong:
        for call in (difference, difference.loss):
            with pytest.raises(ShapeError, match=reason) as caught:
                call(first, second, where)
            assert str(caught.value).startswith(kind)
            assert "found" in str(caught.value)
            assert "\n" not in str(caught.value)
    least = difference.least_side
    assert difference(*(x[:, :least, :least] for x in (image, reference))).isfinite().all()


@pytest.mark.parametrize("name", sorted({*NAMES} - {"ssim", "pu_ssim"}))  # kornia's knows no meta device
def test_everything_stays_on_the_device(name: str) -> None:
    # On the meta device any tensor that was made elsewhere is an error.
    difference = DIFFERENCES[name]()
    image, reference, mask = (x.to("meta") for x in pictures(difference))
    for found in (difference(image, reference, mask), difference.loss(image, reference)):
        assert (found.device.type, found.dtype, found.shape) == ("meta", torch.float64, (2,))


@pytest.mark.parametrize("name", SMALL)
def test_gradients_against_finite_differences(name: str) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = pictures(difference, batch=1, side=6)
    image = image.clamp_min(0.01)  # away from the kink of negative radiance
    assert torch.autograd.gradcheck(lambda x: difference.loss(x, reference, mask), image.requires_grad_())
    assert torch.autograd.gradcheck(lambda x: difference(x, reference, mask), image, fast_mode=True)
    assert torch.autograd.gradcheck(
        lambda x: difference.loss(image.detach(), x, mask), reference.requires_grad_(), fast_mode=True
    )


@pytest.mark.parametrize("name", sorted(set(NAMES) - set(SMALL)))
def test_slopes_in_one_direction_against_finite_differences(name: str) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = pictures(difference, batch=1, side=172)
    way = torch.randn(image.shape, dtype=image.dtype, generator=torch.Generator().manual_seed(5))
    expected = (gradient(difference, image, reference, mask) * way).sum()
    ahead, behind = (difference.loss(image + step * way, reference, mask) for step in (1e-5, -1e-5))
    assert torch.allclose((ahead - behind) / 2e-5, expected, rtol=1e-6)


@given(
    values=st.lists(
        st.sampled_from([0.0, 1e-40, 1e-30, 1e-12, 1e-6, 0.04045, 0.5, 1 - 1e-7, 1.0]) | st.floats(0, 1),
        min_size=12,
        max_size=12,
    ),
    name=st.sampled_from(SMALL),
    dtype=st.sampled_from([torch.float32, torch.float64]),
)
def test_no_colours_break_a_loss(values: list[float], name: str, dtype: torch.dtype) -> None:
    difference = DIFFERENCES[name]()
    # Four colours in quarters of 7 x 7 pixels.
    colours = torch.tensor(values, dtype=dtype).reshape(2, 2, 3)
    image = colours.repeat_interleave(4, 0).repeat_interleave(4, 1)[None, :7, :7]
    reference = image.flip(1)
    loss = difference.loss(image, reference)
    assert loss.isfinite().all()
    assert (loss >= 0).all()
    assert gradient(difference, image, reference).isfinite().all()


# Differences of encoded pixels


@pytest.mark.parametrize("name", PIXELWISE)
def test_a_pixel_difference_is_a_mean_over_encoded_pixels(name: str) -> None:
    difference = DIFFERENCES[name]()
    assert isinstance(difference, PixelDifference)
    image, reference, mask = pictures(difference)
    apart = difference.encode(image) - difference.encode(reference)
    assert apart.shape[:-1] == image.shape[:-1]
    square = apart[:, mask].square().sum(-1)
    if difference.power == 2:
        expected = square.mean(-1) / apart.shape[-1]
        if not difference.higher_is_better:
            assert torch.allclose(difference(image, reference, mask), expected.sqrt(), rtol=1e-12)
    else:
        assert difference.power == 1
        expected = square.sqrt().mean(-1)
        assert torch.equal(difference(image, reference, mask), difference.loss(image, reference, mask))
    assert torch.allclose(difference.loss(image, reference, mask), expected, rtol=1e-12)
    # pixel by pixel, in whatever shape they come
    pixels = image[:, mask]
    assert torch.allclose(difference.encode(pixels), difference.encode(image)[:, mask], rtol=1e-12)
    assert torch.allclose(difference.encode(pixels[0, 0]), difference.encode(image)[0, mask][0], rtol=1e-12)


@pytest.mark.parametrize("name", [name for name in NAMES if DIFFERENCES[name].linear])
def test_negative_radiance_counts_as_black(name: str) -> None:
    difference = DIFFERENCES[name]()
    _, reference, mask = pictures(difference)
    black = torch.zeros_like(reference)
    assert torch.equal(difference(black - 0.1, reference, mask), difference(black, reference, mask))
    if isinstance(difference, PixelDifference):  # and black brightens
        assert (gradient(difference, black, reference, mask)[:, mask].sum(-1) < 0).all()


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: LogHDR(eps=0), "eps"),
        (lambda: CompressedHDR(eps=-1), "eps"),
        (lambda: CompressedHDR(exponent=0), "exponent"),
        (lambda: FLIP(0), "pixels_per_degree"),
        (lambda: FLIP(math.nan), "pixels_per_degree"),
        (lambda: DeltaEITP(0), r"^DeltaEITP: expected peak in cd/m\^2, above 0 and at most 10000, found 0$"),
        (lambda: DeltaEITPHDR(math.nan), "white"),
        (lambda: PUPSNR(10_001), "white"),
        (lambda: PUSSIM(-1), "white"),
    ],
)
def test_settings_out_of_range(make: Callable[[], Difference], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        make()
