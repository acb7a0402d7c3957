"""A rough conductor: GGX with a coloured Fresnel that has a tint near grazing angles."""

from typing import ClassVar

from torch import Tensor

from torchbrdf.lobes._microfacet import tangent
from torchbrdf.lobes._smith import ggx_visibility, ggx_visibility_and_log_derivative
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import f82_colours, f82_weight, schlick_weight
from torchbrdf.lobes.ggx import ggx_distribution
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.separable import Slopes, columns, value_of
from torchbrdf.pairs import Pairs


@half_in_float32
def ggx_f82(pairs: Pairs, f0: Tensor, f82: Tensor, roughness: Tensor, weight: Tensor) -> Tensor:
    """A rough conductor: weight * D G F / (4 cos_i cos_o), with D and G of `ggx`.

    F = S(cos_d) - (1 - tint) S(1/7) cos_d (1 - cos_d)^6 / (1/7 (6/7)^6), S Schlick's Fresnel: at cos_d = 1/7, 82
    degrees, F is tint * S.

    Args:
        pairs: where values are wanted, `(..., N)`.
        f0: reflectance at normal incidence `(..., 3)`.
        f82: the tint, reflectance at 82 degrees by what Schlick's is there `(..., 3)`.
        roughness: a `(..., 1)`; renderers' own "roughness" often is its square root.
        weight: its share `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: P. Kutz, M. Hasan and D. Edmondson, Novel aspects of the Adobe Standard Material, 2021; N. Hoffman, Fresnel
    Equations Considered Harmful, 2019, doi:10.2312/mam.20191305; the metals of OpenPBR.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ggx_f82
        >>> angle, gold = torch.full((1,), 0.2), torch.tensor([1.0, 0.71, 0.29])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> ggx_f82(pairs, gold, torch.ones(3), torch.tensor([0.1]), torch.tensor([1.0]))
        tensor([[0.3586, 0.2546, 0.1040]])
    """
    return value_of(GGXF82)(pairs, f0, f82, roughness, weight)


@LOBES.register("ggx_f82")
class GGXF82(Lobe):
    """A rough conductor, with coloured reflectance at normal incidence and a coloured tint at 82 degrees.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import GGXF82
        >>> GGXF82(f0=[1, 0.71, 0.29], roughness=0.1)
        GGXF82(f0=[1, 0.71, 0.29], f82=[1, 1, 1], roughness=0.1, weight=1)
    """

    f0: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.0, upper=1.0, shape=(3,), affine=True, doc="reflectance at normal incidence, per channel"
    )
    # Below 25/49 a dark F0 would reflect less than nothing somewhere.
    f82: BoundedParameter = BoundedParameter(
        start=1.0, lower=0.52, upper=1.0, shape=(3,), affine=True, doc="tint at 82 degrees, per channel"
    )
    roughness: BoundedParameter = BoundedParameter(
        start=0.1, lower=0.001, upper=1.0, log=True, doc="alpha, the width of the distribution"
    )
    weight: BoundedParameter = BoundedParameter(start=1.0, lower=0.0, upper=1.0, doc="share of the lobe", linear=True)
    function = staticmethod(ggx_f82)
    scalars_of_terms: ClassVar[tuple[str, ...]] = ("roughness",)

    @classmethod
    def terms(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """D G / (4 cos_i cos_o) times 1, `schlick_weight` and `f82_weight`."""
        (roughness,) = scalars
        return _terms(pairs, ggx_distribution(roughness, tangent(pairs)) * ggx_visibility(pairs, roughness))

    @classmethod
    def terms_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> tuple[list[Tensor], Slopes]:
        """d/da = term (2 / a - 4 a / (a^2 + tan2_h) + d log G / da)."""
        (roughness,) = scalars
        visibility, slope = ggx_visibility_and_log_derivative(pairs, roughness)
        facets = ggx_distribution(roughness, tangent(pairs)) * visibility
        slope = slope + 2 / roughness - 4 * roughness / (roughness.square() + tangent(pairs))
        return _terms(pairs, facets), [list[Tensor | None](_terms(pairs, facets * slope))]

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """Those of F."""
        colours = f82_colours(parameters["f0"], parameters["f82"])
        return columns(*(parameters["weight"] * colour for colour in colours))


def _terms(pairs: Pairs, facets: Tensor) -> list[Tensor]:
    return [facets, facets * schlick_weight(pairs), facets * f82_weight(pairs)]
