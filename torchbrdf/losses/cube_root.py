"""The cube root of the squared, cosine-weighted difference (eq. 10)."""

import torch
from torch import Tensor

from torchbrdf.color import safe_power
from torchbrdf.losses.base import LOSSES, Loss, cosine
from torchbrdf.losses.elementary import NEW, Out, power
from torchbrdf.pairs import Pairs
from torchbrdf.reduction import Reduction


@LOSSES.register("cube_root")
class CubeRootLoss(Loss):
    """sqrt(sum(((M cos_i - A cos_i)^2)^(1/3)) / n), the paper's eq. 10 read literally. Shapes as `Loss`.

    The outer n-th root in the paper is read as the square root of its eq. 8 and 9. The cube root has a cusp at zero
    difference d, so that each term is (d^2 + eps)^(1/3) - eps^(1/3): exact at eps = 0, where the gradient at d = 0 is
    defined as 0. The default changes a term by at most 1e-8, which is a difference of 1e-12.

    Args:
        reduction: "none" gives the error of each material, `(...)`; "mean" and "sum" a scalar.
        eps: rounds the cusp.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> pairs = Pairs.from_cosines(cos_i=torch.full((5,), 1.0))
        >>> CubeRootLoss()(torch.full((2, 5, 3), 9.0), torch.ones(2, 5, 3), pairs)
        tensor(2.)

    Source: A. Fores, J. Ferwerda and J. Gu, Toward a Perceptually Based Metric for BRDF Modeling, 2012,
    doi:10.2352/CIC.2012.20.1.art00025.
    """

    needs = ("cos_i",)
    # The last changes errors by less than 1e-3; without any, a fit ends in the nearest of countless kinks.
    smoothing_widths = (0.1, 0.01, 0.001)
    objective = "pointwise"

    def __init__(self, reduction: Reduction = "mean", eps: float = 1e-24) -> None:
        super().__init__(reduction)
        self.eps = eps

    def exposure(self, pairs: Pairs | None) -> Tensor:
        """cos_i."""
        return cosine(pairs)[..., 0]

    def pointwise(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
        """The cube root of the squared difference, which is taken first: equal values are then exactly equal."""
        return self.penalty((prediction - target) * cosine(pairs))

    def penalty(self, difference: Tensor) -> Tensor:
        """(d^2)^(1/3)."""
        if self.eps == 0:
            return safe_power(difference.square(), 1 / 3)
        root = self.eps ** (1 / 3)
        if not difference.requires_grad:
            square = difference.square().add_(self.eps)
            return power(square, 1 / 3, square).sub_(root).clamp_min_(0)
        # Near 0 in units of the cusp, where the second derivative of the power would overflow in float32.
        near = difference.abs() < 1e6 * self.eps**0.5
        square = torch.where(near, difference * self.eps**-0.5, difference).square()
        found = torch.where(near, square + 1, square + self.eps).pow(1 / 3)
        # In float32 the difference of two equal roots may round to just below 0.
        return (torch.where(near, found * root, found) - root).clamp_min(0)

    def penalty_with_derivatives(
        self, difference: Tensor, width: Tensor | None = None, out: Out = NEW
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Of (d^2 + width^2)^(1/3), with the parabola that touches it on both sides and is nowhere below it."""
        if width is None:
            rounding = difference.new_tensor(max(self.eps, torch.finfo(difference.dtype).tiny))
        else:
            rounding = width.square()
        if out[0] is None:  # digit for digit the same wherever a value is, which L-BFGS is sensitive to at cusps
            square = difference.square() + rounding
            root = square.pow(1 / 3)
            curvature = root / square * (2 / 3)
            return root, curvature * difference, curvature
        square = torch.addcmul(rounding, difference, difference, out=out[2])
        root = power(square, 1 / 3, out[0])
        curvature = torch.addcdiv(difference.new_zeros(()), root, square, value=2 / 3, out=out[2])
        return root, torch.mul(curvature, difference, out=out[1]), curvature
