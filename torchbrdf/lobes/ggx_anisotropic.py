"""The GGX lobe of a surface with a grain."""

from torch import Tensor

from torchbrdf.lobes._anisotropic import AnisotropicLobe, rotation_of_the_grain, width
from torchbrdf.lobes._anisotropic_ggx import Part, distribution, facets, visibility
from torchbrdf.lobes._microfacet import apply_albedo
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel, schlick_weight
from torchbrdf.lobes.ggx import GGX
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.pairs import Pairs


@half_in_float32
def ggx_anisotropic(
    pairs: Pairs, specular: Tensor, roughness_x: Tensor, roughness_y: Tensor, rotation: Tensor, f0: Tensor
) -> Tensor:
    """The anisotropic GGX lobe: specular * D G F / (4 cos_i cos_o).

    D = 1 / (pi a_x a_y cos_h^4 (1 + tan2_h (cos^2 p / a_x^2 + sin^2 p / a_y^2))^2) with p = phi_h - rotation,
    G = 1 / (1 + Lambda(wi) + Lambda(wo)) (Smith, heights correlated), 1 + 2 Lambda = sqrt(1 + (a_x^2 x^2 + a_y^2 y^2) /
    z^2) of a direction (x, y, z) in the frame of the grain, F = Schlick's Fresnel.

    Args:
        pairs: where values are wanted, `(..., N)`; they have to know how they lie to the tangent.
        specular: albedo `(..., 3)`.
        roughness_x: a_x `(..., 1)`, alpha along the lobe's own x axis.
        roughness_y: a_y `(..., 1)`.
        rotation: azimuth of the lobe's x axis from the tangent, counterclockwise about the normal, radians `(..., 1)`.
        f0: reflectance at normal incidence `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Raises:
        ShapeError: the pairs know cosines and angles only.

    Source: B. Burley, Physically-Based Shading at Disney, 2012 (SIGGRAPH course), eq. 13; E. Heitz, Understanding the
    Masking-Shadowing Function in Microfacet-Based BRDFs, 2014, JCGT 3(2), eq. 85 to 87 and 99.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ggx_anisotropic
        >>> angle, turn, colour = torch.full((2,), 0.2), torch.tensor([0.0, 1.57]), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle, turn)
        >>> ggx_anisotropic(pairs, colour, *torch.tensor([[0.1], [0.3], [0.0], [0.3]]))
        tensor([[0.0036, 0.0072, 0.0108],
                [0.0440, 0.0879, 0.1319]])
    """
    return apply_albedo(pairs, _facets(pairs, roughness_x, roughness_y, rotation).value * fresnel(f0, pairs), specular)


def _facets(pairs: Pairs, a_x: Tensor, a_y: Tensor, rotation: Tensor) -> Part:
    return facets(distribution(pairs, a_x, a_y, rotation), visibility(pairs, a_x, a_y, rotation))


@LOBES.register("ggx_anisotropic")
class GGXAnisotropic(AnisotropicLobe):
    """The GGX lobe of a surface with a grain, as brushed metal, with correlated Smith shadowing and Schlick's Fresnel.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import GGXAnisotropic
        >>> GGXAnisotropic(roughness_x=0.05, roughness_y=0.3, rotation=0.5)
        GGXAnisotropic(specular=[0.5, 0.5, 0.5], roughness_x=0.05, roughness_y=0.3, rotation=0.5, f0=0.3)
    """

    specular: BoundedParameter = GGX.specular
    roughness_x: BoundedParameter = width("x", 0.1)
    roughness_y: BoundedParameter = width("y", 0.3)
    rotation: BoundedParameter = rotation_of_the_grain()
    f0: BoundedParameter = GGX.f0
    function = staticmethod(ggx_anisotropic)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """Shape times the derivatives of the logarithms of D and G; by F0 shape / F (1 - (1 - cos_d)^5)."""
        a_x, a_y, rotation, f0 = scalars
        own = _facets(pairs, a_x, a_y, rotation)
        shape = own.value * fresnel(f0, pairs)
        return [shape, *(shape * slope for slope in own[1:]), own.value * (1 - schlick_weight(pairs))]
