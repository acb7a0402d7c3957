"""The microfacet lobe with the ABC distribution."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamped_exp, log_secant, v_groove
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import dielectric, dielectric_derivative
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def abc(pairs: Pairs, amplitude: Tensor, sharpness: Tensor, exponent: Tensor, ior: Tensor) -> Tensor:
    """The microfacet lobe of Low et al. 2012: amplitude * S G F / (pi cos_i cos_o), S = 1 / (1 + B (1 - cos_h))^C.

    F is `dielectric`, G the shadowing of Cook-Torrance.

    Args:
        pairs: where values are wanted, `(..., N)`.
        amplitude: A `(..., 3)`, the height of S, which is not normalized.
        sharpness: B `(..., 1)`.
        exponent: C `(..., 1)`.
        ior: a real index of refraction `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: J. Low, J. Kronander, A. Ynnerman and J. Unger, BRDF Models for Accurate and Efficient Rendering of Glossy
    Surfaces, 2012, doi:10.1145/2077341.2077350, the microfacet model; with the 1/pi of its supplement's fits, which
    the paper's equation does not have (github.com/bsdfbenchmark/bbm, include/bsdfmodel/lowmicrofacet.h).

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import abc
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([1.0, 2.0, 3.0])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> abc(pairs, colour, *torch.tensor([[100.0], [1.0], [1.5]]))
        tensor([[0.0046, 0.0092, 0.0139]])
    """
    return apply_albedo(pairs, _facets(pairs, sharpness, exponent) * dielectric(ior, pairs.cos_d), amplitude)


def one_minus_cos_h(pairs: Pairs) -> Tensor:
    """1 - cos_h, with all digits where cos_h is near 1."""
    return pairs.cached(one_minus_cos_h, lambda: -torch.expm1(-0.5 * log_secant(pairs)))


def _facets(pairs: Pairs, sharpness: Tensor, exponent: Tensor) -> Tensor:
    """S G / (pi cos_i cos_o)."""
    return clamped_exp(-exponent * torch.log1p(sharpness * one_minus_cos_h(pairs))) * (v_groove(pairs) / math.pi)


@LOBES.register("abc")
class LowABC(Lobe):
    """A microfacet lobe with the ABC distribution of Low et al. 2012, whose tails are those of many measurements.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import LowABC
        >>> LowABC(ior=1.7)
        LowABC(amplitude=[10, 10, 10], sharpness=1000, exponent=1, ior=1.7)
    """

    amplitude: BoundedParameter = albedo(
        start=10.0, upper=10_000.0, doc="A, the height of the distribution, per channel"
    )
    sharpness: BoundedParameter = BoundedParameter(
        start=1000.0, lower=1.0, upper=1e7, log=True, doc="B, the sharpness of the lobe"
    )
    exponent: BoundedParameter = BoundedParameter(
        start=1.0, lower=0.01, upper=10.0, log=True, doc="C, how fast the tail falls"
    )
    ior: BoundedParameter = BoundedParameter(
        start=1.5, lower=1.02, upper=100.0, log=True, doc="index of refraction, real"
    )
    function = staticmethod(abc)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/dB = -shape C (1 - cos_h) / (1 + B (1 - cos_h)), d/dC = -shape log(1 + B (1 - cos_h)), and d/d(ior)."""
        sharpness, exponent, ior = scalars
        one_minus_cos, cos_d = one_minus_cos_h(pairs), pairs.cos_d
        facets = _facets(pairs, sharpness, exponent)
        shape = facets * dielectric(ior, cos_d)
        scaled = sharpness * one_minus_cos
        return [
            shape,
            shape * (-exponent * one_minus_cos / (1 + scaled)),
            -shape * torch.log1p(scaled),
            facets * dielectric_derivative(ior, cos_d),
        ]
