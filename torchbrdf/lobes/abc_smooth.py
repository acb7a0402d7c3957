"""The lobe of optically smooth surfaces with the ABC distribution."""

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine, clamped_exp, log_secant
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import dielectric, dielectric_derivative
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def abc_smooth(pairs: Pairs, amplitude: Tensor, sharpness: Tensor, exponent: Tensor, ior: Tensor) -> Tensor:
    """The smooth surfaces' model of Low et al. 2012: amplitude * S F, S = 1 / (1 + B |wi + wo|_xy^2)^C.

    By the theory of Rayleigh and Rice, where heights are small beside the wavelength: what counts is how far wo lies
    from the mirror direction of wi in the plane of the surface, and nothing shadows. F is `dielectric` at the angle
    whose sine is half of |wi - wo|_xy, which is theta_d in the mirror direction.

    Args:
        pairs: where values are wanted, `(..., N)`.
        amplitude: A `(..., 3)`, the height of S, which is not normalized.
        sharpness: B `(..., 1)`.
        exponent: C `(..., 1)`.
        ior: a real index of refraction `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: J. Low, J. Kronander, A. Ynnerman and J. Unger, BRDF Models for Accurate and Efficient Rendering of Glossy
    Surfaces, 2012, doi:10.1145/2077341.2077350, eq. 10 to 14, with G = 1.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import abc_smooth
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([1.0, 2.0, 3.0])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> abc_smooth(pairs, colour, *torch.tensor([[100.0], [1.0], [1.5]]))
        tensor([[0.0025, 0.0050, 0.0074]])
    """
    return apply_albedo(pairs, _spectrum(pairs, sharpness, exponent) * dielectric(ior, _cosine(pairs)), amplitude)


def _aside(pairs: Pairs) -> Tensor:
    """|wi + wo|_xy^2 = 4 cos_d^2 sin_h^2, with all digits near 0."""
    return pairs.cached(_aside, lambda: -4 * pairs.cos_d.square() * torch.expm1(-log_secant(pairs)))


def _cosine(pairs: Pairs) -> Tensor:
    """sqrt(1 - |wi - wo|_xy^2 / 4), as |wi - wo|^2 + |wi + wo|^2 = 2 |wi|^2 + 2 |wo|^2 in the plane, too."""

    def make() -> Tensor:
        square = (pairs.cos_i.square() + pairs.cos_o.square()) / 2 + _aside(pairs) / 4
        return clamp_cosine(square).sqrt()

    return pairs.cached(_cosine, make)


def _spectrum(pairs: Pairs, sharpness: Tensor, exponent: Tensor) -> Tensor:
    """S."""
    return clamped_exp(-exponent * torch.log1p(sharpness * _aside(pairs)))


@LOBES.register("abc_smooth")
class LowABCSmooth(Lobe):
    """The ABC lobe of smooth surfaces of Low et al. 2012; the bounds hold all of their fits.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import LowABCSmooth
        >>> LowABCSmooth(ior=1.7)
        LowABCSmooth(amplitude=[10, 10, 10], sharpness=1000, exponent=1, ior=1.7)
    """

    amplitude: BoundedParameter = albedo(start=10.0, upper=10_000.0, doc="A, the height of the spectrum, per channel")
    sharpness: BoundedParameter = BoundedParameter(
        start=1000.0, lower=1.0, upper=1e7, log=True, doc="B, the sharpness of the lobe"
    )
    exponent: BoundedParameter = BoundedParameter(
        start=1.0, lower=0.01, upper=10.0, log=True, doc="C, how fast the tail falls"
    )
    ior: BoundedParameter = BoundedParameter(
        start=1.5, lower=1.02, upper=100.0, log=True, doc="index of refraction, real"
    )
    function = staticmethod(abc_smooth)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """With x = |wi + wo|_xy^2: d/dB = -shape C x / (1 + B x), d/dC = -shape log(1 + B x), and d/d(ior)."""
        sharpness, exponent, ior = scalars
        aside, cosine = _aside(pairs), _cosine(pairs)
        spectrum = _spectrum(pairs, sharpness, exponent)
        shape = spectrum * dielectric(ior, cosine)
        scaled = sharpness * aside
        return [
            shape,
            shape * (-exponent * aside / (1 + scaled)),
            -shape * torch.log1p(scaled),
            spectrum * dielectric_derivative(ior, cosine),
        ]
