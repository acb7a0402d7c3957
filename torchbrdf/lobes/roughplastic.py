"""Mitsuba's rough plastic: a diffuse base below a rough dielectric coat."""

import math
from typing import Any, ClassVar

import numpy as np
from torch import Tensor

from torchbrdf.lobes._rough_dielectric import COSINES, transmittances
from torchbrdf.lobes._sloped import LayeredMaterial, Value, facets, fresnel_of, linear
from torchbrdf.lobes._smith import ggx_separable_visibility_and_log_derivative
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter, share
from torchbrdf.lobes.separable import columns, value_of
from torchbrdf.pairs import Pairs


@half_in_float32
def roughplastic(pairs: Pairs, base_color: Tensor, specular: Tensor, roughness: Tensor, ior: Tensor) -> Tensor:
    """Mitsuba's `roughplastic` of the distribution `ggx`: specular D G F / (4 cos_i cos_o) + a diffuse base.

    The base is base_color / pi T(cos_i) T(cos_o) / (n^2 (1 - F_in)). D is that of `ggx`, G = G1(wi) G1(wo) (Smith,
    heights uncorrelated), F the reflectance of a dielectric of the index of refraction n, T the share of light that the
    coat lets in, the mean of (1 - F) G1(refracted) over the facets that the light sees, and F_in the share of diffuse
    light that it throws back from inside, that of F G1(reflected). As in Mitsuba T is taken at 64 cosines and is linear
    between them, and F_in is a mean over these. The shares themselves are right to 1e-4, and mostly to 2e-5; Mitsuba's
    own, by fewer facets, differ by up to 6e-4, and its values by up to 1.3e-3.

    Mitsuba's option `nonlinear` is off, as by default. A material with it is this one with other colours:
    base_color = c (1 - F_in) / (1 - c F_in).

    Args:
        pairs: where values are wanted, `(..., N)`.
        base_color: Mitsuba's `diffuse_reflectance` `(..., 3)`.
        specular: Mitsuba's `specular_reflectance` `(..., 1)`.
        roughness: a, Mitsuba's `alpha` `(..., 1)`.
        ior: n, Mitsuba's `int_ior` by its `ext_ior` `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: W. Jakob et al., Mitsuba 3, 2022, https://mitsuba-renderer.org; B. Walter, S. Marschner, H. Li and K.
    Torrance, Microfacet Models for Refraction through Rough Surfaces, 2007, doi:10.2312/EGWR/EGSR07/195-206.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import roughplastic
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> roughplastic(pairs, colour, *torch.tensor([[1.0], [0.1], [1.5]]))
        tensor([[0.0434, 0.0724, 0.1014]])
    """
    return value_of(RoughPlastic)(pairs, base_color, specular, roughness, ior)


def _between(table: Value, cosine: Tensor) -> Value:
    """Linear between the numbers of a table `(..., COSINES)`, `(..., N)`."""
    place = cosine.clamp(0, 1) * (COSINES - 1)
    low = place.detach().floor().clamp_max(COSINES - 2)
    index, share = low.long(), place - low

    def interpolated(numbers: Tensor) -> Tensor:
        lead = np.broadcast_shapes(numbers.shape[:-1], index.shape[:-1])
        wide, at = numbers.expand(*lead, COSINES), index.expand(*lead, index.shape[-1])
        below, above = wide.gather(-1, at), wide.gather(-1, at + 1)
        return below + share * (above - below)

    return linear(table, interpolated)


@LOBES.register("roughplastic")
class RoughPlastic(LayeredMaterial):
    """Mitsuba's rough plastic, a whole material: a diffuse base below a rough dielectric coat.

    Of the distribution `ggx`, and without `nonlinear`, which only changes what the numbers of a colour mean.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import RoughPlastic
        >>> RoughPlastic(base_color=[0.8, 0.1, 0.1], roughness=0.2)
        RoughPlastic(base_color=[0.8, 0.1, 0.1], specular=1, roughness=0.2, ior=1.5)
    """

    base_color: BoundedParameter = BoundedParameter(
        start=0.5, lower=0.0, upper=1.0, shape=(3,), doc="colour of the diffuse base, per channel"
    )
    specular: BoundedParameter = share(1.0, "strength of specular reflection, 1 by nature")
    roughness: BoundedParameter = BoundedParameter(
        start=0.1, lower=0.001, upper=1.0, log=True, doc="alpha, the width of the distribution"
    )
    ior: BoundedParameter = BoundedParameter(
        start=1.5, lower=1.02, upper=3.0, log=True, doc="index of refraction of the coat"
    )
    function = staticmethod(roughplastic)
    scalars_of_terms: ClassVar[tuple[str, ...]] = ("roughness", "ior")

    @classmethod
    def layers(cls, pairs: Pairs, *scalars: Any) -> list[Any]:
        """Diffuse and specular reflection."""
        roughness, ior = scalars
        into, out = transmittances(roughness, ior)
        body = _between(into, pairs.cos_i) * _between(into, pairs.cos_o) / (ior**2 * out) * (1 / math.pi)
        return [body, facets(pairs, roughness, ggx_separable_visibility_and_log_derivative) * fresnel_of(pairs, ior)]

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """The base's colour, and the strength of specular reflection."""
        return columns(parameters["base_color"], parameters["specular"])
