"""The material of glTF 2.0 with a grain."""

from typing import Any, ClassVar

from torch import Tensor

from torchbrdf.lobes._anisotropic import AnisotropicLobe, root_of_width, rotation_of_the_grain
from torchbrdf.lobes._sloped import LayeredMaterial, grain_facets
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.gltf import GLTF, layers_over
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.separable import value_of
from torchbrdf.pairs import Pairs


@half_in_float32
def gltf_anisotropic(
    pairs: Pairs,
    base_color: Tensor,
    metallic: Tensor,
    roughness_x: Tensor,
    roughness_y: Tensor,
    rotation: Tensor,
    specular: Tensor,
    specular_color: Tensor,
    ior: Tensor,
    clearcoat: Tensor,
    clearcoat_roughness: Tensor,
    sheen_color: Tensor,
    sheen_roughness: Tensor,
) -> Tensor:
    """The material of glTF 2.0 with the extension KHR_materials_anisotropy: `gltf` with two roughnesses of its base.

    D and G are those of `ggx_anisotropic`, with a_x = roughness_x^2 and a_y = roughness_y^2. In glTF the narrow one is
    roughnessFactor^2, and the wide one is a + (1 - a) anisotropyStrength^2, along the direction that is rotated from
    the tangent by anisotropyRotation.

    Args:
        pairs: where values are wanted, `(..., N)`; they have to know how they lie to the tangent.
        base_color: as of `gltf`.
        metallic: as of `gltf`.
        roughness_x: the square root of a_x `(..., 1)`, along the lobe's own x axis.
        roughness_y: the square root of a_y `(..., 1)`.
        rotation: azimuth of the lobe's x axis from the tangent, counterclockwise about the normal, radians `(..., 1)`.
        specular: as of `gltf`.
        specular_color: as of `gltf`.
        ior: as of `gltf`.
        clearcoat: as of `gltf`.
        clearcoat_roughness: as of `gltf`.
        sheen_color: as of `gltf`.
        sheen_roughness: as of `gltf`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Raises:
        ShapeError: the pairs know cosines and angles only.

    Source: Khronos Group, glTF 2.0 specification, 2021, appendix B, and KHR_materials_anisotropy, 2023.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import GLTFAnisotropic
        >>> angle, turn = torch.full((2,), 0.2), torch.tensor([0.0, 1.57])
        >>> brushed = GLTFAnisotropic(metallic=1, roughness_x=0.3, roughness_y=0.6, clearcoat=0, sheen_color=0)
        >>> brushed(Pairs.from_half_diff(angle, angle, angle, turn)).detach()[:, 0]
        tensor([0.0392, 0.8284])
    """
    rest = (specular, specular_color, ior, clearcoat, clearcoat_roughness, sheen_color, sheen_roughness)
    return value_of(GLTFAnisotropic)(pairs, base_color, metallic, roughness_x, roughness_y, rotation, *rest)


@LOBES.register("gltf_anisotropic")
class GLTFAnisotropic(AnisotropicLobe, LayeredMaterial):
    """The metallic-roughness material of glTF 2.0 with a grain, a whole material: `GLTF` with two roughnesses.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import GLTFAnisotropic
        >>> GLTFAnisotropic(roughness_x=0.2, roughness_y=0.5).roughness_y
        Parameter containing:
        tensor([0.5000], requires_grad=True)
    """

    base_color: BoundedParameter = GLTF.base_color
    metallic: BoundedParameter = GLTF.metallic
    roughness_x: BoundedParameter = root_of_width("x", 0.3)
    roughness_y: BoundedParameter = root_of_width("y", 0.5)
    rotation: BoundedParameter = rotation_of_the_grain()
    specular: BoundedParameter = GLTF.specular
    specular_color: BoundedParameter = GLTF.specular_color
    ior: BoundedParameter = GLTF.ior
    clearcoat: BoundedParameter = GLTF.clearcoat
    clearcoat_roughness: BoundedParameter = GLTF.clearcoat_roughness
    sheen_color: BoundedParameter = GLTF.sheen_color
    sheen_roughness: BoundedParameter = GLTF.sheen_roughness
    function = staticmethod(gltf_anisotropic)
    scalars_of_terms: ClassVar[tuple[str, ...]] = (
        *("roughness_x", "roughness_y", "rotation"),
        *("clearcoat", "clearcoat_roughness", "sheen_roughness"),
    )

    @classmethod
    def layers(cls, pairs: Pairs, *scalars: Any) -> list[Any]:
        """Those of glTF over facets with a grain."""
        first, second, rotation, *rest = scalars
        return layers_over(pairs, grain_facets(pairs, first**2, second**2, rotation), *rest)

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """Those of glTF."""
        return GLTF.coefficients(**parameters)
