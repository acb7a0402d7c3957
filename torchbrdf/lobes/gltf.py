"""The material of glTF 2.0: metallic-roughness with specular, index of refraction, clear coat and sheen."""

import math
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchbrdf.lobes._layers import charlie_albedo, higher_cosine, lower_cosine
from torchbrdf.lobes._sloped import LayeredMaterial, Value, chain, facets, larger, number
from torchbrdf.lobes._smith import ggx_visibility_and_log_derivative
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.charlie import Charlie
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import schlick, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, share
from torchbrdf.lobes.separable import columns, value_of
from torchbrdf.pairs import Pairs


@half_in_float32
def gltf(
    pairs: Pairs,
    base_color: Tensor,
    metallic: Tensor,
    roughness: Tensor,
    specular: Tensor,
    specular_color: Tensor,
    ior: Tensor,
    clearcoat: Tensor,
    clearcoat_roughness: Tensor,
    sheen_color: Tensor,
    sheen_roughness: Tensor,
) -> Tensor:
    """The material of glTF 2.0, with the extensions that say how an opaque, isotropic surface reflects.

    base = lerp(dielectric, metal, metallic), with S = D G / (4 cos_i cos_o) of `ggx` at a = roughness^2:
    metal = S Schlick(base_color); dielectric = (1 - specular max(F)) base_color / pi + specular F S, with
    F = Schlick(min(1, ((ior - 1) / (ior + 1))^2 specular_color)). On it lies
    sheen = sheen_color charlie + (1 - max(sheen_color) E) base, whose a is sheen_roughness^2, and on that the coat,
    lerp(sheen, S of clearcoat_roughness^2, clearcoat Schlick(0.04) at the cosine of the viewer). E, the albedo of the
    sheen, is a fit; and as the viewer counts the lower one of both directions, by which the material is reciprocal.

    Args:
        pairs: where values are wanted, `(..., N)`.
        base_color: baseColorFactor `(..., 3)`.
        metallic: metallicFactor `(..., 1)`.
        roughness: roughnessFactor, the square root of a `(..., 1)`.
        specular: specularFactor `(..., 1)`.
        specular_color: specularColorFactor `(..., 3)`.
        ior: index of refraction `(..., 1)`.
        clearcoat: clearcoatFactor `(..., 1)`.
        clearcoat_roughness: clearcoatRoughnessFactor `(..., 1)`.
        sheen_color: sheenColorFactor `(..., 3)`.
        sheen_roughness: sheenRoughnessFactor `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: Khronos Group, glTF 2.0 specification, 2021, appendix B; the extensions KHR_materials_specular, _ior,
    _clearcoat and _sheen.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import gltf
        >>> angle, red, white = torch.full((1,), 0.2), torch.tensor([0.8, 0.1, 0.1]), torch.ones(3)
        >>> pairs, (none, half, n) = Pairs.from_half_diff(angle, angle, angle), torch.tensor([[0.0], [0.5], [1.5]])
        >>> gltf(pairs, red, none, half, half, white, n, none, half, 0 * red, half)
        tensor([[0.2604, 0.0421, 0.0421]])
    """
    rest = (clearcoat, clearcoat_roughness, sheen_color, sheen_roughness)
    return value_of(GLTF)(pairs, base_color, metallic, roughness, specular, specular_color, ior, *rest)


@LOBES.register("gltf")
class GLTF(LayeredMaterial):
    """The metallic-roughness material of glTF 2.0, a whole material.

    With the extensions specular, ior, clearcoat and sheen. Left out, as they are no opaque, isotropic reflection of one
    surface point: textures, transmission, volume, anisotropy, iridescence, emission.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import GLTF
        >>> GLTF(base_color=[0.8, 0.1, 0.1], metallic=0).metallic.item()
        0.0
    """

    base_color: BoundedParameter = BoundedParameter(
        start=0.5, lower=0.0, upper=1.0, shape=(3,), doc="colour of diffuse reflection and of a metal, per channel"
    )
    metallic: BoundedParameter = share(0.5, "share of metal")
    roughness: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.032, upper=1.0, log=True, doc="the square root of alpha"
    )
    specular: BoundedParameter = share(1.0, "strength of a dielectric's specular reflection")
    specular_color: BoundedParameter = BoundedParameter(
        start=1.0, lower=0.0, upper=1.0, shape=(3,), doc="colour of it at normal incidence, per channel"
    )
    ior: BoundedParameter = BoundedParameter(start=1.5, lower=1.0, upper=3.0, doc="index of refraction of a dielectric")
    clearcoat: BoundedParameter = share(0.1, "strength of the clear coat")
    clearcoat_roughness: BoundedParameter = BoundedParameter(
        start=0.2, lower=0.032, upper=1.0, log=True, doc="the square root of its alpha"
    )
    sheen_color: BoundedParameter = BoundedParameter(
        start=0.05, lower=0.0, upper=1.0, shape=(3,), doc="colour of the sheen, per channel"
    )
    sheen_roughness: BoundedParameter = BoundedParameter(
        start=0.5, lower=0.1, upper=1.0, doc="the square root of the sheen's alpha"
    )
    function = staticmethod(gltf)
    scalars_of_terms: ClassVar[tuple[str, ...]] = ("roughness", "clearcoat", "clearcoat_roughness", "sheen_roughness")

    @classmethod
    def layers(cls, pairs: Pairs, *scalars: Any) -> list[Any]:
        """Those of `layers_over` GGX's facets."""
        roughness, *rest = scalars
        return layers_over(pairs, facets(pairs, roughness**2, ggx_visibility_and_log_derivative), *rest)

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """Of the terms in their order: a dielectric's diffuse share is 1 - specular + specular (1 - max F0) (1 - w)."""
        color, metallic, specular = parameters["base_color"], parameters["metallic"], parameters["specular"]
        ior, sheen = parameters["ior"], parameters["sheen_color"]
        f0 = (((ior - 1) / (ior + 1)).square() * parameters["specular_color"]).clamp_max(1)
        rest, brightest = 1 - metallic, f0.amax(-1, keepdim=True)
        base = [
            rest * color * (1 - specular),
            rest * color * specular * (1 - brightest),
            metallic * color + rest * specular * f0,
            metallic + rest * specular,
        ]
        left = 1 - sheen.amax(-1, keepdim=True)
        return columns(torch.ones_like(color), sheen, *base, *(left * one for one in base))


def layers_over(pairs: Pairs, main: Any, clearcoat: Any, clearcoat_roughness: Any, sheen_roughness: Any) -> list[Any]:
    """Coat; sheen; the two of diffuse and the two of specular reflection, each by 1 - E and by E.

    Args:
        pairs: where values are wanted, `(..., N)`.
        main: D G / (4 cos_i cos_o) of the base.
        clearcoat: as of `gltf`.
        clearcoat_roughness: as of `gltf`.
        sheen_roughness: as of `gltf`.
    """
    viewer, fifth = lower_cosine(pairs), schlick_weight(pairs)
    blend = clearcoat * schlick(viewer.new_tensor(0.04), viewer)
    below, alpha = 1 - blend, sheen_roughness**2
    sheen, slope = Charlie.value_and_jacobian(pairs, number(alpha))
    scattered = _scattered(pairs, alpha)
    coat = facets(pairs, clearcoat_roughness**2, ggx_visibility_and_log_derivative)
    lambert = torch.full_like(fifth, 1 / math.pi)
    base = [lambert, lambert * (1 - fifth), main * (1 - fifth), main * fifth]
    left, taken = below * (1 - scattered), below * scattered
    over = [blend * coat, below * chain(alpha, sheen, lambda: slope)]
    return [*over, *(left * one for one in base), *(taken * one for one in base)]


def _scattered(pairs: Pairs, alpha: Value) -> Value:
    """Share of light that the sheen takes, of the direction from which it takes more."""
    return larger(charlie_albedo(lower_cosine(pairs), alpha), charlie_albedo(higher_cosine(pairs), alpha))
