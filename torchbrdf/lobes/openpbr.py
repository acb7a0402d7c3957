"""OpenPBR's opaque surface: diffuse and metal base, specular, coat and fuzz."""

from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchbrdf.lobes._layers import fuzz, fuzz_albedo, ggx_albedo, lower_cosine
from torchbrdf.lobes._sloped import LayeredMaterial, Value, facets, fresnel_of, larger, root
from torchbrdf.lobes._smith import ggx_visibility_and_log_derivative
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.eon import EON
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import f82_colours, f82_weight, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, share
from torchbrdf.lobes.separable import columns, value_of
from torchbrdf.pairs import Pairs


@half_in_float32
def openpbr(
    pairs: Pairs,
    base_color: Tensor,
    base_diffuse_roughness: Tensor,
    base_metalness: Tensor,
    specular_weight: Tensor,
    specular_color: Tensor,
    specular_roughness: Tensor,
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
    """OpenPBR's opaque, isotropic surface, its layers by albedo scaling as in MaterialX' reference graph.

    With S(a) = D G / (4 cos_i cos_o) of `ggx` at a = roughness^2, and each layer on what is written behind it:
    fuzz: fuzz_weight fuzz_color fuzz + (1 - fuzz_weight E_fuzz) coat;
    coat: coat_weight S F + (1 - coat_weight E_coat) darkening tint base;
    base: lerp(specular_color S F + (1 - E_specular) EON(base_color), specular_weight S F82(base_color, specular_color),
    base_metalness). The roughness and the index of refraction of the base are those that it has below the coat; the
    specular weight scales the reflectance F0 of a dielectric. E, the layers' albedos, are fits; the viewer, whose they
    are, counts as the lower one of both directions, by which the material is reciprocal.

    Args:
        pairs: where values are wanted, `(..., N)`.
        base_color: of diffuse reflection and of a metal `(..., 3)`.
        base_diffuse_roughness: of `eon` `(..., 1)`.
        base_metalness: share of metal `(..., 1)`.
        specular_weight: strength of specular reflection `(..., 1)`.
        specular_color: tint of a dielectric's reflection, and of a metal's at 82 degrees `(..., 3)`.
        specular_roughness: the square root of a `(..., 1)`.
        specular_ior: index of refraction `(..., 1)`.
        coat_weight: presence of the coat `(..., 1)`.
        coat_color: transmittance of the coat `(..., 3)`.
        coat_roughness: the square root of its a `(..., 1)`.
        coat_ior: its index of refraction `(..., 1)`.
        coat_darkening: how much the coat darkens by light that it throws back `(..., 1)`.
        fuzz_weight: presence of the fuzz `(..., 1)`.
        fuzz_color: its colour `(..., 3)`.
        fuzz_roughness: its roughness `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: Z. Andersson, P. Edmondson, J. Guertault et al., OpenPBR Surface specification 1.1, 2024,
    https://academysoftwarefoundation.github.io/OpenPBR; its reference graph in MaterialX 1.39.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import OpenPBR
        >>> angle = torch.full((1,), 0.2)
        >>> OpenPBR(base_color=[0.8, 0.1, 0.1])(Pairs.from_half_diff(angle, angle, angle)).detach()
        tensor([[0.2493, 0.0340, 0.0340]])
    """
    base = (base_color, base_diffuse_roughness, base_metalness)
    specular = (specular_weight, specular_color, specular_roughness, specular_ior)
    coat = (coat_weight, coat_color, coat_roughness, coat_ior, coat_darkening)
    return value_of(OpenPBR)(pairs, *base, *specular, *coat, fuzz_weight, fuzz_color, fuzz_roughness)


def _color(start: float, doc: str, lower: float = 0.0) -> BoundedParameter:
    return BoundedParameter(start=start, lower=lower, upper=1.0, shape=(3,), doc=doc)


def _roughness(start: float, doc: str) -> BoundedParameter:
    return BoundedParameter(start=start, lower=0.032, upper=1.0, log=True, doc=doc)


def _ior(start: float, doc: str) -> BoundedParameter:
    return BoundedParameter(start=start, lower=1.02, upper=3.0, doc=doc)


@LOBES.register("openpbr")
class OpenPBR(LayeredMaterial):
    """OpenPBR's opaque surface, a whole material.

    `base_weight`, which only multiplies the base colour, is 1. Left out, as they are no opaque, isotropic reflection of
    one surface point: transmission, subsurface, thin film, anisotropy, emission. As in the reference graph the coat's
    colour does not depend on angles. Light that facets scatter more than once is left out.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import OpenPBR
        >>> OpenPBR(base_metalness=1, coat_weight=0).base_metalness.item()
        1.0
    """

    base_color: BoundedParameter = _color(0.5, "colour of diffuse reflection and of a metal, per channel")
    base_diffuse_roughness: BoundedParameter = share(0.3, "roughness of diffuse reflection")
    base_metalness: BoundedParameter = share(0.5, "share of metal")
    specular_weight: BoundedParameter = share(1.0, "strength of specular reflection")
    # Below 25/49 a dark metal would reflect less than nothing somewhere.
    specular_color: BoundedParameter = _color(1.0, "tint of it, of metals at 82 degrees, per channel", lower=0.52)
    specular_roughness: BoundedParameter = _roughness(0.3, "the square root of alpha")
    specular_ior: BoundedParameter = _ior(1.5, "index of refraction of a dielectric")
    coat_weight: BoundedParameter = share(0.1, "presence of the coat")
    coat_color: BoundedParameter = _color(1.0, "transmittance of the coat, per channel")
    coat_roughness: BoundedParameter = _roughness(0.2, "the square root of its alpha")
    coat_ior: BoundedParameter = _ior(1.6, "its index of refraction")
    coat_darkening: BoundedParameter = share(1.0, "how much the coat darkens what is below")
    fuzz_weight: BoundedParameter = share(0.05, "presence of the fuzz")
    fuzz_color: BoundedParameter = _color(0.5, "its colour, per channel")
    fuzz_roughness: BoundedParameter = BoundedParameter(start=0.5, lower=0.01, upper=1.0, doc="its roughness")
    function = staticmethod(openpbr)
    scalars_of_terms: ClassVar[tuple[str, ...]] = (
        *("base_diffuse_roughness", "specular_weight", "specular_roughness", "specular_ior"),
        *("coat_weight", "coat_roughness", "coat_ior", "fuzz_weight", "fuzz_roughness"),
    )

    @classmethod
    def layers(cls, pairs: Pairs, *scalars: Any) -> list[Any]:
        """Those of `layers_over` GGX's facets, of the roughness that is seen below the coat."""
        rough, weight, roughness, *rest = scalars
        alpha = below_coat(roughness, rest[1], rest[2])
        return layers_over(pairs, facets(pairs, alpha, ggx_visibility_and_log_derivative), alpha, rough, weight, *rest)

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """Of the terms in their order."""
        color, metalness, weight = parameters["base_color"], parameters["base_metalness"], parameters["specular_weight"]
        left = darkening(**parameters) * (1 + parameters["coat_weight"] * (parameters["coat_color"] - 1))
        body = EON.coefficients(albedo=color, roughness=parameters["base_diffuse_roughness"])
        plastic, metal = (1 - metalness) * left, metalness * weight * left
        return columns(
            parameters["fuzz_color"],
            torch.ones_like(color),
            plastic * parameters["specular_color"],
            *(plastic * one for one in body.unbind(-1)),
            *(metal * one for one in f82_colours(color, parameters["specular_color"])),
        )


def layers_over(
    pairs: Pairs,
    glossy: Any,
    alpha: Any,
    rough: Any,
    weight: Any,
    ior: Any,
    coat: Any,
    coat_roughness: Any,
    coat_ior: Any,
    fuzz_weight: Any,
    fuzz_roughness: Any,
) -> list[Any]:
    """Fuzz; coat; a dielectric's specular reflection; EON's two terms; the three of F82.

    Args:
        pairs: where values are wanted, `(..., N)`.
        glossy: D G / (4 cos_i cos_o) of the base.
        alpha: its width, below the coat.
        rough: `base_diffuse_roughness` of `openpbr`; those that follow are the others that `OpenPBR.terms` takes.
        weight: as of `openpbr`.
        ior: as of `openpbr`.
        coat: as of `openpbr`.
        coat_roughness: as of `openpbr`.
        coat_ior: as of `openpbr`.
        fuzz_weight: as of `openpbr`.
        fuzz_roughness: as of `openpbr`.
    """
    viewer, smith = lower_cosine(pairs), ggx_visibility_and_log_derivative
    taken = fuzz_albedo(viewer, fuzz_roughness)
    below_fuzz, coat_alpha = 1 - fuzz_weight * taken, coat_roughness**2
    below = below_fuzz * (1 - coat * ggx_albedo(viewer, coat_alpha, _f0(coat_ior)))
    eta = eta_below_coat(weight, ior, coat, coat_ior)
    main = below * glossy
    diffuse = below * (1 - ggx_albedo(viewer, alpha, _f0(eta)))
    return [
        fuzz_weight * fuzz(pairs, fuzz_roughness),
        below_fuzz * (coat * (facets(pairs, coat_alpha, smith) * fresnel_of(pairs, coat_ior))),
        main * fresnel_of(pairs, eta),
        *(diffuse * term for term in _body(pairs, rough)),
        main,
        main * schlick_weight(pairs),
        main * f82_weight(pairs),
    ]


def _f0(ior: Value) -> Value:
    return ((ior - 1) / (ior + 1)) ** 2


def _body(pairs: Pairs, roughness: Value) -> list[Value]:
    """The terms of EON."""
    if isinstance(roughness, Tensor):
        return EON.terms(pairs, roughness)
    terms, (slopes,) = EON.terms_and_jacobian(pairs, roughness.value)
    return [roughness.chain(term, partial(torch.as_tensor, slope)) for term, slope in zip(terms, slopes, strict=True)]


def below_coat(roughness: Value, coat: Value, coat_roughness: Value) -> Value:
    """alpha of the base, which looks rougher through a rough coat."""
    rougher = (roughness**4 + 2 * coat_roughness**4).clamp(0, 1) ** 0.25
    return (roughness + coat * (rougher - roughness)) ** 2


def eta_below_coat(weight: Value, ior: Value, coat: Value, coat_ior: Value) -> Value:
    """Index of refraction of the base, against the coat where that is present, whose F0 is scaled by the weight."""
    against = larger(ior / coat_ior, coat_ior / ior)
    eta = ior + coat * (against - ior)
    scaled = root(weight) * ((eta - 1) / (eta + 1))
    return (1 + scaled) / (1 - scaled)


def darkening(**parameters: Tensor) -> Tensor:
    """What light that the coat throws back to the base leaves of the base's colour."""
    color, ior = parameters["base_color"], parameters["coat_ior"]
    albedo = color * (1 + parameters["base_metalness"] * (parameters["specular_weight"] - 1))
    left = (1 - _f0(ior)) / ior.square()
    darkened = left / (1 - albedo * (1 - left))
    return 1 + parameters["coat_weight"] * parameters["coat_darkening"] * (darkened - 1)
