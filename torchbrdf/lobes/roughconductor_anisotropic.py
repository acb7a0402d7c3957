"""Mitsuba's rough conductor with a grain."""

from torch import Tensor

from torchbrdf.lobes._anisotropic import AnisotropicLobe, rotation_of_the_grain, width
from torchbrdf.lobes._anisotropic_ggx import Part, distribution, facets, separable_visibility
from torchbrdf.lobes._microfacet import apply_albedo
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import conductor
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.roughconductor import RoughConductor
from torchbrdf.lobes.separable import tangents
from torchbrdf.pairs import Pairs


@half_in_float32
def roughconductor_anisotropic(
    pairs: Pairs, specular: Tensor, roughness_x: Tensor, roughness_y: Tensor, rotation: Tensor, eta: Tensor, k: Tensor
) -> Tensor:
    """Mitsuba's `roughconductor` of the distribution `ggx` with two roughnesses: specular * D G F / (4 cos_i cos_o).

    D is that of `ggx_anisotropic`, G = G1(wi) G1(wo) (Smith, heights uncorrelated), F the reflectance of a metal of the
    index of refraction eta + i k, which all channels share; `specular` is Mitsuba's `specular_reflectance`.

    Args:
        pairs: where values are wanted, `(..., N)`; they have to know how they lie to the tangent.
        specular: colour `(..., 3)`.
        roughness_x: a_x `(..., 1)`, Mitsuba's `alpha_u` where the rotation is 0.
        roughness_y: a_y `(..., 1)`, Mitsuba's `alpha_v` there.
        rotation: azimuth of the lobe's x axis from the tangent, counterclockwise about the normal, radians `(..., 1)`.
        eta: real part of the index of refraction `(..., 1)`.
        k: imaginary part `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Raises:
        ShapeError: the pairs know cosines and angles only.

    Source: W. Jakob et al., Mitsuba 3, 2022, https://mitsuba-renderer.org; E. Heitz, Understanding the
    Masking-Shadowing Function in Microfacet-Based BRDFs, 2014, JCGT 3(2).

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import roughconductor_anisotropic
        >>> angle, turn, colour = torch.full((2,), 0.2), torch.tensor([0.0, 1.57]), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle, turn)
        >>> roughconductor_anisotropic(pairs, colour, *torch.tensor([[0.1], [0.3], [0.0], [0.2], [3.0]]))
        tensor([[0.0110, 0.0221, 0.0331],
                [0.1353, 0.2706, 0.4059]])
    """
    own = _facets(pairs, roughness_x, roughness_y, rotation)
    return apply_albedo(pairs, own.value * conductor(eta, k, pairs.cos_d), specular)


def _facets(pairs: Pairs, a_x: Tensor, a_y: Tensor, rotation: Tensor) -> Part:
    return facets(distribution(pairs, a_x, a_y, rotation), separable_visibility(pairs, a_x, a_y, rotation))


@LOBES.register("roughconductor_anisotropic")
class RoughConductorAnisotropic(AnisotropicLobe):
    """Mitsuba's rough conductor with a grain, exactly: `RoughConductor` with `alpha_u` and `alpha_v`.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import RoughConductorAnisotropic
        >>> RoughConductorAnisotropic(roughness_x=0.05, roughness_y=0.3).k
        Parameter containing:
        tensor([2.], requires_grad=True)
    """

    specular: BoundedParameter = RoughConductor.specular
    roughness_x: BoundedParameter = width("x", 0.1)
    roughness_y: BoundedParameter = width("y", 0.3)
    rotation: BoundedParameter = rotation_of_the_grain()
    eta: BoundedParameter = RoughConductor.eta
    k: BoundedParameter = RoughConductor.k
    function = staticmethod(roughconductor_anisotropic)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """Shape times the derivatives of the logarithms of D and G; those of F by forward differentiation."""
        a_x, a_y, rotation, *index = scalars
        own = _facets(pairs, a_x, a_y, rotation)
        (reflected,), slopes = tangents(lambda eta, k: [conductor(eta, k, pairs.cos_d)], index)
        of_metal = [slope for (slope,) in slopes if slope is not None]
        shape = own.value * reflected
        return [shape, *(shape * slope for slope in own[1:]), *(own.value * slope for slope in of_metal)]
