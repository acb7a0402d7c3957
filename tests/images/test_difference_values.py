"""Image differences against formulas written out here, published numbers, and other people's programs."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from helpers.picture_pairs import gradient, pair, pictures
from scipy.signal import correlate2d
from torch import Tensor

from torchbrdf.images import DIFFERENCES
from torchbrdf.images.differences.delta_e76 import lab
from torchbrdf.images.differences.delta_e2000 import ciede2000
from torchbrdf.images.differences.flip import FLIP

# Formulas written out


def plain_psnr(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    return 10 * math.log10(1 / np.mean((image[mask] - reference[mask]) ** 2))


def gaussian() -> np.ndarray:
    """11 taps, sigma 1.5."""
    taps = np.exp(-((np.arange(11) - 5) ** 2) / (2 * 1.5**2))
    return taps / taps.sum()


def wang_maps(x: np.ndarray, y: np.ndarray, blur: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Luminance, and contrast with structure."""
    mx, my = blur(x), blur(y)
    vx, vy, cov = blur(x * x) - mx**2, blur(y * y) - my**2, blur(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    return (2 * mx * my + c1) / (mx**2 + my**2 + c1), (2 * cov + c2) / (vx + vy + c2)


def plain_ssim(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    """Grey outside the mask."""
    return wang_ssim(*(np.where(mask[..., None], x, 0.5) for x in (image, reference)), mask)


def wang_ssim(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    """Wang's formula with an 11-tap Gaussian window, sigma 1.5, mirrored borders."""

    def blur(plane: np.ndarray) -> np.ndarray:
        return correlate2d(np.pad(plane, 5, mode="reflect"), np.outer(gaussian(), gaussian()), mode="valid")

    maps = [np.prod(wang_maps(image[..., k], reference[..., k], blur), 0) for k in range(3)]
    return float(np.mean([plane[mask] for plane in maps]))


def plain_ms_ssim(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    """The authors' procedure: windows inside the picture; a mirrored 2 x 2 mean, of which every other is kept."""

    def blur(plane: np.ndarray) -> np.ndarray:
        return correlate2d(np.apply_along_axis(np.convolve, 0, plane, gaussian(), "valid"), gaussian()[None], "valid")

    def halved(plane: np.ndarray) -> np.ndarray:
        wide = np.pad(plane, [(0, 1), (0, 1)], mode="symmetric")
        return ((wide[:-1, :-1] + wide[1:, :-1] + wide[:-1, 1:] + wide[1:, 1:]) / 4)[::2, ::2]

    products = []
    for k in range(3):
        x, y = (np.where(mask, picture[..., k], 0.5) for picture in (image, reference))
        seen, product = mask.astype(float), 1.0
        for scale, exponent in enumerate([0.0448, 0.2856, 0.3001, 0.2363, 0.1333]):
            if scale:
                x, y, seen = halved(x), halved(y), halved(seen)
            luminance, rest = wang_maps(x, y, blur)
            product *= np.average(luminance * rest if scale == 4 else rest, weights=blur(seen)) ** exponent
        products.append(product)
    return float(np.mean(products))


def plain_delta_e76(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    """IEC 61966-2-1 and CIE 15."""
    to_xyz = np.array(
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    )

    def lab(display: np.ndarray) -> np.ndarray:
        linear = np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
        xyz = linear @ to_xyz.T / [0.95047, 1.0, 1.08883]
        root = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
        x, y, z = np.moveaxis(root, -1, 0)
        return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)

    return float(np.linalg.norm(lab(image) - lab(reference), axis=-1)[mask].mean())


def plain_log(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    return math.sqrt(np.mean((np.log(image[mask] + 1e-2) - np.log(reference[mask] + 1e-2)) ** 2))


def plain_compressed(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    return math.sqrt(np.mean((np.cbrt(image[mask] + 1e-3) - np.cbrt(reference[mask] + 1e-3)) ** 2))


def plain_pu21(radiance: np.ndarray) -> np.ndarray:
    """As the authors' program has it, of 203 cd/m^2 for radiance 1, with 256 for the largest display value."""
    power = (203 * radiance) ** 0.9062562627
    quotient = (0.353487901 + 0.3734658629 * power) / (1 + 8.277049286e-05 * power)
    return 596.3148142 * (quotient**0.09150303166 - 0.9099517204) / 256


def plain_pu_psnr(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    return plain_psnr(plain_pu21(image), plain_pu21(reference), mask)


def plain_pu_ssim(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    return wang_ssim(*(plain_pu21(np.where(mask[..., None], x, 0.5)) for x in (image, reference)), mask)


@pytest.mark.parametrize(
    ("name", "plain", "tolerance"),
    [
        ("psnr", plain_psnr, 1e-12),
        ("ssim", plain_ssim, 1e-9),
        ("ms_ssim", plain_ms_ssim, 1e-9),
        ("delta_e76", plain_delta_e76, 1e-4),
        ("log_hdr", plain_log, 1e-12),
        ("compressed_hdr", plain_compressed, 1e-12),
        ("pu_psnr", plain_pu_psnr, 1e-4),
        ("pu_ssim", plain_pu_ssim, 1e-4),
    ],
)
def test_differences_against_plain_numpy(name: str, plain, tolerance: float) -> None:
    difference = DIFFERENCES[name]()
    image, reference, mask = pictures(difference)
    found = difference(image, reference, mask)
    expected = [plain(image[k].numpy(), reference[k].numpy(), mask.numpy()) for k in range(2)]
    np.testing.assert_allclose(found.numpy(), expected, rtol=tolerance)


def test_a_mask_in_a_corner_has_an_ms_ssim() -> None:
    image, reference, mask = pictures(DIFFERENCES["ms_ssim"]())
    mask[:, 4:] = False
    mask[4:] = False
    assert DIFFERENCES["ms_ssim"]()(image, reference, mask).isfinite().all()


def test_unlike_pictures_have_no_negative_ms_ssim() -> None:
    difference = DIFFERENCES["ms_ssim"]()
    _, reference, mask = pictures(difference)
    assert (difference(1 - reference, reference, mask) == 0).all()
    assert (difference.loss(1 - reference, reference, mask) == 1).all()
    assert gradient(difference, 1 - reference, reference, mask).isfinite().all()


# Table 1 of G. Sharma et al., doi:10.1002/col.20070.
SHARMA = [
    (50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425),
    (50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615),
    (50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412),
    (50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000),
    (50.0000, -1.1848, -84.8006, 50.0000, 0.0000, -82.7485, 1.0000),
    (50.0000, -0.9009, -85.5211, 50.0000, 0.0000, -82.7485, 1.0000),
    (50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669),
    (50.0000, -1.0000, 2.0000, 50.0000, 0.0000, 0.0000, 2.3669),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0010, 7.1792),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0012, 7.2195),
    (50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045),
    (50.0000, -0.0010, 2.4900, 50.0000, 0.0010, -2.4900, 4.8045),
    (50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461),
    (50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065),
    (50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492),
    (50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977),
    (50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030),
    (50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535),
    (50.0000, 2.5000, 0.0000, 50.0000, 3.1736, 0.5854, 1.0000),
    (50.0000, 2.5000, 0.0000, 50.0000, 3.2972, 0.0000, 1.0000),
    (50.0000, 2.5000, 0.0000, 50.0000, 1.8634, 0.5757, 1.0000),
    (50.0000, 2.5000, 0.0000, 50.0000, 3.2592, 0.3350, 1.0000),
    (60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644),
    (63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630),
    (61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731),
    (35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645),
    (22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373),
    (36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146),
    (90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441),
    (90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381),
    (6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377),
    (2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082),
]


def test_ciede2000_gives_the_published_numbers() -> None:
    table = torch.tensor(SHARMA, dtype=torch.float64)
    first, second, expected = table[:, :3], table[:, 3:6], table[:, 6]
    for found in (ciede2000(first, second), ciede2000(second, first)):
        assert (found - expected).abs().max() < 5.1e-5  # four decimals


def test_ciede2000_improves_a_grey_towards_its_colour() -> None:
    # At grey, chroma and hue have no slope; what is left must still point the right way.
    grey = torch.tensor([50.0, 0.0, 0.0], dtype=torch.float64, requires_grad=True)
    colour = torch.tensor([50.0, 12.0, -20.0], dtype=torch.float64)
    (slope,) = torch.autograd.grad(ciede2000(grey, colour), grey)
    assert torch.nn.functional.cosine_similarity(-slope[1:], colour[1:], 0) > 0.9
    equal = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(ciede2000(equal, torch.zeros(3, dtype=torch.float64)), equal)
    assert (slope == 0).all()


# Other implementations


def smooth(seed: int, height: int, width: int) -> Tensor:
    """A colourful picture `(1, H, W, 3)` with soft and sharp parts, some of them black and white."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 3, height // 12, width // 12, generator=generator, dtype=torch.float64) * 1.4 - 0.2
    picture = torch.nn.functional.interpolate(coarse, (height, width), mode="bicubic")
    fine = 0.1 * torch.rand(picture.shape, generator=generator, dtype=torch.float64)
    fine[..., : width // 2] = 0
    return torch.movedim((picture + fine).clamp(0, 1), 1, -1)


def test_ciede2000_against_skimage() -> None:
    color = pytest.importorskip("skimage.color")
    generator = np.random.default_rng(0)
    first = generator.uniform([0, -100, -100], [100, 100, 100], (20_000, 3))
    for second in (first[::-1].copy(), first + generator.normal(0, 1, first.shape), first * [1, 0, 0]):
        found = ciede2000(torch.from_numpy(first), torch.from_numpy(second))
        np.testing.assert_allclose(found.numpy(), color.deltaE_ciede2000(first, second), rtol=1e-9)


def test_colours_against_skimage() -> None:
    color = pytest.importorskip("skimage.color")
    image, reference, mask = pair()
    np.testing.assert_allclose(lab(image).numpy(), color.rgb2lab(image.numpy()), atol=1e-3)
    for name, distance in (("delta_e76", color.deltaE_cie76), ("delta_e2000", color.deltaE_ciede2000)):
        apart = distance(color.rgb2lab(image.numpy()), color.rgb2lab(reference.numpy()))[:, mask.numpy()].mean(-1)
        np.testing.assert_allclose(DIFFERENCES[name]()(image, reference, mask).numpy(), apart, rtol=1e-6)


@pytest.mark.parametrize("size", [(176, 176), (192, 240)])  # odd sides are halved in another way there
def test_ms_ssim_against_pytorch_msssim(size: tuple[int, int]) -> None:
    library = pytest.importorskip("pytorch_msssim")
    reference = smooth(1, *size)
    for share in (0.1, 0.6):
        image = torch.lerp(reference, smooth(2, *size), share)
        expected = library.ms_ssim(
            *(torch.movedim(x, -1, 1) for x in (image, reference)), data_range=1.0, size_average=False
        )
        assert torch.allclose(DIFFERENCES["ms_ssim"]()(image, reference), expected, atol=1e-6)


@pytest.mark.parametrize("pixels_per_degree", [None, 20.0, 45.5])
@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
def test_flip_against_its_authors(pixels_per_degree: float | None, share: float) -> None:
    library = pytest.importorskip("flip_evaluator")
    reference = smooth(1, 60, 72)
    image = torch.lerp(reference, smooth(2, 60, 72), share)
    flip = FLIP() if pixels_per_degree is None else FLIP(pixels_per_degree)
    parameters = {} if pixels_per_degree is None else {"ppd": pixels_per_degree}
    expected, mean, _ = library.evaluate(
        reference[0].float().numpy(), image[0].float().numpy(), "LDR", applyMagma=False, parameters=parameters
    )
    assert flip.pixels_per_degree == pytest.approx(pixels_per_degree or 67.02, abs=1e-3)
    np.testing.assert_allclose(flip.map(image, reference)[0].numpy(), expected[..., 0], atol=2e-5)
    assert flip(image, reference).item() == pytest.approx(mean, abs=1e-5)
