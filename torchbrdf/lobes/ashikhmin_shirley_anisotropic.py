"""The Ashikhmin-Shirley lobe of a surface with a grain."""

import math
from typing import ClassVar

import torch
from torch import Tensor

from torchbrdf.lobes._anisotropic import AnisotropicLobe, half_slopes, rotation_of_the_grain
from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine, clamped_exp, tangent
from torchbrdf.lobes.ashikhmin_shirley import AshikhminShirley
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio

# Below this squared tangent log(1 + t) / t is its series, of which so many terms have all digits.
_SMALL, _TERMS = 0.01, 8


@half_in_float32
def ashikhmin_shirley_anisotropic(
    pairs: Pairs, specular: Tensor, exponent_x: Tensor, exponent_y: Tensor, rotation: Tensor, f0: Tensor
) -> Tensor:
    """The Ashikhmin-Shirley lobe: specular sqrt((n_u + 1) (n_v + 1)) / (8 pi) cos_h^n / (cos_d max(cos_i, cos_o)) F.

    n = n_u cos^2 p + n_v sin^2 p with p = phi_h - rotation; F is Schlick's Fresnel.

    Args:
        pairs: where values are wanted, `(..., N)`; they have to know how they lie to the tangent.
        specular: albedo `(..., 3)`.
        exponent_x: n_u `(..., 1)`, along the lobe's own x axis.
        exponent_y: n_v `(..., 1)`.
        rotation: azimuth of the lobe's x axis from the tangent, counterclockwise about the normal, radians `(..., 1)`.
        f0: reflectance at normal incidence `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Raises:
        ShapeError: the pairs know cosines and angles only.

    Source: M. Ashikhmin and P. Shirley, An Anisotropic Phong BRDF Model, 2000, doi:10.1080/10867651.2000.10487522.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ashikhmin_shirley_anisotropic
        >>> angle, turn, colour = torch.full((2,), 0.2), torch.tensor([0.0, 1.57]), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle, turn)
        >>> ashikhmin_shirley_anisotropic(pairs, colour, *torch.tensor([[200.0], [20.0], [0.0], [0.3]]))
        tensor([[0.0014, 0.0028, 0.0042],
                [0.0529, 0.1059, 0.1588]])
    """
    power = _power(pairs, exponent_x, exponent_y, rotation)[0]
    return apply_albedo(pairs, power * fresnel(f0, pairs), specular)


def _power(pairs: Pairs, n_u: Tensor, n_v: Tensor, rotation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """All but F, and the half vector's slopes along the lobe's axes.

    cos_h^n is exp(-(n_u u^2 + n_v v^2) g / 2) of slopes u, v and g = log(1 + tan2_h) / tan2_h, which needs no azimuth.
    """
    u, v = half_slopes(pairs, rotation)
    height = _geometry(pairs) * ((n_u + 1) * (n_v + 1)).sqrt()
    exponent = (n_u * u.square() + n_v * v.square()) * _flattening(pairs)
    return clamped_exp(-0.5 * exponent) * height, u, v


def _flattening(pairs: Pairs) -> Tensor:
    """log(1 + tan2_h) / tan2_h."""

    def make() -> Tensor:
        t = tangent(pairs)
        small = t < _SMALL
        series, inside = torch.zeros_like(t), torch.where(small, t, 0)
        for k in range(_TERMS, 0, -1):
            series = 1 / k - inside * series
        beyond = torch.where(small, 1, t)
        return torch.where(small, series, torch.log1p(beyond) / beyond)

    return pairs.cached(_flattening, make)


def _geometry(pairs: Pairs) -> Tensor:
    """1 / (8 pi cos_d max(cos_i, cos_o))."""

    def make() -> Tensor:
        highest = torch.maximum(clamp_cosine(pairs.cos_i), pairs.cos_o)
        return safe_ratio(1, clamp_cosine(pairs.cos_d) * highest) / (8 * math.pi)

    return pairs.cached(_geometry, make)


@LOBES.register("ashikhmin_shirley_anisotropic")
class AshikhminShirleyAnisotropic(AnisotropicLobe):
    """The Ashikhmin-Shirley lobe of a surface with a grain.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import AshikhminShirleyAnisotropic
        >>> AshikhminShirleyAnisotropic(exponent_x=1000.0, exponent_y=20.0).exponent_y
        Parameter containing:
        tensor([20.], requires_grad=True)
    """

    axes: ClassVar[tuple[str, str]] = ("exponent_x", "exponent_y")
    rises_with_width: ClassVar[bool] = False
    specular: BoundedParameter = AshikhminShirley.specular
    exponent_x: BoundedParameter = BoundedParameter(
        start=50.0, lower=0.001, upper=50000.0, log=True, doc="n_u, the sharpness along the lobe's x axis"
    )
    exponent_y: BoundedParameter = BoundedParameter(
        start=5.0, lower=0.001, upper=50000.0, log=True, doc="n_v, the sharpness along the lobe's y axis"
    )
    rotation: BoundedParameter = rotation_of_the_grain()
    f0: BoundedParameter = AshikhminShirley.f0
    function = staticmethod(ashikhmin_shirley_anisotropic)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/dn_u = shape (1 / (n_u + 1) - u^2 g) / 2, d/dr = shape u v (n_v - n_u) g; u, v, g as in the power."""
        n_u, n_v, rotation, f0 = scalars
        power, u, v = _power(pairs, n_u, n_v, rotation)
        shape, flattening = power * fresnel(f0, pairs), _flattening(pairs)
        by_x = 0.5 * (1 / (n_u + 1) - u.square() * flattening)
        by_y = 0.5 * (1 / (n_v + 1) - v.square() * flattening)
        by_turn = u * v * flattening * (n_v - n_u)
        return [shape, shape * by_x, shape * by_y, shape * by_turn, power * (1 - schlick_weight(pairs))]
