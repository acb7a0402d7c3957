"""Cosine-weighted root mean square error with the solid angle of a bin as weight."""

import math
from typing import ClassVar

from torch import Tensor

from torchbrdf.losses.base import LOSSES
from torchbrdf.losses.cosine import CosineRMSLoss
from torchbrdf.pairs import Pairs

# Radians that angles are kept from 0, and theta_d from 90 degrees: all of no solid angle would have no mean.
NARROWEST = 1e-6


@LOSSES.register("solid_angle_cosine_rms")
class SolidAngleCosineRMSLoss(CosineRMSLoss):
    """sqrt(sum(w (M cos_i - A cos_i)^2) / sum(w)). Shapes as `Loss`.

    w is the solid angle d(omega_i) d(omega_o) that a MERL bin stands for, but for a constant:
    sqrt(theta_h) sin(theta_h) sin(theta_d) cos(theta_d), since d(omega_i) d(omega_o) = 4 cos(theta_d) d(omega_h)
    d(omega_d) and MERL's bins are equal in sqrt(theta_h). On pairs that were drawn in another way the matching
    weight is theirs: use CosineRMSLoss and pass it. Angles count as at least 1e-6, so that exact mirror pairs alone,
    which have no solid angle, still have a mean.

    Source: the metric of A. Ngan, F. Durand and W. Matusik, Experimental Analysis of BRDF Models, 2005,
    doi:10.2312/EGWR/EGSR05/117-126, "weighted by the cosine and the solid angle"; the formula of w is our reading.

    Args:
        reduction: "none" gives the error of each material, `(...)`; "mean" and "sum" a scalar.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> pairs = Pairs.from_half_diff(*torch.full((3, 5), 0.5))
        >>> bool(SolidAngleCosineRMSLoss()(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3), pairs) > 1)
        True
    """

    needs: ClassVar[tuple[str, ...]] = ("cos_i", "theta_h", "theta_d")

    def sample_weight(self, pairs: Pairs) -> Tensor | None:
        """The solid angle."""
        return solid_angle(pairs)


def solid_angle(pairs: Pairs) -> Tensor:
    """What a MERL bin at these angles covers of d(omega_i) d(omega_o), but for a constant, `(..., N)`."""
    theta_h, theta_d = pairs.theta_h.clamp_min(NARROWEST), pairs.theta_d.clamp(NARROWEST, math.pi / 2 - NARROWEST)
    return theta_h.sqrt() * theta_h.sin() * theta_d.sin() * theta_d.cos()
