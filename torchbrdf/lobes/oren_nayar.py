"""Oren and Nayar's diffuse reflection of rough surfaces."""

import math
from typing import ClassVar

import torch
from torch import Tensor

from torchbrdf.lobes import parameter
from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio


@half_in_float32
def oren_nayar(pairs: Pairs, albedo: Tensor, roughness: Tensor) -> Tensor:
    """Diffuse reflection of V-shaped grooves: albedo / pi * (A + B max(0, cos phi) sin_a tan_b).

    A = 1 - s^2 / (2 (s^2 + 0.33)), B = 0.45 s^2 / (s^2 + 0.09), a the larger and b the smaller of theta_i and theta_o,
    phi the azimuth between the directions: the qualitative model, without interreflection. s = 0 is `lambert`.

    Args:
        pairs: where values are wanted, `(..., N)`.
        albedo: `(..., 3)`; of the grooves' sides, not of the surface, which reflects less.
        roughness: s `(..., 1)`, the standard deviation of the slopes' angle in radians.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: M. Oren and S. Nayar, Generalization of Lambert's Reflectance Model, 1994, doi:10.1145/192161.192213,
    eq. 30.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import oren_nayar
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> oren_nayar(Pairs.from_half_diff(angle, angle, angle), colour, torch.tensor([0.5]))
        tensor([[0.0250, 0.0499, 0.0749]])
    """
    return apply_albedo(pairs, _shape(pairs, roughness), albedo)


def _shape(pairs: Pairs, roughness: Tensor) -> Tensor:
    square = roughness.square()
    constant = (1 - 0.5 * square / (square + 0.33)) / math.pi
    return constant + (0.45 / math.pi) * square / (square + 0.09) * grooves(pairs)


def grooves(pairs: Pairs) -> Tensor:
    """max(0, cos phi) sin_a tan_b = max(0, wi wo - cos_i cos_o) / max(cos_i, cos_o)."""

    def make() -> Tensor:
        horizontal = 2 * pairs.cos_d.square() - 1 - pairs.cos_i * pairs.cos_o  # sin_i sin_o cos phi
        return safe_ratio(horizontal.clamp_min(0), torch.maximum(clamp_cosine(pairs.cos_i), pairs.cos_o))

    return pairs.cached(grooves, make)


@LOBES.register("oren_nayar")
class OrenNayar(Lobe):
    """Oren and Nayar's diffuse reflection: flatter than Lambert's, brighter towards the light.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import OrenNayar
        >>> OrenNayar(albedo=0.25, roughness=0.5)
        OrenNayar(albedo=[0.25, 0.25, 0.25], roughness=0.5)
    """

    is_diffuse: ClassVar[bool] = True
    albedo: BoundedParameter = parameter.albedo(start=0.5, doc="diffuse albedo of the grooves, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.001, upper=1.5, doc="standard deviation of the slopes' angle, in radians"
    )
    function = staticmethod(oren_nayar)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/ds = s (-0.33 / (s^2 + 0.33)^2 + 0.081 / (s^2 + 0.09)^2 max(0, cos phi) sin_a tan_b) / pi."""
        (roughness,) = scalars
        square, groove = roughness.square(), grooves(pairs)
        slope = 0.081 / (square + 0.09).square() * groove - 0.33 / (square + 0.33).square()
        return [_shape(pairs, roughness), slope * (roughness / math.pi)]

    @classmethod
    def pair_factors(cls, pairs: Pairs) -> list[Tensor]:
        """1, and max(0, cos phi) sin_a tan_b."""
        groove = grooves(pairs)
        return [torch.ones_like(groove), groove]
