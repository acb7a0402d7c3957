"""Lafortune's generalized cosine lobe."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamped_exp, log_secant
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def lafortune(pairs: Pairs, specular: Tensor, cz: Tensor, exponent: Tensor) -> Tensor:
    """Lafortune's isotropic lobe: specular * (n + 2) / (2 pi) * (C / max(|C_xy|, C_z))^n.

    C = C_xy (x_i x_o + y_i y_o) + C_z z_i z_o, and 0 where that is below 0. As only the ratio of C_xy and C_z changes
    anything, C_xy is -1 here: `cz` is C_z / |C_xy| of published fits. 1 is Phong's lobe about the mirror direction;
    below 1 the lobe rises towards grazing directions and lies beyond the mirror direction.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        cz: C_z where C_xy is -1 `(..., 1)`.
        exponent: n `(..., 1)`; about a quarter of the exponent of a lobe of half vectors.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: E. Lafortune, S. Foo, K. Torrance and D. Greenberg, Non-linear Approximation of Reflectance Functions, 1997,
    doi:10.1145/258734.258801; isotropic and with this factor as in A. Ngan, F. Durand and W. Matusik, Experimental
    Analysis of BRDF Models, 2005, doi:10.2312/EGWR/EGSR05/117-126.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import lafortune
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> lafortune(pairs, colour, torch.tensor([0.9]), torch.tensor([20.0]))
        tensor([[0.0082, 0.0165, 0.0247]])
    """
    return apply_albedo(pairs, _power(_missing(pairs, cz), exponent), specular)


def _apart(pairs: Pairs) -> Tensor:
    """(1 - cos of the angle between wo and the mirror direction of wi) / 2, with all digits where that is near 0.

    It is cos_d^2 - cos_i cos_o = sin_h^2 cos_d^2 + (cos_i - cos_o)^2 / 4.
    """

    def make() -> Tensor:
        square = -torch.expm1(-log_secant(pairs)) * pairs.cos_d.square()
        return square + (pairs.cos_i - pairs.cos_o).square() / 4

    return pairs.cached(_apart, make)


def _missing(pairs: Pairs, cz: Tensor) -> Tensor:
    """1 - C / max(1, C_z), a sum of numbers of at least 0."""
    product = pairs.cos_i * pairs.cos_o
    aside = torch.where(cz < 1, product * (1 - cz), (1 - product) * (cz - 1))
    return (2 * _apart(pairs) + aside) / cz.clamp_min(1)


def _power(missing: Tensor, exponent: Tensor) -> Tensor:
    """(n + 2) / (2 pi) (1 - missing)^n; 0 from `missing` = 1 on."""
    positive = missing < 1
    logarithm = torch.log1p(-torch.where(positive, missing, 0))
    return torch.where(positive, clamped_exp(exponent * logarithm), 0) * ((exponent + 2) / (2 * math.pi))


@LOBES.register("lafortune")
class Lafortune(Lobe):
    """Lafortune's lobe with the factor of Ngan et al., all of whose fits have a `cz` of at most 1.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import Lafortune
        >>> Lafortune(cz=0.9, exponent=50.0)
        Lafortune(specular=[0.3, 0.3, 0.3], cz=0.9, exponent=50)
    """

    specular: BoundedParameter = albedo(start=0.3, upper=5.0, doc="specular albedo, per channel")
    cz: BoundedParameter = BoundedParameter(
        start=0.95, lower=0.0, upper=1.0, doc="C_z / |C_xy|; 1 is Phong's lobe, less rises to grazing"
    )
    exponent: BoundedParameter = BoundedParameter(
        start=50.0, lower=0.1, upper=50_000.0, log=True, doc="n, the sharpness of the lobe"
    )
    function = staticmethod(lafortune)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """With B = C / max(1, C_z), d/dn = shape (1 / (n + 2) + log(B)) and d/dC_z = shape n / B dB/dC_z.

        dB/dC_z is cos_i cos_o up to C_z = 1, and (C_xy part of C, negative) / C_z^2 beyond.
        """
        cz, exponent = scalars
        missing = _missing(pairs, cz)
        shape = _power(missing, exponent)
        positive = missing < 1
        height = torch.where(positive, 1 - missing, 1)
        product = pairs.cos_i * pairs.cos_o
        # -(x x + y y) is 1 - cos_i cos_o - 2 apart.
        slope = torch.where(cz < 1, product, (product + 2 * _apart(pairs) - 1) / cz.square())
        logarithm = torch.where(positive, torch.log1p(-torch.where(positive, missing, 0)), 0)
        return [shape, shape * (exponent * slope / height), shape * (1 / (exponent + 2) + logarithm)]
