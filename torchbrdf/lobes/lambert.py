"""Lambert's diffuse reflection."""

import math
from typing import ClassVar

import torch
from torch import Tensor

from torchbrdf.lobes import parameter
from torchbrdf.lobes._microfacet import apply_albedo
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.pairs import Pairs


@half_in_float32
def lambert(pairs: Pairs, albedo: Tensor) -> Tensor:
    """Diffuse reflection: albedo / pi.

    Args:
        pairs: where values are wanted, `(..., N)`.
        albedo: diffuse albedo `(..., 3)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: the diffuse term of the paper's eq. 11.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import lambert
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> lambert(pairs, colour)
        tensor([[0.0318, 0.0637, 0.0955]])
    """
    return apply_albedo(pairs, torch.full_like(pairs.cos_i, 1 / math.pi), albedo)


@LOBES.register("lambert")
class Lambert(Lobe):
    """Diffuse reflection: albedo / pi.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import Lambert
        >>> Lambert(albedo=[0.3, 0.2, 0.1])
        Lambert(albedo=[0.3, 0.2, 0.1])
    """

    is_diffuse: ClassVar[bool] = True
    albedo: BoundedParameter = parameter.albedo(start=0.5, doc="diffuse albedo, per channel")
    function = staticmethod(lambert)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """1 / pi."""
        return [pairs.cached(lambert, lambda: torch.full_like(pairs.cos_i, 1 / math.pi))]
