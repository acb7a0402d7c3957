"""The microfacet lobe whose slopes have Student's t-distribution."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamped_exp, log_secant, tangent
from torchbrdf.lobes._student_smith import LEAST, student_visibility, student_visibility_and_log_derivatives
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def student_t(pairs: Pairs, specular: Tensor, roughness: Tensor, exponent: Tensor, f0: Tensor) -> Tensor:
    """The lobe with Student's t-distribution of slopes (STD): specular * D G F / (4 cos_i cos_o).

    D = (1 + tan2_h / ((gamma - 1) sigma^2))^-gamma / (pi sigma^2 cos_h^4), G = 1 / (1 + Lambda(wi) + Lambda(wo)),
    Smith's with heights correlated, F = Schlick's Fresnel. gamma = 2 is GGX with a = sigma, a large gamma Beckmann's
    lobe with m = sigma. The shadowing is that of D, at every gamma, and would be complete at 1.5. Lambda is not the
    paper's rational approximation but exact, to 1e-13 in float64.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        roughness: sigma `(..., 1)`.
        exponent: gamma `(..., 1)`, above 1.5; below 1.501 it counts as that.
        f0: reflectance at normal incidence `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: M. Ribardiere, B. Bringier, D. Meneveaux and L. Simonot, STD: Student's t-Distribution of Slopes for
    Microfacet Based BSDFs, 2017, doi:10.1111/cgf.13137.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import student_t
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> student_t(pairs, colour, *torch.tensor([[0.1], [2.0], [0.3]]))
        tensor([[0.0108, 0.0215, 0.0323]])
    """
    exponent = exponent.clamp_min(LEAST)
    facets = _distribution(pairs, roughness, exponent) * student_visibility(pairs, roughness, exponent)
    return apply_albedo(pairs, facets * fresnel(f0, pairs), specular)


def _scaled(pairs: Pairs, roughness: Tensor, exponent: Tensor) -> Tensor:
    """tan2_h / ((gamma - 1) sigma^2)."""
    return tangent(pairs) / ((exponent - 1) * roughness.square())


def _distribution(pairs: Pairs, roughness: Tensor, exponent: Tensor) -> Tensor:
    """D."""
    falling = 2 * log_secant(pairs) - exponent * torch.log1p(_scaled(pairs, roughness, exponent))
    return clamped_exp(falling) / (math.pi * roughness.square())


@LOBES.register("student_t")
class StudentT(Lobe):
    """Student's t-distribution of slopes, from Beckmann's short tails past GGX's long ones.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import StudentT
        >>> StudentT(roughness=0.1, exponent=1.7)
        StudentT(specular=[0.5, 0.5, 0.5], roughness=0.1, exponent=1.7, f0=0.3)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.1, lower=0.001, upper=1.0, log=True, doc="sigma, the width of the distribution of slopes"
    )
    exponent: BoundedParameter = BoundedParameter(
        start=2.0, lower=1.51, upper=40.0, log=True, doc="gamma, how fast the tail falls; 2 is GGX"
    )
    f0: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.02, upper=1.0, affine=True, doc="reflectance at normal incidence"
    )
    function = staticmethod(student_t)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """Derivatives of log D, with u = tan2_h / ((gamma - 1) sigma^2), and those of G.

        By sigma: 2 (gamma u / (1 + u) - 1) / sigma; by gamma: gamma u / ((gamma - 1) (1 + u)) - log(1 + u).
        """
        roughness, exponent, f0 = scalars
        visibility, by_roughness, by_exponent = student_visibility_and_log_derivatives(pairs, roughness, exponent)
        scaled = _scaled(pairs, roughness, exponent)
        facets = _distribution(pairs, roughness, exponent) * visibility
        shape, share = facets * fresnel(f0, pairs), exponent * (scaled / (1 + scaled))
        by_roughness = by_roughness + (share - 1) * (2 / roughness)
        by_exponent = by_exponent + share / (exponent - 1) - torch.log1p(scaled)
        return [shape, shape * by_roughness, shape * by_exponent, facets * (1 - schlick_weight(pairs))]
