"""Ward's lobe of a surface with a grain."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._anisotropic import AnisotropicLobe, half_slopes, rotation_of_the_grain, width
from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine, clamped_exp
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.ward import Ward
from torchbrdf.pairs import Pairs


@half_in_float32
def ward_anisotropic(
    pairs: Pairs, specular: Tensor, roughness_x: Tensor, roughness_y: Tensor, rotation: Tensor
) -> Tensor:
    """Ward's anisotropic lobe: specular * exp(-tan2_h (cos^2 p / a_x^2 + sin^2 p / a_y^2)) / (4 pi a_x a_y c).

    c = sqrt(cos_i cos_o), and p = phi_h - rotation.

    Args:
        pairs: where values are wanted, `(..., N)`; they have to know how they lie to the tangent.
        specular: albedo `(..., 3)`.
        roughness_x: a_x `(..., 1)`, alpha along the lobe's own x axis.
        roughness_y: a_y `(..., 1)`.
        rotation: azimuth of the lobe's x axis from the tangent, counterclockwise about the normal, radians `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Raises:
        ShapeError: the pairs know cosines and angles only.

    Source: G. Ward, Measuring and Modeling Anisotropic Reflection, 1992, eq. 5a, doi:10.1145/142920.134078.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ward_anisotropic
        >>> angle, turn, colour = torch.full((2,), 0.2), torch.tensor([0.0, 1.57]), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle, turn)
        >>> ward_anisotropic(pairs, colour, *torch.tensor([[0.1], [0.3], [0.0]]))
        tensor([[0.0045, 0.0091, 0.0136],
                [0.1751, 0.3501, 0.5252]])
    """
    return apply_albedo(pairs, _shape(pairs, roughness_x, roughness_y, rotation)[0], specular)


def _shape(pairs: Pairs, a_x: Tensor, a_y: Tensor, rotation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The lobe where its albedo is 1, and the half vector's slopes along its axes."""
    u, v = half_slopes(pairs, rotation)
    height = _geometry(pairs) / (a_x * a_y)
    return clamped_exp(-(u / a_x).square() - (v / a_y).square()) * height, u, v


def _geometry(pairs: Pairs) -> Tensor:
    """1 / (4 pi sqrt(cos_i cos_o))."""

    def make() -> Tensor:
        return torch.rsqrt(clamp_cosine(pairs.cos_i)) * torch.rsqrt(clamp_cosine(pairs.cos_o)) / (4 * math.pi)

    return pairs.cached(_geometry, make)


@LOBES.register("ward_anisotropic")
class WardAnisotropic(AnisotropicLobe):
    """Ward's lobe of a surface with a grain, in the form that `Ward` has, with its bounds.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import WardAnisotropic
        >>> WardAnisotropic(roughness_x=0.05, roughness_y=0.3)
        WardAnisotropic(specular=[0.5, 0.5, 0.5], roughness_x=0.05, roughness_y=0.3, rotation=0)
    """

    specular: BoundedParameter = Ward.specular
    roughness_x: BoundedParameter = width("x", 0.05, upper=0.5)
    roughness_y: BoundedParameter = width("y", 0.15, upper=0.5)
    rotation: BoundedParameter = rotation_of_the_grain()
    function = staticmethod(ward_anisotropic)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/da_x = shape (2 u^2 / a_x^3 - 1 / a_x), d/dr = shape 2 u v (1 / a_y^2 - 1 / a_x^2), of slopes u, v."""
        a_x, a_y, rotation = scalars
        shape, u, v = _shape(pairs, a_x, a_y, rotation)
        by_x = 2 * (u / a_x).square() / a_x - 1 / a_x
        by_y = 2 * (v / a_y).square() / a_y - 1 / a_y
        by_turn = 2 * u * v * (a_y.square().reciprocal() - a_x.square().reciprocal())
        return [shape, shape * by_x, shape * by_y, shape * by_turn]
