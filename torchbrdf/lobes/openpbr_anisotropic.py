"""OpenPBR's opaque surface with a grain."""

from typing import Any, ClassVar

from torch import Tensor

from torchbrdf.lobes._anisotropic import AnisotropicLobe, root_of_width, rotation_of_the_grain
from torchbrdf.lobes._sloped import LayeredMaterial, grain_facets
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.openpbr import OpenPBR, below_coat, layers_over
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.separable import value_of
from torchbrdf.pairs import Pairs


@half_in_float32
def openpbr_anisotropic(
    pairs: Pairs,
    base_color: Tensor,
    base_diffuse_roughness: Tensor,
    base_metalness: Tensor,
    specular_weight: Tensor,
    specular_color: Tensor,
    specular_roughness_x: Tensor,
    specular_roughness_y: Tensor,
    rotation: Tensor,
    specular_ior: Tensor,
    coat_weight: Tensor,
    coat_color: Tensor,
    coat_roughness: Tensor,
    coat_ior: Tensor,
    coat_darkening: Tensor,
    fuzz_weight: Tensor,
    fuzz_color: Tensor,
    fuzz_roughness: Tensor,
) -> Tensor:
    """OpenPBR's opaque surface with a grain in its base: `openpbr` with two roughnesses.

    D and G are those of `ggx_anisotropic`, with a_x = specular_roughness_x^2 and a_y = specular_roughness_y^2. Of the
    wide one, t, and the narrow one, b, OpenPBR has `specular_roughness`^2 = sqrt((t^2 + b^2) / 2) and
    `specular_roughness_anisotropy` = 1 - b / t; a coat makes that roughness larger, and leaves b / t as it is. The
    albedo of the base is that of the alpha sqrt(a_x a_y).

    Args:
        pairs: where values are wanted, `(..., N)`; they have to know how they lie to the tangent.
        base_color: as of `openpbr`.
        base_diffuse_roughness: as of `openpbr`.
        base_metalness: as of `openpbr`.
        specular_weight: as of `openpbr`.
        specular_color: as of `openpbr`.
        specular_roughness_x: the square root of a_x `(..., 1)`, along the lobe's own x axis.
        specular_roughness_y: the square root of a_y `(..., 1)`.
        rotation: azimuth of the lobe's x axis from the tangent, counterclockwise about the normal, radians `(..., 1)`.
        specular_ior: as of `openpbr`.
        coat_weight: as of `openpbr`.
        coat_color: as of `openpbr`.
        coat_roughness: as of `openpbr`.
        coat_ior: as of `openpbr`.
        coat_darkening: as of `openpbr`.
        fuzz_weight: as of `openpbr`.
        fuzz_color: as of `openpbr`.
        fuzz_roughness: as of `openpbr`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Raises:
        ShapeError: the pairs know cosines and angles only.

    Source: Z. Andersson, P. Edmondson, J. Guertault et al., OpenPBR Surface specification 1.1, 2024,
    https://academysoftwarefoundation.github.io/OpenPBR; its reference graph in MaterialX 1.39.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import OpenPBRAnisotropic
        >>> angle, turn = torch.full((2,), 0.2), torch.tensor([0.0, 1.57])
        >>> brushed = OpenPBRAnisotropic(base_metalness=1, coat_weight=0, fuzz_weight=0)
        >>> brushed(Pairs.from_half_diff(angle, angle, angle, turn)).detach()[:, 0]
        tensor([0.0564, 0.7554])
    """
    base = (base_color, base_diffuse_roughness, base_metalness, specular_weight, specular_color)
    grain = (specular_roughness_x, specular_roughness_y, rotation)
    coat = (specular_ior, coat_weight, coat_color, coat_roughness, coat_ior, coat_darkening)
    return value_of(OpenPBRAnisotropic)(pairs, *base, *grain, *coat, fuzz_weight, fuzz_color, fuzz_roughness)


@LOBES.register("openpbr_anisotropic")
class OpenPBRAnisotropic(AnisotropicLobe, LayeredMaterial):
    """OpenPBR's opaque surface with a grain, a whole material: `OpenPBR` with two roughnesses of its base.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import OpenPBRAnisotropic
        >>> OpenPBRAnisotropic(base_metalness=1, specular_roughness_y=0.75).specular_roughness_y
        Parameter containing:
        tensor([0.7500], requires_grad=True)
    """

    axes: ClassVar[tuple[str, str]] = ("specular_roughness_x", "specular_roughness_y")
    base_color: BoundedParameter = OpenPBR.base_color
    base_diffuse_roughness: BoundedParameter = OpenPBR.base_diffuse_roughness
    base_metalness: BoundedParameter = OpenPBR.base_metalness
    specular_weight: BoundedParameter = OpenPBR.specular_weight
    specular_color: BoundedParameter = OpenPBR.specular_color
    specular_roughness_x: BoundedParameter = root_of_width("x", 0.3)
    specular_roughness_y: BoundedParameter = root_of_width("y", 0.5)
    rotation: BoundedParameter = rotation_of_the_grain()
    specular_ior: BoundedParameter = OpenPBR.specular_ior
    coat_weight: BoundedParameter = OpenPBR.coat_weight
    coat_color: BoundedParameter = OpenPBR.coat_color
    coat_roughness: BoundedParameter = OpenPBR.coat_roughness
    coat_ior: BoundedParameter = OpenPBR.coat_ior
    coat_darkening: BoundedParameter = OpenPBR.coat_darkening
    fuzz_weight: BoundedParameter = OpenPBR.fuzz_weight
    fuzz_color: BoundedParameter = OpenPBR.fuzz_color
    fuzz_roughness: BoundedParameter = OpenPBR.fuzz_roughness
    function = staticmethod(openpbr_anisotropic)
    scalars_of_terms: ClassVar[tuple[str, ...]] = (
        *("base_diffuse_roughness", "specular_weight", "specular_roughness_x", "specular_roughness_y", "rotation"),
        *("specular_ior", "coat_weight", "coat_roughness", "coat_ior", "fuzz_weight", "fuzz_roughness"),
    )

    @classmethod
    def layers(cls, pairs: Pairs, *scalars: Any) -> list[Any]:
        """Those of OpenPBR over facets with a grain."""
        rough, weight, first, second, rotation, *rest = scalars
        roughness = ((first**4 + second**4) / 2) ** 0.25
        rougher = below_coat(roughness, rest[1], rest[2]) / roughness**2
        a_x, a_y = first**2 * rougher, second**2 * rougher
        alpha = first * second * rougher
        return layers_over(pairs, grain_facets(pairs, a_x, a_y, rotation), alpha, rough, weight, *rest)

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """Those of OpenPBR."""
        return OpenPBR.coefficients(**parameters)
